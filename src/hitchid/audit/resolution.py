"""Whether the sensor of the displacement resolves the motion: its step, noise and rate of renewal."""

import numpy as np

from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Look

FEWEST_STEPS = 200
MUCH_NOISE = 0.01
HIDDEN_NOISE = 1 / 3
REPEATS = 3
FEWEST_HOPS = 10
HOP_STEPS = 4.0
EVEN = 1.5
LOOKED_AT = 2**20


def quantisation(look: Look) -> list[AuditFinding]:
    """Find displacements written in too large a step.

    Fewer than 200 steps over the campaign's range (0.5 % each) are coarser than the models to be told apart:
    a warning. Where less than half a step is moved a sample while commanded, and noise below a third of a
    step does not hide the rounding, most one-step motions are zero: a note, for errors of one-step
    predictions then tell of the rounding.
    """
    step, quality = look.quality.quantum, look.quality
    if step is None or not look.reach > 0:
        return []
    found = []
    if look.reach < FEWEST_STEPS * step:
        found.append(
            look.finding(
                "quantisation",
                Level.WARNING,
                f"the displacement comes in steps of {step:.3g} {quality.unit}, only "
                f"{look.reach / step:.0f} over the range of {look.reach:.4g} {quality.unit}",
                "use a finer sensor or converter, or log more digits",
            )
        )
    return found + _lost_in_rounding(look, step)


def _lost_in_rounding(look: Look, step: float) -> list[AuditFinding]:
    quality = look.quality
    moving = look.any_active()[:-1]
    samples = int(np.count_nonzero(moving))
    if not samples or quality.noise > HIDDEN_NOISE * step:
        return []
    motion = np.abs(np.diff(look.record.displacement))
    each = float(np.sum(motion, where=moving)) / samples
    still = float(np.count_nonzero(moving & (motion < step / 2))) / samples
    if not (0 < each < step / 2 and still > 0.5):
        return []
    return [
        look.finding(
            "quantisation",
            Level.NOTE,
            f"in {still:.0%} of the commanded samples the displacement does not change, for it comes "
            f"in steps of {step:.3g} {quality.unit} and moves {each:.2g} {quality.unit} a sample",
            "judge models by long runs, not by one-step errors; or log more digits",
        )
    ]


def noisy(look: Look) -> list[AuditFinding]:
    """Find displacements whose noise is above 1 % of the campaign's range.

    Such noise is as large as the error of a good model in free run.
    """
    noise, unit = look.quality.noise, look.quality.unit
    if not (look.reach > 0 and noise > MUCH_NOISE * look.reach):
        return []
    return [
        look.finding(
            "noise",
            Level.WARNING,
            f"the displacement's noise has a standard deviation of {noise:.3g} {unit}, "
            f"{noise / look.reach:.1%} of the range of {look.reach:.4g} {unit}",
            "look at shielding, supply and the sensor's range",
        )
    ]


def renewal(look: Look) -> list[AuditFinding]:
    """Find displacements that stand and hop: renewed less often than logged, or with a dead band.

    At least ten changes, each by four of the smallest steps and of σ or more in the median, have three or
    more exact repeats before and after: neither rounding nor a piston that stands and then moves does that.
    Where such hops come evenly (nine in ten spaced by less than 1.5 times the median) the sensor is read less
    often than logged, a warning, for what the log calls a step is several. Else it has a dead band: a note, a
    warning where its hops are above 0.5 % of the campaign's range.
    """
    quality, step_s = look.quality, look.record.step_s
    steps = np.diff(look.record.displacement[:LOOKED_AT])
    spacing = np.diff(np.flatnonzero(steps))
    alone = (spacing[:-1] > REPEATS) & (spacing[1:] > REPEATS)
    if np.count_nonzero(alone) < FEWEST_HOPS:
        return []
    hop = float(np.median(np.abs(steps[np.flatnonzero(steps)[1:-1][alone]])))
    if not hop >= HOP_STEPS * max(quality.quantum or 0.0, quality.noise):
        return []
    middle, long = np.percentile(spacing, [50, 90])
    if middle > REPEATS and long <= EVEN * middle:
        what = (
            f"the displacement is renewed only every {middle * step_s:.3g} s, but logged every {step_s:g} s"
        )
        advice = "log at the rate the sensor is read at; dead times below that cannot be told"
        return [look.finding("sampling", Level.WARNING, what, advice)]
    share = np.count_nonzero(steps) / steps.size
    what = (
        f"the displacement changes in {share:.1%} of the samples and else repeats exactly; in slow motion it "
        f"hops by {hop:.2g} {quality.unit}, the range being {look.reach:.4g} {quality.unit}"
    )
    advice = "look for a dead band in the sensor or in the logger, or friction in the sensor's drive"
    level = Level.WARNING if hop * FEWEST_STEPS > look.reach else Level.NOTE
    return [look.finding("dead band", level, what, advice)]
