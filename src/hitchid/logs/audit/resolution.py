"""Checks of the displacement's resolution and of changes that no piston makes: spikes and jumps."""

import numpy as np

from hitchid._support.numbers import count
from hitchid._support.records import Severity
from hitchid.logs.audit.context import MAX_SAMPLES, Findings, Quality, RecordContext, fast_step
from hitchid.logs.record import Record

FEWEST_STEPS = 200  # quanta over the range: 0.5 % each, about the difference between models
MUCH_NOISE = 0.01  # of the range; about the free-run error of a good model
HIDDEN_NOISE = 1 / 3  # of the quantum; less noise does not dither the rounding
REPEATS = 3  # exact repeats before and after an isolated change (chosen)
FEWEST_HOPS = 10  # isolated changes (chosen)
HOP_STEPS = 4.0  # quanta or σ of noise; smaller changes may be rounding
MAX_SPACING_RATIO = 1.5  # 90th percentile over median of the spacing; up to it, even (chosen)

# Spikes and jumps.
SPIKE_SIGMAS = 8.0  # σ of the noise of one sample (chosen)
FASTER_THAN_MOTION = 3.0  # times the fast one-step motion (chosen)
LONGEST_SPIKE = 3  # samples (chosen)
MIN_SPIKE_FRACTION = 0.002  # of the range; smallest height (chosen)
RETURNED_FRACTION = 0.5  # of the height; largest remainder after a spike (chosen)
MOST_SPIKES_FRACTION = 0.02  # of the steps; with more, large steps are normal for the sensor (chosen)
JUMP_FACTOR = 5.0  # times the neighbouring steps; a piston accelerates over several samples
JUMP_AROUND = 5  # steps compared before and after (chosen)
JUMP_FRACTION = 0.01  # of the range; smallest jump (chosen)


def quantisation(context: RecordContext) -> Findings:
    """Find displacements with too coarse a quantum.

    Fewer than 200 steps over the campaign's range (0.5 % each) are coarser than the difference between
    models: a warning. Where the piston moves less than half a step per sample and noise is below a third of a
    step, most one-step motions are zero: a note, since one-step prediction errors are then rounding errors.
    """
    step, quality = context.quality.quantum, context.quality
    if step is None or not context.campaign_range > 0:
        return
    if context.campaign_range < FEWEST_STEPS * step:
        what = (
            f"the displacement is quantised in steps of {step:.3g} {quality.unit}, "
            f"{context.campaign_range / step:.0f} in the "
            f"range of {context.campaign_range:.4g} {quality.unit}"
        )
        advice = "use a finer sensor or converter, or log more digits"
        yield context.finding("quantisation", Severity.WARNING, what, advice)
    moving = context.any_active()[:-1]
    samples = int(np.count_nonzero(moving))
    # Noise dithers the rounding: means of rounded samples are then right.
    if not samples or quality.noise > HIDDEN_NOISE * step:
        return
    motion = np.abs(np.diff(context.record.displacement))
    mean_motion = float(np.sum(motion, where=moving)) / samples
    still_share = float(np.count_nonzero(moving & (motion < step / 2))) / samples
    if 0 < mean_motion < step / 2 and still_share > 0.5:
        what = (
            f"in {still_share:.0%} of the commanded samples the displacement does not change: it is "
            f"quantised in steps of {step:.3g} {quality.unit}; "
            f"it moves {mean_motion:.2g} {quality.unit} per sample"
        )
        advice = "compare models by free runs, not by one-step errors; or log more digits"
        yield context.finding("quantisation", Severity.NOTE, what, advice)


def noisy(context: RecordContext) -> Findings:
    """Find displacements whose noise is above 1 % of the campaign's range.

    Such noise is as large as the free-run error of a good model.
    """
    noise, unit = context.quality.noise, context.quality.unit
    if not (context.campaign_range > 0 and noise > MUCH_NOISE * context.campaign_range):
        return
    what = (
        f"the displacement's noise has a standard deviation of {noise:.3g} {unit}, "
        f"{noise / context.campaign_range:.1%} of the range of {context.campaign_range:.4g} {unit}"
    )
    advice = "check the shielding, the supply and the range of the sensor"
    yield context.finding("noise", Severity.WARNING, what, advice)


def update_rate(context: RecordContext) -> Findings:
    """Find displacements that change in isolated steps: a low update rate, or a dead band.

    The condition of a dead band: at least ten changes, in the median of four quanta and 4 σ or more, with
    three or more exact repeats before and after; neither rounding nor a piston that starts to move causes
    that. It is a note, a warning above 0.5 % of the campaign's range. Where changes are evenly spaced, the
    sensor is read less often than logged: a warning; see `update_interval`.
    """
    quality, step_s = context.quality, context.record.step_s
    interval_s = update_interval(context.record, quality)
    if interval_s is not None:
        what = f"the displacement is updated every {interval_s:.3g} s but logged every {step_s:g} s"
        advice = (
            "log at the update rate of the sensor; a dead time shorter than the update "
            "interval cannot be identified"
        )
        yield context.finding("sampling", Severity.WARNING, what, advice)
        return
    steps = np.diff(context.record.displacement[:MAX_SAMPLES])
    changes = np.flatnonzero(steps)
    spacing = np.diff(changes)
    isolated = (spacing[:-1] > REPEATS) & (spacing[1:] > REPEATS)
    if np.count_nonzero(isolated) < FEWEST_HOPS:
        return
    hop = float(np.median(np.abs(steps[changes[1:-1][isolated]])))
    if not hop >= HOP_STEPS * max(quality.quantum or 0.0, quality.noise):
        return
    share = changes.size / steps.size
    what = (
        f"the displacement changes in {share:.1%} of the samples and is constant in between; in slow motion "
        f"it jumps by {hop:.2g} {quality.unit} (range {context.campaign_range:.4g} {quality.unit})"
    )
    advice = "check for a dead band in the sensor or logger, or friction in the sensor's linkage"
    severity = Severity.WARNING if hop * FEWEST_STEPS > context.campaign_range else Severity.NOTE
    yield context.finding("dead band", severity, what, advice)


def update_interval(record: Record, quality: Quality) -> float | None:
    """Return the interval at which a sensor is updated, s; None where each sample is measured anew.

    Hardly any two samples on end change, and the changes are evenly spaced: the 90th percentile of the
    spacing is below 1.5 times the median. In the median they are four quanta or more, so that the piston
    moved by several in every sample between.
    """
    steps = np.diff(record.displacement[:MAX_SAMPLES])
    changes = np.flatnonzero(steps)
    if changes.size <= FEWEST_HOPS:
        return None
    # Percentiles: the piston may rest for long, and a sample may come early.
    shortest, middle, longest = np.percentile(np.diff(changes), [10, 50, 90])
    is_even = shortest > 1 and longest <= MAX_SPACING_RATIO * middle
    is_motion = np.median(np.abs(steps[changes])) >= HOP_STEPS * (quality.quantum or 0.0)
    return float(middle) * record.step_s if is_even and is_motion else None


def spikes(context: RecordContext) -> Findings:
    """Find spikes of one to three samples.

    A spike is two steps y[k+1] − y[k] of opposite sign, at most three samples apart, after which less than
    half of the height remains. Both exceed 8 √2 σ + 2 q, three times the 99th percentile of all steps (no
    piston is that fast) and 0.2 % of the range. If more than 2 % of all steps are so large, none is reported.
    """
    steps = np.diff(context.record.displacement)
    large = _large_steps(context, steps)
    if large.size < 2 or large.size > MOST_SPIKES_FRACTION * steps.size:
        return
    out, back = large[:-1], large[1:]
    height = np.abs(steps[out])
    displacement = context.record.displacement
    remainder = np.abs(displacement[back + 1] - displacement[out])
    is_spike = (back - out <= LONGEST_SPIKE) & (steps[out] * steps[back] < 0)
    is_spike &= remainder < RETURNED_FRACTION * height
    candidates = np.flatnonzero(is_spike)
    # The return of one spike is not the start of the next.
    selected = candidates[np.diff(candidates, prepend=-2) != 1].tolist()
    pairs = [(int(out[k]) + 1, int(back[k]) + 1) for k in selected]
    if not pairs:
        return
    highest = max(float(height[k]) for k in selected)
    what = (
        f"{count(len(pairs), 'spike')} of up to {highest:.3g} {context.quality.unit} in the "
        f"displacement, first at {context.time_s(pairs[0][0]):.6g} s"
    )
    advice = (
        "check the sensor's cable, shield and slider; remove the spikes from the log: the identification "
        "treats them as real motion"
    )
    yield context.finding("spikes", Severity.WARNING, what, advice, intervals=pairs)


def jumps(context: RecordContext) -> Findings:
    """Find jumps: large single steps of the displacement without motion before or after.

    A jump is a step as large as those of spikes, above 1 % of the range and five times larger than any of the
    five steps before and after: a piston accelerates over several samples, a slipping sensor does not.
    """
    steps = np.diff(context.record.displacement)
    large = _large_steps(context, steps)
    if large.size == 0 or large.size > MOST_SPIKES_FRACTION * steps.size:
        return
    offsets = np.array([k for k in range(-JUMP_AROUND, JUMP_AROUND + 1) if k])
    neighbours = large[:, None] + offsets
    valid_neighbours = np.where((neighbours >= 0) & (neighbours < steps.size), neighbours, large[:, None] + 1)
    neighbour_steps = np.abs(steps[np.clip(valid_neighbours, 0, steps.size - 1)])
    isolated = np.abs(steps[large]) > JUMP_FACTOR * neighbour_steps.max(axis=1)
    significant = np.abs(steps[large]) > JUMP_FRACTION * context.quality.peak_to_peak
    # At the ends of a log half of the neighbours are missing that would show motion.
    inside = (large >= JUMP_AROUND) & (large < steps.size - JUMP_AROUND)
    jump_samples = large[isolated & significant & inside]
    if jump_samples.size == 0:
        return
    largest = float(steps[jump_samples][np.argmax(np.abs(steps[jump_samples]))])
    what = (
        f"the displacement jumps {count(jump_samples.size, 'time')}, by up to "
        f"{abs(largest):.3g} {context.quality.unit} from one sample to the next, "
        f"first at {context.time_s(jump_samples[0]):.6g} s"
    )
    advice = "check for a slipping sensor, a sticking slider or lost samples; cut the log at the jump"
    intervals = [(k, k + 2) for k in jump_samples.tolist()]
    yield context.finding("jumps", Severity.WARNING, what, advice, intervals=intervals)


def _large_steps(context: RecordContext, steps: np.ndarray) -> np.ndarray:
    """Return the indices of steps larger than noise and motion explain."""
    if steps.size < 2 * JUMP_AROUND:
        return np.zeros(0, dtype=np.int64)
    quality = context.quality
    limit = max(
        SPIKE_SIGMAS * 2**0.5 * quality.noise + 2 * (quality.quantum or 0.0),
        FASTER_THAN_MOTION * fast_step(steps[:MAX_SAMPLES]),
        MIN_SPIKE_FRACTION * quality.peak_to_peak,
    )
    return np.flatnonzero(np.abs(steps) > limit) if limit > 0 else np.zeros(0, dtype=np.int64)
