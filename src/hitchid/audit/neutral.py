"""Check for a signed command that rests at a reading other than zero and moves the piston both ways."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hitchid._support.notices import Severity
from hitchid._support.short_repr import short_repr
from hitchid.audit.context import CampaignContext, command_unit
from hitchid.audit.finding import AuditFinding
from hitchid.data.record import COMMAND, LIFTING, LOWERING, Record
from hitchid.data.test_kinds import ACTIVE_FRACTION

RESTING_FRACTION = 0.1  # of all samples; smallest share at the rest level (chosen)
WORKING_FRACTION = 0.01  # of the time; smallest share above and below the rest level (chosen)
BINS = 200  # bins of the histogram of a noisy command (chosen)
CREEP_FRACTION = 0.2  # of the speed away from the rest level; largest speed at it (chosen)


@short_repr
class CommandResponse(NamedTuple):
    """One log's signed command and displacement, each of shape [N], and its sampling time, s."""

    command: np.ndarray
    displacement: np.ndarray
    step_s: float


def rest_level(runs: Sequence[CommandResponse]) -> float | None:
    """Return the neutral reading of a signed command; None where no reading meets the conditions.

    The most frequent reading, with at least a tenth of all samples. Above and below it, by 5 % of the range
    and for 1 % of the time each, the displacement must move in opposite directions, and at it less than a
    fifth as fast as in either: this excludes a one-sided command with a frequent level.
    """
    commands = np.concatenate([run.command for run in runs])
    command_range = float(np.ptp(commands))
    if not 0 < command_range < np.inf:
        return None
    level, share = _most_frequent(commands)
    if share < RESTING_FRACTION:
        return None
    band = ACTIVE_FRACTION * command_range
    speeds = []
    for inside in (
        lambda c: c > level + band,
        lambda c: c < level - band,
        lambda c: np.abs(c - level) <= band,
    ):
        travel = sum(float(np.sum(np.diff(r.displacement)[inside(r.command[:-1])])) for r in runs)
        duration_s = sum(np.count_nonzero(inside(r.command[:-1])) * r.step_s for r in runs)
        if duration_s < WORKING_FRACTION * sum(r.command.size * r.step_s for r in runs):
            return None
        speeds.append(travel / duration_s)
    above, below, at_rest = speeds
    moving = min(abs(above), abs(below))
    return level if above * below < 0 and abs(at_rest) < CREEP_FRACTION * moving else None


def _most_frequent(samples: np.ndarray) -> tuple[float, float]:
    """Return the most frequent value (of noisy samples the median of the fullest bin) and its share."""
    values, counts = np.unique(samples, return_counts=True)
    most_frequent = int(np.argmax(counts))
    if counts[most_frequent] >= RESTING_FRACTION * samples.size:
        return float(values[most_frequent]), float(counts[most_frequent] / samples.size)
    filled, edges = np.histogram(samples, bins=BINS)
    fullest = int(np.argmax(filled))
    inside = samples[(samples >= edges[fullest]) & (samples <= edges[fullest + 1])]
    return float(np.median(inside)), inside.size / samples.size


def neutral(context: CampaignContext) -> list[AuditFinding]:
    """Find a signed command that rests at a constant above 5 % of its largest reading.

    Such a command has the sign of one direction even at rest: a fault where it never changes its sign, since
    one direction is then missing, else a warning.
    """
    records = [test.record for test in context.tests]
    signed = [_signed(record) for record in records]
    if any(command is None for command in signed):
        return []
    runs = [
        CommandResponse(command, record.displacement, record.step_s)
        for command, record in zip(signed, records, strict=True)
        if command is not None
    ]
    level, largest = rest_level(runs), max(context.scales.values())
    if level is None or abs(level) <= ACTIVE_FRACTION * largest:
        return []
    unseen = all(np.min(run.command) * np.max(run.command) >= 0 for run in runs)
    direction = LIFTING if LIFTING in records[0].directions else LOWERING
    unit = command_unit(records[0], direction)
    consequence = ", so that one direction is taken for both" if unseen else ""
    what = f"the command rests at {level:.6g} {unit} and moves the piston both ways around it{consequence}"
    advice = f"put zero = {level:.6g} beside the column of the command in campaign.toml"
    severity = Severity.FAULT if unseen else Severity.WARNING
    return [AuditFinding("neutral", severity, "", COMMAND[direction], (), what, advice)]


def _signed(record: Record) -> np.ndarray | None:
    """Return lifting less lowering command, shape [N]; None where both are on at once."""
    commands = [record.command(direction) for direction in record.directions]
    if len(commands) == 1:
        return commands[0] if record.directions == (LIFTING,) else -commands[0]
    lifting, lowering = commands
    return None if np.any((lifting != 0) & (lowering != 0)) else lifting - lowering
