"""The public surface: commands and options, documented names of Python, keys of the files that people write.

python -m tools.surface            # what changed since the last release
python -m tools.surface --release  # writes tools/surface.txt, for the release of this version
"""

import argparse
import inspect
import re
import sys
import tomllib
from collections.abc import Iterator
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import get_args, get_type_hints

from pydantic import BaseModel
from typer.main import get_command

import hitchid
from hitchid.cli import app
from hitchid.hmi.plans import Limits
from hitchid.identification.settings_file import IdentifyFile
from hitchid.logs.signal_map import CampaignFile
from hitchid.validation.limits import AcceptanceLimits

ROOT = Path(__file__).parents[1]
RELEASED = Path(__file__).with_name("surface.txt")
FILES = {
    "campaign.toml": CampaignFile,
    "identify.toml": IdentifyFile,
    "limits.toml of hitchid validate": AcceptanceLimits,
    "limits.toml of a bench": Limits,
}
DIRECTIVE = re.compile(
    r"^\.\. (currentmodule|autofunction|autoclass|autodata|autoexception):: (\S+)", re.MULTILINE
)


def surface() -> dict[str, str]:
    """Return each public thing and its signature, empty where it has none; sorted by name."""
    return dict(sorted([*_commands(), *_python(), *_keys()]))


def _commands() -> Iterator[tuple[str, str]]:
    group = get_command(app)
    commands = {"": group, **{f" {name}": command for name, command in group.commands.items()}}
    for name, command in group.commands.items():
        commands |= {f" {name} {inner}": part for inner, part in getattr(command, "commands", {}).items()}
    for name, command in commands.items():
        arguments = " ".join(p.name.upper() for p in command.params if p.param_type_name == "argument")
        yield f"hitchid{name}", arguments
        callback = getattr(command, "callback", None)
        hints = get_type_hints(inspect.unwrap(callback)) if callback else {}
        for parameter in command.params:
            if parameter.param_type_name == "option":
                choices = [
                    e
                    for e in _parts(hints.get(parameter.name))
                    if isinstance(e, type) and issubclass(e, Enum)
                ]
                values = "|".join(str(member.value) for choice in choices for member in choice)
                other = [*parameter.opts[1:], *parameter.secondary_opts]
                yield f"hitchid{name} {parameter.opts[0]}", " ".join([*other, *([values] if values else [])])


def _parts(annotation: object) -> Iterator[object]:
    yield annotation
    for argument in get_args(annotation):
        yield from _parts(argument)


def _python() -> Iterator[tuple[str, str]]:
    """Yield what the reference documents, and the names of the package itself."""
    module = "hitchid"
    documented = [f"hitchid.{name}" for name in dir(hitchid)]
    for page in sorted((ROOT / "docs" / "reference").glob("*.md")):
        for directive, name in DIRECTIVE.findall(page.read_text()):
            if directive == "currentmodule":
                module = name
            else:
                documented.append(name if name.startswith("hitchid.") else f"{module}.{name}")
    for name in dict.fromkeys(documented):
        thing = _resolve(name)
        yield name, _signature(thing)
        if isinstance(thing, type):
            yield from ((f"{name}.{member}", text) for member, text in _members(thing))


def _members(kind: type) -> Iterator[tuple[str, str]]:
    """Yield methods, properties and constants of a class and of its ancestors in this package."""
    if issubclass(kind, Enum):
        yield from ((member.name, "") for member in kind)
        return
    own = [cls for cls in kind.__mro__ if cls.__module__.startswith("hitchid")]
    for name in sorted({name for cls in own for name in vars(cls)}):
        member = inspect.getattr_static(kind, name)
        if name != "__getitem__" and (name.startswith("_") or isinstance(member, type)):
            continue
        method = inspect.unwrap(getattr(member, "__func__", member))
        yield name, _signature(method) if inspect.isroutine(method) else ""


def _resolve(name: str) -> object:
    """Return what a name stands for, from the longest module in it: some functions are named like theirs."""
    module, _, rest = name.rpartition(".")
    try:
        thing: object = import_module(module)
    except ModuleNotFoundError:
        thing = _resolve(module)
    return getattr(thing, rest)


def _signature(thing: object) -> str:
    """Return the parameters by name; `=` for an optional one. Annotations and defaults may change."""
    if isinstance(thing, type) and issubclass(thing, Enum):
        return ""  # its own, which differs between versions of Python
    try:
        parameters = inspect.signature(getattr(thing, "__func__", thing)).parameters.values()  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return ""
    texts, keyword = [], False
    for parameter in parameters:
        if parameter.kind is parameter.KEYWORD_ONLY and not keyword:
            texts.append("*")
            keyword = True
        sign = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
        keyword |= sign == "*"
        default = "=" if parameter.default is not parameter.empty else ""
        texts.append(f"{sign}{parameter.name}{default}")
    return f"({', '.join(texts)})"


def _keys() -> Iterator[tuple[str, str]]:
    for file, model in FILES.items():
        for key in _fields(model, ""):
            yield f"{file}: {key}", ""


def _fields(model: type[BaseModel], prefix: str) -> Iterator[str]:
    for name, field in model.model_fields.items():
        key = f"{prefix}{field.alias or name}"
        yield key
        for inner in _models_in(field.annotation):
            yield from _fields(inner, f"{key}.")


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def released() -> tuple[str, dict[str, str]]:
    """Return the version of the last release and its surface."""
    version, *lines = RELEASED.read_text().splitlines()
    return version, {name: signature for name, _, signature in (line.partition("\t") for line in lines)}


def changes(before: dict[str, str], now: dict[str, str]) -> dict[str, str]:
    """Return each name that was added, removed or changed, and which; parts of a new one are in it."""
    names = {name: "added" for name in now if name not in before}
    names |= {name: "removed" for name in before if name not in now}
    whole = {name: kind for name, kind in names.items() if not _is_part(name, kind, names)}
    return whole | {name: "changed" for name in now if name in before and now[name] != before[name]}


def _is_part(name: str, kind: str, names: dict[str, str]) -> bool:
    """Return whether a name belongs to another of the same fate, as an option to its command."""
    ends = (match.start() for match in re.finditer(r"[ .]", name))
    return any(names.get(name[:end]) == kind for end in ends)


def unmentioned(changed: dict[str, str], changelog: str) -> list[str]:
    """Return the changed names that stand in no unreleased line of a changelog as code.

    The last part suffices, `to_matlab`; of an option it stands beside its command, `hitchid export --to`.
    """
    unreleased = changelog.partition("## [Unreleased]")[2].partition("\n## [")[0]
    spans = [set(re.findall(r"[\w-]+", span)) for span in re.findall(r"`([^`]+)`", unreleased)]
    missing = []
    for name in changed:
        words = re.findall(r"[\w-]+", name)
        needed = set(words[-2:]) if words[-1].startswith("-") else {words[-1]}
        if not any(needed <= span for span in spans):
            missing.append(name)
    return missing


def main() -> int:
    """Print what changed since the last release; or write the surface of this version as released."""
    parser = argparse.ArgumentParser(prog="python -m tools.surface")
    parser.add_argument("--release", action="store_true", help="write the surface as that of this version")
    now = surface()
    if parser.parse_args().release:
        version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
        lines = [version, *(f"{name}\t{signature}".rstrip() for name, signature in now.items())]
        RELEASED.write_text("\n".join(lines) + "\n")
        return 0
    version, before = released()
    for name, kind in changes(before, now).items():
        sys.stdout.write(f"{kind} since {version}: {name}{now.get(name, '')}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
