"""Checks that command, current and displacement were logged on one clock."""

import numpy as np

from hitchid._support.numbers import count
from hitchid._support.records import Severity
from hitchid.logs.audit.context import (
    MAX_SAMPLES,
    AuditFinding,
    CampaignContext,
    Findings,
    RecordContext,
    fast_step,
    travel,
)
from hitchid.logs.not_measured import NOT_MEASURED
from hitchid.logs.record import COMMAND, DISPLACEMENT, RAMP
from hitchid.logs.units import UNITS

# Checks of the clock: jitter, sampling time and gaps.

UNLIKE_STEPS = 1.5  # ratio of sampling times; above it, resampling interpolates or smooths motion (chosen)
MUCH_JITTER = 0.10  # of the sampling time: a tenth of the one-step motion at working speed
FEWEST_SAMPLES_A_STROKE = 20  # samples per stroke at full speed, to resolve dead time and lag (chosen)
# s: a hydraulic axis crosses its stroke in seconds, and none moves from rest and back in less (chosen).
LONGEST_STEP_S, SHORTEST_TEST_S = 1.0, 0.1
MUCH_LOST = 0.05  # of the samples, or of the time (chosen)


def steps(context: RecordContext) -> Findings:
    """Find logs that were resampled.

    From another sampling time: a note; a warning beyond a factor of 1.5, where interpolation distorts motion.
    For clock jitter: a note; a warning from 10 %, a position error of a tenth of the one-step motion at
    working speed. For lost samples that were interpolated: a note; a warning from 5 % of all samples.
    """
    clock, step_s = context.record.clock, context.record.step_s
    if clock.logged_step_s is not None:
        step_differs = not 1 / UNLIKE_STEPS < clock.logged_step_s / step_s < UNLIKE_STEPS
        severity = Severity.WARNING if step_differs else Severity.NOTE
        what = (
            f"the log was sampled every {clock.logged_step_s:.4g} s, the campaign every {step_s:.4g} s; "
            "it was resampled"
        )
        advice = "log every test with the same sampling time"
        yield context.finding("sampling", severity, what, advice, signal="")
    # One reason is enough: the notice of a jittering clock names its gaps, too.
    if context.quality.jitter is not None:
        severity = Severity.WARNING if context.quality.jitter >= MUCH_JITTER else Severity.NOTE
        what = f"the clock jitters by {context.quality.jitter:.1%} of {step_s:g} s; the log was resampled"
        advice = "log on the controller's clock, or record the time of each sample"
        yield context.finding("sampling", severity, what, advice, signal="")
    elif clock.longest_gap_s:
        severity = Severity.WARNING if clock.interpolated_share >= MUCH_LOST else Severity.NOTE
        what = (
            f"{clock.interpolated_share:.1%} of the samples were lost and are interpolated; "
            f"the longest gap is {clock.longest_gap_s:.3g} s"
        )
        advice = "check why the logger lost samples"
        yield context.finding("sampling", severity, what, advice, signal="")


def coarse(context: RecordContext) -> Findings:
    """Find logs with fewer than 20 samples for the whole travel at working speed.

    With s the 99th percentile of |y[k+1] − y[k]|, where above noise, and R the record's range, a stroke at
    full speed has R/s samples. Below 20, dead time and lag, a small part of a stroke, are not resolved. The
    percentile excludes single spikes.
    """
    quality = context.quality
    displacement = context.record.displacement[:MAX_SAMPLES]
    if displacement.size < 2 or not quality.peak_to_peak > quality.noise_bound:
        return
    motion = fast_step(np.diff(displacement))
    if not (motion > quality.noise_bound and motion * FEWEST_SAMPLES_A_STROKE > quality.peak_to_peak):
        return
    what = (
        f"from one sample to the next the piston moves by up to {motion:.3g} {quality.unit}, "
        f"{motion / quality.peak_to_peak:.0%} of its range of {quality.peak_to_peak:.4g} {quality.unit}"
    )
    advice = f"log with a shorter sampling time: at least {FEWEST_SAMPLES_A_STROKE} samples per stroke"
    yield context.finding("sampling", Severity.WARNING, what, advice)


def time_unit(context: CampaignContext) -> Findings:
    """Find campaigns whose time has probably another unit: too slow, or too short, for a hydraulic axis."""
    step_s = context.tests[0].record.step_s
    longest_s = max(test.quality.duration_s for test in context.tests)
    if longest_s >= SHORTEST_TEST_S and step_s < LONGEST_STEP_S:
        return
    unit = "ms or us" if step_s >= LONGEST_STEP_S else "s"
    what = (
        f"the sampling time is {step_s:.3g} s, and the longest log lasts {longest_s:.3g} s: "
        f"the time is probably in {unit}"
    )
    yield context.finding("units", Severity.WARNING, what, "check the unit of the time", signal="")


def not_measured(context: RecordContext) -> Findings:
    """Find logs with samples that no sensor measured, which reading has left out."""
    advice = "check the sensor and the logger; the samples are used nowhere"
    for notice in context.record.notices:
        if notice.code == NOT_MEASURED:
            what, signal = notice.sentence, notice.place
            yield context.finding("not measured", notice.severity, what, advice, signal=signal)


def gaps(context: CampaignContext) -> Findings:
    """Find logs that were cut at gaps, and the time lost.

    The parts of a cut log are called log@1, log@2 and so on. A part begins in motion:
    a note; a warning if more than 5 % of the log's time is lost.
    """
    # Reading names the parts of a cut log log@1, log@2: a user may call a log a@b as well.
    tests_by_log: dict[str, list[RecordContext]] = {}
    for test in context.tests:
        base, separator, number = test.record.name.rpartition("@")
        if separator and number.isdecimal():
            tests_by_log.setdefault(base, []).append(test)
    for base, parts in tests_by_log.items():
        tests = sorted(parts, key=lambda test: test.record.start_s)
        begins = [test.record.start_s for test in tests]
        ends = [test.record.start_s + test.quality.duration_s for test in tests]
        between = zip(ends[:-1], begins[1:], strict=True)
        lost = [(round(end, 6), round(begin, 6)) for end, begin in between if begin > end]
        total, missing = ends[-1] - begins[0], sum(b - a for a, b in lost)
        if not lost or not total > 0:
            continue
        severity = Severity.WARNING if missing > MUCH_LOST * total else Severity.NOTE
        what = (
            f"the log '{base}' has {count(len(lost), 'gap')}: "
            f"{missing:.3g} s of {total:.4g} s are lost ({missing / total:.1%})"
        )
        advice = (
            "check why the logger lost samples; a part after a gap is used from its first stroke out of rest"
        )
        yield AuditFinding("gaps", severity, tests[0].record.name, "", tuple(lost), what, advice)


LONGEST_LAG_S = 1.0  # s, search range to either side (chosen)
MAX_LAGS = 2000  # samples, search range to either side (chosen)
MAX_LAG_SAMPLES = 2**18  # samples examined, to limit time and memory (chosen)
LEAST_CORRELATION = 0.7  # of command and current at the best lag (chosen)
LEAST_SHARPNESS = 0.02  # decrease of the correlation from the peak to both ends (chosen)
LEAD_SAMPLES = 1.0  # samples; lead explained by the order in which a logger samples
MAX_LAG_S = 0.1  # s; the lag of a coil is a tenth of it
CHANGED_FRACTION = 0.01  # of full scale; smallest change of command (chosen)
MIN_TRAVEL_FRACTION = 0.005  # of the campaign's range; smallest motion (chosen)
FEWEST_BEFORE = 5  # samples at rest before the command (chosen)
CREEP_FRACTION = 0.3  # of working speed; slower motion is creep (chosen)


def current_lag(context: RecordContext) -> Findings:
    """Find the lag of each measured current behind its command.

    The lag is where the correlation of command and current is largest within ±1 s, between samples by a
    parabola through the three largest. The command is that of one direction, or the sum of both, whichever
    correlates best. It is valid if the correlation reaches 0.7 and falls by 0.02 towards both ends (not so
    for a slow ramp). A lead of up to one sample is explained by the order of logging; a larger one is a
    fault, since no coil leads its command. A lag above 0.1 s, ten times that of a coil, is a warning; any
    other is a note.
    """
    record = context.record
    for role, unit in record.units.items():
        is_skipped = role in COMMAND.values() or role == DISPLACEMENT or role not in record.signals
        # A slow ramp correlates with its current at any lag.
        if is_skipped or UNITS[unit].dimension != "current" or record.kind == RAMP:
            continue
        choices: dict[str, tuple[str, ...]] = {
            f"the {direction} command": (direction,) for direction in record.directions
        }
        choices["the commands"] = record.directions  # one sensor in the supply of both coils
        fits = {name: _fit(context, directions, role) for name, directions in choices.items()}
        lags = [(fit[1], fit[0], name) for name, fit in fits.items() if fit]
        if not lags:
            continue
        _, lag, name = max(lags)
        is_leading = -lag > LEAD_SAMPLES * record.step_s
        is_late = lag > max(MAX_LAG_S, LEAD_SAMPLES * record.step_s)
        severity = Severity.FAULT if is_leading else Severity.WARNING if is_late else Severity.NOTE
        phrase = f"leads {name} by" if lag < 0 else f"lags behind {name} by"
        advice = {
            Severity.FAULT: "command and current are on different clocks: log both with one device",
            Severity.WARNING: "check the current filter and the clocks; the lag becomes dead time",
            Severity.NOTE: "no action needed: the lag is part of the model's dead time and time constant",
        }[severity]
        yield context.finding("lag", severity, f"{role} {phrase} {abs(lag):.4f} s", advice, signal=role)


def _fit(context: RecordContext, directions: tuple[str, ...], role: str) -> tuple[float, float] | None:
    """Return lag, s, and correlation of a current and a sum of commands; None without a sharp peak."""
    active = context.any_active()
    if not active.any():
        return None
    max_lag = round(min(LONGEST_LAG_S / context.record.step_s, MAX_LAGS))
    # A long rest before the first command holds no lag, only samples.
    first = max(0, int(np.argmax(active)) - 2 * max_lag)
    window = slice(first, first + MAX_LAG_SAMPLES)
    return lag_of(
        np.sum([np.abs(context.record.command(direction)[window]) for direction in directions], axis=0),
        context.record.signals[role][window],
        step_s=context.record.step_s,
    )


def lag_of(command: np.ndarray, current: np.ndarray, *, step_s: float) -> tuple[float, float] | None:
    """Return the lag of a current behind a command, s, negative where it leads, and the correlation at it.

    None without a sharp peak.
    """
    max_lag = round(min(LONGEST_LAG_S / step_s, MAX_LAGS, command.size // 4))
    if max_lag < 2:
        return None
    lags = np.arange(-max_lag, max_lag + 1)
    with np.errstate(all="ignore"):
        fit = _correlations(command, current, lags)
    if not np.all(np.isfinite(fit)):
        return None
    peak = int(np.argmax(fit))
    top = float(fit[peak])
    # A largest value at the end of the range is no peak: the lag lies beyond it, or there is none.
    if not 0 < peak < fit.size - 1 or top < LEAST_CORRELATION:
        return None
    if top - float(max(fit[0], fit[-1])) < LEAST_SHARPNESS:
        return None
    left_value, right_value = float(fit[peak - 1]), float(fit[peak + 1])
    curvature = left_value - 2 * top + right_value
    fraction = 0.5 * (left_value - right_value) / curvature if curvature < 0 else 0.0
    return float(lags[peak] + fraction) * step_s, top


def _correlations(command: np.ndarray, current: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Return the correlation of c[k] and m[k + l] over the overlapping samples, for lags l, shape [L]."""
    samples = command.size
    # Scaled to 1, so that rounding errors are not counted as variance.
    a = (command - command.mean()) / np.max(np.abs(command - command.mean()))
    b = (current - current.mean()) / np.max(np.abs(current - current.mean()))
    # So long that the cyclic correlation of the transform does not wrap around within the lags.
    length = 1 << int(samples + lags.size).bit_length()
    cross_spectrum = np.conj(np.fft.rfft(a, length)) * np.fft.rfft(b, length)
    product = np.fft.irfft(cross_spectrum, length)[lags]
    lead_samples, lag_samples = np.maximum(-lags, 0), np.maximum(lags, 0)

    def sums(values: np.ndarray, first: np.ndarray, skipped: np.ndarray) -> np.ndarray:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return total[samples - skipped] - total[first]

    overlap = samples - np.abs(lags)
    mean_a = sums(a, lead_samples, lag_samples) / overlap
    mean_b = sums(b, lag_samples, lead_samples) / overlap
    spread_a = sums(a * a, lead_samples, lag_samples) / overlap - mean_a * mean_a
    spread_b = sums(b * b, lag_samples, lead_samples) / overlap - mean_b * mean_b
    return (product / overlap - mean_a * mean_b) / np.sqrt(spread_a * spread_b)


def motion_before_command(context: CampaignContext) -> Findings:
    """Find tests in which the piston moves before any command changes.

    Motion is a change above 6 σ + 2 q and 0.5 % of the campaign's range before a command first changes by 1 %
    of full scale. Below 30 % of the record's speed under command it is creep: a warning. Else it is a fault
    (the clocks differ) if at least two tests and half of those that begin at rest show it; else a warning.
    Parts after a gap begin in motion and are left out.
    """
    tests = [test for test in context.tests if test.record.name.rpartition("@")[2] in ("1", test.record.name)]
    onsets = [(test, _onset(test)) for test in tests]
    from_rest = [(test, onset) for test, onset in onsets if onset is not None and onset >= FEWEST_BEFORE]
    starts = [(test, onset, _motion_start(test, onset)) for test, onset in from_rest]
    early = [(test, onset, start) for test, onset, start in starts if start is not None]
    creeps = [_creeps(*entry) for entry in early]
    # One test may have begun in motion; where half of them do, the clocks are the common cause.
    at_speed = creeps.count(False)
    clocks_disagree = at_speed >= 2 and 2 * at_speed >= len(from_rest)
    for (test, onset, start), creeping in zip(early, creeps, strict=True):
        travelled = float(test.record.displacement[onset] - test.record.displacement[0])
        verb = "creeps" if creeping else "moves"
        lead_s = (onset - start) * test.record.step_s
        severity = Severity.FAULT if clocks_disagree and not creeping else Severity.WARNING
        what = (
            f"the displacement {verb} by {travelled:.3g} {test.quality.unit} before any "
            f"command changes; the motion starts {lead_s:.3g} s before the command"
        )
        advice = (
            "let the piston come to rest before a test"
            if creeping
            else "check that command and displacement are logged on one clock, or start tests at rest"
        )
        yield test.finding("motion before command", severity, what, advice, intervals=[(start, onset + 1)])


def _onset(context: RecordContext) -> int | None:
    """Return the sample at which a command, zero at first, changes; None where none does."""
    record, firsts = context.record, []
    for direction in record.directions:
        command = record.command(direction)
        changed = np.abs(command - command[0]) > CHANGED_FRACTION * context.scales[direction]
        # A log that begins under command says nothing about what comes first.
        if context.active(direction)[0]:
            return None
        if changed.any():
            firsts.append(int(np.argmax(changed)))
    return min(firsts, default=None)


def _motion_start(context: RecordContext, onset: int) -> int | None:
    """Return the sample before the onset at which motion exceeds noise and 0.5 % of the range, or None."""
    displacement = context.record.displacement[:onset]
    rest = float(np.median(displacement[:FEWEST_BEFORE]))
    threshold = max(context.quality.noise_bound, MIN_TRAVEL_FRACTION * context.campaign_range)
    has_moved = np.abs(displacement - rest) > threshold
    # A spike has returned by the onset of the command; motion has not.
    return int(np.argmax(has_moved)) if has_moved[-1] and has_moved[-2] else None


def _creeps(context: RecordContext, onset: int, start: int) -> bool:
    displacement = context.record.displacement
    window = max(1, min(onset, onset - start + FEWEST_BEFORE))
    speed_before = abs(float(displacement[onset] - displacement[onset - window])) / window
    # Net travel: noise would increase the sum of absolute changes.
    total_travel = sum(abs(travel(context, direction)) for direction in context.record.directions)
    working_speed = total_travel / max(1, int(np.count_nonzero(context.any_active())))
    return bool(speed_before < CREEP_FRACTION * working_speed)
