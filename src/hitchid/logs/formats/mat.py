"""MATLAB `.mat` files of any version: vectors, structs of them, exports of ControlDesk and Simulink."""

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.formats.hdf5 import NUMERIC_KINDS, is_external, read_dataset
from hitchid.logs.formats.library import (
    as_log_errors,
    column_names,
    column_of,
    floats,
    import_optional,
    is_matrix,
    is_vector,
    match_clocked_channels,
    to_seconds,
    unique_names,
)

SUFFIXES = (".mat",)
KIND = "a MATLAB file"

# Loads variables of plain numbers, all at once: each loading runs through the whole file.
LoadVariables = Callable[[Sequence[str]], None]


class Leaf(NamedTuple):
    """An array of numbers, loaded on demand.

    Attributes:
        shape: its shape.
        load: returns the numbers.
        variable: the variable that must be loaded first; None if there is none.
    """

    shape: tuple[int, ...]
    load: Callable[[], np.ndarray]
    variable: str | None = None


class ChannelSource(NamedTuple):
    """The arrays of a channel and of its time, with their units."""

    values: Leaf
    unit: str | None = None
    time: Leaf | None = None
    time_unit: str | None = None


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected vectors of a MATLAB file; the time is optional where each signal has one."""
    with as_log_errors(path, KIND):
        with path.open("rb") as stream:
            head = stream.read(SIGNATURE_OFFSETS[-1] + len(SIGNATURE))
        is_hdf5 = any(head[offset:].startswith(SIGNATURE) for offset in SIGNATURE_OFFSETS)
        with (_open_73 if is_hdf5 else _open_5)(path) as (tree, load_variables):
            sources = channels_of(tree)
            clocked = {name for name, source in sources.items() if source.time}
            matches = match_clocked_channels(path, list(sources), selection, clocked)
            selected = {requested: sources[name] for requested, name in matches.items()}
            leaves = [leaf for c in selected.values() for leaf in (c.values, c.time) if leaf]
            load_variables([leaf.variable for leaf in leaves if leaf.variable])
            channels = _channels(path, selected, strict=selection.signals is not None)
    return Content(path, channels)


def _channels(path: Path, selected: Mapping[str, ChannelSource], *, strict: bool) -> dict[str, LogChannel]:
    channels: dict[str, LogChannel] = {}
    clocks: dict[int, np.ndarray] = {}
    for requested, source in selected.items():
        values = source.values.load()
        if values.dtype.kind not in "fiub":
            if strict:
                raise LogError(path, "expected a real numeric vector", column=requested)
            continue  # whether a vector is complex is known only after reading
        clock_s = None
        if source.time is not None:
            if id(source.time) not in clocks:
                clocks[id(source.time)] = to_seconds(floats(source.time.load()), source.time_unit)
            clock_s = clocks[id(source.time)]
        channels[requested] = LogChannel(floats(values), source.unit, clock_s)
    return channels


# The content of a file of any version: structs, lists of structs, numbers, texts.


def channels_of(tree: Mapping[str, object]) -> dict[str, ChannelSource]:
    """Return full name to source of every vector of numbers in a file, and of every column of a matrix.

    Fields of structs are named `log/stroke`; signals of a ControlDesk export by their own name, those of a
    Simulink structure with time `out/label`; columns `data(:,2)`, where samples are along the longer side.
    """
    # One export needs no prefix: signals keep the names they have in the model.
    exports = sum(_is_control_desk(node) for node in tree.values())
    pairs: list[tuple[str, ChannelSource]] = []
    for name, node in tree.items():
        if isinstance(node, dict) and _is_control_desk(node):
            pairs += _control_desk(node, f"{name}/" if exports > 1 else "")
        else:
            pairs += _plain_channels(name, node)
    names = unique_names([name for name, _ in pairs])
    return dict(zip(names, (source for _, source in pairs), strict=True))


def _plain_channels(name: str, node: object) -> list[tuple[str, ChannelSource]]:
    if isinstance(node, Leaf):
        return [(column, ChannelSource(leaf)) for column, leaf in _columns(name, node)]
    if not isinstance(node, dict):
        return []
    if isinstance(time := node.get("time"), Leaf) and is_vector(time.shape) and "signals" in node:
        return _simulink(name, time, _struct_list(node["signals"]))
    return [pair for field, inner in node.items() for pair in _plain_channels(f"{name}/{field}", inner)]


def _is_control_desk(node: object) -> bool:
    if not isinstance(node, dict) or not {"X", "Y"} <= node.keys():
        return False
    axes, signals = _struct_list(node["X"]), _struct_list(node["Y"])
    return bool(axes and signals) and "Data" in axes[0] and {"Name", "Data"} <= signals[0].keys()


def _control_desk(node: Mapping[str, object], prefix: str) -> list[tuple[str, ChannelSource]]:
    axes = _struct_list(node["X"])
    pairs = []
    for number, signal in enumerate(_struct_list(node["Y"]), start=1):
        data = signal.get("Data")
        if isinstance(data, Leaf) and is_vector(data.shape):
            axis = _axis(axes, signal.get("XIndex"), data)
            time = axis.get("Data")
            clock = time if isinstance(time, Leaf) else None
            unit, time_unit = _text(signal.get("Unit")), _text(axis.get("Unit"))
            name = _text(signal.get("Name")) or str(number)
            pairs.append((f"{prefix}{name}", ChannelSource(data, unit, clock, time_unit)))
    return pairs


def _axis(axes: Sequence[Mapping[str, object]], index: object, data: Leaf) -> Mapping[str, object]:
    """Return the axis of a signal's index, from 1, else the first of equal length, else an empty one."""
    matching = [
        number for number, axis in enumerate(axes, start=1) if _length(axis.get("Data")) == max(data.shape)
    ]
    axis_number = int(np.ravel(index.load())[0]) if isinstance(index, Leaf) and _length(index) == 1 else 0
    if axis_number in matching:
        return axes[axis_number - 1]
    return axes[matching[0] - 1] if matching else {}


def _simulink(
    name: str, time: Leaf, signals: Sequence[Mapping[str, object]]
) -> list[tuple[str, ChannelSource]]:
    pairs = [(f"{name}/time", ChannelSource(time, "s", time))]
    for number, signal in enumerate(signals, start=1):
        values = signal.get("values")
        if isinstance(values, Leaf) and _length(values) == _length(time):
            label = _text(signal.get("label")) or f"signals({number})"
            columns = _columns(f"{name}/{label}", values)
            pairs += [(column, ChannelSource(leaf, None, time)) for column, leaf in columns]
    return pairs


def _columns(name: str, leaf: Leaf) -> list[tuple[str, Leaf]]:
    """Return a vector under its own name, or the columns of a matrix."""
    if is_vector(leaf.shape):
        return [(name, leaf)]
    if not is_matrix(leaf.shape):
        return []
    return [
        (column, Leaf((max(leaf.shape),), lambda k=k: column_of(leaf.load(), k), leaf.variable))
        for k, column in enumerate(column_names(name, leaf.shape))
    ]


def _struct_list(node: object) -> list[Mapping[str, object]]:
    return [node] if isinstance(node, dict) else node if isinstance(node, list) else []


def _length(node: object) -> int:
    return max(node.shape, default=0) if isinstance(node, Leaf) else 0


def _text(node: object) -> str | None:
    return (node.strip() or None) if isinstance(node, str) else None


# Up to version 7: read by scipy after a check of all declared sizes.

KIND_5 = "a MATLAB file up to version 7"
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
def _open_5(path: Path) -> Iterator[tuple[Mapping[str, object], LoadVariables]]:
    """Open a MATLAB file: the tree of its content, and a function that loads variables of plain numbers."""
    from scipy.io import whosmat  # not at the top: a quarter of a second

    with as_log_errors(path, KIND_5):
        _check_sizes(path)
        # Names that scipy adds begin with two underscores, which no name in MATLAB does.
        listing = [variable for variable in whosmat(path) if not variable[0].startswith("__")]
    loaded: dict[str, np.ndarray] = {}
    structs = _load_variables(path, [name for name, _, kind in listing if kind == "struct"])
    tree: dict[str, object] = {}
    for name, shape, kind in listing:
        if kind in NUMERIC_CLASSES and (is_vector(shape) or is_matrix(shape)):
            tree[name] = Leaf(tuple(shape), partial(loaded.__getitem__, name), name)
        elif kind == "struct":
            tree[name] = _node_5(structs[name])
    yield tree, lambda names: loaded.update(_load_variables(path, names))


def _check_sizes(path: Path) -> None:
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
                path, f"cannot be read as {KIND_5}: {packed_length} bytes declare {length} unpacked bytes"
            )
        head = head[8:]
    if kind != MATRIX or len(head) < 24:
        return
    numbers = np.frombuffer(head[: len(head) // 4 * 4], f"{order}u4").tolist()
    shape = numbers[6 : 6 + min(numbers[5] // 4, 32)]
    count = int(np.prod(shape, dtype=object))
    if numbers[2] & 0xFF != SPARSE and count > max(length, MAX_EMPTY_STRUCTS):
        raise LogError(path, f"cannot be read as {KIND_5}: {length} bytes declare {count} values")


def _load_variables(path: Path, names: Sequence[str]) -> dict[str, StructValue]:
    from scipy.io import loadmat

    if not names:
        return {}
    with as_log_errors(path, KIND_5):
        loaded = loadmat(path, variable_names=list(names))
    return {name: loaded[name] for name in names}


def _node_5(value: Any) -> object:
    """Return the node of a value loaded by scipy and of all in it; None for a value without numbers."""
    if type(value) is not np.ndarray:  # objects and functions are subclasses of the array
        return None
    if value.dtype.names is not None:
        structs = [{name: _node_5(struct[name]) for name in value.dtype.names} for struct in value.ravel()]
        return structs[0] if len(structs) == 1 else structs
    if value.dtype.kind == "U":
        return str(value[0]) if value.size == 1 else None
    return Leaf(value.shape, lambda: value) if value.dtype.kind in "fiub" else None


# Version 7.3: an HDF5 file, in which groups are structs.

SIGNATURE = b"\x89HDF\r\n\x1a\n"
SIGNATURE_OFFSETS = (0, 512)  # bytes; MATLAB puts a header of 512 bytes in front
MAX_DEPTH = 30  # nested structs; chosen
NON_NUMERIC_CLASSES = ("char", "cell", "struct", "function_handle", "table", "string", "categorical")


@contextmanager
def _open_73(path: Path) -> Iterator[tuple[Mapping[str, object], LoadVariables]]:
    """Open a MATLAB 7.3 file: the tree of its content, whose leaves load themselves."""
    h5py = import_optional("h5py", "hdf5", path)
    with h5py.File(path, "r") as file:
        yield _fields(_Reader(h5py, path), file, 0), lambda _: None


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
        return Leaf(item.shape[::-1], lambda: read_dataset(reader.path, item, item.name.lstrip("/")).T)
    return None


def _external_leaf(reader: _Reader, name: str) -> Leaf:
    return Leaf((2,), lambda: read_dataset(reader.path, None, name.lstrip("/")))
