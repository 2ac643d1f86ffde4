"""Checks of the displacement's resolution: quantum, noise and update rate."""

import numpy as np

from hitchid._support.records import Severity
from hitchid.logs.audit.context import AuditFinding, Quality, RecordContext
from hitchid.logs.record import Record

FEWEST_STEPS = 200  # quanta over the range: 0.5 % each, about the difference between models
MUCH_NOISE = 0.01  # of the range; about the free-run error of a good model
HIDDEN_NOISE = 1 / 3  # of the quantum; less noise does not dither the rounding
REPEATS = 3  # exact repeats before and after an isolated change (chosen)
FEWEST_HOPS = 10  # isolated changes (chosen)
HOP_STEPS = 4.0  # quanta or σ of noise; smaller changes may be rounding
MAX_SPACING_RATIO = 1.5  # 90th percentile over median of the spacing; up to it, even (chosen)
MAX_SAMPLES = 2**20  # samples examined, to limit time and memory (chosen)


def quantisation(context: RecordContext) -> list[AuditFinding]:
    """Find displacements with too coarse a quantum.

    Fewer than 200 steps over the campaign's range (0.5 % each) are coarser than the difference between
    models: a warning. Where the piston moves less than half a step per sample and noise is below a third of a
    step, most one-step motions are zero: a note, since one-step prediction errors are then rounding errors.
    """
    step, quality = context.quality.quantum, context.quality
    if step is None or not context.campaign_range > 0:
        return []
    findings, count = [], context.campaign_range / step
    if context.campaign_range < FEWEST_STEPS * step:
        findings.append(
            context.finding(
                "quantisation",
                Severity.WARNING,
                f"the displacement is quantised in steps of {step:.3g} {quality.unit}, {count:.0f} in the "
                f"range of {context.campaign_range:.4g} {quality.unit}",
                "use a finer sensor or converter, or log more digits",
            )
        )
    return findings + _below_resolution(context, step)


def _below_resolution(context: RecordContext, step: float) -> list[AuditFinding]:
    quality = context.quality
    moving = context.any_active()[:-1]
    samples = int(np.count_nonzero(moving))
    if not samples or quality.noise > HIDDEN_NOISE * step:
        return []
    motion = np.abs(np.diff(context.record.displacement))
    mean_motion = float(np.sum(motion, where=moving)) / samples
    still_share = float(np.count_nonzero(moving & (motion < step / 2))) / samples
    if not (0 < mean_motion < step / 2 and still_share > 0.5):
        return []
    return [
        context.finding(
            "quantisation",
            Severity.NOTE,
            f"in {still_share:.0%} of the commanded samples the displacement does not change: it is "
            f"quantised in steps of {step:.3g} {quality.unit}; "
            f"it moves {mean_motion:.2g} {quality.unit} per sample",
            "compare models by free runs, not by one-step errors; or log more digits",
        )
    ]


def noisy(context: RecordContext) -> list[AuditFinding]:
    """Find displacements whose noise is above 1 % of the campaign's range.

    Such noise is as large as the free-run error of a good model.
    """
    noise, unit = context.quality.noise, context.quality.unit
    if not (context.campaign_range > 0 and noise > MUCH_NOISE * context.campaign_range):
        return []
    return [
        context.finding(
            "noise",
            Severity.WARNING,
            f"the displacement's noise has a standard deviation of {noise:.3g} {unit}, "
            f"{noise / context.campaign_range:.1%} of the range of {context.campaign_range:.4g} {unit}",
            "check the shielding, the supply and the range of the sensor",
        )
    ]


def update_rate(context: RecordContext) -> list[AuditFinding]:
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
        return [context.finding("sampling", Severity.WARNING, what, advice)]
    steps = np.diff(context.record.displacement[:MAX_SAMPLES])
    hop, _ = _hops(steps)
    if hop is None or not hop >= HOP_STEPS * max(quality.quantum or 0.0, quality.noise):
        return []
    share = np.count_nonzero(steps) / steps.size
    what = (
        f"the displacement changes in {share:.1%} of the samples and is constant in between; in slow motion "
        f"it jumps by {hop:.2g} {quality.unit} (range {context.campaign_range:.4g} {quality.unit})"
    )
    advice = "check for a dead band in the sensor or logger, or friction in the sensor's linkage"
    severity = Severity.WARNING if hop * FEWEST_STEPS > context.campaign_range else Severity.NOTE
    return [context.finding("dead band", severity, what, advice)]


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
    shortest, middle, longest = np.percentile(np.diff(changes), [10, 50, 90])
    is_even = shortest > 1 and longest <= MAX_SPACING_RATIO * middle
    is_motion = np.median(np.abs(steps[changes])) >= HOP_STEPS * (quality.quantum or 0.0)
    return float(middle) * record.step_s if is_even and is_motion else None


def _hops(steps: np.ndarray) -> tuple[float | None, np.ndarray]:
    """Return the median size of isolated changes, None with few of them, and the spacing of all changes."""
    spacing = np.diff(np.flatnonzero(steps))
    isolated = (spacing[:-1] > REPEATS) & (spacing[1:] > REPEATS)
    if np.count_nonzero(isolated) < FEWEST_HOPS:
        return None, spacing
    return float(np.median(np.abs(steps[np.flatnonzero(steps)[1:-1][isolated]]))), spacing
