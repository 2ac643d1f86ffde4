"""Whether the displacement stands where the piston must move: a stuck sensor, or the end of its range."""

from typing import NamedTuple

import numpy as np

from hitchid.audit.finding import AuditFinding, Level, runs
from hitchid.audit.look import Look, Survey, command_unit

STUCK_S = 0.5
STUCK_SAMPLES = 10
STUCK_TRAVEL_FRACTION = 0.01
BY_CHANCE = 1e-9
FEWEST_AT_REST = 50
MOVING_FRACTION = 0.1
NOISE_SHOWS = 0.5
STRONG = 0.9


class _Standing(NamedTuple):
    """Samples `start:stop` in which a displacement is exactly constant although it is commanded to move."""

    look: Look
    start: int
    stop: int
    mode: str
    level: float
    noiseless: bool


def standing(survey: Survey) -> list[AuditFinding]:
    """Find sensors that stand although the piston must move: stuck ones, and ones at the end of their range.

    Exactly constant for at least 0.5 s and ten samples under a command in the record's upper half, during
    which elsewhere it would move by 1 % of the range, ten steps and twenty σ. An end stop or a dead zone
    keeps the sensor's noise: the standing counts if by the share z of unchanged samples at rest (anywhere,
    where a record hardly rests and σ is above half a step) so long a run of n has odds zⁿ < 10⁻⁹; or, where
    noise doesn't show, if the displacement goes the same way at more than a tenth of working speed before and
    after. Two or more such runs at one and the same extreme of all logs are a saturated sensor, a warning,
    for its samples can be left out; others a stuck one, a fault.
    """
    found = [each for look in survey.looks for each in _standings(look)]
    lowest = min(look.quality.lowest for look in survey.looks)
    highest = max(look.quality.highest for look in survey.looks)
    findings = []
    for look in survey.looks:
        for saturated in (False, True):
            those = [
                each
                for each in found
                if each.look is look and _is_saturated(each, found, (lowest, highest)) == saturated
            ]
            if those:
                findings.append(_standing_finding(look, those, saturated=saturated))
    return findings


def _is_saturated(one: _Standing, found: list[_Standing], ends: tuple[float, float]) -> bool:
    return one.level in ends and sum(each.level == one.level for each in found) >= 2


def _standing_finding(look: Look, those: list[_Standing], *, saturated: bool) -> AuditFinding:
    record, first = look.record, those[0]
    level = float(np.median(np.abs(record.command(first.mode)[first.start : first.stop])))
    begin, end = (record.start_s + at * record.step_s for at in (first.start, first.stop - 1))
    what = (
        f"the displacement stands at {first.level:.5g} {look.quality.unit} from {begin:.6g} to {end:.6g} s "
        f"although {first.mode} is commanded at {level:.3g} {command_unit(record, first.mode)}"
    )
    if len(those) > 1:
        what += f", and {len(those) - 1} more times"
    stretches = [(each.start, each.stop) for each in those]
    if saturated:
        advice = "this is the end of the sensor's range: move the sensor, or keep the tests inside it"
        return look.finding(
            "saturated sensor", Level.WARNING, what + ", as in other places", advice, at=stretches
        )
    advice = "look at the sensor and its cable; leave this stretch out or measure again"
    return look.finding("stuck sensor", Level.FAULT, what, advice, at=stretches)


def _standings(look: Look) -> list[_Standing]:
    displacement = look.record.displacement
    still = displacement[1:] == displacement[:-1]
    starts, stops = runs(still)
    shortest = max(STUCK_SAMPLES, round(min(STUCK_S / look.record.step_s, 1e9)))
    long = stops - starts >= shortest
    if not long.any():
        return []
    stretches = list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))
    unchanged = _unchanged(look, still, stretches)
    found: list[_Standing] = []
    for mode in look.record.modes:
        strong = _strong(look, mode)
        speed = _speed(displacement, strong[:-1], still)
        found += [
            piece
            for piece in _commanded(look, mode, strong, stretches, unchanged)
            if piece.stop - piece.start > shortest and _must_move(piece, speed, strong)
        ]
    return found


def _unchanged(look: Look, still: np.ndarray, stretches: list[tuple[int, int]]) -> float:
    """Return which share of samples repeats the one before: at rest, or wherever noise shows by itself."""
    resting = ~look.any_active()[:-1]
    quality = look.quality
    if np.count_nonzero(resting) < FEWEST_AT_REST:
        if quality.noise < NOISE_SHOWS * (quality.quantum or 0.0) or quality.noise == 0.0:
            return 1.0
        resting = np.ones(still.size, dtype=bool)
        for start, stop in stretches:
            resting[start:stop] = False
    counted = int(np.count_nonzero(resting))
    return int(np.count_nonzero(still & resting)) / counted if counted >= FEWEST_AT_REST else 1.0


def _strong(look: Look, mode: str) -> np.ndarray:
    """Tell where a command is in the upper half of what is active of it, or by noise a little below."""
    strong = look.active(mode)
    if strong.any():
        command = np.abs(look.record.command(mode))
        strong &= command >= STRONG * np.median(command[strong])
    return strong


def _commanded(
    look: Look, mode: str, strong: np.ndarray, stretches: list[tuple[int, int]], unchanged: float
) -> list[_Standing]:
    """Return the parts of stretches of exact standing in which the command is strong."""
    odds = np.log(max(unchanged, 1e-12))
    found = []
    for start, stop in stretches:
        level = float(look.record.displacement[start])
        for begin, end in zip(*runs(strong[start : stop + 1]), strict=True):
            noiseless = bool((end - begin) * odds > np.log(BY_CHANCE))
            found.append(_Standing(look, start + int(begin), start + int(end), mode, level, noiseless))
    return found


def _speed(displacement: np.ndarray, strong: np.ndarray, still: np.ndarray) -> float:
    """Return the mean displacement a sample, with its sign, under a strong command where it moves at all."""
    moving = strong & ~still
    count = int(np.count_nonzero(moving))
    return float(np.sum(np.diff(displacement), where=moving)) / count if count else 0.0


def _must_move(piece: _Standing, speed: float, strong: np.ndarray) -> bool:
    """Tell a sensor that stands from a piston that does."""
    quality, samples = piece.look.quality, piece.stop - piece.start
    worth = max(STUCK_TRAVEL_FRACTION * quality.reach, 10 * (quality.quantum or 0.0), 20 * quality.noise)
    if not abs(speed) * samples > worth:
        return False
    if not piece.noiseless:
        return True
    displacement = piece.look.record.displacement
    before, after = max(0, piece.start - samples), min(displacement.size, piece.stop + samples)
    if not (strong[max(0, piece.start - 2)] and strong[min(strong.size - 1, piece.stop + 1)]):
        return False
    moved = np.array([piece.level - displacement[before], displacement[after - 1] - piece.level])
    spent = np.array([piece.start - before, after - piece.stop])
    return bool(np.all(moved * np.sign(speed) > MOVING_FRACTION * abs(speed) * spent) and np.all(spent > 0))
