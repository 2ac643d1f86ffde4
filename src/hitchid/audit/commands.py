"""Whether the commands are as they should be: one valve at a time, and zero when idle."""

import numpy as np

from hitchid.audit.finding import AuditFinding, Level, runs
from hitchid.audit.look import Look, Survey, command_unit
from hitchid.data.record import COMMAND, RAMP
from hitchid.data.test_kinds import ACTIVE_FRACTION

SHORT_OVERLAP_S = 0.1
IDLE_FRACTION = 0.01


def both_valves(look: Look) -> list[AuditFinding]:
    """Find where both commands are above 5 % of full scale.

    Up to 0.1 s at a change of direction is what filters and ramps of a controller leave: a note. Longer, the
    two directions cannot be told apart: a warning.
    """
    record = look.record
    if len(record.modes) < 2:
        return []
    both = look.active(record.modes[0])
    both &= look.active(record.modes[1])
    starts, stops = runs(both)
    if starts.size == 0:
        return []
    longest = int(np.max(stops - starts)) * record.step_s
    time = int(np.sum(stops - starts)) * record.step_s
    return [
        look.finding(
            "both valves",
            Level.NOTE if longest <= SHORT_OVERLAP_S else Level.WARNING,
            f"both valves are on {starts.size} time{'s' * (starts.size > 1)}, {time:.3g} s in all, "
            f"{longest:.3g} s at the longest, first at {record.start_s + starts[0] * record.step_s:.6g} s",
            "let one command end before the other begins; lowering counts where both are on",
            signal="",
            at=list(zip(starts.tolist(), stops.tolist(), strict=True)),
        )
    ]


def idle_commands(survey: Survey) -> list[AuditFinding]:
    """Find commands that are not zero when idle.

    The smallest |c| of all logs above 5 % of full scale: the command is never off, as with a 4–20 mA signal,
    a warning, for the dead zone is then counted from a wrong zero. Else the median of |c| where it is off
    above 1 % of full scale: a bias or a sensor's zero, a note.
    """
    found = []
    for mode in survey.looks[0].record.modes:
        scale = survey.scales[mode]
        smallest = min(float(np.min(np.abs(look.record.command(mode)))) for look in survey.looks)
        if not scale > 0:
            continue
        unit = command_unit(survey.looks[0].record, mode)
        if smallest > ACTIVE_FRACTION * scale:
            what = (
                f"the {mode} command is never below {smallest:.3g} {unit} in any log, "
                f"{smallest / scale:.0%} of the largest"
            )
            advice = "take the offset off, or log one test from rest: it counts as part of the dead zone"
            found.append(AuditFinding("idle command", Level.WARNING, "", COMMAND[mode], (), what, advice))
            continue
        levels = [float(np.median(off)) for look in survey.looks if (off := _off(look, mode)).size]
        level = float(np.median(levels)) if levels else 0.0
        if level > IDLE_FRACTION * scale:
            what = f"the idle {mode} command stands at {level:.3g} {unit}, {level / scale:.1%} of full scale"
            advice = "check the zero of the current sensor, or whether the valve is biased"
            found.append(AuditFinding("idle command", Level.NOTE, "", COMMAND[mode], (), what, advice))
    return found


def _off(look: Look, mode: str) -> np.ndarray:
    """Return |c| where no mode is on, shape [M]; none of a ramp, which passes through there."""
    if look.record.kind == RAMP:
        return np.zeros(0)
    return np.abs(look.record.command(mode)[~look.any_active()])
