"""What a mixed log does, stretch by stretch: lift, hold, lower, and where something stands in the way."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hitchid.data.record import LIFTING, LOWERING, Record
from hitchid.data.test_kinds import ACTIVE_FRACTION, full_scales

HOLD, SATURATED, END_STOP, BOTH = "hold", "saturated", "end stop", "both valves on"
LABELS = (LIFTING, LOWERING, HOLD, SATURATED, END_STOP, BOTH)
WINDOW_S = 0.3
STANDING_FRACTION = 0.1
AT_END_FRACTION = 0.02
CLIPPED_SAMPLES = 5
LEVELS = 50


class Switch(NamedTuple):
    """How one direction hears its command.

    Attributes:
        dead_zone: command at which motion begins, in its unit.
        hysteresis: how far below it the command falls before motion ends, same unit.
        dead_time_s: from command to motion, s.
    """

    dead_zone: float
    hysteresis: float = 0.0
    dead_time_s: float = 0.0


class Segment(NamedTuple):
    """Samples `start:stop` of a record and what happens in them."""

    label: str
    start: int
    stop: int


def segments(
    record: Record,
    scales: Mapping[str, float] | None = None,
    switches: Mapping[str, Switch] | None = None,
) -> list[Segment]:
    """Divide a record into stretches of lift, hold, lower, saturated, end stop and both valves on.

    A direction works from its dead zone up (from 5 % of full scale where that is larger or the dead zone is
    not known), until its command falls by the hysteresis below it, and its dead time later. Both directions
    at once are a fault of their own. While one works,

    - the piston is at an end stop where over 0.3 s it moves by less than 10 % of what that direction moves it
      in the median, within 2 % of the end of the record's travel;
    - elsewhere such a standstill is a hold: the command lies below the dead zone;
    - the valve is saturated where a command that takes many values stands at the largest one of all logs.

    Args:
        record: a test of any kind.
        scales: mode to largest command of all logs; by default of this one.
        switches: mode to how it hears its command, where that is known.
    """
    full = dict(scales or full_scales([record]))
    known = switches or {}
    works = {mode: _works(record, mode, full[mode], known.get(mode)) for mode in record.modes}
    label = np.full(len(record), LABELS.index(HOLD))
    for mode, working in works.items():
        label[working] = LABELS.index(mode)
    moved = _moved(record)
    for mode in works:
        alone = label == LABELS.index(mode)
        if not alone.any():
            continue
        slow = alone & (moved < STANDING_FRACTION * np.median(moved[alone]))
        standing = _lasting(slow, max(1, round(WINDOW_S / record.step_s)))
        at_end = _at_end(record, upwards=_upwards(record, alone))
        label[alone & _clipped(record, mode, full[mode])] = LABELS.index(SATURATED)
        label[standing & ~at_end] = LABELS.index(HOLD)
        label[standing & at_end] = LABELS.index(END_STOP)
    if len(works) == 2:
        label[works[LIFTING] & works[LOWERING]] = LABELS.index(BOTH)
    edges = np.flatnonzero(np.diff(label)) + 1
    starts = [0, *edges.tolist()]
    return [
        Segment(LABELS[label[start]], start, stop)
        for start, stop in zip(starts, [*edges.tolist(), len(record)], strict=True)
    ]


def durations_s(found: Sequence[Segment], step_s: float) -> dict[str, float]:
    """Return label to the time it takes in all, s, for the labels that occur."""
    return {
        label: round(sum(each.stop - each.start for each in found if each.label == label) * step_s, 6)
        for label in LABELS
        if any(each.label == label for each in found)
    }


def _works(record: Record, mode: str, full_scale: float, switch: Switch | None) -> np.ndarray:
    """Tell where a direction works, by its command with hysteresis and dead time, shape [N]."""
    heard = switch or Switch(0.0)
    on = max(heard.dead_zone, ACTIVE_FRACTION * full_scale)
    off = max(on - heard.hysteresis, ACTIVE_FRACTION * full_scale)
    command = np.abs(record.command(mode))
    # Between the two levels the state stands: the last sample outside them decides.
    decided = np.where((command > on) | (command <= off), np.arange(command.size), -1)
    last = np.maximum.accumulate(decided)
    working = (last >= 0) & (command[np.maximum(last, 0)] > on)
    late = min(round(heard.dead_time_s / record.step_s), working.size)
    return np.concatenate([np.zeros(late, dtype=bool), working[: working.size - late]])


def _moved(record: Record) -> np.ndarray:
    """Return how far the piston moves over 0.3 s around each sample, shape [N]."""
    half = max(1, round(0.5 * WINDOW_S / record.step_s))
    place = np.arange(len(record))
    before, after = np.maximum(place - half, 0), np.minimum(place + half, len(record) - 1)
    moved = np.abs(record.displacement[after] - record.displacement[before])
    return moved * 2 * half / np.maximum(after - before, 1)


def _upwards(record: Record, alone: np.ndarray) -> bool:
    steps = np.diff(record.displacement, append=record.displacement[-1])
    return float(steps[alone].sum()) >= 0


def _at_end(record: Record, *, upwards: bool) -> np.ndarray:
    """Tell which samples lie within 2 % of the end of the record's travel, shape [N]."""
    near = AT_END_FRACTION * float(np.ptp(record.displacement))
    if upwards:
        return record.displacement >= record.displacement.max() - near
    return record.displacement <= record.displacement.min() + near


def _clipped(record: Record, mode: str, full_scale: float) -> np.ndarray:
    """Tell where a command of many values stands at the largest of all logs, shape [N]."""
    command = np.abs(record.command(mode))
    top = command >= full_scale * (1 - 1e-9)
    if np.unique(command).size < LEVELS:
        return np.zeros(command.size, dtype=bool)
    return _lasting(top, CLIPPED_SAMPLES)


def _lasting(true: np.ndarray, samples: int) -> np.ndarray:
    """Tell where something is true for at least so many samples on end, shape [N]."""
    if true.size < samples:
        return np.zeros(true.size, dtype=bool)
    long = np.convolve(true, np.ones(samples), "valid") == samples
    return np.convolve(long, np.ones(samples)) > 0
