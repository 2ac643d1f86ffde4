"""MATLAB files up to version 7, read by scipy after a check of all declared sizes."""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.formats.library import as_log_errors, is_matrix, is_vector
from hitchid.logs.formats.mat.tree import Leaf, LoadVariables

KIND = "a MATLAB file up to version 7"
NUMERIC_CLASSES = (
    "double",
    "single",
    "logical",
    *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64)),
)
# From the MAT-file format: bytes of the header; data types of elements; class of sparse arrays.
HEADER, MATRIX, COMPRESSED, SPARSE = 128, 14, 15, 5
MAX_COMPRESSION_RATIO = 1032  # largest of zlib
MAX_EMPTY_STRUCTS = 10_000  # accepted structs without fields, which take no bytes; chosen
StructValue = Any  # of scipy.io.loadmat, which has no types


@contextmanager
def open_log(path: Path) -> Iterator[tuple[Mapping[str, object], LoadVariables]]:
    """Open a MATLAB file: the tree of its content, and a function that loads variables of plain numbers."""
    from scipy.io import whosmat  # not at the top: a quarter of a second

    with as_log_errors(path, KIND):
        check_sizes(path)
        # Names that scipy adds begin with two underscores, which no name in MATLAB does.
        listing = [variable for variable in whosmat(path) if not variable[0].startswith("__")]
    structs = _load_variables(path, [name for name, _, kind in listing if kind == "struct"])
    tree: dict[str, object] = {}
    for name, shape, kind in listing:
        if kind in NUMERIC_CLASSES and (is_vector(shape) or is_matrix(shape)):
            tree[name] = Leaf(tuple(shape), lambda variables, name=name: variables[name], name)
        elif kind == "struct":
            tree[name] = _node(structs[name])
    yield tree, partial(_load_variables, path)


def check_sizes(path: Path) -> None:
    """Check that the parts of a file of version 5 to 7 lie within it and are no larger than their bytes."""
    with path.open("rb") as stream:
        header = stream.read(HEADER)
        order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
        if order is None:  # version 4, or another format: scipy raises
            return
        size, position = stream.seek(0, 2), HEADER
        while position < size:
            stream.seek(position)
            kind, length = _read_tag(stream.read(8), order)
            end = position + 8 + length
            if end > size:
                raise LogError(path, f"is truncated: a variable ends at byte {end}, the file has {size}")
            _check_declared_size(path, stream, order, kind, length)
            position = end


def _read_tag(block: bytes, order: str) -> tuple[int, int]:
    if len(block) < 8:
        return 0, 1 << 32  # cut within the tag: beyond any end
    first, second = np.frombuffer(block[:8], f"{order}u4").tolist()
    return first, second


def _check_declared_size(path: Path, stream: BinaryIO, order: str, kind: int, length: int) -> None:
    head = stream.read(min(length, 2048))
    if kind == COMPRESSED:
        head = zlib.decompressobj().decompress(head, 512)
        if len(head) < 8:
            return
        kind, packed_length, length = *_read_tag(head, order)[:1], length, _read_tag(head, order)[1]
        if length > MAX_COMPRESSION_RATIO * packed_length:
            raise LogError(
                path, f"cannot be read as {KIND}: {packed_length} bytes declare {length} unpacked bytes"
            )
        head = head[8:]
    if kind != MATRIX or len(head) < 24:
        return
    numbers = np.frombuffer(head[: len(head) // 4 * 4], f"{order}u4").tolist()
    shape = numbers[6 : 6 + min(numbers[5] // 4, 32)]
    count = int(np.prod(shape, dtype=object))
    if numbers[2] & 0xFF != SPARSE and count > max(length, MAX_EMPTY_STRUCTS):
        raise LogError(path, f"cannot be read as {KIND}: {length} bytes declare {count} values")


def _load_variables(path: Path, names: Sequence[str]) -> dict[str, StructValue]:
    from scipy.io import loadmat

    if not names:
        return {}
    with as_log_errors(path, KIND):
        loaded = loadmat(path, variable_names=list(names))
    return {name: loaded[name] for name in names}


def _node(value: Any) -> object:
    """Return the node of a value loaded by scipy and of all in it; None for a value without numbers."""
    if type(value) is not np.ndarray:  # objects and functions are subclasses of the array
        return None
    if value.dtype.names is not None:
        structs = [{name: _node(struct[name]) for name in value.dtype.names} for struct in value.ravel()]
        return structs[0] if len(structs) == 1 else structs
    if value.dtype.kind == "U":
        return str(value[0]) if value.size == 1 else None
    return Leaf(value.shape, lambda _: value) if value.dtype.kind in "fiub" else None
