"""Kind of a test from its commands, strokes of a mixed log."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from hitchid.data.record import COMMAND, CYCLE, IDLE, LIFTING, LOWERING, RAMP, Record

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
    """Return the effective command, the part beyond the dead zone.

    u = sign(c)·max(|c| − d, 0); for the one-signed current of a valve this is max(c − d, 0) of Sun et al.
    2025, sec. 2.2.1.

    Args:
        command: command, shape [N], in its own unit.
        dead_zone: dead zone d ≥ 0, same unit.
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
    return RAMP if _is_ramp(record.command(direction), record.step_s, thresholds[direction]) else direction


def _is_ramp(command: np.ndarray, step_s: float, threshold: float) -> bool:
    onset = int(np.flatnonzero(command > threshold)[0]) if np.any(command > threshold) else command.size
    rise = command[onset : int(np.argmax(command)) + 1]
    if rise.size * step_s < RAMP_SHORTEST_S or rise[0] > 0.25 * rise[-1]:
        return False
    return float(np.corrcoef(np.arange(rise.size), rise)[0, 1]) > RAMP_CORRELATION


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
    turns = active_samples[1:][signs[active_samples[1:]] != signs[active_samples[:-1]]]
    edges = [0, *(int(turn) for turn in turns), len(record)]
    firsts = [int(active_samples[0]), *(int(turn) for turn in turns)]
    return [
        Stroke(LIFTING if signs[first] > 0 else LOWERING, start, stop)
        for first, start, stop in zip(firsts, edges[:-1], edges[1:], strict=True)
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
    after_rest = np.diff(active_samples, prepend=-rest - 1) > rest
    after_reversal = np.diff(signs[active_samples], prepend=signs[active_samples[0]]) != 0
    is_start = after_rest | after_reversal
    onsets = active_samples[is_start]
    lead_ins = np.where(after_rest[is_start], lead, 0)
    starts = [max(0, int(onset) - int(lead_in)) for onset, lead_in in zip(onsets, lead_ins, strict=True)]
    valid_strokes = []
    for onset, start, stop in zip(onsets, starts, [*starts[1:], len(record)], strict=True):
        if stop - start >= shortest:
            valid_strokes.append(Stroke(LIFTING if signs[onset] > 0 else LOWERING, start, stop))
    return valid_strokes
