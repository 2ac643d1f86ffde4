"""Origin of a result: the information required to reproduce it."""

from collections.abc import Mapping

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
        ("model's digest", provenance.digest),
        ("seed of the identification", str(provenance.seed)),
        ("sampling time", f"{source.step_s:g} s"),
        *(
            (f"setting: {name.replace('_', ' ')}", _setting_text(value))
            for name, value in provenance.settings.items()
        ),
        *(
            (f"set by hand: {direction}", _setting_text(values))
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
    return ReportSection(
        "How to reproduce", (note, Table("Origin", ("what", "value"), tuple(r for r in rows if r[1])))
    )


def _setting_text(value: object) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name}: {_setting_text(item)}" for name, item in value.items() if _is_set(item))
    return str(value)


def _is_set(value: object) -> bool:
    return not (value is None or value is False or value == {})


def _versions(model_version: str | None, current_version: str | None) -> str:
    if model_version == current_version or current_version is None:
        return model_version or ""
    return (
        current_version
        if model_version is None
        else f"{model_version} at identification, {current_version} now"
    )
