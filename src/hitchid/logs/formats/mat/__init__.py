"""MATLAB `.mat` files of any version: vectors, structs of them, exports of ControlDesk and Simulink."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.formats.hdf5 import NUMERIC_KINDS, is_external, read_dataset
from hitchid.logs.formats.library import (
    as_log_errors,
    floats,
    import_optional,
    match_clocked_channels,
    to_seconds,
)
from hitchid.logs.formats.mat import version5
from hitchid.logs.formats.mat.tree import ChannelSource, Leaf, LoadVariables, channels_of

SUFFIXES = (".mat",)
KIND = "a MATLAB file"


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected vectors of a MATLAB file; the time is optional where each signal has one."""
    with as_log_errors(path, KIND):
        open_log = _open_73 if _is_hdf5(path) else version5.open_log
        with open_log(path) as (tree, load_variables):
            sources = channels_of(tree)
            clocked = {name for name, source in sources.items() if source.time}
            matches = match_clocked_channels(path, list(sources), selection, clocked)
            selected = {requested: sources[name] for requested, name in matches.items()}
            leaves = [leaf for c in selected.values() for leaf in (c.values, c.time) if leaf]
            variables = load_variables([leaf.variable for leaf in leaves if leaf.variable])
            channels = _channels(path, selected, variables, strict=selection.signals is not None)
    return Content(path, channels)


def _channels(
    path: Path, selected: Mapping[str, ChannelSource], variables: Mapping[str, np.ndarray], *, strict: bool
) -> dict[str, LogChannel]:
    channels: dict[str, LogChannel] = {}
    clocks: dict[int, np.ndarray] = {}
    for requested, source in selected.items():
        values = source.values.load(variables)
        if values.dtype.kind not in "fiub":
            if strict:
                raise LogError(path, "expected a real numeric vector", column=requested)
            continue  # whether a vector is complex is known only after reading
        clock_s = None
        if source.time is not None:
            if id(source.time) not in clocks:
                clocks[id(source.time)] = to_seconds(floats(source.time.load(variables)), source.time_unit)
            clock_s = clocks[id(source.time)]
        channels[requested] = LogChannel(floats(values), source.unit, clock_s)
    return channels


# Version 7.3: an HDF5 file, in which groups are structs.

SIGNATURE = b"\x89HDF\r\n\x1a\n"
SIGNATURE_OFFSETS = (0, 512)  # bytes; MATLAB puts a header of 512 bytes in front
MAX_DEPTH = 30  # nested structs; chosen
NON_NUMERIC_CLASSES = ("char", "cell", "struct", "function_handle", "table", "string", "categorical")


def _is_hdf5(path: Path) -> bool:
    """Return whether a file is HDF5 inside."""
    with path.open("rb") as stream:
        head = stream.read(SIGNATURE_OFFSETS[-1] + len(SIGNATURE))
    return any(head[offset:].startswith(SIGNATURE) for offset in SIGNATURE_OFFSETS)


@contextmanager
def _open_73(path: Path) -> Iterator[tuple[Mapping[str, object], LoadVariables]]:
    """Open a MATLAB 7.3 file: the tree of its content, whose leaves load themselves."""
    h5py = import_optional("h5py", "hdf5", path)
    with h5py.File(path, "r") as file:
        yield _fields(_Reader(h5py, path), file, 0), lambda _: {}


class _Reader(NamedTuple):
    h5py: Any
    path: Path


class _Column(NamedTuple):
    """One field of an array of structs: a node for each struct."""

    nodes: list[object]


def _fields(reader: _Reader, group: Any, depth: int) -> dict[str, object]:
    fields: dict[str, object] = {}
    for name in group if depth < MAX_DEPTH else ():
        if name.startswith("#"):  # targets of references
            continue
        link = group.get(name, getlink=True)
        if isinstance(link, reader.h5py.ExternalLink):
            fields[name] = _external_leaf(reader, f"{group.name}/{name}")
        elif isinstance(link, reader.h5py.HardLink):
            fields[name] = _node(reader, group[name], depth + 1)
    return fields


def _node(reader: _Reader, item: Any, depth: int) -> object:
    if isinstance(item, reader.h5py.Group):
        if "MATLAB_sparse" in item.attrs:
            return None
        fields = _fields(reader, item, depth)
        columns = {name: inner.nodes for name, inner in fields.items() if isinstance(inner, _Column)}
        lengths = {len(inner) for inner in columns.values()}
        if len(columns) != len(fields) or len(lengths) != 1:
            return fields
        # MATLAB keeps an array of structs as one group, each field of which refers to the values of all.
        return [{name: inner[k] for name, inner in columns.items()} for k in range(lengths.pop())]
    if not isinstance(item, reader.h5py.Dataset):
        return None
    return _external_leaf(reader, item.name) if is_external(item) else _array(reader, item, depth)


def _array(reader: _Reader, item: Any, depth: int) -> object:
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode("ascii", errors="replace") if isinstance(kind, bytes) else str(kind)
    if "MATLAB_empty" in item.attrs or item.shape is None:
        return None
    if kind == "char" and item.dtype.kind == "u" and item.ndim == 2:
        return "".join(map(chr, item[()].ravel().tolist())) if min(item.shape) == 1 else None
    if kind == "" and item.dtype == reader.h5py.ref_dtype:  # one field of an array of structs
        return _Column([_node(reader, item.file[reference], depth + 1) for reference in item[()].ravel()])
    if item.dtype.kind in NUMERIC_KINDS and kind not in NON_NUMERIC_CLASSES:
        # MATLAB stores the transpose.
        return Leaf(item.shape[::-1], lambda _: read_dataset(reader.path, item, item.name.lstrip("/")).T)
    return None


def _external_leaf(reader: _Reader, name: str) -> Leaf:
    return Leaf((2,), lambda _: read_dataset(reader.path, None, name.lstrip("/")))
