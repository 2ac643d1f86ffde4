"""Channels in the variables of a MATLAB file: vectors, tables, records of toolboxes and of ControlDesk."""

import re
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from hitchid.logs.formats.library import is_time, is_vector, unique_names
from hitchid.logs.formats.mat_experiments import experiments
from hitchid.logs.formats.mat_tree import (
    NOTHING,
    ChannelSource,
    Leaf,
    Named,
    Record,
    columns_of,
    fields_of,
    inside,
    join,
    length_of,
    one_line,
    structs_of,
    text_of,
)


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
    names = unique_names([one_line(name) for name, _ in pairs])
    return dict(zip(names, (source for _, source in pairs), strict=True))


def is_entry(name: str) -> bool:
    """Return whether a channel lies in an entry of a cell or of an array of structs."""
    return re.search(r"\(\d+\)/|\{\d+\}", name) is not None


def _channels_in(name: str, node: object) -> Named:
    if isinstance(node, Leaf):
        return [(column, ChannelSource(leaf)) for column, leaf in columns_of(name, node)]
    pairs: Named = []
    if isinstance(node, dict):
        for record in (_simulink, _data_set, _time_series, experiments):
            used, channels = record(name, node)
            pairs += channels
            node = {field: inner for field, inner in node.items() if field not in used}
    return pairs + [pair for path, inner in inside(name, node) for pair in _channels_in(path, inner)]


# Kinds of record in a struct.


def _simulink(name: str, node: Mapping[str, object]) -> Record:
    """Read a structure with time of Simulink."""
    time, signals = node.get("time"), structs_of(node.get("signals"))
    if not (isinstance(time, Leaf) and is_vector(time.shape)):
        return NOTHING
    if not any(length_of(signal.get("values")) == length_of(time) for signal in signals):
        return NOTHING
    pairs = [(join(name, "time"), ChannelSource(time, "s", time))]
    for number, signal in enumerate(signals, start=1):
        values = signal.get("values")
        if isinstance(values, Leaf) and length_of(values) == length_of(time):
            label = text_of(signal.get("label")) or f"signals({number})"
            columns = columns_of(join(name, label), values)
            pairs += [(column, ChannelSource(leaf, None, time)) for column, leaf in columns]
    return ("time", "signals"), pairs


def _data_set(name: str, node: Mapping[str, object]) -> Record:
    """Read a data set of Simulink that became a struct: elements with a name and values."""
    elements = structs_of(node.get("Elements"))
    if not any("Values" in element for element in elements):
        return NOTHING
    pairs = []
    for number, element in enumerate(elements, start=1):
        labels = (text_of(element.get(field)) for field in ("Name", "PropagatedName"))
        label = next(filter(None, labels), f"Elements({number})")
        pairs += _channels_in(join(name, label), _in_seconds(element.get("Values")))
    return ("Elements",), pairs


def _in_seconds(values: object) -> object:
    """Return the time series of a signal, or of a bus, with Simulink's unit of time if they state none."""
    if not isinstance(values, dict):
        return values
    if "Time" in values and not isinstance(values.get("TimeInfo"), dict):
        return {**values, "TimeInfo": {"Units": "seconds"}}
    return {field: _in_seconds(inner) for field, inner in values.items()}


def _time_series(name: str, node: Mapping[str, object]) -> Record:
    """Read a `timeseries` that became a struct, whole or in part."""
    time, data = node.get("Time"), node.get("Data")
    # Time and Data alone may be anybody's, with a time in any unit.
    if not {"TimeInfo", "DataInfo", "IsTimeFirst"} & node.keys():
        return NOTHING
    if not (isinstance(time, Leaf) and is_vector(time.shape) and isinstance(data, Leaf)):
        return NOTHING
    unit, time_unit = (text_of(fields_of(node.get(info)).get("Units")) for info in ("DataInfo", "TimeInfo"))
    if time_unit and not is_time(time_unit):
        return NOTHING
    stamps = join(name, "Time")
    note = None if time_unit else f"{stamps}: its unit is hidden; taken for s, which is a timeseries' default"
    columns = [pair for pair in columns_of(join(name, "Data"), data) if length_of(pair[1]) == length_of(time)]
    # An assumed unit goes after one that the user states.
    is_assumed = time_unit is None
    clocked = partial(ChannelSource, time=time, time_unit=time_unit or "s", note=note, from_period=is_assumed)
    pairs = [(stamps, clocked(time, time_unit, alias=stamps))]
    pairs += [(column, clocked(leaf, unit, alias=column)) for column, leaf in columns]
    return ("Time", *(["Data"] if columns else [])), pairs


def _is_control_desk(node: object) -> bool:
    if not isinstance(node, dict) or not {"X", "Y"} <= node.keys():
        return False
    axes, signals = structs_of(node["X"]), structs_of(node["Y"])
    return bool(axes and signals) and "Data" in axes[0] and {"Name", "Data"} <= signals[0].keys()


def _control_desk(node: Mapping[str, object], prefix: str) -> list[tuple[str, ChannelSource]]:
    axes = structs_of(node["X"])
    pairs = []
    for number, signal in enumerate(structs_of(node["Y"]), start=1):
        data = signal.get("Data")
        if isinstance(data, Leaf) and is_vector(data.shape):
            axis = _axis(axes, signal.get("XIndex"), data)
            time = axis.get("Data")
            clock = time if isinstance(time, Leaf) else None
            unit, time_unit = text_of(signal.get("Unit")), text_of(axis.get("Unit"))
            name = text_of(signal.get("Name")) or str(number)
            pairs.append((f"{prefix}{name}", ChannelSource(data, unit, clock, time_unit)))
    return pairs


def _axis(axes: Sequence[Mapping[str, object]], index: object, data: Leaf) -> Mapping[str, object]:
    """Return the axis of a signal's index, from 1, else the first of equal length, else an empty one."""
    matching = [
        number for number, axis in enumerate(axes, start=1) if length_of(axis.get("Data")) == max(data.shape)
    ]
    axis_number = int(np.ravel(index.load())[0]) if isinstance(index, Leaf) and length_of(index) == 1 else 0
    if axis_number in matching:
        return axes[axis_number - 1]
    return axes[matching[0] - 1] if matching else {}
