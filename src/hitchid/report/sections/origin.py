"""Where a result comes from: everything that is needed to get it again."""

from collections.abc import Mapping

from hitchid._support.versions import installed_versions
from hitchid.model import Hitch
from hitchid.report.document import Section, Text
from hitchid.validation import Table


def origin(model: Hitch, command: str) -> Section:
    """Return the section on how to get the same result again.

    Args:
        model: what was validated.
        command: that wrote the report.
    """
    then, now = model.provenance.versions, installed_versions()
    rows = [
        ("command", command),
        ("model's digest", model.provenance.digest),
        ("seed of the identification", str(model.provenance.seed)),
        ("sampling time", f"{model.step_s:g} s"),
        *(
            (f"setting: {name.replace('_', ' ')}", _told(value))
            for name, value in model.provenance.settings.items()
        ),
        *((f"version of {name}", _versions(then.get(name), now.get(name))) for name in {**then, **now}),
    ]
    said = Text(
        "The same logs, model and versions give the same figures; on another kind of machine the last digits "
        "may differ. Hashes of the logs stand in their table."
    )
    return Section(
        "How to reproduce", (said, Table("Origin", ("what", "value"), tuple(r for r in rows if r[1])))
    )


def _told(value: object) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name}: {_told(each)}" for name, each in value.items() if _given(each))
    return str(value)


def _given(value: object) -> bool:
    return not (value is None or value is False or value == {})


def _versions(then: str | None, now: str | None) -> str:
    if then == now or now is None:
        return then or ""
    return now if then is None else f"{then} at identification, {now} now"
