"""MATLAB `.mat` files up to version 7 whose vectors are the signals."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeGuard

import numpy as np
from scipy.io import loadmat, whosmat

from hitchid.errors import LogError
from hitchid.readers.table import Table

SUFFIXES = (".mat",)


def column_names(path: Path) -> list[str]:
    """Return the names of the real vectors in the file.

    Raises:
        LogError: the file cannot be read.
    """
    try:
        shapes = whosmat(path)
    except Exception as error:  # scipy raises whatever a damaged file leads it to
        raise LogError(path, f"cannot be read as a MATLAB file up to version 7: {error}") from error
    return [name for name, shape, kind in shapes if _is_vector(shape) and kind != "char"]


def read_table(path: Path, wanted: Sequence[str]) -> Table:
    """Read the wanted vectors of a MATLAB file.

    Raises:
        LogError: the file cannot be read, or a wanted vector is missing, not real, or of another length.
    """
    names = column_names(path)
    for name in wanted:
        if name not in names:
            raise LogError(
                path, f"there is no such vector; required it, found {', '.join(names)}", column=name
            )
    content = _load(path, wanted)
    columns = {}
    for name in wanted:
        values = content.get(name)
        if not _is_real(values):
            raise LogError(path, "required a real numeric vector", column=name)
        columns[name] = values.astype(np.float64).ravel()
        if columns[name].size != columns[wanted[0]].size:
            raise LogError(
                path,
                f"has {columns[name].size} samples, required {columns[wanted[0]].size} as '{wanted[0]}'",
                column=name,
            )
    return Table(path, columns)


def read_rows(path: Path, like: str) -> tuple[list[str], list[list[str]]]:
    """Return the vectors as long as `like`, as a header and rows of text."""
    length = read_table(path, [like]).columns[like].size
    content = _load(path, column_names(path))
    columns = {
        name: values.ravel().tolist()
        for name, values in content.items()
        if _is_real(values) and _is_vector(values.shape) and values.size == length
    }
    return list(columns), [[repr(value) for value in row] for row in zip(*columns.values(), strict=True)]


def _load(path: Path, names: Sequence[str]) -> dict:
    try:
        return loadmat(path, variable_names=list(names))
    except Exception as error:  # scipy raises whatever a damaged file leads it to
        raise LogError(path, f"cannot be read as a MATLAB file up to version 7: {error}") from error


def _is_real(values: object) -> TypeGuard[np.ndarray]:
    return isinstance(values, np.ndarray) and values.dtype.kind in "fiub"


def _is_vector(shape: tuple[int, ...]) -> bool:
    return len(shape) == 2 and min(shape) == 1 and max(shape) > 1
