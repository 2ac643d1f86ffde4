"""Checks of the clock: jitter, sampling time and gaps."""

import numpy as np

from hitchid._support.notices import Severity
from hitchid.audit.context import CampaignContext, RecordContext
from hitchid.audit.finding import AuditFinding
from hitchid.data.not_measured import NOT_MEASURED

UNLIKE_STEPS = 1.5  # ratio of sampling times; above it, resampling interpolates or smooths motion (chosen)
MUCH_JITTER = 0.10  # of the sampling time: a tenth of the one-step motion at working speed
FEWEST_SAMPLES_A_STROKE = 20  # samples per stroke at full speed, to resolve dead time and lag (chosen)
FAST_FRACTION = 0.99  # quantile of one-step motions; the rest may be spikes (chosen)
# s: a hydraulic axis crosses its stroke in seconds, and none moves from rest and back in less (chosen).
LONGEST_STEP_S, SHORTEST_TEST_S = 1.0, 0.1
MUCH_LOST = 0.05  # of the samples, or of the time (chosen)
MAX_SAMPLES = 2**20  # samples examined, to limit time and memory (chosen)


def steps(context: RecordContext) -> list[AuditFinding]:
    """Find logs that were resampled.

    From another sampling time: a note; a warning beyond a factor of 1.5, where interpolation distorts motion.
    For clock jitter: a note; a warning from 10 %, a position error of a tenth of the one-step motion at
    working speed. For lost samples that were interpolated: a note; a warning from 5 % of all samples.
    """
    findings = []
    clock = context.record.clock
    if clock.logged_step_s is not None:
        step_s = context.record.step_s
        step_differs = not 1 / UNLIKE_STEPS < clock.logged_step_s / step_s < UNLIKE_STEPS
        findings.append(
            context.finding(
                "sampling",
                Severity.WARNING if step_differs else Severity.NOTE,
                f"the log was sampled every {clock.logged_step_s:.4g} s, the campaign every {step_s:.4g} s; "
                "it was resampled",
                "log every test with the same sampling time",
                signal="",
            )
        )
    if context.quality.jitter is not None:
        findings.append(
            context.finding(
                "sampling",
                Severity.WARNING if context.quality.jitter >= MUCH_JITTER else Severity.NOTE,
                f"the clock jitters by {context.quality.jitter:.1%} of {context.record.step_s:g} s; "
                "the log was resampled",
                "log on the controller's clock, or record the time of each sample",
                signal="",
            )
        )
    elif clock.longest_gap_s:
        findings.append(
            context.finding(
                "sampling",
                Severity.WARNING if clock.interpolated_share >= MUCH_LOST else Severity.NOTE,
                f"{clock.interpolated_share:.1%} of the samples were lost and are interpolated; "
                f"the longest gap is {clock.longest_gap_s:.3g} s",
                "check why the logger lost samples",
                signal="",
            )
        )
    return findings


def coarse(context: RecordContext) -> list[AuditFinding]:
    """Find logs with fewer than 20 samples for the whole travel at working speed.

    With s the 99th percentile of |y[k+1] − y[k]|, where above noise, and R the record's range, a stroke at
    full speed has R/s samples. Below 20, dead time and lag, a small part of a stroke, are not resolved. The
    percentile excludes single spikes.
    """
    quality = context.quality
    displacement = context.record.displacement[:MAX_SAMPLES]
    if displacement.size < 2 or not quality.peak_to_peak > quality.noise_bound:
        return []
    steps = np.abs(np.diff(displacement))
    percentile_index = int(FAST_FRACTION * (steps.size - 1))
    steps.partition(percentile_index)
    fast_step = float(steps[percentile_index])
    if not (fast_step > quality.noise_bound and fast_step * FEWEST_SAMPLES_A_STROKE > quality.peak_to_peak):
        return []
    share = fast_step / quality.peak_to_peak
    return [
        context.finding(
            "sampling",
            Severity.WARNING,
            f"from one sample to the next the piston moves by up to {fast_step:.3g} {quality.unit}, "
            f"{share:.0%} of its range of {quality.peak_to_peak:.4g} {quality.unit}",
            f"log with a shorter sampling time: at least {FEWEST_SAMPLES_A_STROKE} samples per stroke",
        )
    ]


def time_unit(context: CampaignContext) -> list[AuditFinding]:
    """Find campaigns whose time has probably another unit: too slow, or too short, for a hydraulic axis."""
    step_s = context.tests[0].record.step_s
    longest_s = max(test.quality.duration_s for test in context.tests)
    if longest_s >= SHORTEST_TEST_S and step_s < LONGEST_STEP_S:
        return []
    unit = "ms or us" if step_s >= LONGEST_STEP_S else "s"
    what = (
        f"the sampling time is {step_s:.3g} s, and the longest log lasts {longest_s:.3g} s: "
        f"the time is probably in {unit}"
    )
    return [AuditFinding("units", Severity.WARNING, "", "", (), what, "check the unit of the time")]


def not_measured(context: RecordContext) -> list[AuditFinding]:
    """Find logs with samples that no sensor measured, which reading has left out."""
    return [
        context.finding(
            "not measured",
            notice.severity,
            notice.sentence,
            "check the sensor and the logger; the samples are used nowhere",
            signal=notice.place,
        )
        for notice in context.record.notices
        if notice.code == NOT_MEASURED
    ]


def gaps(context: CampaignContext) -> list[AuditFinding]:
    """Find logs that were cut at gaps, and the time lost.

    The parts of a cut log are called log@1, log@2 and so on. A part begins in motion:
    a note; a warning if more than 5 % of the log's time is lost.
    """
    tests_by_log: dict[str, list[RecordContext]] = {}
    for test in context.tests:
        base, separator, number = test.record.name.rpartition("@")
        if separator and number.isdecimal():
            tests_by_log.setdefault(base, []).append(test)
    return [finding for base, tests in tests_by_log.items() for finding in _gaps_of(base, tests)]


def _gaps_of(base: str, tests: list[RecordContext]) -> list[AuditFinding]:
    tests = sorted(tests, key=lambda test: test.record.start_s)
    ends = [test.record.start_s + test.quality.duration_s for test in tests]
    begins = [test.record.start_s for test in tests]
    lost = [
        (round(end, 6), round(begin, 6))
        for end, begin in zip(ends[:-1], begins[1:], strict=True)
        if begin > end
    ]
    total, missing = ends[-1] - begins[0], sum(b - a for a, b in lost)
    if not lost or not total > 0:
        return []
    severity = Severity.WARNING if missing > MUCH_LOST * total else Severity.NOTE
    what = (
        f"the log '{base}' has {len(lost)} gap{'s' * (len(lost) > 1)}: "
        f"{missing:.3g} s of {total:.4g} s are lost ({missing / total:.1%})"
    )
    advice = "check why the logger lost samples; each part after a gap starts in motion"
    return [AuditFinding("gaps", severity, tests[0].record.name, "", tuple(lost), what, advice)]
