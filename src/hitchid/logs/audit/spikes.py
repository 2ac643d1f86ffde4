"""Checks for spikes and jumps: changes of the displacement that no piston can make."""

import numpy as np

from hitchid._support.records import Severity
from hitchid.logs.audit.context import AuditFinding, RecordContext

SPIKE_SIGMAS = 8.0  # σ of the noise of one sample (chosen)
FASTER_THAN_MOTION = 3.0  # times the fast one-step motion (chosen)
FAST_FRACTION = 0.99  # quantile of one-step motions; the rest may be spikes (chosen)
LONGEST_SPIKE = 3  # samples (chosen)
MIN_SPIKE_FRACTION = 0.002  # of the range; smallest height (chosen)
RETURNED_FRACTION = 0.5  # of the height; largest remainder after a spike (chosen)
MOST_SPIKES_FRACTION = 0.02  # of the steps; with more, large steps are normal for the sensor (chosen)
JUMP_FACTOR = 5.0  # times the neighbouring steps; a piston accelerates over several samples
JUMP_AROUND = 5  # steps compared before and after (chosen)
JUMP_FRACTION = 0.01  # of the range; smallest jump (chosen)
MAX_SAMPLES = 2**20  # samples examined, to limit time and memory (chosen)


def spikes(context: RecordContext) -> list[AuditFinding]:
    """Find spikes of one to three samples.

    A spike is two steps y[k+1] − y[k] of opposite sign, at most three samples apart, after which less than
    half of the height remains. Both exceed 8 √2 σ + 2 q, three times the 99th percentile of all steps (no
    piston is that fast) and 0.2 % of the range. If more than 2 % of all steps are so large, none is reported.
    """
    steps = np.diff(context.record.displacement)
    large = _large_steps(context, steps)
    if large.size < 2 or large.size > MOST_SPIKES_FRACTION * steps.size:
        return []
    pairs, heights = _pairs(context.record.displacement, steps, large)
    if not pairs:
        return []
    first_s, unit = context.record.start_s + pairs[0][0] * context.record.step_s, context.quality.unit
    return [
        context.finding(
            "spikes",
            Severity.WARNING,
            f"{len(pairs)} spike{'s' * (len(pairs) > 1)} of up to {max(heights):.3g} {unit} in the "
            f"displacement, first at {first_s:.6g} s",
            (
                "check the sensor's cable, shield and slider; remove the spikes from the log: "
                "the identification treats them as real motion"
            ),
            intervals=pairs,
        )
    ]


def jumps(context: RecordContext) -> list[AuditFinding]:
    """Find jumps: large single steps of the displacement without motion before or after.

    A jump is a step as large as those of spikes, above 1 % of the range and five times larger than any of the
    five steps before and after: a piston accelerates over several samples, a slipping sensor does not.
    """
    steps = np.diff(context.record.displacement)
    large = _large_steps(context, steps)
    if large.size == 0 or large.size > MOST_SPIKES_FRACTION * steps.size:
        return []
    offsets = np.array([k for k in range(-JUMP_AROUND, JUMP_AROUND + 1) if k])
    neighbours = large[:, None] + offsets
    valid_neighbours = np.where((neighbours >= 0) & (neighbours < steps.size), neighbours, large[:, None] + 1)
    neighbour_steps = np.abs(steps[np.clip(valid_neighbours, 0, steps.size - 1)])
    isolated = np.abs(steps[large]) > JUMP_FACTOR * neighbour_steps.max(axis=1)
    significant = np.abs(steps[large]) > JUMP_FRACTION * context.quality.peak_to_peak
    inside = (large >= JUMP_AROUND) & (large < steps.size - JUMP_AROUND)
    jump_samples = large[isolated & significant & inside]
    if jump_samples.size == 0:
        return []
    largest = float(steps[jump_samples][np.argmax(np.abs(steps[jump_samples]))])
    first_s = context.record.start_s + float(jump_samples[0]) * context.record.step_s
    return [
        context.finding(
            "jumps",
            Severity.WARNING,
            f"the displacement jumps {jump_samples.size} time{'s' * (jump_samples.size > 1)}, by up to "
            f"{abs(largest):.3g} {context.quality.unit} from one sample to the next, "
            f"first at {first_s:.6g} s",
            "check for a slipping sensor, a sticking slider or lost samples; cut the log at the jump",
            intervals=[(int(k), int(k) + 2) for k in jump_samples],
        )
    ]


def _large_steps(context: RecordContext, steps: np.ndarray) -> np.ndarray:
    """Return the indices of steps larger than noise and motion explain."""
    if steps.size < 2 * JUMP_AROUND:
        return np.zeros(0, dtype=np.int64)
    step_sizes = np.abs(steps[:MAX_SAMPLES])
    percentile_index = int(FAST_FRACTION * (step_sizes.size - 1))
    step_sizes.partition(percentile_index)
    quality = context.quality
    limit = max(
        SPIKE_SIGMAS * 2**0.5 * quality.noise + 2 * (quality.quantum or 0.0),
        FASTER_THAN_MOTION * float(step_sizes[percentile_index]),
        MIN_SPIKE_FRACTION * quality.peak_to_peak,
    )
    return np.flatnonzero(np.abs(steps) > limit) if limit > 0 else np.zeros(0, dtype=np.int64)


def _pairs(
    displacement: np.ndarray, steps: np.ndarray, large: np.ndarray
) -> tuple[list[tuple[int, int]], list[float]]:
    """Return samples `start:stop` of spikes and their heights."""
    out, back = large[:-1], large[1:]
    height = np.abs(steps[out])
    remainder = np.abs(displacement[back + 1] - displacement[out])
    spike = (back - out <= LONGEST_SPIKE) & (steps[out] * steps[back] < 0)
    spike &= remainder < RETURNED_FRACTION * height
    candidates = np.flatnonzero(spike)
    # The return of one spike is not the start of the next.
    selected = [
        int(k) for position, k in enumerate(candidates) if position == 0 or candidates[position - 1] != k - 1
    ]
    return [(int(out[k]) + 1, int(back[k]) + 1) for k in selected], [float(height[k]) for k in selected]
