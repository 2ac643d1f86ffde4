"""Kind of a test from its commands, strokes of a mixed log."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hitchid.logs.record import COMMAND, CYCLE, IDLE, LIFTING, LOWERING, RAMP, Record

ACTIVE_FRACTION = 0.05  # of full scale; a smaller command counts as noise (chosen)
RAMP_CORRELATION = 0.99  # correlation of a ramp's command with time, at least (chosen)
RAMP_SHORTEST_S = 2.0  # s; a faster rise excites the dynamics (chosen)
REST_S = 0.5  # s without command before a stroke, in which the piston comes to rest (chosen)
LEAD_IN_S = 0.1  # s kept before the onset of a stroke (chosen)
SHORTEST_STROKE_S = 0.5  # s; shorter strokes do not determine the lag (chosen)
SHORTEST_STROKE_SAMPLES = 3  # samples; the fewest with two speeds, on a slow clock too


@dataclass(frozen=True)
class Stroke:
    """Samples `start:stop` of a record with one active direction."""

    direction: str
    start: int
    stop: int


def effective_command(command: np.ndarray, dead_zone: float | np.ndarray) -> np.ndarray:
    """Return the effective command, the part of c, shape [N], beyond the dead zone d ≥ 0 in the same unit.

    u = sign(c)·max(|c| − d, 0); for the one-signed current of a valve this is max(c − d, 0) of Sun et al.
    2025, sec. 2.2.1.
    """
    return np.sign(command) * np.maximum(np.abs(command) - dead_zone, 0.0)


def full_scales(records: Iterable[Record]) -> dict[str, float]:
    """Return direction to full scale, the largest of all commands in its unit.

    Both directions share a scale so that noise on an inactive valve does not count as a command.
    """
    largest: dict[str, float] = {}
    units: dict[str, str] = {}
    for record in records:
        for direction in record.directions:
            units[direction] = record.units[COMMAND[direction]]
            peak = float(np.max(np.abs(record.command(direction))))
            largest[units[direction]] = max(largest.get(units[direction], 0.0), peak)
    return {direction: largest[unit] for direction, unit in units.items()}


def detect_kind(record: Record, scales: Mapping[str, float]) -> str:
    """Return the kind of a record from its commands: lifting, lowering, ramp, cycle or idle.

    A command counts as active above 5 % of full scale; see `full_scales`.
    """
    thresholds = {direction: ACTIVE_FRACTION * scales[direction] for direction in record.directions}
    active = [
        direction
        for direction in record.directions
        if np.count_nonzero(np.abs(record.command(direction)) > thresholds[direction]) >= 3
    ]
    if not active:
        return IDLE
    if len(active) == 2:
        return CYCLE
    (direction,) = active
    command, is_active = record.command(direction), record.command(direction) > thresholds[direction]
    onset = int(np.flatnonzero(is_active)[0]) if np.any(is_active) else command.size
    rise = command[onset : int(np.argmax(command)) + 1]
    # A faster rise excites the dynamics; one from a high level begins behind the dead zone.
    if rise.size * record.step_s < RAMP_SHORTEST_S or rise[0] > 0.25 * rise[-1]:
        return direction
    correlation = float(np.corrcoef(np.arange(rise.size), rise)[0, 1])
    return RAMP if correlation > RAMP_CORRELATION else direction


def ramp_direction(record: Record) -> str:
    """Return the direction a ramp excites: the one with the larger command."""
    return max(record.directions, key=lambda direction: float(np.max(np.abs(record.command(direction)))))


def direction_signs(record: Record, dead_zones: Mapping[str, float]) -> np.ndarray:
    """Return the direction of the effective command: +1 lifting, −1 lowering, 0 neither; shape [N].

    Where both are effective it is lowering, as in Sun et al. 2025, sec. 2.2.1: lifting requires a lowering
    command of zero. A command below 5 % of the record's largest is noise, even if the dead zone is smaller.
    """
    scales = full_scales([record])
    signs = np.zeros(len(record), dtype=np.int64)
    for direction, sign in ((LIFTING, 1), (LOWERING, -1)):
        if direction in record.directions:
            threshold = max(dead_zones.get(direction, 0.0), ACTIVE_FRACTION * scales[direction])
            signs[np.abs(record.command(direction)) > threshold] = sign
    return signs


def split_by_direction(record: Record, dead_zones: Mapping[str, float]) -> list[Stroke]:
    """Divide a whole record into strokes with one active direction each.

    A direction stays active while neither command is effective, so a hold belongs to the stroke before it;
    a hold at the start belongs to the first stroke.
    """
    signs = direction_signs(record, dead_zones)
    active_samples = np.flatnonzero(signs)
    if active_samples.size == 0:
        return [Stroke(record.directions[0], 0, len(record))]
    turns = active_samples[1:][signs[active_samples[1:]] != signs[active_samples[:-1]]].tolist()
    return [
        Stroke(LIFTING if signs[first] > 0 else LOWERING, start, stop)
        for first, start, stop in zip(
            [active_samples[0], *turns], [0, *turns], [*turns, len(record)], strict=True
        )
    ]


def strokes(record: Record, dead_zones: Mapping[str, float]) -> list[Stroke]:
    """Cut a mixed record into strokes, each for the identification of one direction.

    A stroke begins 0.1 s before the command becomes effective after at least 0.5 s without effect, or at a
    change of direction, and ends at the start of the next. Strokes shorter than 0.5 s or 3 samples are left
    out.
    """
    signs = direction_signs(record, dead_zones)
    active_samples = np.flatnonzero(signs)
    if active_samples.size == 0:
        return []
    rest = max(1, round(REST_S / record.step_s))
    lead = round(LEAD_IN_S / record.step_s)
    shortest = max(SHORTEST_STROKE_S / record.step_s, SHORTEST_STROKE_SAMPLES)
    # The first active sample has no predecessor: as if the record came after a rest.
    after_rest = np.diff(active_samples, prepend=-rest - 1) > rest
    after_reversal = np.diff(signs[active_samples], prepend=signs[active_samples[0]]) != 0
    is_start = after_rest | after_reversal
    onsets = active_samples[is_start]
    # At a reversal the lead would belong to the other direction.
    lead_ins = np.where(after_rest[is_start], lead, 0)
    starts = [max(0, int(onset) - int(lead_in)) for onset, lead_in in zip(onsets, lead_ins, strict=True)]
    valid_strokes = []
    for onset, start, stop in zip(onsets, starts, [*starts[1:], len(record)], strict=True):
        if stop - start >= shortest:
            valid_strokes.append(Stroke(LIFTING if signs[onset] > 0 else LOWERING, start, stop))
    return valid_strokes


# Segmentation of mixed logs: lifting, hold, lowering, saturated, end stop, both valves on.

HOLD, SATURATED, END_STOP, BOTH_VALVES_ACTIVE = "hold", "saturated", "end stop", "both valves on"
LABELS = (LIFTING, LOWERING, HOLD, SATURATED, END_STOP, BOTH_VALVES_ACTIVE)  # in the order of JSON output
WINDOW_S = 0.3  # s; window of a standstill: several lags of a common valve (chosen)
STATIONARY_FRACTION = 0.1  # of a direction's median travel over the window; slower is a standstill (chosen)
AT_END_FRACTION = 0.02  # of the record's travel; largest distance from its end (chosen)
CLIPPED_SAMPLES = 5  # consecutive samples at full scale (chosen)
# Distinct values; a command with fewer has levels, and its largest level is no saturation (chosen).
MIN_COMMAND_VALUES = 50


class CommandThreshold(NamedTuple):
    """Threshold at which a direction responds to its command.

    Attributes:
        dead_zone: command at which motion begins, in its unit.
        hysteresis: distance below it at which motion ends, same unit.
        dead_time_s: from command to motion, s.
    """

    dead_zone: float
    hysteresis: float = 0.0
    dead_time_s: float = 0.0


class Segment(NamedTuple):
    """Samples `start:stop` of a record with one label."""

    label: str
    start: int
    stop: int


def segments(
    record: Record,
    scales: Mapping[str, float] | None = None,
    command_thresholds: Mapping[str, CommandThreshold] | None = None,
) -> list[Segment]:
    """Divide a record into segments of lifting, hold, lowering, saturated, end stop and both valves on.

    A direction is active above its dead zone (above 5 % of full scale if that is larger or the dead zone
    is unknown), until its command falls below it by the hysteresis, and delayed by its dead time. Both
    directions active at once have a label of their own. While one is active,

    - the piston is at an end stop if its travel over 0.3 s is below 10 % of the direction's median over that
      time, within 2 % of the end of the record's travel;
    - elsewhere such a standstill is a hold: the command is below the dead zone;
    - the valve is saturated if a command with many values is at the largest one of all logs.

    Args:
        record: a test of any kind.
        scales: direction to largest command of all logs; by default of this one.
        command_thresholds: direction to its threshold, if known.
    """
    scale_of = dict(scales or full_scales([record]))
    thresholds = command_thresholds or {}
    active = {
        direction: _active_samples(record, direction, scale_of[direction], thresholds.get(direction))
        for direction in record.directions
    }
    # Each later label covers those before it: a standstill says more than a command at its largest, and with
    # both valves on nothing is known of either.
    label = np.full(len(record), LABELS.index(HOLD))
    for direction, active_samples in active.items():
        label[active_samples] = LABELS.index(direction)
    displacement = record.displacement
    half = max(1, round(0.5 * WINDOW_S / record.step_s))
    samples = np.arange(len(record))
    start, stop = np.maximum(samples - half, 0), np.minimum(samples + half, len(record) - 1)
    travel = np.abs(displacement[stop] - displacement[start]) * 2 * half / np.maximum(stop - start, 1)
    lowest, highest = displacement.min(), displacement.max()
    # Of this record alone: stops of a whole campaign are found in the audit, which sees all logs.
    margin = AT_END_FRACTION * float(np.ptp(displacement))
    for direction in active:
        selected = label == LABELS.index(direction)
        if not selected.any():
            continue
        slow = selected & (travel < STATIONARY_FRACTION * np.median(travel[selected]))
        stationary = _sustained(slow, max(1, round(WINDOW_S / record.step_s)))
        is_upwards = float(np.diff(displacement, append=displacement[-1])[selected].sum()) >= 0
        at_end = displacement >= highest - margin if is_upwards else displacement <= lowest + margin
        command = np.abs(record.command(direction))
        # A switched command is at its largest level half of the time without being limited.
        if np.unique(command).size >= MIN_COMMAND_VALUES:
            clipped = _sustained(command >= scale_of[direction] * (1 - 1e-9), CLIPPED_SAMPLES)
            label[selected & clipped] = LABELS.index(SATURATED)
        label[stationary & ~at_end] = LABELS.index(HOLD)
        label[stationary & at_end] = LABELS.index(END_STOP)
    if len(active) == 2:
        label[active[LIFTING] & active[LOWERING]] = LABELS.index(BOTH_VALVES_ACTIVE)
    edges = [0, *(np.flatnonzero(np.diff(label)) + 1).tolist(), len(record)]
    return [Segment(LABELS[label[start]], start, stop) for start, stop in pairwise(edges)]


def durations_s(parts: Sequence[Segment], step_s: float) -> dict[str, float]:
    """Return label to its total duration, s, for the labels that occur."""
    return {
        label: round(sum(part.stop - part.start for part in parts if part.label == label) * step_s, 6)
        for label in LABELS
        if any(part.label == label for part in parts)
    }


def _active_samples(
    record: Record, direction: str, full_scale: float, command_threshold: CommandThreshold | None
) -> np.ndarray:
    """Return where a direction is active, by its command with hysteresis and dead time, shape [N]."""
    threshold = command_threshold or CommandThreshold(0.0)
    on = max(threshold.dead_zone, ACTIVE_FRACTION * full_scale)
    off = max(on - threshold.hysteresis, ACTIVE_FRACTION * full_scale)
    command = np.abs(record.command(direction))
    # Hysteresis: between the two levels the state is that of the last sample outside them.
    decisive = np.where((command > on) | (command <= off), np.arange(command.size), -1)
    last = np.maximum.accumulate(decisive)
    active = (last >= 0) & (command[np.maximum(last, 0)] > on)
    delay_samples = min(round(threshold.dead_time_s / record.step_s), active.size)
    return np.concatenate([np.zeros(delay_samples, dtype=bool), active[: active.size - delay_samples]])


def _sustained(condition: np.ndarray, samples: int) -> np.ndarray:
    """Return where a condition is true for at least `samples` consecutive samples, shape [N]."""
    if condition.size < samples:
        return np.zeros(condition.size, dtype=bool)
    full_windows = np.convolve(condition, np.ones(samples), "valid") == samples
    return np.convolve(full_windows, np.ones(samples)) > 0
