"""The content of a MATLAB file of any version: structs, lists of structs, numbers, texts."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hitchid.logs.formats.library import column_names, column_of, is_matrix, is_vector, unique_names

LoadVariables = Callable[[Sequence[str]], Mapping[str, np.ndarray]]


class Leaf(NamedTuple):
    """An array of numbers, loaded on demand.

    Attributes:
        shape: its shape.
        load: returns the numbers, given the loaded variables.
        variable: the variable that must be loaded first; None if there is none.
    """

    shape: tuple[int, ...]
    load: Callable[[Mapping[str, np.ndarray]], np.ndarray]
    variable: str | None = None


class ChannelSource(NamedTuple):
    """The arrays of a channel and of its time, with their units."""

    values: Leaf
    unit: str | None = None
    time: Leaf | None = None
    time_unit: str | None = None


def channels_of(tree: Mapping[str, object]) -> dict[str, ChannelSource]:
    """Return full name to source of every vector of numbers in a file, and of every column of a matrix.

    Fields of structs are named `log/stroke`; signals of a ControlDesk export by their own name, those of a
    Simulink structure with time `out/label`; columns `data(:,2)`, where samples are along the longer side.
    """
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
    axis_number = int(np.ravel(index.load({}))[0]) if isinstance(index, Leaf) and _length(index) == 1 else 0
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
        (
            column,
            Leaf(
                (max(leaf.shape),),
                lambda variables, k=index: column_of(leaf.load(variables), k),
                leaf.variable,
            ),
        )
        for index, column in enumerate(column_names(name, leaf.shape))
    ]


def _struct_list(node: object) -> list[Mapping[str, object]]:
    return [node] if isinstance(node, dict) else node if isinstance(node, list) else []


def _length(node: object) -> int:
    return max(node.shape, default=0) if isinstance(node, Leaf) else 0


def _text(node: object) -> str | None:
    return (node.strip() or None) if isinstance(node, str) else None
