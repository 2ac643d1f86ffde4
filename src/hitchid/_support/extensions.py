"""Extensions by entry points of other packages: structures, baselines, log formats, renderers."""

from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import TypeVar

from hitchid.errors import InputError

Extension = TypeVar("Extension")


def with_extensions(
    group: str, built_in: Iterable[Extension], *, kind: type[Extension], name: Callable[[Extension], str]
) -> Mapping[str, Extension]:
    """Return built-in extensions of one kind and those registered by installed packages, by name.

    Another package registers an extension by an entry point, for instance
    `[project.entry-points."hitchid.structures"]` in its `pyproject.toml`, whose value is the object.

    Raises:
        InputError: an extension cannot be imported, is of another type, or its name is taken.
    """
    extensions = {name(extension): extension for extension in built_in}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        extension = _load(entry, kind)
        if name(extension) in extensions:
            raise InputError(f"{_source(entry)}: the name '{name(extension)}' is taken; choose another name")
        extensions[name(extension)] = extension
    return MappingProxyType(extensions)


def _load(entry: EntryPoint, kind: type[Extension]) -> Extension:
    try:
        extension = entry.load()
    except Exception as error:  # the code of another package may raise anything
        raise InputError(
            f"{_source(entry)}: cannot be imported: {type(error).__name__}: {error}; repair or "
            "uninstall the package"
        ) from error
    if not isinstance(extension, kind):
        raise InputError(f"{_source(entry)}: expected {kind.__name__}, got {type(extension).__name__}")
    return extension


def _source(entry: EntryPoint) -> str:
    package = entry.dist.name if entry.dist else "an installed package"
    return f"{package}: entry point '{entry.name}' in {entry.group}"
