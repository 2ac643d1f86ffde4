"""What a MATLAB file holds: numbers, texts, structs as mappings, cells and arrays of structs as lists."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hitchid.logs.formats.library import column_names, column_of, is_matrix, is_vector

# Classes of objects without samples: nobody looks for a log in them.
NO_LOGS = {"categorical", "containers.Map", "function_handle", "string"}
# From the class of an object to the lines of MATLAB that replace it in a struct `s`. Simulink's time is in s.
TO_STRUCT = {
    "table": "{x} = table2struct({x}, 'ToScalar', true);",
    "timetable": "t = timetable2table({x}); t.(1) = seconds(t.(1) - t.(1)(1)); "
    "{x} = table2struct(t, 'ToScalar', true);",
    "timeseries": "{x} = struct('Time', {x}.Time, "
    "'TimeInfo', struct('Units', {x}.TimeInfo.Units), 'Data', {x}.Data);",
    "datetime": "{x} = seconds({x} - {x}(1));",
    "duration": "{x} = seconds({x});",
    "iddata": "{x} = get({x});",
    "Simulink.SimulationData.Dataset": "d = {x}; o = struct(); for k = 1:d.numElements, v = d{{k}}.Values; "
    "n = matlab.lang.makeUniqueStrings(matlab.lang.makeValidName(d{{k}}.Name), fieldnames(o)); "
    "o.(n) = struct('Time', v.Time, 'TimeInfo', struct('Units', 'seconds'), 'Data', v.Data); end, {x} = o;",
    "Simulink.SimulationOutput": "d = {x}; o = struct(); for n = d.who', o.(n{{1}}) = d.get(n{{1}}); end, "
    "{x} = o;",
}
OTHER_TO_STRUCT = "{x} = struct({x});"
MAX_HIDDEN = 10  # objects in one message; chosen


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
    """The arrays of a channel and of its time.

    Attributes:
        values, unit: the samples, and their unit as stored.
        time, time_unit: the clock, and its unit.
        note: what was assumed.
        from_period: whether a time that is named goes before the clock, which comes from a sampling time
            alone, or has a unit that is assumed.
        alias: name of the array in the file, where the channel has a better one.
    """

    values: Leaf
    unit: str | None = None
    time: Leaf | None = None
    time_unit: str | None = None
    note: str | None = None
    from_period: bool = False
    alias: str | None = None


Named = list[tuple[str, ChannelSource]]
# Of one kind: the fields that it used, and the channels in them; neither in a struct of another kind.
Record = tuple[Sequence[str], Named]
NOTHING: Record = ((), [])


def hidden_objects(tree: Mapping[str, object], file_name: str) -> str | None:
    """Return a sentence on objects that may hold a log, with the line of MATLAB that makes them readable."""
    hidden = list(_hidden("", tree))[:MAX_HIDDEN]
    if not hidden:
        return None
    names = ", ".join(f"'{one_line(path)}' ({one_line(kind)})" for path, kind in hidden)
    # What comes from the file is code only where it is a name; a file's name is quoted.
    stored = file_name.replace("'", "''") if file_name.isprintable() else "log.mat"
    replaced = []
    for path, kind in hidden:
        is_plain = re.fullmatch(r"[A-Za-z]\w*((\(\d+\)|\{\d+\})?/[A-Za-z]\w*|\{\d+\})*", path, re.ASCII)
        x = f"s.{path.replace('/', '.')}" if is_plain else "s.x"
        replaced.append(TO_STRUCT.get(kind, OTHER_TO_STRUCT).format(x=x))
    return (
        f"MATLAB hides the content of {names} from other programs; save it readably, in MATLAB: "
        f"s = load('{stored}'); {' '.join(replaced)} "
        f"save('{stored.removesuffix('.mat')}_readable.mat', '-struct', 's')"
    )


def one_line(text: str) -> str:
    return re.sub(r"[\x00-\x1f\x7f]+", " ", text)


def _hidden(path: str, node: object) -> Iterator[tuple[str, str]]:
    if isinstance(node, HiddenObject) and node.kind not in NO_LOGS:
        yield path, node.kind
    for inner_path, inner in inside(path, node):
        yield from _hidden(inner_path, inner)


def inside(path: str, node: object) -> list[tuple[str, object]]:
    """Return the fields of a struct, the entries of an array of structs or of a cell, with MATLAB's names."""
    if isinstance(node, dict):
        return [(join(path, field), inner) for field, inner in node.items()]
    if isinstance(node, list):
        index = "({})" if all(isinstance(entry, dict) for entry in node) else "{{{}}}"
        return [(path + index.format(k), entry) for k, entry in enumerate(node, start=1)]
    return []


# What records are made of.


def columns_of(name: str, leaf: Leaf) -> list[tuple[str, Leaf]]:
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


def join(name: str, field: str) -> str:
    return f"{name}/{field}" if name else field


def first_of(node: Mapping[str, object], fields: Sequence[str]) -> str | None:
    return next((field for field in fields if field in node), None)


def structs_of(node: object) -> list[Mapping[str, object]]:
    entries = node if isinstance(node, list) else [node]
    return [entry for entry in entries if isinstance(entry, dict)]


def fields_of(node: object) -> Mapping[str, object]:
    return node if isinstance(node, dict) else {}


def leaves_of(node: object) -> list[Leaf]:
    """Return an array as one, a cell of arrays as all of them; empty for anything else."""
    entries = node if isinstance(node, list) else [node]
    leaves = [entry for entry in entries if isinstance(entry, Leaf) and length_of(entry)]
    return leaves if len(leaves) == len(entries) else []


def lengths_of(node: object) -> list[int]:
    return [length_of(leaf) for leaf in leaves_of(node)]


def entries_of(node: object, count: int) -> list[object]:
    """Return what a field says of each experiment: a cell, a number for each, or one for all."""
    if isinstance(node, Leaf) and node.variable is None and count > 1 and np.prod(node.shape) == count:
        return [Leaf((1,), lambda value=value: np.array([value])) for value in node.load().ravel()]
    if isinstance(node, list):
        return node if len(node) == count else list(node) * count if len(node) == 1 else [None] * count
    return [node] * count


def number_of(node: object) -> float | None:
    """Return the number of a scalar, alone or in a cell; None if it is none."""
    node = node[0] if isinstance(node, list) and len(node) == 1 else node
    if not isinstance(node, Leaf) or set(node.shape) != {1}:
        return None
    number = node.load().ravel()[0]
    return float(number) if np.isrealobj(number) and np.isfinite(number) else None


def texts_of(node: object, count: int) -> list[str]:
    """Return `count` texts, blank ones if there are not as many."""
    texts = [text_of(entry) or "" for entry in (node if isinstance(node, list) else [node])]
    return texts if len(texts) == count else [""] * count


def length_of(node: object) -> int:
    return max(node.shape, default=0) if isinstance(node, Leaf) and 0 not in node.shape else 0


def text_of(node: object) -> str | None:
    return (node.strip() or None) if isinstance(node, str) else None
