"""MATLAB `.mat` files up to version 7 whose vectors are the signals."""

from collections.abc import Sequence
from pathlib import Path

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
    try:
        content = loadmat(path, variable_names=list(wanted))
    except Exception as error:  # scipy raises whatever a damaged file leads it to
        raise LogError(path, f"cannot be read as a MATLAB file up to version 7: {error}") from error
    columns = {}
    for name in wanted:
        values = content.get(name)
        if values is None or not np.issubdtype(values.dtype, np.number) or np.iscomplexobj(values):
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
    shapes = {name: max(shape) for name, shape, _ in whosmat(path) if _is_vector(shape)}
    names = [name for name in column_names(path) if shapes[name] == shapes[like]]
    table = read_table(path, names)
    columns = [table.columns[name].tolist() for name in names]
    return names, [[repr(value) for value in row] for row in zip(*columns, strict=True)]


def _is_vector(shape: tuple[int, ...]) -> bool:
    return len(shape) == 2 and min(shape) == 1 and max(shape) > 1
