"""Origin of a result: the information required to reproduce it."""

import ast
import json
from collections.abc import Iterator, Mapping

from hitchid.report.document import ReportSection, Table, Text
from hitchid.validation.report_data import Origin


def origin(source: Origin, command: str) -> ReportSection:
    """Return the section on reproducing the result.

    Args:
        source: origin of the model.
        command: the command line that wrote the report.
    """
    provenance, current_versions = source.provenance, source.versions
    model_versions = provenance.versions
    rows = [
        ("command", command),
        ("model", provenance.name),
        ("date of the model's files", provenance.date),
        ("model's digest", provenance.digest),
        ("seed of the identification", str(provenance.seed)),
        ("sampling time", f"{source.step_s:g} s"),
        *(
            (f"set by hand: {direction}", ", ".join(f"{name} = {value:g}" for name, value in values.items()))
            for direction, values in provenance.set_by_hand.items()
        ),
        *(
            (f"version of {name}", _versions(model_versions.get(name), current_versions.get(name)))
            for name in {**model_versions, **current_versions}
        ),
    ]
    note = Text(
        "The same logs, model and versions give the same figures; on another processor the last digits "
        "may differ. The hashes of the logs are in the table of logs."
    )
    origin_table = Table("Origin", ("what", "value"), tuple(row for row in rows if row[1]))
    settings = tuple(_toml_rows(_by_section(provenance.settings)))
    settings_table = Table("Settings of the identification", ("setting", "value"), settings)
    return ReportSection("How to reproduce", (note, origin_table, *([settings_table] if settings else [])))


def _by_section(settings: Mapping[str, object]) -> Mapping[str, object]:
    """Return settings in the sections of the settings file: those of each direction under its name."""
    sections = {
        name: _arguments(value) for name, value in settings.items() if name not in ("structure", "dead_zones")
    }
    forms, dead_zones = settings.get("structure"), settings.get("dead_zones")
    for direction, form in forms.items() if isinstance(forms, Mapping) else ():
        known_dead_zones = dead_zones if isinstance(dead_zones, Mapping) else {}
        automatic = {"structure": "automatic"} if form.get("automatic") else {}
        values = {name: value for name, value in form.items() if name != "automatic"}
        sections[direction] = automatic | values | {"dead_zone": known_dead_zones.get(direction)}
    return sections


def _arguments(value: object) -> object:
    """Return a setting; of a call as text, as in models saved by earlier versions, its keyword arguments."""
    if not isinstance(value, str):
        return value
    try:
        return _keywords(ast.parse(value, mode="eval").body)
    except (SyntaxError, ValueError):
        return value


def _keywords(node: ast.expr) -> object:
    if isinstance(node, ast.Call) and not node.args:
        return {str(keyword.arg): _keywords(keyword.value) for keyword in node.keywords}
    return ast.literal_eval(node)


def _toml_rows(settings: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield key and value of each setting in TOML; settings without a value are left out."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _toml_rows(value, f"{prefix}{name}.")
        elif value is not None:
            yield f"{prefix}{name}", json.dumps(value, ensure_ascii=False)


def _versions(model_version: str | None, current_version: str | None) -> str:
    if model_version == current_version or current_version is None:
        return model_version or ""
    return (
        current_version
        if model_version is None
        else f"{model_version} at identification, {current_version} now"
    )
