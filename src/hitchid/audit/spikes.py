"""Single samples and single steps of the displacement that no piston makes."""

import numpy as np

from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Look

SPIKE_SIGMAS = 8.0
FASTER_THAN_MOTION = 3.0
FAST_FRACTION = 0.99
LONGEST_SPIKE = 3
WORTH_FRACTION = 0.002
RETURNED_FRACTION = 0.5
MOST_SPIKES_FRACTION = 0.02
JUMP_FACTOR = 5.0
JUMP_AROUND = 5
JUMP_FRACTION = 0.01
LOOKED_AT = 2**20


def spikes(look: Look) -> list[AuditFinding]:
    """Find one to three samples that stand off and come back.

    Two steps y[k+1] − y[k] beyond 8 √2 σ + 2 q, beyond three times the 99th percentile of all steps (no
    piston is that fast) and beyond 0.2 % of the range, of opposite sign, at most three samples apart, that
    bring the displacement back by more than half. Where more than 2 % of all steps are so large, they are
    how the log is.
    """
    steps = np.diff(look.record.displacement)
    big = _big(look, steps)
    if big.size < 2 or big.size > MOST_SPIKES_FRACTION * steps.size:
        return []
    pairs, heights = _pairs(look.record.displacement, steps, big)
    if not pairs:
        return []
    at, unit = look.record.start_s + pairs[0][0] * look.record.step_s, look.quality.unit
    return [
        look.finding(
            "spikes",
            Level.WARNING,
            f"{len(pairs)} spike{'s' * (len(pairs) > 1)} of up to {max(heights):.3g} {unit} in the "
            f"displacement, first at {at:.6g} s",
            "look at the sensor's cable, its shield and its slider; a fit takes spikes for motion",
            at=pairs,
        )
    ]


def jumps(look: Look) -> list[AuditFinding]:
    """Find single steps of the displacement that no motion leads to or follows.

    A step as large as those of spikes and beyond 1 % of the range, five times larger than any of the five
    before and after: a piston gathers speed over several samples, a slipping sensor doesn't.
    """
    steps = np.diff(look.record.displacement)
    big = _big(look, steps)
    if big.size == 0 or big.size > MOST_SPIKES_FRACTION * steps.size:
        return []
    offsets = np.array([k for k in range(-JUMP_AROUND, JUMP_AROUND + 1) if k])
    around = big[:, None] + offsets
    near = np.where((around >= 0) & (around < steps.size), around, big[:, None] + 1)
    beside = np.abs(steps[np.clip(near, 0, steps.size - 1)])
    alone = np.abs(steps[big]) > JUMP_FACTOR * beside.max(axis=1)
    worth = np.abs(steps[big]) > JUMP_FRACTION * look.quality.reach
    inside = (big >= JUMP_AROUND) & (big < steps.size - JUMP_AROUND)
    found = big[alone & worth & inside]
    if found.size == 0:
        return []
    largest = float(steps[found][np.argmax(np.abs(steps[found]))])
    at = look.record.start_s + float(found[0]) * look.record.step_s
    return [
        look.finding(
            "jumps",
            Level.WARNING,
            f"the displacement jumps {found.size} time{'s' * (found.size > 1)}, by up to {abs(largest):.3g} "
            f"{look.quality.unit} from one sample to the next, first at {at:.6g} s",
            "look whether the sensor slips, its slider sticks, or samples were lost; cut the log there",
            at=[(int(k), int(k) + 2) for k in found],
        )
    ]


def _big(look: Look, steps: np.ndarray) -> np.ndarray:
    """Return which steps are beyond noise and motion."""
    if steps.size < 2 * JUMP_AROUND:
        return np.zeros(0, dtype=np.int64)
    usual = np.abs(steps[:LOOKED_AT])
    place = int(FAST_FRACTION * (usual.size - 1))
    usual.partition(place)
    quality = look.quality
    limit = max(
        SPIKE_SIGMAS * 2**0.5 * quality.noise + 2 * (quality.quantum or 0.0),
        FASTER_THAN_MOTION * float(usual[place]),
        WORTH_FRACTION * quality.reach,
    )
    return np.flatnonzero(np.abs(steps) > limit) if limit > 0 else np.zeros(0, dtype=np.int64)


def _pairs(
    displacement: np.ndarray, steps: np.ndarray, big: np.ndarray
) -> tuple[list[tuple[int, int]], list[float]]:
    """Return samples `start:stop` of spikes and their heights."""
    leave, back = big[:-1], big[1:]
    height = np.abs(steps[leave])
    left = np.abs(displacement[back + 1] - displacement[leave])
    spike = (back - leave <= LONGEST_SPIKE) & (steps[leave] * steps[back] < 0)
    spike &= left < RETURNED_FRACTION * height
    found = np.flatnonzero(spike)
    # The way back of one spike is not the way out of the next.
    kept = [int(k) for place, k in enumerate(found) if place == 0 or found[place - 1] != k - 1]
    return [(int(leave[k]) + 1, int(back[k]) + 1) for k in kept], [float(height[k]) for k in kept]
