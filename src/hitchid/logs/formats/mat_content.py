"""Channels in the variables of a MATLAB file: vectors, tables, records of toolboxes and of ControlDesk."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from hitchid.logs.formats.library import (
    column_names,
    column_of,
    floats,
    is_matrix,
    is_vector,
    to_seconds,
    unique_names,
)

# Classes of objects without samples: nobody looks for a log in them.
NO_LOGS = {"categorical", "containers.Map", "function_handle", "string"}
# From the class of an object to the line of MATLAB that replaces it in a struct `s`. Simulink's time is in s.
TO_STRUCT = {
    "table": "{x} = table2struct({x}, 'ToScalar', true);",
    "timetable": "t = timetable2table({x}); t.(1) = seconds(t.(1) - t.(1)(1)); "
    "{x} = table2struct(t, 'ToScalar', true);",
    "timeseries": "{x} = struct('Time', {x}.Time, "
    "'TimeInfo', struct('Units', {x}.TimeInfo.Units), 'Data', {x}.Data);",
    "datetime": "{x} = seconds({x} - {x}(1));",
    "duration": "{x} = seconds({x});",
    "iddata": "{x} = get({x});",
    "Simulink.SimulationData.Dataset": "d = {x}; {x} = struct(); for k = 1:d.numElements, v = d{{k}}.Values; "
    "{x}.(matlab.lang.makeValidName(d{{k}}.Name)) = "
    "struct('Time', v.Time, 'TimeInfo', struct('Units', 'seconds'), 'Data', v.Data); end,",
}
OTHER_TO_STRUCT = "{x} = struct({x});"
MAX_HIDDEN = 10  # objects in one message; chosen
# Fields of `iddata`, and of Octave's, and those that people give structs of their own.
INPUTS, OUTPUTS, PERIODS = ("InputData", "u"), ("OutputData", "y"), ("Ts", "tsam")
LABELS = (
    (("InputName", "inname"), ("InputUnit", "inunit")),
    (("OutputName", "outname"), ("OutputUnit", "outunit")),
)
# s and sampling times, the longer counts: between experiments of one file, more than any gap that is closed.
EXPERIMENTS_APART_S, EXPERIMENTS_APART_STEPS = 10.0, 100


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


class HiddenObject(NamedTuple):
    """An object whose content MATLAB keeps from other programs, with its class."""

    kind: str


class ChannelSource(NamedTuple):
    """The arrays of a channel and of its time, with their units; a note tells what was assumed."""

    values: Leaf
    unit: str | None = None
    time: Leaf | None = None
    time_unit: str | None = None
    note: str | None = None


Named = list[tuple[str, ChannelSource]]


def channels_of(tree: Mapping[str, object]) -> dict[str, ChannelSource]:
    """Return full name to source of every vector of numbers in a file, and of every column of a matrix.

    Fields of structs are named `log/stroke`, entries of an array `log(2)/stroke`; signals of a ControlDesk
    export by their own name, those of a Simulink structure with time or a data set `out/label`, those of an
    `iddata` by their names; columns `data(:,2)`, where samples are along the longer side.
    """
    # One export needs no prefix: signals keep the names they have in the model.
    exports = sum(_is_control_desk(node) for node in tree.values())
    desks = {name: node for name, node in tree.items() if isinstance(node, dict) and _is_control_desk(node)}
    pairs: Named = []
    for name, node in desks.items():
        pairs += _control_desk(node, f"{name}/" if exports > 1 else "")
    pairs += _channels_in("", {name: node for name, node in tree.items() if name not in desks})
    names = unique_names([name for name, _ in pairs])
    return dict(zip(names, (source for _, source in pairs), strict=True))


def hidden_objects(tree: Mapping[str, object], file_name: str) -> str | None:
    """Return a sentence on objects that may hold a log, with the line of MATLAB that makes them readable."""
    hidden = list(_hidden("", tree))[:MAX_HIDDEN]
    if not hidden:
        return None
    names = ", ".join(f"'{path}' ({kind})" for path, kind in hidden)
    # What comes from the file is part of the line only where it is a name.
    stored = file_name if re.fullmatch(r"[A-Za-z0-9][\w.-]*", file_name, re.ASCII) else "log.mat"
    replaced = []
    for path, kind in hidden:
        is_plain = re.fullmatch(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", path, re.ASCII)
        x = f"s.{path.replace('/', '.')}" if is_plain else "s.x"
        replaced.append(TO_STRUCT.get(kind, OTHER_TO_STRUCT).format(x=x))
    return (
        f"MATLAB hides the content of {names} from other programs; save it readably, in MATLAB: "
        f"s = load('{stored}'); {' '.join(replaced)} save('readable.mat', '-struct', 's')"
    )


def _hidden(path: str, node: object) -> Iterator[tuple[str, str]]:
    if isinstance(node, HiddenObject) and node.kind not in NO_LOGS:
        yield path, node.kind
    elif isinstance(node, dict):
        for field, inner in node.items():
            yield from _hidden(_join(path, field), inner)
    elif isinstance(node, list):
        for number, inner in enumerate(node, start=1):
            yield from _hidden(f"{path}({number})", inner)


def _channels_in(name: str, node: object) -> Named:
    if isinstance(node, Leaf):
        return [(column, ChannelSource(leaf)) for column, leaf in _columns(name, node)]
    if isinstance(node, list):
        index = "({})" if all(isinstance(entry, dict) for entry in node) else "{{{}}}"
        entries = enumerate(node, start=1)
        return [pair for k, entry in entries for pair in _channels_in(name + index.format(k), entry)]
    if not isinstance(node, dict):
        return []
    rest, pairs = node, []
    for record in (_simulink, _data_set, _time_series, _experiments):
        used, channels = record(name, rest)
        pairs += channels
        rest = {field: inner for field, inner in rest.items() if field not in used}
    return pairs + [pair for field, inner in rest.items() for pair in _channels_in(_join(name, field), inner)]


# Each kind of record: the fields that it used, and the channels in them; neither in a struct of another kind.

Record = tuple[Sequence[str], Named]
NOTHING: Record = ((), [])


def _simulink(name: str, node: Mapping[str, object]) -> Record:
    """Read a structure with time of Simulink."""
    time = node.get("time")
    if not (isinstance(time, Leaf) and is_vector(time.shape) and "signals" in node):
        return NOTHING
    pairs = [(_join(name, "time"), ChannelSource(time, "s", time))]
    for number, signal in enumerate(_struct_list(node["signals"]), start=1):
        values = signal.get("values")
        if isinstance(values, Leaf) and _length(values) == _length(time):
            label = _text(signal.get("label")) or f"signals({number})"
            columns = _columns(_join(name, label), values)
            pairs += [(column, ChannelSource(leaf, None, time)) for column, leaf in columns]
    return tuple(node), pairs


def _data_set(name: str, node: Mapping[str, object]) -> Record:
    """Read a data set of Simulink that became a struct: elements with a name and values."""
    elements = _struct_list(node.get("Elements"))
    if not any("Values" in element for element in elements):
        return NOTHING
    pairs = []
    for number, element in enumerate(elements, start=1):
        labels = (_text(element.get(field)) for field in ("Name", "PropagatedName"))
        label = next(filter(None, labels), f"Elements({number})")
        values = element.get("Values")
        # Simulink's time is in seconds, whether or not it says so.
        if isinstance(values, dict) and not isinstance(values.get("TimeInfo"), dict):
            values = {**values, "TimeInfo": {"Units": "seconds"}}
        pairs += _channels_in(_join(name, label), values)
    return ("Elements",), pairs


def _time_series(name: str, node: Mapping[str, object]) -> Record:
    """Read a `timeseries` that became a struct, whole or in part."""
    time, data = node.get("Time"), node.get("Data")
    # Time and Data alone may be anybody's, with a time in any unit.
    if not {"TimeInfo", "DataInfo", "IsTimeFirst"} & node.keys():
        return NOTHING
    if not (isinstance(time, Leaf) and is_vector(time.shape) and isinstance(data, Leaf)):
        return NOTHING
    unit, time_unit = (_text(_fields_of(node.get(info)).get("Units")) for info in ("DataInfo", "TimeInfo"))
    stamps = _join(name, "Time")
    note = None if time_unit else f"{stamps}: its unit is hidden; taken for s, which is a timeseries' default"
    columns = [pair for pair in _columns(_join(name, "Data"), data) if _length(pair[1]) == _length(time)]
    clocked = partial(ChannelSource, time=time, time_unit=time_unit or "s", note=note)
    pairs = [(stamps, clocked(time, time_unit or "s"))]
    return ("Time", "Data"), pairs + [(column, clocked(leaf, unit)) for column, leaf in columns]


def _experiments(name: str, node: Mapping[str, object]) -> Record:
    """Read a struct with the fields of an `iddata`: one experiment, or a cell in each field for several.

    Experiments follow one another in time, so far apart that each becomes a record of its own.
    """
    tables = {field: _leaves(node[field]) for fields in (INPUTS, OUTPUTS) if (field := _first(node, fields))}
    counts = {len(leaves) for leaves in tables.values()}
    if len(tables) < 2 or len(counts) > 1 or counts == {0}:
        return NOTHING
    lengths = [max(leaf.shape) for leaf in tables[list(tables)[1]]]
    # A time of its own says more than a sampling time; samples over frequencies have none.
    own_times = [field for field in node if re.fullmatch("t|(t_|time).*", field, re.ASCII | re.IGNORECASE)]
    if (
        sum(lengths) in [_length(node[field]) for field in own_times]
        or _text(node.get("Domain")) == "Frequency"
    ):
        return NOTHING
    time, time_unit = _clock(node, lengths)
    if time is None:
        return NOTHING
    note = None
    if len(lengths) > 1:
        note = f"{name or 'the file'}: {len(lengths)} experiments; each becomes a record of its own"
    pairs: Named = []
    for (field, leaves), labelled in zip(tables.items(), LABELS, strict=True):
        columns = _columns(_join(name, field), _joined(leaves))
        labels, units = (_texts(node.get(_first(node, fields) or ""), len(columns)) for fields in labelled)
        for (column, leaf), label, unit in zip(columns, labels, units, strict=True):
            if _length(leaf) == _length(time):
                channel = ChannelSource(leaf, unit or None, time, time_unit, note)
                pairs.append((_join(name, label) if label else column, channel))
    return (*INPUTS, *OUTPUTS, *PERIODS, "Tstart", "Period", "SamplingInstants"), pairs


def _clock(node: Mapping[str, object], lengths: Sequence[int]) -> tuple[Leaf | None, str]:
    """Return the time of all experiments, one after the other, with its unit; None where none is stated."""
    instants, unit = _leaves(node.get("SamplingInstants")), _text(node.get("TimeUnit")) or "s"
    periods, starts = (_numbers(node.get(field or "")) for field in (_first(node, PERIODS), "Tstart"))
    if [max(leaf.shape) for leaf in instants] == list(lengths):
        if len(lengths) == 1:
            return instants[0], unit
        clocks = [floats(leaf.load()) for leaf in instants]
    elif len(periods) == len(lengths) and min(periods) > 0:
        starts = starts if len(starts) == len(lengths) else [0.0] * len(lengths)
        clocks = [
            start + period * np.arange(length)
            for start, period, length in zip(starts, periods, lengths, strict=True)
        ]
    else:
        return None, unit
    stamps_s, end_s = [], None
    for clock in clocks:
        clock_s = to_seconds(clock, unit)
        if end_s is not None:
            step_s = float(np.median(np.diff(clock_s))) if clock_s.size > 1 else 0.0
            clock_s = (
                clock_s - clock_s[0] + end_s + max(EXPERIMENTS_APART_S, EXPERIMENTS_APART_STEPS * step_s)
            )
        stamps_s.append(clock_s)
        end_s = clock_s[-1]
    joined_s = np.concatenate(stamps_s)
    return Leaf(joined_s.shape, lambda: joined_s), "s"


def _joined(tables: Sequence[Leaf]) -> Leaf:
    """Return the tables of several experiments one below the other; without rows if their columns differ."""
    if len(tables) == 1:
        return tables[0]
    samples, widths = sum(max(table.shape) for table in tables), {min(table.shape) for table in tables}

    def load() -> np.ndarray:
        loaded = [table.load() for table in tables]
        return np.concatenate([rows if rows.shape[0] == max(rows.shape) else rows.T for rows in loaded])

    return Leaf((samples if len(widths) == 1 else 0, *widths), load)


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


def _columns(name: str, leaf: Leaf) -> list[tuple[str, Leaf]]:
    """Return a vector under its own name, or the columns of a matrix."""
    if len(leaf.shape) > 2:  # Simulink logs samples along the last dimension
        shape = tuple(size for size in leaf.shape if size != 1)
        leaf = Leaf(shape, lambda stored=leaf: stored.load().reshape(shape), leaf.variable)
    if is_vector(leaf.shape):
        return [(name, leaf)]
    if not is_matrix(leaf.shape):
        return []
    return [
        (column, Leaf((max(leaf.shape),), lambda k=k: column_of(leaf.load(), k), leaf.variable))
        for k, column in enumerate(column_names(name, leaf.shape))
    ]


def _join(name: str, field: str) -> str:
    return f"{name}/{field}" if name else field


def _first(node: Mapping[str, object], fields: Sequence[str]) -> str | None:
    return next((field for field in fields if field in node), None)


def _struct_list(node: object) -> list[Mapping[str, object]]:
    entries = node if isinstance(node, list) else [node]
    return [entry for entry in entries if isinstance(entry, dict)]


def _fields_of(node: object) -> Mapping[str, object]:
    return node if isinstance(node, dict) else {}


def _leaves(node: object) -> list[Leaf]:
    """Return an array as one, a cell of arrays as all of them; empty for anything else."""
    entries = node if isinstance(node, list) else [node]
    leaves = [entry for entry in entries if isinstance(entry, Leaf) and entry.shape]
    return leaves if len(leaves) == len(entries) else []


def _numbers(node: object) -> list[float]:
    """Return the numbers of scalars; empty if one is none."""
    leaves = [leaf for leaf in _leaves(node) if set(leaf.shape) == {1}]
    numbers = [leaf.load().ravel()[0] for leaf in leaves]
    return [float(n) for n in numbers] if all(np.isrealobj(n) and np.isfinite(n) for n in numbers) else []


def _texts(node: object, count: int) -> list[str]:
    """Return `count` texts, blank ones if there are not as many."""
    texts = [_text(entry) or "" for entry in (node if isinstance(node, list) else [node])]
    return texts if len(texts) == count else [""] * count


def _length(node: object) -> int:
    return max(node.shape, default=0) if isinstance(node, Leaf) else 0


def _text(node: object) -> str | None:
    return (node.strip() or None) if isinstance(node, str) else None
