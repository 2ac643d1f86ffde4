"""Whether lifting raises the displacement and lowering reduces it, over all tests."""

import numpy as np

from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Look, Survey, named, travel
from hitchid.data.record import COMMAND, CYCLE, DISPLACEMENT, LIFTING, LOWERING, MODES, RAMP

CLEAR_FRACTION = 0.02
CLEAR_OF_TYPICAL = 0.25


def signs(survey: Survey) -> list[AuditFinding]:
    """Find directions that contradict each other.

    A mode's direction is that of most of its tests, by the displacement's travel while its command alone is
    on, where that exceeds 6 σ + 2 q and 2 % of the campaign's range. One test against the others, by a
    quarter of their travel, is a fault of that test; both modes going the same way is a fault of the
    campaign. Both reversed is what a sensor that measures downwards does, and identification takes each
    direction as measured; but so do swapped commands: a warning.
    """
    found: list[AuditFinding] = []
    usual: dict[str, int] = {}
    for mode in survey.looks[0].record.modes:
        travels = _travels(survey, mode)
        if not travels:
            continue
        usual[mode] = 1 if np.median([moved for _, moved in travels]) >= 0 else -1
        typical = abs(float(np.median([moved for _, moved in travels])))
        against = [
            (look, moved) for look, moved in travels if moved * usual[mode] < -CLEAR_OF_TYPICAL * typical
        ]
        if len(travels) >= 3 and 2 * len(against) < len(travels):
            found += [_against(look, mode, moved, len(travels)) for look, moved in against]
        elif against:
            found.append(_divided(mode, against, len(travels)))
    return found + _of_both(usual)


def _travels(survey: Survey, mode: str) -> list[tuple[Look, float]]:
    """Return the looks at the tests of a mode whose travel under it is clear, and that travel."""
    found = []
    for look in survey.looks:
        if look.record.kind not in (mode, CYCLE, RAMP):
            continue
        moved = travel(look, mode)
        if abs(moved) > max(look.quality.sure, CLEAR_FRACTION * look.reach):
            found.append((look, moved))
    return found


def _way(sign: float | int) -> str:
    return "grows" if sign > 0 else "falls"


def _against(look: Look, mode: str, moved: float, tests: int) -> AuditFinding:
    what = (
        f"the displacement {_way(moved)} by {abs(moved):.4g} {look.quality.unit} while {mode} is commanded; "
        f"in most of the {tests} tests of {mode} it {_way(-moved)}"
    )
    advice = "check the sign of the displacement and which command is which in this log; leave it out"
    return look.finding("sign", Level.FAULT, what, advice)


def _divided(mode: str, against: list[tuple[Look, float]], tests: int) -> AuditFinding:
    names = named([look.record.name for look, _ in against])
    what = (
        f"under {mode} the displacement {_way(against[0][1])} in {len(against)} of {tests} tests ({names}) "
        f"and {_way(-against[0][1])} in the others"
    )
    advice = "check the sign of the displacement and which command is which, test by test"
    return AuditFinding("sign", Level.FAULT, "", DISPLACEMENT, (), what, advice)


def _of_both(usual: dict[str, int]) -> list[AuditFinding]:
    if set(usual) != set(MODES) or usual == {LIFTING: 1, LOWERING: -1}:
        return []
    if usual[LIFTING] == usual[LOWERING]:
        what = f"the displacement {_way(usual[LIFTING])} under lifting and under lowering alike"
        advice = f"check which columns are {COMMAND[LIFTING]} and {COMMAND[LOWERING]} in campaign.toml"
        return [AuditFinding("sign", Level.FAULT, "", DISPLACEMENT, (), what, advice)]
    what = "the displacement falls under lifting and grows under lowering"
    advice = (
        "this is right for a sensor that measures downwards, and each direction is taken as measured; "
        "otherwise the commands are swapped in campaign.toml, or one signal's sign is turned: put scale = -1 "
        "beside its column"
    )
    return [AuditFinding("sign", Level.WARNING, "", DISPLACEMENT, (), what, advice)]
