"""Segmentation of mixed logs: lifting, hold, lowering, saturated, end stop, both valves on."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hitchid.data.record import LIFTING, LOWERING, Record
from hitchid.data.test_kinds import ACTIVE_FRACTION, full_scales

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
    label = np.full(len(record), LABELS.index(HOLD))
    for direction, active_samples in active.items():
        label[active_samples] = LABELS.index(direction)
    travel = _local_travel(record)
    for direction in active:
        selected = label == LABELS.index(direction)
        if not selected.any():
            continue
        slow = selected & (travel < STATIONARY_FRACTION * np.median(travel[selected]))
        stationary = _sustained(slow, max(1, round(WINDOW_S / record.step_s)))
        at_end = _at_end(record, upwards=_upwards(record, selected))
        label[selected & _clipped(record, direction, scale_of[direction])] = LABELS.index(SATURATED)
        label[stationary & ~at_end] = LABELS.index(HOLD)
        label[stationary & at_end] = LABELS.index(END_STOP)
    if len(active) == 2:
        label[active[LIFTING] & active[LOWERING]] = LABELS.index(BOTH_VALVES_ACTIVE)
    edges = np.flatnonzero(np.diff(label)) + 1
    starts = [0, *edges.tolist()]
    return [
        Segment(LABELS[label[start]], start, stop)
        for start, stop in zip(starts, [*edges.tolist(), len(record)], strict=True)
    ]


def durations_s(found_segments: Sequence[Segment], step_s: float) -> dict[str, float]:
    """Return label to its total duration, s, for the labels that occur."""
    return {
        label: round(
            sum(segment.stop - segment.start for segment in found_segments if segment.label == label)
            * step_s,
            6,
        )
        for label in LABELS
        if any(segment.label == label for segment in found_segments)
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


def _local_travel(record: Record) -> np.ndarray:
    """Return the travel over 0.3 s around each sample, shape [N]."""
    half = max(1, round(0.5 * WINDOW_S / record.step_s))
    samples = np.arange(len(record))
    window_start, window_stop = np.maximum(samples - half, 0), np.minimum(samples + half, len(record) - 1)
    travel = np.abs(record.displacement[window_stop] - record.displacement[window_start])
    return travel * 2 * half / np.maximum(window_stop - window_start, 1)


def _upwards(record: Record, selected: np.ndarray) -> bool:
    steps = np.diff(record.displacement, append=record.displacement[-1])
    return float(steps[selected].sum()) >= 0


def _at_end(record: Record, *, upwards: bool) -> np.ndarray:
    """Return which samples lie within 2 % of the end of the record's travel, shape [N]."""
    margin = AT_END_FRACTION * float(np.ptp(record.displacement))
    if upwards:
        return record.displacement >= record.displacement.max() - margin
    return record.displacement <= record.displacement.min() + margin


def _clipped(record: Record, direction: str, full_scale: float) -> np.ndarray:
    """Return where a command with many values is at the largest of all logs, shape [N]."""
    command = np.abs(record.command(direction))
    at_maximum = command >= full_scale * (1 - 1e-9)
    if np.unique(command).size < MIN_COMMAND_VALUES:
        return np.zeros(command.size, dtype=bool)
    return _sustained(at_maximum, CLIPPED_SAMPLES)


def _sustained(condition: np.ndarray, samples: int) -> np.ndarray:
    """Return where a condition is true for at least `samples` consecutive samples, shape [N]."""
    if condition.size < samples:
        return np.zeros(condition.size, dtype=bool)
    full_windows = np.convolve(condition, np.ones(samples), "valid") == samples
    return np.convolve(full_windows, np.ones(samples)) > 0
