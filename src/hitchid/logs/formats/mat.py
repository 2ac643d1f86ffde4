"""MATLAB `.mat` files of any version, as trees of structs, cells, numbers and texts."""

import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.formats.hdf5 import NUMERIC_KINDS, is_external, read_dataset
from hitchid.logs.formats.library import (
    MAX_COLUMNS,
    as_log_errors,
    floats,
    import_optional,
    match_clocked_channels,
    to_seconds,
)
from hitchid.logs.formats.mat_content import channels_of, is_entry
from hitchid.logs.formats.mat_experiments import rival_time
from hitchid.logs.formats.mat_tree import TO_STRUCT, ChannelSource, HiddenObject, Leaf, hidden_objects

SUFFIXES = (".mat",)
KIND = "a MATLAB file"

# Loads variables of plain numbers, all at once: each loading runs through the whole file.
LoadVariables = Callable[[Sequence[str]], None]


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected vectors of a MATLAB file; the time is optional where each signal has one."""
    with as_log_errors(path, KIND):
        with path.open("rb") as stream:
            head = stream.read(SIGNATURE_OFFSETS[-1] + len(SIGNATURE))
        is_hdf5 = any(head[offset:].startswith(SIGNATURE) for offset in SIGNATURE_OFFSETS)
        with (_open_73 if is_hdf5 else _open_5)(path) as (tree, load_variables):
            sources, hidden = channels_of(tree), hidden_objects(tree, path.name)
            if hidden and not sources:
                raise LogError(path, hidden)
            try:
                selected = _selected(path, sources, selection)
            except LogError as error:
                if not hidden:
                    raise
                raise LogError(path, f"{error.problem}; {hidden}", column=error.column) from error
            load_variables(_variables_of(selected.values()))
            if any(source.from_period for source in selected.values()):
                load_variables(_variables_of(sources.values()))
                if rival := rival_time(sources, selected.values()):
                    if selection.signals is not None:
                        problem = (
                            "rises like a time, which the sampling time beside it does not settle; name it"
                        )
                        raise LogError(path, problem, column=rival)
                    selected = _without_periods(selected)
            channels = _channels(path, selected, strict=selection.signals is not None)
    notices = dict.fromkeys(source.note for source in selected.values() if source.note)
    if hidden and selection.signals is None:
        notices[f"left out: {hidden}"] = None
    return Content(path, channels, tuple(notices))


def _selected(
    path: Path, sources: Mapping[str, ChannelSource], selection: ChannelSelection
) -> dict[str, ChannelSource]:
    """Return requested name to source; a time that is named goes before one from a sampling time."""
    channels = dict(sources)
    if selection.signals is not None:
        channels |= {
            source.alias: source
            for source in sources.values()
            if source.alias and source.alias not in channels
        }
    clocked = {name for name, source in channels.items() if source.time}
    # Entries of cells and arrays may have short names like those of the plain structs beside them.
    plain = [name for name in channels if selection.signals is None or not is_entry(name)]
    try:
        matches = match_clocked_channels(path, plain, selection, clocked)
    except LogError:
        matches = match_clocked_channels(path, list(channels), selection, clocked)
    selected = {requested: channels[name] for requested, name in matches.items()}
    is_named = selection.signals is not None and selection.time in matches
    return _without_periods(selected) if is_named else selected


def _without_periods(sources: Mapping[str, ChannelSource]) -> dict[str, ChannelSource]:
    """Return channels without the clocks that a sampling time gives."""
    bare = {"time": None, "note": None}
    return {
        name: source._replace(**bare) if source.from_period else source for name, source in sources.items()
    }


def _variables_of(sources: Iterable[ChannelSource]) -> list[str]:
    leaves = [leaf for source in sources for leaf in (source.values, source.time) if leaf]
    return [leaf.variable for leaf in leaves if leaf.variable]


def _channels(path: Path, selected: Mapping[str, ChannelSource], *, strict: bool) -> dict[str, LogChannel]:
    channels: dict[str, LogChannel] = {}
    clocks: dict[int, np.ndarray] = {}
    for requested, source in selected.items():
        values = source.values.load()
        if values.dtype.kind not in "fiub":
            if strict:
                raise LogError(path, "expected a real numeric vector", column=requested)
            continue  # only reading shows whether a vector is complex
        clock_s = None
        if source.time is not None:
            if id(source.time) not in clocks:
                clocks[id(source.time)] = to_seconds(floats(source.time.load()), source.time_unit)
            clock_s = clocks[id(source.time)]
        channels[requested] = LogChannel(floats(values), source.unit, clock_s)
    return channels


# Up to version 7: read by scipy after a check of all declared sizes.

KIND_5 = "a MATLAB file up to version 7"
NUMERIC_CLASSES = (
    "double",
    "single",
    "logical",
    *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64)),
)
# From the MAT-file format: bytes of the header; data types of elements; classes of arrays by number.
HEADER, MATRIX, COMPRESSED = 128, 14, 15
CLASSES = (
    "",
    "cell",
    "struct",
    "object",
    "char",
    "sparse",
    "double",
    "single",
    "int8",
    "uint8",
    "int16",
    "uint16",
)
CLASSES += ("int32", "uint32", "int64", "uint64", "function_handle", "opaque")
WITH_NODES = ("struct", "cell", "object", "char")  # classes of records and of what they say
MAX_COMPRESSION_RATIO = 1032  # largest of zlib
MAX_EMPTY_STRUCTS = 10_000  # accepted structs without fields, which take no bytes; chosen
StructValue = Any  # of scipy.io.loadmat, which has no types


class _Variable(NamedTuple):
    """A variable as its header declares it; `hidden` is the class of an object that MATLAB hides."""

    name: str
    shape: tuple[int, ...]
    kind: str
    hidden: str | None = None


@contextmanager
def _open_5(path: Path) -> Iterator[tuple[Mapping[str, object], LoadVariables]]:
    """Open a MATLAB file: the tree of its content, and a function that loads variables of plain numbers."""
    from scipy.io import whosmat  # not at the top: a quarter of a second

    with as_log_errors(path, KIND_5):
        listing = _variables(path)
        if listing is None:
            listing = [_Variable(name, tuple(shape), kind) for name, shape, kind in whosmat(path)]
    # Single numbers, too: a sampling time says what the vectors are.
    whole = [
        v.name for v in listing if v.kind in WITH_NODES or (v.kind in NUMERIC_CLASSES and set(v.shape) == {1})
    ]
    loaded = _load_variables(path, whole)
    tree: dict[str, object] = {}
    for name, shape, kind, hidden in listing:
        if hidden:
            tree[name] = HiddenObject(hidden)
        elif kind in WITH_NODES:
            tree[name] = _node_5(loaded[name])
        elif kind in NUMERIC_CLASSES:
            tree[name] = Leaf(shape, partial(loaded.__getitem__, name), name)
    yield tree, lambda names: loaded.update(_load_variables(path, names))


def _variables(path: Path) -> list[_Variable] | None:
    """Return the variables of a file of version 5 to 7, checked against their declared sizes.

    scipy lists none where one is an object. None for version 4, or another format, which scipy tells apart.
    """
    variables = []
    with path.open("rb") as stream:
        header = stream.read(HEADER)
        order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
        if order is None:
            return None
        size, position = stream.seek(0, 2), HEADER
        while position < size:
            stream.seek(position)
            kind, length = _read_tag(stream.read(8), order)
            end = position + 8 + length
            if end > size:
                raise LogError(path, f"is truncated: a variable ends at byte {end}, the file has {size}")
            variable = _declared(path, stream, order, kind, length)
            # The workspace of functions and objects has no name; none in MATLAB begins with an underscore.
            if variable and variable.name and not variable.name.startswith("__"):
                variables.append(variable)
            position = end
    return variables


def _read_tag(block: bytes, order: str) -> tuple[int, int]:
    if len(block) < 8:
        return 0, 1 << 32  # cut within the tag: beyond any end
    first, second = np.frombuffer(block[:8], f"{order}u4").tolist()
    return first, second


def _declared(path: Path, stream: BinaryIO, order: str, kind: int, length: int) -> _Variable | None:
    """Return what the header of a variable declares; only sparse arrays may be larger than their bytes."""
    head = stream.read(min(length, 2048))
    if kind == COMPRESSED:
        head = zlib.decompressobj().decompress(head, 512)
        if len(head) < 8:
            return None
        kind, packed_length, length = *_read_tag(head, order)[:1], length, _read_tag(head, order)[1]
        if length > MAX_COMPRESSION_RATIO * packed_length:
            raise LogError(
                path, f"cannot be read as {KIND_5}: {packed_length} bytes declare {length} unpacked bytes"
            )
        head = head[8:]
    if kind != MATRIX or len(head) < 24:
        return None
    numbers = np.frombuffer(head[: len(head) // 4 * 4], f"{order}u4").tolist()
    number, is_logical = numbers[2] & 0xFF, bool(numbers[2] & 0x200)
    array_class = CLASSES[number] if number < len(CLASSES) else ""
    if array_class == "opaque":  # no shape; name, kind of object, class
        name, at = _text_at(head, 16, order)
        _, at = _text_at(head, at, order)
        return _Variable(name, (), array_class, hidden=_text_at(head, at, order)[0] or "object")
    rank = min(numbers[5] // 4, 32)
    shape = tuple(numbers[6 : 6 + rank])
    count = int(np.prod(shape, dtype=object))
    if array_class != "sparse" and count > max(length, MAX_EMPTY_STRUCTS):
        raise LogError(path, f"cannot be read as {KIND_5}: {length} bytes declare {count} values")
    name, _ = _text_at(head, 24 + -(-4 * rank // 8) * 8, order)
    return _Variable(name, shape, "logical" if is_logical and array_class != "sparse" else array_class)


def _text_at(head: bytes, start: int, order: str) -> tuple[str, int]:
    """Return the text of an element, and where the next one starts."""
    kind, length = _read_tag(head[start:], order)
    if kind >> 16:  # up to four bytes lie within the tag
        begin, length, after = start + 4, kind >> 16, start + 8
    else:
        begin, after = start + 8, start + 8 + -(-length // 8) * 8
    return head[begin : begin + length].decode("latin1"), after


def _load_variables(path: Path, names: Sequence[str]) -> dict[str, StructValue]:
    from scipy.io import loadmat

    if not names:
        return {}
    with as_log_errors(path, KIND_5):
        loaded = loadmat(path, variable_names=list(names))
    return {name: loaded[name] for name in names}


def _node_5(value: Any) -> object:
    """Return the node of a value loaded by scipy and of all in it; None for a value without numbers."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if isinstance(value, MatlabOpaque):
        described = value.ravel()[0]
        stored = described["_Class" if "_Class" in (value.dtype.names or ()) else "s2"]
        return HiddenObject(stored.decode("latin1") if isinstance(stored, bytes) else str(stored))
    if not isinstance(value, np.ndarray) or isinstance(value, MatlabFunction):
        return None
    if value.dtype.names is not None:
        # Column by column, as MATLAB counts.
        entries = value.ravel(order="F")
        structs = [{name: _node_5(struct[name]) for name in value.dtype.names} for struct in entries]
        return structs[0] if len(structs) == 1 else structs
    if value.dtype.kind == "O":
        return [_node_5(entry) for entry in value.ravel(order="F")]
    if value.dtype.kind == "U":  # a matrix of letters is a text a row
        texts = [str(text).strip() for text in value.ravel()]
        return texts[0] if len(texts) == 1 else texts
    return Leaf(value.shape, lambda: value) if value.dtype.kind in "fiub" else None


# Version 7.3: an HDF5 file, in which groups are structs.

SIGNATURE = b"\x89HDF\r\n\x1a\n"
SIGNATURE_OFFSETS = (0, 512)  # bytes; MATLAB puts a header of 512 bytes in front
MAX_DEPTH = 30  # nested structs; chosen
MAX_NODES = 20_000  # fields and entries of cells in a file; chosen
NON_NUMERIC_CLASSES = ("char", "cell", "struct", "function_handle", "string", "categorical")
MCOS = 3  # value of MATLAB_object_decode at a reference to an object of a class


@contextmanager
def _open_73(path: Path) -> Iterator[tuple[Mapping[str, object], LoadVariables]]:
    """Open a MATLAB 7.3 file: the tree of its content, whose leaves load themselves."""
    h5py = import_optional("h5py", "hdf5", path)
    with h5py.File(path, "r") as file:
        yield _fields(_Reader(h5py, path, iter(range(MAX_NODES))), file, 0), lambda _: None


class _Reader(NamedTuple):
    """The library, the file, and how many more values may be looked at: references may form circles."""

    h5py: Any
    path: Path
    budget: Iterator[int]


class _Column(NamedTuple):
    """One field of an array of structs: a node for each struct."""

    nodes: list[object]


def _fields(reader: _Reader, group: Any, depth: int) -> dict[str, object]:
    fields: dict[str, object] = {}
    for name in group if depth < MAX_DEPTH else ():
        if not isinstance(name, str) or name.startswith("#"):  # no name of MATLAB; targets of references
            continue
        link = group.get(name, getlink=True)
        if isinstance(link, reader.h5py.ExternalLink):
            fields[name] = _external_leaf(reader, f"{group.name}/{name}")
        elif isinstance(link, reader.h5py.HardLink):
            fields[name] = _node(reader, group[name], depth + 1)
    return fields


def _node(reader: _Reader, item: Any, depth: int) -> object:
    if next(reader.budget, None) is None:
        raise LogError(reader.path, f"holds more than {MAX_NODES} fields and entries of cells")
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
        rows = item[()].T if min(item.shape) > 1 else item[()].reshape(1, -1)  # MATLAB stores the transpose
        texts = ["".join(map(chr, row.tolist())).strip() for row in rows]
        return texts[0] if len(texts) == 1 else texts
    if kind in TO_STRUCT or np.array_equal(item.attrs.get("MATLAB_object_decode"), MCOS):
        return HiddenObject(kind)
    if kind in ("", "cell") and item.dtype == reader.h5py.ref_dtype:
        # Of a long cell nobody made a log: dates, mostly. Without a class: one field of an array of structs.
        if depth >= MAX_DEPTH or (kind == "cell" and item.size > MAX_COLUMNS):
            return None
        references = np.ravel(item[()])
        nodes = [_node(reader, item.file[ref], depth + 1) if ref else None for ref in references]
        return nodes if kind == "cell" else _Column(nodes)
    if item.dtype.kind in NUMERIC_KINDS and kind not in NON_NUMERIC_CLASSES:
        # MATLAB stores the transpose.
        return Leaf(item.shape[::-1], lambda: read_dataset(reader.path, item, item.name.lstrip("/")).T)
    return None


def _external_leaf(reader: _Reader, name: str) -> Leaf:
    return Leaf((2,), lambda: read_dataset(reader.path, None, name.lstrip("/")))
