"""End stops of a campaign, and the check that names the logs that reach them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hitchid._support.records import Severity
from hitchid.logs.audit.context import (
    CampaignContext,
    Findings,
    RecordContext,
    join_names,
    quality,
    travel,
)
from hitchid.logs.kinds import ACTIVE_FRACTION
from hitchid.logs.not_measured import true_intervals
from hitchid.logs.record import DIRECTIONS, RAMP, Record

STANDS_S = 0.3  # s; shortest standstill, after as long under the same command: several lags (chosen)
AT_END_FRACTION = 0.02  # of the range; largest distance of a stop from the farthest displacement (chosen)
REACHED_FRACTION = 0.0025  # of the range; a log that comes so near to a stop has reached it (chosen)
STALL_SPEED_FRACTION = 0.1  # of the largest travel over 0.3 s; slower is a stall (chosen)
STALL_COMMAND_FRACTION = 0.8  # of a stall; least share with a strong command (chosen)
LONGEST_SPIKE = 3  # samples; a farther displacement that lasts no longer is no motion
CLEARLY_LESS = 0.8  # of a command at which the piston stands; hysteresis and friction differ less (chosen)
BACK_SHARE = 0.1  # of the time under command; a plant that moves back longer balances its command (chosen)
PASSED_FRACTION = 0.02  # of the range; a stop that logs pass by more is not where it is said to be (chosen)


@dataclass(frozen=True)
class EndStop:
    """A mechanical end of the stroke.

    Attributes:
        position: its displacement.
        reached: names of the records that come to it.
        standing: record to the samples `start:stop` in which the piston stands there under command.
    """

    position: float
    reached: tuple[str, ...]
    standing: Mapping[str, list[tuple[int, int]]]


class _Drive(NamedTuple):
    """One record in the direction of a stop, arrays of shape [N].

    Attributes:
        record: the record.
        position: sign times displacement.
        command: the least command over the last 0.6 s, zero where there is none.
        most: the largest command over the last 0.6 s.
        travel: of the position over the last 0.3 s.
        tolerance: what noise and rounding change at most.
        window: samples of 0.3 s.
    """

    record: Record
    position: np.ndarray
    command: np.ndarray
    most: np.ndarray
    travel: np.ndarray
    tolerance: float
    window: int


def find_end_stop(
    records: Sequence[Record], direction: str, sign: int, known: float | None = None
) -> EndStop | None:
    """Return the end stop in a direction; None where no record meets one.

    A piston is at its stop where it stands at the extreme of its travel, within 2 % of the range, while its
    command has been on for 0.6 s, the last 0.3 s of them without motion. The command must be one that moves
    the piston elsewhere, and more than any at which it stands elsewhere, as in the dead zone. Once is enough,
    but of a plant that moves back under its command, such as a level with an outflow: that may be a balance.
    Where tests of this direction agree on where a strong command moves it no further, the stop is there.

    Args:
        records: tests of any kind.
        direction: whose command drives towards the stop.
        sign: +1 where the displacement grows with that command, −1 where it falls.
        known: position of the stop where it is known already.
    """
    drives = [_drive(record, direction, sign) for record in records if direction in record.directions]
    if not drives:
        return None
    # Without spikes: one sample beyond the stop would put all standstills short of the end.
    farthest = max(_without_spikes(drive.position) for drive in drives)
    span = farthest - min(-_without_spikes(-drive.position) for drive in drives)
    if known is None:
        # Tests of one direction first: several that agree are better evidence than one standstill.
        known = _agreed_stall([record for record in records if record.kind == direction], direction, sign)
    if known is None:
        standing = _pressed_at_end(drives, farthest, span)
        # Each log counts once, however long it stands there.
        levels = [np.median(d.position[rows]) for d, rows in zip(drives, standing, strict=True) if rows.any()]
        if not levels:
            return None
        position = float(np.median(levels))
    else:
        position = sign * known
        standing = [
            (drive.command > 0)
            & (np.abs(drive.travel) <= drive.tolerance)
            & (drive.position >= position - max(drive.tolerance, REACHED_FRACTION * span))
            for drive in drives
        ]
    reached = [
        drive.record.name
        for drive in drives
        if _without_spikes(drive.position) >= position - max(drive.tolerance, REACHED_FRACTION * span)
    ]
    stretches = {}
    for drive, rows in zip(drives, standing, strict=True):
        if rows.any():
            # A standstill began a window before the sample that shows it.
            covered = rows.copy()
            for start, stop in zip(*true_intervals(rows), strict=True):
                covered[max(0, start - drive.window) : stop] = True
            starts, stops = true_intervals(covered)
            stretches[drive.record.name] = list(zip(starts.tolist(), stops.tolist(), strict=True))
    return EndStop(sign * position, tuple(reached), stretches)


def _pressed_at_end(drives: Sequence[_Drive], farthest: float, span: float) -> list[np.ndarray]:
    """Return where each piston stands at the end of the travel under a command that moves it elsewhere."""
    largest = max(float(drive.command.max()) for drive in drives)
    moving, still, standing, back = [], [], [], []
    for drive in drives:
        is_driven = drive.command > ACTIVE_FRACTION * largest
        is_at_end = drive.position >= farthest - max(drive.tolerance, AT_END_FRACTION * span)
        moving.append(drive.command[is_driven & ~is_at_end & (drive.travel > drive.tolerance)])
        stands = is_driven & (np.abs(drive.travel) <= drive.tolerance)
        still.append(drive.command[stands & ~is_at_end])
        back.append((drive.travel < -drive.tolerance)[is_driven])
        standing.append(stands & is_at_end)
    commands, idle = np.concatenate(moving), np.concatenate(still)
    if not commands.size or np.mean(np.concatenate(back)) > BACK_SHARE:
        return [np.zeros_like(rows) for rows in standing]
    # One percent either way for chance: a rounding that looks like motion, a sensor that stuck.
    least, most = np.percentile(commands, 1), np.percentile(idle, 99) if idle.size else 0.0
    return [
        at_end & (drive.command >= least * (1 - 1e-9)) & (drive.command > most)
        for drive, at_end in zip(drives, standing, strict=True)
    ]


def _agreed_stall(records: Sequence[Record], direction: str, sign: int) -> float | None:
    """Return the displacement at which at least two tests stall, none going 2 % of the range beyond it.

    A stop gives: a piston that is pressed harder goes on a little. The median of whole stalls, of one test
    each, tells where it gives least; that of single standstills would be of the weakest commands.
    """
    contacts = [(record, _stall(record, direction)) for record in records]
    levels = [np.median(record.displacement[start:]) for record, start in contacts if start is not None]
    if len(levels) < 2:
        return None
    farthest = max(float(np.max(sign * record.displacement)) for record in records)
    nearest = min(float(np.min(sign * record.displacement)) for record in records)
    tolerance, level = AT_END_FRACTION * (farthest - nearest), float(np.median(levels))
    agreeing = int(np.sum(np.abs(np.array(levels) - level) <= tolerance))
    return level if agreeing >= 2 and farthest - sign * level <= tolerance else None


def _stall(record: Record, direction: str) -> int | None:
    """Return the sample from which a strong command moves the piston no further, or None.

    Beyond half of the record's travel and up to the last strong command (one at or above the median), the
    travel over 0.3 s is below 10 % of the largest travel over that time.
    """
    command = np.abs(record.command(direction))
    active = command > ACTIVE_FRACTION * command.max()
    window = max(2, round(STANDS_S / record.step_s))
    if not np.any(active):
        return None
    # A weak command may be within the dead zone, where standing still means nothing.
    strong = command >= np.median(command[active])
    stop = int(np.flatnonzero(strong)[-1]) + 1
    displacement = record.displacement[:stop]
    if stop <= 2 * window:
        return None
    travelled = np.abs(displacement[window:] - displacement[:-window])
    moving = np.flatnonzero(travelled >= STALL_SPEED_FRACTION * travelled.max())
    contact = int(moving[-1]) + 1
    past_half = abs(displacement[contact] - displacement[0]) > 0.5 * float(np.ptp(displacement))
    is_pressed = float(np.mean(strong[contact:stop])) > STALL_COMMAND_FRACTION
    return contact if past_half and is_pressed and stop - contact > window else None


def _drive(record: Record, direction: str, sign: int) -> _Drive:
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # not at the top: a tenth of a second

    command, position = record.command(direction), sign * record.displacement
    # A single command of both signs drives towards the stop with one of them.
    command = np.maximum(command, 0.0) if command.min() < 0 < command.max() else np.abs(command)
    for other in record.directions:
        if other != direction:
            command = np.where(np.abs(record.command(other)) > command, 0.0, command)
    window = max(2, round(STANDS_S / record.step_s))
    least, most = (
        window_filter(command, 2 * window + 1, mode="constant", origin=window)
        for window_filter in (minimum_filter1d, maximum_filter1d)
    )
    # Unknown within the first window: infinite travel is no standstill.
    moved = np.full(position.size, np.inf)
    moved[window:] = position[window:] - position[:-window]
    return _Drive(record, position, least, most, moved, quality(record).noise_bound, window)


def _without_spikes(position: np.ndarray) -> float:
    """Return the largest position that is held for longer than a spike."""
    count = min(LONGEST_SPIKE + 1, position.size)
    return float(np.lib.stride_tricks.sliding_window_view(position, count).min(axis=1).max())


def find_end_stops(context: CampaignContext) -> dict[str, EndStop]:
    """Return direction to the end stop that its command drives the piston to, where logs meet one."""
    stops = {}
    for direction, sign, tests in _driven(context):
        known = context.campaign.end_stop(sign)
        stop = find_end_stop([test.record for test in tests], direction, sign, known)
        if stop is not None:
            stops[direction] = stop
    return stops


def _driven(context: CampaignContext) -> Iterator[tuple[str, int, list[RecordContext]]]:
    """Yield each direction that moves the piston, the sign of its motion, and its tests."""
    for direction in DIRECTIONS:
        tests = [test for test in context.tests if direction in test.record.directions]
        ways = sum(travel(test, direction) for test in tests)
        if ways:
            yield direction, 1 if ways > 0 else -1, tests


def end_stops(context: CampaignContext) -> Findings:
    """Find the logs that reach an end stop: a note, since identification leaves out samples at it.

    A stop that is said in `campaign.toml`, and that logs pass by 2 % of the range, is a warning.
    """
    tests = {test.record.name: test for test in context.tests}
    unit = context.tests[0].quality.unit
    stops = find_end_stops(context)
    for stop in stops.values():
        for name in stop.reached:
            test, stretches = tests[name], stop.standing.get(name, [])
            record = test.record
            if stretches:
                seconds = sum(last - first for first, last in stretches) * record.step_s
                where = f"stays at {stop.position:.5g} {unit}, an end stop, under command from"
                extent = f", {seconds:.3g} s in total"
            else:
                # It came to the stop without standing there: the nearest sample is the place.
                way = np.abs(record.displacement - stop.position)
                stretches, where, extent = [(int(np.argmin(way)), int(np.argmin(way)) + 1)], "", ""
                where = f"reaches the end stop of {stop.position:.5g} {unit} at"
            what = f"the piston {where} {test.time_s(stretches[0][0]):.6g} s{extent}"
            advice = "end tests before the stop: samples at the stop contain no information on the valve"
            yield test.finding("end stop", Severity.NOTE, what, advice, intervals=stretches)
    low, high = context.campaign.end_stops or (-np.inf, np.inf)
    margin = PASSED_FRACTION * (high - low)
    for test in context.tests:
        lowest, highest = test.quality.lowest, test.quality.highest
        if lowest < low - margin or highest > high + margin:
            what = (
                f"the piston goes from {lowest:.5g} to {highest:.5g} {test.quality.unit}, "
                f"beyond end_stops = [{low:g}, {high:g}]"
            )
            advice = "check end_stops and the displacement's unit in campaign.toml"
            yield test.finding("end stop", Severity.WARNING, what, advice)
    yield from _stalled(context, stops)


def _stalled(context: CampaignContext, stops: Mapping[str, EndStop]) -> Findings:
    """Find tests that come to stand before an end stop, where a smaller command moves the piston on."""
    for direction, sign, tests in _driven(context):
        drives = [_drive(test.record, direction, sign) for test in tests]
        # The command must be on over all of the 0.6 s: an idle current that is above zero moves nothing. Near
        # the dead zone a command moves the piston slowly in one test and not at all in another.
        active = [drive.command > ACTIVE_FRACTION * context.scales[direction] for drive in drives]
        fastest = max(
            float(np.max(drive.travel[np.isfinite(drive.travel) & rows], initial=0.0))
            for drive, rows in zip(drives, active, strict=True)
        )
        moves = [
            rows & (drive.travel > max(drive.tolerance, STALL_SPEED_FRACTION * fastest))
            for drive, rows in zip(drives, active, strict=True)
        ]
        for test, drive, is_on, moved in zip(tests, drives, active, moves, strict=True):
            stands = is_on & (np.abs(drive.travel) <= drive.tolerance)
            starts, ends = true_intervals(stands & np.logical_or.accumulate(moved))
            at_stop = direction in stops and test.record.name in stops[direction].reached
            # A slow ramp begins to move anywhere; what does not change at all is a stuck sensor.
            if test.record.kind == RAMP or at_stop or not starts.size:
                continue
            # Where the strongest command fails, a weaker one that works elsewhere says most.
            strongest = max(
                zip(starts, ends, strict=True), key=lambda rows: drive.command[slice(*rows)].max()
            )
            position, command = drive.position[slice(*strongest)], drive.command[slice(*strongest)].max()
            beyond = float(np.median(position)) + max(
                PASSED_FRACTION * context.campaign_range, drive.tolerance
            )
            going_on = [
                other.record.name
                for other, rows in zip(drives, moves, strict=True)
                if np.any(rows & (other.position > beyond) & (other.most <= CLEARLY_LESS * command))
            ]
            if np.ptp(position) == 0 or not going_on:
                continue
            what = (
                f"the piston stands at {sign * np.median(position):.5g} {test.quality.unit} under "
                f"{command:.3g} {context.command_unit(direction)} of {direction}; less "
                f"moves it on in {join_names(going_on)}"
            )
            advice = "check load, pressure and sensor; cut the interval out, or leave the test out"
            intervals = list(zip(starts.tolist(), ends.tolist(), strict=True))
            yield test.finding("stall", Severity.WARNING, what, advice, intervals=intervals)
