"""Checks of the commands: one valve at a time, and zero when idle."""

import numpy as np

from hitchid._support.notices import Severity
from hitchid.audit.context import CampaignContext, RecordContext, command_unit
from hitchid.audit.finding import AuditFinding, true_intervals
from hitchid.data.record import COMMAND, RAMP
from hitchid.data.test_kinds import ACTIVE_FRACTION

SHORT_OVERLAP_S = 0.1  # s; overlap that filters and ramps of a controller cause at a change of direction
IDLE_FRACTION = 0.01  # of full scale; smallest bias or sensor offset reported (chosen)


def both_valves(context: RecordContext) -> list[AuditFinding]:
    """Find where both commands are above 5 % of full scale.

    Filters and ramps of a controller overlap by up to 0.1 s at a change of direction: a note. With a longer
    overlap the motion cannot be assigned to one direction: a warning.
    """
    record = context.record
    if len(record.directions) < 2:
        return []
    both_active = context.active(record.directions[0])
    both_active &= context.active(record.directions[1])
    starts, stops = true_intervals(both_active)
    if starts.size == 0:
        return []
    longest = int(np.max(stops - starts)) * record.step_s
    time = int(np.sum(stops - starts)) * record.step_s
    return [
        context.finding(
            "both valves",
            Severity.NOTE if longest <= SHORT_OVERLAP_S else Severity.WARNING,
            f"both commands are active {starts.size} time{'s' * (starts.size > 1)}, {time:.3g} s in total, "
            f"at most {longest:.3g} s at once, first at {record.start_s + starts[0] * record.step_s:.6g} s",
            "end one command before the other starts; in an overlap the lowering command is used",
            signal="",
            intervals=list(zip(starts.tolist(), stops.tolist(), strict=True)),
        )
    ]


def idle_commands(context: CampaignContext) -> list[AuditFinding]:
    """Find commands that are not zero when idle.

    A warning if the smallest |c| of all logs is above 5 % of full scale: the command is never off, as with a
    4–20 mA signal, and the dead zone is measured from a wrong zero. Else a note if the median of |c| without
    command is above 1 % of full scale: a bias or a sensor's offset.
    """
    findings = []
    for direction in context.tests[0].record.directions:
        scale = context.scales[direction]
        smallest = min(float(np.min(np.abs(test.record.command(direction)))) for test in context.tests)
        if not scale > 0:
            continue
        unit = command_unit(context.tests[0].record, direction)
        if smallest > ACTIVE_FRACTION * scale:
            what = (
                f"the {direction} command is never below {smallest:.3g} {unit} in any log, "
                f"{smallest / scale:.0%} of the largest"
            )
            advice = (
                "subtract the offset from the command, or log one test that starts at command "
                "zero: the offset makes the dead zone too large"
            )
            findings.append(
                AuditFinding("idle command", Severity.WARNING, "", COMMAND[direction], (), what, advice)
            )
            continue
        levels = [
            float(np.median(idle)) for test in context.tests if (idle := _idle_command(test, direction)).size
        ]
        level = float(np.median(levels)) if levels else 0.0
        if level > IDLE_FRACTION * scale:
            what = f"the idle {direction} command is {level:.3g} {unit}, {level / scale:.1%} of full scale"
            advice = "check the zero of the current sensor and the bias of the valve"
            findings.append(
                AuditFinding("idle command", Severity.NOTE, "", COMMAND[direction], (), what, advice)
            )
    return findings


def _idle_command(context: RecordContext, direction: str) -> np.ndarray:
    """Return |c| where no direction is active, shape [M]; empty for a ramp, which crosses zero."""
    if context.record.kind == RAMP:
        return np.zeros(0)
    return np.abs(context.record.command(direction)[~context.any_active()])
