"""Checks of repeatability: speed and start of the tests, and the command at which ramps start motion."""

import numpy as np
from scipy.special import stdtr

from hitchid._support.notices import Severity
from hitchid.audit.context import CampaignContext, RecordContext, command_unit, join_names, travel
from hitchid.audit.finding import AuditFinding
from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT, RAMP
from hitchid.data.test_kinds import ramp_direction

COMPARABLE = 0.25  # of the median; largest deviation of a test's mean command (chosen)
FEWEST_TESTS = 5  # tests, for a regression on order and command
SIGNIFICANCE = 0.005  # level of the t-test (chosen)
MIN_DRIFT = 0.05  # of the gain, first test to last; warming oil causes less in an hour
START_FRACTION = 0.05  # of the campaign's range; largest spread of start positions (chosen)
ONSET_FRACTION = 0.10  # of the median onset; largest spread of onsets (chosen)
SAME_RATE = 0.10  # relative difference of the rates of ramps that count as equal (chosen)
MIN_UNEXPLAINED = 0.1  # of the order's variance; least share that the commands do not explain (chosen)
ROUNDING = 1e-12  # relative rounding error of floating-point sums


def drift(context: CampaignContext) -> list[AuditFinding]:
    """Find a drift of the speed with the order of the tests.

    Of tests whose mean command lies within ±25 % of the median (five at least), travel = K (∫|c| dt − d T) is
    fitted for gain K and dead zone d; the logarithm of each test's own gain is then regressed on order and
    mean command, which corrects for a curved valve characteristic; if the commands explain nine tenths of
    the order's variance, there is no test. A drift is reported if significant at 0.5 % and above 5 % from the
    first test to the last: warming oil causes less in an hour.
    """
    findings = []
    for direction in DIRECTIONS:
        tests, travels, areas, times = _comparable(context, direction)
        if len(tests) < FEWEST_TESTS:
            continue
        change, p_value = _trend(travels, areas, times)
        if not (p_value < SIGNIFICANCE and abs(change) > MIN_DRIFT):
            continue
        what = (
            f"for the same command, {direction} is {abs(change):.0%} {'faster' if change > 0 else 'slower'} "
            f"in the last test than in the first, over {len(tests)} tests "
            f"({join_names([test.record.name for test in tests])})"
        )
        advice = "warm the oil before the tests, or log its temperature; hold out tests from the whole day"
        findings.append(AuditFinding("drift", Severity.WARNING, "", DISPLACEMENT, (), what, advice))
    return findings


def _comparable(
    context: CampaignContext, direction: str
) -> tuple[list[RecordContext], np.ndarray, np.ndarray, np.ndarray]:
    """Return tests of similar command, with travel, ∫|c| dt and active time of each."""
    tests = context.of_kind(direction)
    rows = []
    for test in tests:
        active = test.active(direction)
        time = int(np.count_nonzero(active)) * test.record.step_s
        area = float(np.sum(np.abs(test.record.command(direction)), where=active)) * test.record.step_s
        rows.append((abs(travel(test, direction)), area, time))
    table = np.array(rows).reshape(-1, 3)
    with np.errstate(all="ignore"):
        means = table[:, 1] / table[:, 2]
    usable = np.isfinite(means) & (means > 0) & (table[:, 0] > 0)
    if not usable.any():
        return [], *table[:0].T
    is_comparable = usable & (np.abs(means / np.median(means[usable]) - 1) <= COMPARABLE)
    comparable_tests = [test for test, is_near in zip(tests, is_comparable, strict=True) if is_near]
    return comparable_tests, *table[is_comparable].T


def _trend(travels: np.ndarray, areas: np.ndarray, times: np.ndarray) -> tuple[float, float]:
    """Return the relative change of the gain from the first test to the last, and its p-value."""
    no_trend = (0.0, 1.0)
    means, speeds = areas / times, travels / times
    varied = bool(np.ptp(means) > 0.01 * means.mean())
    slope, offset = np.polyfit(means, speeds, 1) if varied else (0.0, 0.0)
    # With a dead zone above nine tenths of the smallest mean, rounding would dominate the gains.
    zone = min(max(0.0, -offset / slope), 0.9 * means.min()) if slope > 0 else 0.0
    gains = np.log(speeds / (means - zone))
    order = np.arange(gains.size) / (gains.size - 1)
    regressors = np.stack([np.ones(gains.size), *([means / means.mean()] if varied else [])], axis=1)
    degrees_of_freedom = gains.size - 1 - regressors.shape[1] - (zone > 0)
    if degrees_of_freedom < 1 or not np.all(np.isfinite(gains)):
        return no_trend
    order_residual, gain_residual = _unexplained(order, regressors), _unexplained(gains, regressors)
    # Commands that rise with the order are collinear with it: no drift can be estimated.
    if float(order_residual @ order_residual) < MIN_UNEXPLAINED * float(np.sum((order - order.mean()) ** 2)):
        return no_trend
    slope = float(order_residual @ gain_residual / (order_residual @ order_residual))
    fit_residual = gain_residual - slope * order_residual
    error = float(
        np.sqrt(fit_residual @ fit_residual / degrees_of_freedom / (order_residual @ order_residual))
    )
    if error <= ROUNDING:
        return float(np.expm1(slope)), 0.0 if abs(slope) > 1e3 * ROUNDING else 1.0
    return float(np.expm1(slope)), float(2 * stdtr(degrees_of_freedom, -abs(slope) / error))


def _unexplained(values: np.ndarray, regressors: np.ndarray) -> np.ndarray:
    """Return the residuals of a linear regression, shape [T]."""
    coefficients, *_ = np.linalg.lstsq(regressors, values, rcond=None)
    return values - regressors @ coefficients


def start_positions(context: CampaignContext) -> list[AuditFinding]:
    """Find directions with start positions that differ by more than 5 % of the campaign's range.

    The lever of the linkage depends on the position, so speeds differ: a note.
    """
    findings = []
    for direction in DIRECTIONS:
        starts = [float(test.record.displacement[0]) for test in context.of_kind(direction)]
        if len(starts) < 2 or not max(starts) - min(starts) > START_FRACTION * context.campaign_range:
            continue
        unit = context.tests[0].quality.unit
        span = f"between {min(starts):.4g} and {max(starts):.4g} {unit}"
        what = f"the {len(starts)} {direction} tests start {span}"
        advice = "suitable for a model of the whole stroke; start repeated tests at the same position"
        findings.append(AuditFinding("start position", Severity.NOTE, "", DISPLACEMENT, (), what, advice))
    return findings


def ramp_onsets(context: CampaignContext) -> list[AuditFinding]:
    """Find repeated ramps in which motion starts at different commands.

    The onset is the command at half of the shortest ramp's travel, of ramps whose rates agree within 10 %; a
    spread of more than 10 % is a warning: one dead zone does not describe all.
    """
    findings = []
    for direction in DIRECTIONS:
        ramps = _ramps(context, direction)
        if len(ramps) < 2:
            continue
        tops = [float(np.max(np.abs(test.record.command(direction)))) for test in ramps]
        rates = [top / test.quality.duration_s for top, test in zip(tops, ramps, strict=True)]
        similar_ramps = [
            test
            for test, rate in zip(ramps, rates, strict=True)
            if abs(rate / np.median(rates) - 1) <= SAME_RATE
        ]
        shortest = min((test.quality.peak_to_peak for test in similar_ramps), default=0.0)
        if len(similar_ramps) < 2 or not shortest > 2 * max(
            test.quality.noise_bound for test in similar_ramps
        ):
            continue
        onsets = [_onset(test, direction, shortest / 2) for test in similar_ramps]
        middle = float(np.median(onsets))
        if not max(onsets) - min(onsets) > ONSET_FRACTION * middle:
            continue
        unit = command_unit(context.tests[0].record, direction)
        names = join_names([test.record.name for test in similar_ramps])
        what = (
            f"{len(similar_ramps)} equal {direction} ramps start motion between "
            f"{min(onsets):.3g} and {max(onsets):.3g} {unit} ({names})"
        )
        advice = "repeat the ramps with warm oil and the same load; their mean is used as dead zone"
        findings.append(AuditFinding("dead zone", Severity.WARNING, "", COMMAND[direction], (), what, advice))
    return findings


def _ramps(context: CampaignContext, direction: str) -> list[RecordContext]:
    return [test for test in context.of_kind(RAMP) if ramp_direction(test.record) == direction]


def _onset(context: RecordContext, direction: str, distance: float) -> float:
    """Return |c|, the mean of eleven samples, where the travel from the start reaches `distance`."""
    has_moved = np.abs(context.record.displacement - context.record.displacement[0]) >= distance
    onset = int(np.argmax(has_moved))
    return float(np.mean(np.abs(context.record.command(direction)[max(0, onset - 5) : onset + 6])))
