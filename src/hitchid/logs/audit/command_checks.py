"""Checks of the commands: one valve at a time, and zero when idle."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hitchid._support.numbers import count
from hitchid._support.records import Severity, short_repr
from hitchid.logs.audit.context import (
    CampaignContext,
    Findings,
    RecordContext,
    join_names,
    travel,
)
from hitchid.logs.kinds import ACTIVE_FRACTION
from hitchid.logs.not_measured import true_intervals
from hitchid.logs.record import COMMAND, CYCLE, DIRECTIONS, LIFTING, LOWERING, RAMP, Record

# Check for a signed command that rests at a reading other than zero and moves the piston both ways.

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
    # All logs together: each of them may rest at another of its levels.
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
    # An exact reading first: a bin of a histogram would move the zero by part of its width.
    values, counts = np.unique(samples, return_counts=True)
    most_frequent = int(np.argmax(counts))
    if counts[most_frequent] >= RESTING_FRACTION * samples.size:
        return float(values[most_frequent]), float(counts[most_frequent] / samples.size)
    filled, edges = np.histogram(samples, bins=BINS)
    fullest = int(np.argmax(filled))
    inside = samples[(samples >= edges[fullest]) & (samples <= edges[fullest + 1])]
    return float(np.median(inside)), inside.size / samples.size


def neutral(context: CampaignContext) -> Findings:
    """Find a signed command that rests at a constant above 5 % of its largest reading.

    Such a command has the sign of one direction even at rest: a fault where it never changes its sign, since
    one direction is then missing, else a warning.
    """
    records = [test.record for test in context.tests]
    signed = [_signed(record) for record in records]
    # Two commands that are on at once are no halves of one signed column.
    if any(command is None for command in signed):
        return
    runs = [
        CommandResponse(command, record.displacement, record.step_s)
        for command, record in zip(signed, records, strict=True)
        if command is not None
    ]
    level, largest = rest_level(runs), max(context.scales.values())
    if level is None or abs(level) <= ACTIVE_FRACTION * largest:
        return
    unseen = all(np.min(run.command) * np.max(run.command) >= 0 for run in runs)
    direction = context.directions[0]
    unit = context.command_unit(direction)
    consequence = ", so one direction is identified from motion in both" if unseen else ""
    what = (
        f"the command rests at {level:.6g} {unit} and moves the piston in both directions about this value"
        f"{consequence}"
    )
    advice = f"set zero = {level:.6g} for the command's column in campaign.toml"
    severity = Severity.FAULT if unseen else Severity.WARNING
    yield context.finding("neutral", severity, what, advice, signal=COMMAND[direction])


def _signed(record: Record) -> np.ndarray | None:
    """Return lifting less lowering command, shape [N]; None where both are on at once."""
    commands = [record.command(direction) for direction in record.directions]
    if len(commands) == 1:
        return commands[0] if record.directions == (LIFTING,) else -commands[0]
    lifting, lowering = commands
    return None if np.any((lifting != 0) & (lowering != 0)) else lifting - lowering


# Check of polarity: lifting raises the displacement and lowering reduces it, over all tests.

CLEAR_FRACTION = 0.02  # of the campaign's range; smallest travel with a sign (chosen)
CLEAR_OF_TYPICAL = 0.25  # of the median travel; smallest opposite travel of a test (chosen)


def signs(context: CampaignContext) -> Findings:
    """Find directions whose displacement has the wrong sign.

    The sign of a direction is that of the median travel of its tests while only its command is on, where the
    travel exceeds 6 σ + 2 q and 2 % of the campaign's range. A test of opposite sign, by a quarter of the
    median travel, is a fault of that test; equal signs of both directions are a fault of the campaign. Both
    signs reversed are a warning: either the sensor measures downwards, which identification allows, or the
    commands are swapped.
    """
    majority_sign: dict[str, int] = {}
    for direction in context.directions:
        travels = _travels(context, direction)
        if not travels:
            continue
        # The median: one log with swapped columns must not turn the sign of all.
        middle = float(np.median([way for _, way in travels]))
        majority_sign[direction] = sign = 1 if middle >= 0 else -1
        typical = abs(middle)
        opposed = [(test, way) for test, way in travels if way * sign < -CLEAR_OF_TYPICAL * typical]
        advice = "check the sign of the displacement and the assignment of the commands in "
        if len(travels) >= 3 and 2 * len(opposed) < len(travels):
            for test, way in opposed:
                what = (
                    f"the displacement {_verb(-sign)} by {abs(way):.4g} {test.quality.unit} while "
                    f"{direction} is commanded; in most of the {len(travels)} tests of {direction} it "
                    f"{_verb(sign)}"
                )
                yield test.finding("sign", Severity.FAULT, what, f"{advice}this log, or remove it")
        elif opposed:
            names = join_names([test.record.name for test, _ in opposed])
            what = (
                f"in {direction} the displacement {_verb(-sign)} in {len(opposed)} of {len(travels)} tests "
                f"({names}) and {_verb(sign)} in the others"
            )
            yield context.finding("sign", Severity.FAULT, what, f"{advice}each test")
    if set(majority_sign) != set(DIRECTIONS) or majority_sign == {LIFTING: 1, LOWERING: -1}:
        return
    severity = Severity.WARNING
    what = "the displacement decreases in lifting and increases in lowering"
    advice = (
        "this is correct for a sensor that measures downwards: each direction is identified as measured; "
        "otherwise swap the commands in campaign.toml, or reverse the sign of one signal: set scale = -1 "
        "for its column"
    )
    # Both reversed is a matter of where the sensor points; both alike no plant does.
    if majority_sign[LIFTING] == majority_sign[LOWERING]:
        severity = Severity.FAULT
        what = f"the displacement {_verb(majority_sign[LIFTING])} in lifting and in lowering"
        advice = f"check the columns assigned to {COMMAND[LIFTING]} and {COMMAND[LOWERING]} in campaign.toml"
    yield context.finding("sign", severity, what, advice)


def _travels(context: CampaignContext, direction: str) -> list[tuple[RecordContext, float]]:
    """Return the tests with significant travel under a direction, and that travel."""
    tests = [test for test in context.tests if test.record.kind in (direction, CYCLE, RAMP)]
    travels = [(test, travel(test, direction)) for test in tests]
    least = CLEAR_FRACTION * context.campaign_range
    return [(test, way) for test, way in travels if abs(way) > max(test.quality.noise_bound, least)]


def _verb(sign: int) -> str:
    return "increases" if sign > 0 else "decreases"


SHORT_OVERLAP_S = 0.1  # s; overlap that filters and ramps of a controller cause at a change of direction
IDLE_FRACTION = 0.01  # of full scale; smallest bias or sensor offset reported (chosen)


def both_valves(context: RecordContext) -> Findings:
    """Find where both commands are above 5 % of full scale.

    Filters and ramps of a controller overlap by up to 0.1 s at a change of direction: a note. With a longer
    overlap the motion cannot be assigned to one direction: a warning.
    """
    record = context.record
    if len(record.directions) < 2:
        return
    starts, stops = true_intervals(context.active(LIFTING) & context.active(LOWERING))
    if starts.size == 0:
        return
    longest = int(np.max(stops - starts)) * record.step_s
    time = int(np.sum(stops - starts)) * record.step_s
    severity = Severity.NOTE if longest <= SHORT_OVERLAP_S else Severity.WARNING
    what = (
        f"both commands are active {count(starts.size, 'time')}, {time:.3g} s in total, "
        f"at most {longest:.3g} s at once, first at {context.time_s(starts[0]):.6g} s"
    )
    advice = "end one command before the other starts; in an overlap the lowering command is used"
    intervals = list(zip(starts.tolist(), stops.tolist(), strict=True))
    yield context.finding("both valves", severity, what, advice, signal="", intervals=intervals)


def idle_commands(context: CampaignContext, direction: str) -> Findings:
    """Find commands that are not zero when idle.

    A warning if the smallest |c| of all logs is above 5 % of full scale: the command is never off, as with a
    4–20 mA signal, and the dead zone is measured from a wrong zero. Else a note if the median of |c| without
    command is above 1 % of full scale: a bias or a sensor's offset.
    """
    scale, unit = context.scales[direction], context.command_unit(direction)
    # In any log: one test that begins at zero shows that the offset is none.
    smallest = min(float(np.min(np.abs(test.record.command(direction)))) for test in context.tests)
    if not scale > 0:
        return
    if smallest > ACTIVE_FRACTION * scale:
        what = (
            f"the {direction} command is never below {smallest:.3g} {unit} in any log, "
            f"{smallest / scale:.0%} of the largest"
        )
        advice = (
            "subtract the offset from the command, or log one test that starts at command "
            "zero: the offset makes the dead zone too large"
        )
        yield context.finding("idle command", Severity.WARNING, what, advice, signal=COMMAND[direction])
        return
    # A ramp crosses zero.
    idle = [
        np.abs(test.record.command(direction)[~test.any_active()])
        for test in context.tests
        if test.record.kind != RAMP
    ]
    levels = [float(np.median(command)) for command in idle if command.size]
    level = float(np.median(levels)) if levels else 0.0
    if level > IDLE_FRACTION * scale:
        what = f"the idle {direction} command is {level:.3g} {unit}, {level / scale:.1%} of full scale"
        advice = "check the zero of the current sensor and the bias of the valve"
        yield context.finding("idle command", Severity.NOTE, what, advice, signal=COMMAND[direction])
