"""Parts that other installed packages add: structures, baselines, log formats, renderers."""

from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import TypeVar

from hitchid.errors import InputError

Part = TypeVar("Part")


def with_extensions(
    group: str, own: Iterable[Part], *, kind: type[Part], name: Callable[[Part], str]
) -> Mapping[str, Part]:
    """Return this package's parts of one kind and those that installed packages register, by name.

    Another package registers a part by an entry point, for instance
    `[project.entry-points."hitchid.structures"]` in its `pyproject.toml`, whose value is the part.

    Args:
        group: name of the group of entry points.
        own: the parts of this package.
        kind: the type that every part has.
        name: returns the name of a part.

    Raises:
        InputError: a registered part cannot be imported, is of another type, or its name is taken.
    """
    parts = {name(part): part for part in own}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        part = _load(entry, kind)
        if name(part) in parts:
            raise InputError(f"{_source(entry)}: the name '{name(part)}' is taken; required another name")
        parts[name(part)] = part
    return MappingProxyType(parts)


def _load(entry: EntryPoint, kind: type[Part]) -> Part:
    try:
        part = entry.load()
    except Exception as error:  # the code of another package may raise anything
        raise InputError(
            f"{_source(entry)}: cannot be imported: {type(error).__name__}: {error}; required a package that "
            "can be imported; repair or uninstall it"
        ) from error
    if not isinstance(part, kind):
        raise InputError(f"{_source(entry)}: required a {kind.__name__}, came a {type(part).__name__}")
    return part


def _source(entry: EntryPoint) -> str:
    package = entry.dist.name if entry.dist else "an installed package"
    return f"{package}: entry point '{entry.name}' in {entry.group}"
