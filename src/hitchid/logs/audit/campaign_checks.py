"""Checks of excitation, what the commands can show at all, and of repeatability, how alike tests are."""

import numpy as np
from scipy.special import stdtr

from hitchid._support.records import Severity
from hitchid.logs.audit.context import (
    AuditFinding,
    CampaignContext,
    Findings,
    RecordContext,
    join_names,
    travel,
)
from hitchid.logs.not_measured import true_intervals
from hitchid.logs.record import COMMAND, CYCLE, IDLE

# Checks of the excitation: levels, changes, motion, time, and number of tests.

LEVEL_FRACTION = 0.10  # of full scale; smallest difference of two levels of command (chosen)
COMMAND_PERCENTILES = (2.0, 98.0)  # %, of the active command; exclude its transients (chosen)
FEWEST_CHANGES = 4  # changes of the command in a test (chosen)
MIN_NOISE_RATIO = 50.0  # range over noise; at 50 noise costs 2 % of fit
LEAST_ACTIVE = 0.10  # of a test's duration, time with a command (chosen)
SHORTEST_S = 3.0  # s; a few dead times and lags of common valves
FEWEST_FOR_VARIANCE = 5  # tests, for the variance of parameters between tests
ABOVE_DEAD_ZONE = 1.2  # ratio of the command to that at which ramps start motion (chosen)
OUTER = 0.25  # of the range of levels: the weakest or the strongest tests (chosen)
ONSET_TRAVEL = 0.05  # of a ramp's travel; defines its onset (chosen)


def little_motion(context: RecordContext) -> Findings:
    """Find tests whose displacement moves by less than 50 times its noise.

    Noise alone then costs 2 % of fit, about the difference between good models.
    """
    quality = context.quality
    if context.record.kind == IDLE or not 0 < quality.peak_to_peak < MIN_NOISE_RATIO * quality.noise:
        return
    ratio = quality.peak_to_peak / quality.noise
    what = (
        f"the displacement changes by {quality.peak_to_peak:.3g} {quality.unit}, {ratio:.0f} times its "
        f"noise standard deviation of {quality.noise:.2g} {quality.unit}"
    )
    advice = "run the test longer or at a higher command"
    yield context.finding("excitation", Severity.WARNING, what, advice)


def short_or_idle(context: RecordContext) -> Findings:
    """Find tests without any command, active less than 10 % of the time, or shorter than 3 s: notes.

    Rest contains information on dead time and drift only; 3 s are a few dead times and lags of common valves.
    """
    record = context.record
    active = int(np.count_nonzero(context.any_active()))
    if record.kind == IDLE or active == 0:
        what = "no command is active; the record is not used"
        advice = "remove the log, or check its columns"
        yield context.finding("excitation", Severity.NOTE, what, advice, signal="")
        return
    if active < LEAST_ACTIVE * len(record):
        what = f"a command is active in {active / len(record):.1%} of {context.quality.duration_s:.4g} s"
        yield context.finding("excitation", Severity.NOTE, what, "shorten the rests", signal="")
    if context.quality.duration_s < SHORTEST_S:
        what = f"the test lasts {context.quality.duration_s:.3g} s"
        advice = f"run tests of at least {SHORTEST_S:g} s, better 10 s"
        yield context.finding("excitation", Severity.NOTE, what, advice, signal="")


def changes(context: CampaignContext, direction: str) -> Findings:
    """Find directions with one level of command, or tests with fewer than four changes of it.

    One level (the middle 96 % of the active command of all tests lies within 10 % of full scale) determines
    neither dead zone nor valve curve: a warning, unless there are ramps. Changes are counted in steps of 10 %
    of full scale; only they excite dead time and lag: fewer than four are a note.
    """
    tests = [test for test in context.tests if test.record.kind in (direction, CYCLE)]
    spans = [(test, *span) for test in tests if (span := _levels(test, direction)) is not None]
    if not spans:
        return
    low, high = min(span[1] for span in spans), max(span[2] for span in spans)
    if high - low < LEVEL_FRACTION * context.scales[direction] and not context.ramps(direction):
        all_tests = "the one test" if len(spans) == 1 else f"all {len(spans)} tests"
        verb = "has" if len(spans) == 1 else "have"
        what = (
            f"{all_tests} of {direction} {verb} one level of command, about {high:.3g} "
            f"{context.command_unit(direction)}"
        )
        advice = "run tests at several levels, or PRBS tests with different pairs of levels"
        yield _excitation(context, direction, Severity.WARNING, what, advice)
    few = [test.record.name for test, _, _, turns in spans if turns < FEWEST_CHANGES]
    if few:
        what = (
            f"in {len(few)} of {len(spans)} tests the {direction} command changes fewer than "
            f"{FEWEST_CHANGES} times ({join_names(few)})"
        )
        advice = "change the command more often within a test, as a PRBS does: steps determine the lag"
        yield _excitation(context, direction, Severity.NOTE, what, advice)


def _levels(context: RecordContext, direction: str) -> tuple[float, float, int] | None:
    """Return the 2nd and 98th percentile of active |c| and the number of its changes; None without any."""
    active = context.active(direction)
    if not active.any():
        return None
    command = np.abs(context.record.command(direction))
    # Percentiles: a filter or a ramp at the change of a level passes through all levels between.
    low, high = np.percentile(command[active], COMMAND_PERCENTILES)
    # In steps of a tenth of full scale: noise on a measured command is no change.
    command /= LEVEL_FRACTION * context.scales[direction]
    np.rint(command, out=command)
    return float(low), float(high), int(np.count_nonzero(command[1:] != command[:-1]))


def one_sided_split(context: CampaignContext, direction: str) -> Findings:
    """Find directions whose held-out last fifth is of the weakest or strongest tests alone: a note.

    Logs named by their level are held out by it, and the validation says nothing of the others.
    """
    if context.campaign.test_patterns is not None:
        return  # the user has chosen
    spans = {test.record.name: _levels(test, direction) for test in context.of_kind(direction)}
    highest = {name: span[1] for name, span in spans.items() if span is not None}
    held_out = [highest[test.name] for test in context.campaign.held_out(direction) if test.name in highest]
    if len(highest) < FEWEST_FOR_VARIANCE or not held_out:
        return
    names = sorted(highest, key=lambda name: highest[name])
    low, high = highest[names[0]], highest[names[-1]]
    if high - low < LEVEL_FRACTION * context.scales[direction]:
        return
    shares = [(level - low) / (high - low) for level in held_out]
    if max(shares) > OUTER and min(shares) < 1 - OUTER:
        return
    # One test of every five by level: as many as are held out by default, spread over the range.
    spread = names[FEWEST_FOR_VARIANCE // 2 :: FEWEST_FOR_VARIANCE]
    what = (
        f"the held-out {direction} tests reach {min(held_out):.3g} to {max(held_out):.3g} "
        f"{context.command_unit(direction)} only, all tests {low:.3g} to {high:.3g} "
        f"{context.command_unit(direction)}"
    )
    advice = f"hold out other levels too, under [split] in campaign.toml: {join_names(spread)}"
    yield _excitation(context, direction, Severity.NOTE, what, advice)


def too_few_tests(context: CampaignContext, direction: str) -> Findings:
    """Find directions with too few tests for a dead zone, an uncertainty, or a validation: notes.

    No ramp (the dead zone is then estimated from the tests), fewer than five tests (the variance of the
    parameters between tests cannot be estimated), none held out, never commanded.
    """
    campaign, tests, mixed = context.campaign, context.of_kind(direction), context.of_kind(CYCLE)
    has_ramps = bool(context.ramps(direction))
    strokes = len(tests) + sum(true_intervals(test.active(direction))[0].size for test in mixed)
    gaps = []
    if not has_ramps:
        what = f"there is no slow {direction} ramp: the dead zone from tests has a larger error"
        gaps.append((what, "add two or three slow ramps from zero"))
    if strokes < FEWEST_FOR_VARIANCE:
        what = f"{direction} tests or strokes: {strokes}, too few to estimate the uncertainty"
        gaps.append((what, f"measure at least {FEWEST_FOR_VARIANCE}"))
    if tests and not campaign.held_out(direction) and not (mixed and campaign.held_out(CYCLE)):
        what = f"no {direction} test is held out: the accuracy of the model cannot be validated"
        gaps.append((what, "name tests to hold out under [split] in campaign.toml"))
    if strokes == 0 and not has_ramps:  # which says all of the others
        gaps = [(f"{direction} is never commanded", "this direction cannot be identified")]
    for what, advice in gaps:
        yield _excitation(context, direction, Severity.NOTE, what, advice)


def weak_commands(context: CampaignContext, direction: str) -> Findings:
    """Find directions in half of whose tests the command stays near the one at which ramps start motion.

    Near is below 1.2 times it, of the ramp that starts last: a warning. It is where a ramp has covered 5 % of
    its travel, if that is more than noise.
    """
    zone = 0.0
    for ramp in context.ramps(direction):
        distance = ONSET_TRAVEL * ramp.quality.peak_to_peak
        if distance > ramp.quality.noise_bound:
            zone = max(zone, float(np.abs(ramp.record.command(direction)[_onset(ramp, distance)])))
    tests = context.of_kind(direction)
    weak = [
        test.record.name
        for test in tests
        if float(np.max(np.abs(test.record.command(direction)))) < ABOVE_DEAD_ZONE * zone
    ]
    if not weak or 2 * len(weak) < len(tests):
        return
    what = (
        f"in {len(weak)} of {len(tests)} tests the {direction} command stays below {ABOVE_DEAD_ZONE:g} times "
        f"the {zone:.3g} {context.command_unit(direction)} at which motion starts in ramps "
        f"({join_names(weak)})"
    )
    advice = "run tests at commands well above the dead zone"
    yield _excitation(context, direction, Severity.WARNING, what, advice)


def _onset(context: RecordContext, distance: float) -> int:
    """Return the first sample that is more than a distance away from the first position."""
    return int(np.argmax(np.abs(context.record.displacement - context.record.displacement[0]) > distance))


def _excitation(
    context: CampaignContext, direction: str, severity: Severity, what: str, advice: str
) -> AuditFinding:
    return context.finding("excitation", severity, what, advice, signal=COMMAND[direction])


COMPARABLE = 0.25  # of the median; largest deviation of a test's mean command (chosen)
FEWEST_TESTS = 5  # tests, for a regression on order and command
SIGNIFICANCE = 0.005  # level of the t-test (chosen)
MIN_DRIFT = 0.05  # of the gain, first test to last; warming oil causes less in an hour
START_FRACTION = 0.05  # of the campaign's range; largest spread of start positions (chosen)
ONSET_SPREAD = 0.10  # of the median onset; largest spread of onsets (chosen)
SAME_RATE = 0.10  # relative difference of the rates of ramps that count as equal (chosen)
MIN_UNEXPLAINED = 0.1  # of the order's variance; least share that the commands do not explain (chosen)
ROUNDING = 1e-12  # relative rounding error of floating-point sums


def drift(context: CampaignContext, direction: str) -> Findings:
    """Find a drift of the speed with the order of the tests.

    Of tests whose mean command lies within ±25 % of the median (five at least), travel = K (∫|c| dt − d T) is
    fitted for gain K and dead zone d; the logarithm of each test's own gain is then regressed on order and
    mean command, which corrects for a curved valve characteristic; if the commands explain nine tenths of
    the order's variance, there is no test. A drift is reported if significant at 0.5 % and above 5 % from the
    first test to the last: warming oil causes less in an hour.
    """
    tests, travels, areas, times = _comparable(context.of_kind(direction), direction)
    if len(tests) < FEWEST_TESTS:
        return
    change, p_value = _trend(travels, areas, times)
    if not (p_value < SIGNIFICANCE and abs(change) > MIN_DRIFT):
        return
    what = (
        f"for the same command, {direction} is {abs(change):.0%} {'faster' if change > 0 else 'slower'} "
        f"in the last test than in the first, over {len(tests)} tests "
        f"({join_names([test.record.name for test in tests])})"
    )
    advice = "warm the oil before the tests, or log its temperature; hold out tests from the whole day"
    yield context.finding("drift", Severity.WARNING, what, advice)


def _comparable(
    tests: list[RecordContext], direction: str
) -> tuple[list[RecordContext], np.ndarray, np.ndarray, np.ndarray]:
    """Return tests of similar command, with travel, ∫|c| dt and active time of each."""
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
    # Logarithms: a drift is a factor, whatever the command was.
    gains = np.log(speeds / (means - zone))
    order = np.arange(gains.size) / (gains.size - 1)
    regressors = np.stack([np.ones(gains.size), *([means / means.mean()] if varied else [])], axis=1)
    degrees_of_freedom = gains.size - 1 - regressors.shape[1] - (zone > 0)
    if degrees_of_freedom < 1 or not np.all(np.isfinite(gains)):
        return no_trend
    # What the commands explain is taken out of both: order and command may be correlated.
    order_residual, gain_residual = _unexplained(order, regressors), _unexplained(gains, regressors)
    # Commands that rise with the order are collinear with it: no drift can be estimated.
    if float(order_residual @ order_residual) < MIN_UNEXPLAINED * float(np.sum((order - order.mean()) ** 2)):
        return no_trend
    slope = float(order_residual @ gain_residual / (order_residual @ order_residual))
    fit_residual = gain_residual - slope * order_residual
    error = float(
        np.sqrt(fit_residual @ fit_residual / degrees_of_freedom / (order_residual @ order_residual))
    )
    # A fit without scatter has no t-value: rounding alone would decide.
    if error <= ROUNDING:
        return float(np.expm1(slope)), 0.0 if abs(slope) > 1e3 * ROUNDING else 1.0
    return float(np.expm1(slope)), float(2 * stdtr(degrees_of_freedom, -abs(slope) / error))


def _unexplained(values: np.ndarray, regressors: np.ndarray) -> np.ndarray:
    """Return the residuals of a linear regression, shape [T]."""
    coefficients, *_ = np.linalg.lstsq(regressors, values, rcond=None)
    return values - regressors @ coefficients


def start_positions(context: CampaignContext, direction: str) -> Findings:
    """Find directions with start positions that differ by more than 5 % of the campaign's range.

    The lever of the linkage depends on the position, so speeds differ: a note.
    """
    starts = [float(test.record.displacement[0]) for test in context.of_kind(direction)]
    if len(starts) < 2 or not max(starts) - min(starts) > START_FRACTION * context.campaign_range:
        return
    span = f"between {min(starts):.4g} and {max(starts):.4g} {context.tests[0].quality.unit}"
    what = f"the {len(starts)} {direction} tests start {span}"
    advice = "suitable for a model of the whole stroke; start repeated tests at the same position"
    yield context.finding("start position", Severity.NOTE, what, advice)


def ramp_onsets(context: CampaignContext, direction: str) -> Findings:
    """Find repeated ramps in which motion starts at different commands.

    The onset is the command at half of the shortest ramp's travel, of ramps whose rates agree within 10 %; a
    spread of more than 10 % is a warning: one dead zone does not describe all.
    """
    ramps = context.ramps(direction)
    if len(ramps) < 2:
        return
    tops = [float(np.max(np.abs(test.record.command(direction)))) for test in ramps]
    rates = [top / test.quality.duration_s for top, test in zip(tops, ramps, strict=True)]
    usual = np.median(rates)
    # A faster ramp passes more command while the piston covers the same way: only equal ones compare.
    similar = [r for r, rate in zip(ramps, rates, strict=True) if abs(rate / usual - 1) <= SAME_RATE]
    shortest = min((test.quality.peak_to_peak for test in similar), default=0.0)
    if len(similar) < 2 or not shortest > 2 * max(test.quality.noise_bound for test in similar):
        return
    onsets = []
    for test in similar:
        has_moved = np.abs(test.record.displacement - test.record.displacement[0]) >= shortest / 2
        at = int(np.argmax(has_moved))
        # The mean of eleven samples: a measured command is noisy, and a ramp changes little within them.
        onsets.append(float(np.mean(np.abs(test.record.command(direction)[max(0, at - 5) : at + 6]))))
    if not max(onsets) - min(onsets) > ONSET_SPREAD * float(np.median(onsets)):
        return
    what = (
        f"{len(similar)} equal {direction} ramps start motion between {min(onsets):.3g} and "
        f"{max(onsets):.3g} {context.command_unit(direction)} "
        f"({join_names([test.record.name for test in similar])})"
    )
    advice = "repeat the ramps with warm oil and the same load; their mean is used as dead zone"
    yield context.finding("dead zone", Severity.WARNING, what, advice, signal=COMMAND[direction])
