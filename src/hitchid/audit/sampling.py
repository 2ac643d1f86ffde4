"""Whether the clock of the logs is even, fine enough, and without holes."""

import re

import numpy as np

from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Look, Survey

UNLIKE_STEPS = 1.5
MUCH_JITTER = 0.10
FEWEST_SAMPLES_A_STROKE = 20
FAST_FRACTION = 0.99
MUCH_LOST = 0.05
LOOKED_AT = 2**20


def steps(look: Look) -> list[AuditFinding]:
    """Find logs that were resampled.

    From another step: a note, a warning beyond a factor 1.5, where interpolation invents or smooths motion.
    For a jittering clock: a note, a warning from 10 %, which at working speed moves the piston by a tenth of
    its one-step motion. For lost samples that were interpolated: a note, a warning from 5 % of all on.
    """
    found = []
    clock = look.record.clock
    said = "; ".join(look.record.notices)
    moved = re.search(r"resampled from ([\d.e+-]+) s to ([\d.e+-]+) s", said)
    if moved:
        had, has = float(moved.group(1)), float(moved.group(2))
        unlike = has > 0 and not 1 / UNLIKE_STEPS < had / has < UNLIKE_STEPS
        found.append(
            look.finding(
                "sampling",
                Level.WARNING if unlike else Level.NOTE,
                f"the log was sampled every {had:g} s, the campaign every {has:g} s; it was resampled",
                "log every test at the same step",
                signal="",
            )
        )
    if look.quality.jitter is not None:
        found.append(
            look.finding(
                "sampling",
                Level.WARNING if look.quality.jitter >= MUCH_JITTER else Level.NOTE,
                f"the clock jitters by {look.quality.jitter:.1%} of {look.record.step_s:g} s; "
                "the log was resampled",
                "log on the controller's own clock, or give each sample the time it was taken at",
                signal="",
            )
        )
    elif clock.longest_gap_s:
        found.append(
            look.finding(
                "sampling",
                Level.WARNING if clock.interpolated_share >= MUCH_LOST else Level.NOTE,
                f"{clock.interpolated_share:.1%} of the samples were lost and are interpolated; "
                f"the longest gap is {clock.longest_gap_s:.3g} s",
                "find out why the logger dropped samples",
                signal="",
            )
        )
    return found


def coarse(look: Look) -> list[AuditFinding]:
    """Find logs with fewer than 20 samples for the whole travel at working speed.

    With s the 99th percentile of |y[k+1] − y[k]|, less what noise explains, and R the record's range, a
    stroke at full speed has R/s samples. Below 20 neither dead time nor lag, which are a small part of a
    stroke, are resolved. The percentile leaves out single spikes.
    """
    quality = look.quality
    stretch = look.record.displacement[:LOOKED_AT]
    if stretch.size < 2 or not quality.reach > quality.sure:
        return []
    steps = np.abs(np.diff(stretch))
    place = int(FAST_FRACTION * (steps.size - 1))
    steps.partition(place)
    fast = float(steps[place])
    if not (fast > quality.sure and fast * FEWEST_SAMPLES_A_STROKE > quality.reach):
        return []
    return [
        look.finding(
            "sampling",
            Level.WARNING,
            f"from one sample to the next the piston moves by up to {fast:.3g} {quality.unit}, "
            f"{fast / quality.reach:.0%} of its range of {quality.reach:.4g} {quality.unit}",
            f"log at a shorter step, so that a stroke has at least {FEWEST_SAMPLES_A_STROKE} samples",
        )
    ]


def gaps(survey: Survey) -> list[AuditFinding]:
    """Find logs that were cut at gaps, and how much of them is lost.

    The parts of a cut log are called log@1, log@2 and so on. A part begins in the middle of a motion, which
    a note tells; from 5 % of the log's time lost on it is a warning.
    """
    parts: dict[str, list[Look]] = {}
    for look in survey.looks:
        base, separator, number = look.record.name.rpartition("@")
        if separator and number.isdecimal():
            parts.setdefault(base, []).append(look)
    return [finding for base, looks in parts.items() for finding in _gaps_of(base, looks)]


def _gaps_of(base: str, looks: list[Look]) -> list[AuditFinding]:
    looks = sorted(looks, key=lambda look: look.record.start_s)
    ends = [look.record.start_s + look.quality.duration_s for look in looks]
    begins = [look.record.start_s for look in looks]
    lost = [
        (round(end, 6), round(begin, 6))
        for end, begin in zip(ends[:-1], begins[1:], strict=True)
        if begin > end
    ]
    total, missing = ends[-1] - begins[0], sum(b - a for a, b in lost)
    if not lost or not total > 0:
        return []
    level = Level.WARNING if missing > MUCH_LOST * total else Level.NOTE
    what = (
        f"the log '{base}' has {len(lost)} gap{'s' * (len(lost) > 1)}: "
        f"{missing:.3g} s of {total:.4g} s are lost ({missing / total:.1%})"
    )
    advice = "find out why the logger dropped samples; each part after a gap begins in mid-motion"
    return [AuditFinding("gaps", level, looks[0].record.name, "", tuple(lost), what, advice)]
