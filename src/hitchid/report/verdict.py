"""The verdict of a report: a sentence on the use of each model, and findings from the tables below it."""

from collections.abc import Iterator, Sequence

import numpy as np

from hitchid._support import numbers
from hitchid.model import Estimates
from hitchid.model.estimates import NOT_ASSESSED
from hitchid.report.document import (
    WORST_FIRST,
    Finding,
    Findings,
    Rating,
    ReportSection,
    Table,
    worst_first,
)
from hitchid.validation import Acceptance, Accuracy, BandFigures, ChannelResult, Check, Validation
from hitchid.validation.results import BENCHMARK, CYCLES, FREE_RUN, GREYBOX, MIN_TESTS, model_name

# Acceptance limits and the figures they apply to.


def limits_section(acceptance: Acceptance) -> ReportSection:
    """Return the section on limits: failed ones first, then all of them."""
    rows = tuple(
        (check.name, check.limit, check.figure, "pass" if check.passed else "fail")
        for check in acceptance.checks
    )
    failed = tuple(
        Finding(Rating.BAD, f"{check.name}: {check.figure}, required {check.limit}.")
        for check in acceptance.checks
        if not check.passed
    )
    table = Table("Limits", ("figure", "required", "found", "verdict"), rows)
    return ReportSection("Acceptance", ((Findings(failed), table) if failed else (table,)))


def check_line(check: Check) -> str:
    """Return a check as one line; unprintable characters, as in names of logs, are replaced."""
    verdict = "pass" if check.passed else "fail"
    text = f"{verdict}  {check.name} {check.figure}, required {check.limit}"
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


COVERAGE_TOLERANCE = 0.05  # deviation of coverage from its level without a caution, share of samples; chosen
MAX_SHORTFALL = 0.2  # of the coverage of predictions ahead, whose error over tests is unknown; chosen
# Fits, percent, below which a simulation is rough, and of no use: the RMSE is a fifth, and a half, of the
# standard deviation of the displacement; chosen.
ROUGH_FIT, POOR_FIT = 80.0, 50.0
# Ratios of the grey box's RMSE some samples ahead to another model's that are worth a word: smaller ones are
# of no use to anybody, from the larger one on the grey box is the wrong predictor; chosen.
MIN_EXCESS, MAX_EXCESS = 1.05, 1.5
Reservation = tuple[Rating, str]


def uses_section(result: Validation) -> tuple[str, ...]:
    """Return for each direction, and for mixed cycles, a sentence on the use of the model and its error."""
    sentences = [
        _use(direction, channel.accuracy, result.unit, channel)
        for direction, channel in result.channels.items()
    ]
    cycles = [] if result.cycles is None else [_use(CYCLES, result.cycles.accuracy, result.unit)]
    return (*sentences, *cycles)


def verdict_section(result: Validation, acceptance: Acceptance | None) -> tuple[Finding, ...]:
    """Return the findings on limits, and for each direction on free run, predictions ahead, bands and
    parameters; the worst first."""
    findings = []
    if acceptance is not None:
        failed, count = [check for check in acceptance.checks if not check.passed], len(acceptance.checks)
        names = "; ".join(f"{check.name} {check.figure}, required {check.limit}" for check in failed)
        findings.append(
            Finding(Rating.BAD, f"Not accepted: {len(failed)} of {count} limits violated: {names}.")
            if failed
            else Finding(Rating.GOOD, f"Accepted: {_all_text(count, 'limit')} met.")
        )
    unit, step_s = result.unit, result.model.step_s
    for section, accuracy in result.accuracy.items():
        findings += [
            _free_run_finding(section, accuracy, unit),
            *_ahead_finding(section, accuracy, unit, step_s),
        ]
        if section == CYCLES:
            continue
        if accuracy.bands is not None:
            findings.append(_band_finding(section, accuracy.bands, len(accuracy.tests), unit))
        parameters = result.channels[section].parameters
        if parameters is not None and parameters.parameters:
            findings.append(_parameter_finding(section, parameters))
    return worst_first(findings)


def _title(section: str) -> str:
    return "Mixed cycles" if section == CYCLES else section.capitalize()


def _tests(section: str, accuracy: Accuracy) -> str:
    return numbers.count(len(accuracy.tests), "unseen cycle" if section == CYCLES else "unseen test")


def _use(section: str, accuracy: Accuracy, unit: str, channel: ChannelResult | None = None) -> str:
    """Return whether a simulation is of use, at which commands, its error, and what is determined."""
    free_run, tests = accuracy.free_run(), _tests(section, accuracy)
    if free_run.rmse is None or free_run.fit is None:
        return f"{_title(section)}: not usable for simulation, the free run diverged on {tests}."
    use = "usable for simulation"
    if free_run.fit < ROUGH_FIT:
        use = f"not {use}" if free_run.fit < POOR_FIT else "usable for rough simulation"
    parts = []
    if channel is not None and channel.characteristics is not None and free_run.fit >= POOR_FIT:
        # The commands between which the speed is determined; nothing where it is not.
        command_unit = channel.characteristics.command_unit
        commands = [point.command for point in channel.characteristics.speed_map if point.determined]
        use += f" between {min(commands):.3g} and {max(commands):.3g} {command_unit}" if commands else ""
    if channel is not None:
        parts = [*_determined(channel)]
    travel = max(map(np.max, accuracy.predictions.actual)) - min(map(np.min, accuracy.predictions.actual))
    error = f"typical error {free_run.rmse:.2g} {unit} of {travel:.3g} {unit} on {tests}"
    return f"{_title(section)}: {use}: {'; '.join([error, *parts])}."


def _determined(channel: ChannelResult) -> Iterator[str]:
    """Yield what the identification tests determine: parameters, and the speed map."""
    if channel.parameters is not None and channel.parameters.parameters:
        lacking = [estimate for estimate in channel.parameters.parameters if not estimate.determined]
        count = len(channel.parameters.parameters)
        yield (
            f"{len(lacking)} of {numbers.count(count, 'parameter')} not determined"
            if lacking
            else _all_text(count, "parameter") + " determined"
        )
    if channel.characteristics is not None:
        points = channel.characteristics.speed_map
        determined = sum(point.determined for point in points)
        yield (
            "the speed map is determined"
            if determined == len(points)
            else f"the speed map is determined at {determined} of {numbers.count(len(points), 'point')}"
        )


def _all_text(count: int, what: str) -> str:
    return f"the one {what}" if count == 1 else f"all {count} {what}s"


def _free_run_finding(section: str, accuracy: Accuracy, unit: str) -> Finding:
    """Return the error of the free run, of its worst test and of the best rival, with every reservation."""
    free_run, title, tests = accuracy.free_run(), _title(section), _tests(section, accuracy)
    if free_run.rmse is None or free_run.fit is None:
        return Finding(Rating.BAD, f"{title}: the free run diverged on {tests}.")
    rmse = numbers.with_error(free_run.rmse, free_run.rmse_error)
    text = f"{title}, free run: RMSE {rmse} {unit} on {tests} (fit {free_run.fit:.3g} %)"
    if len(accuracy.tests) > 1:
        errors = accuracy.predictions.rmse(FREE_RUN)
        worst = int(np.argmax(errors))
        text += f", worst {accuracy.tests[worst]}: {errors[worst]:.3g} {unit}"
    reservations = [*_fit_reservations(accuracy, free_run.fit), *_rival_reservations(accuracy, unit)]
    return _reserved(text, reservations, "; ")


def _fit_reservations(accuracy: Accuracy, fit: float) -> Iterator[Reservation]:
    """Yield what is wrong with a free run by itself, over all tests and in the worst one."""
    worst_fit, worst = min(
        (fit if figures.fit is None else figures.fit, name) for name, figures in accuracy.per_test.items()
    )
    if fit < 0:
        yield Rating.BAD, "worse than the mean of each test"
    elif fit < POOR_FIT:
        yield Rating.BAD, "RMSE above half the standard deviation of the displacement"
    elif fit < ROUGH_FIT:
        yield Rating.CAUTION, "RMSE above a fifth of the standard deviation of the displacement"
    if worst_fit < POOR_FIT <= fit:
        yield Rating.CAUTION, f"the fit of {worst} is {worst_fit:.3g} %"


def _rival_reservations(accuracy: Accuracy, unit: str) -> Iterator[Reservation]:
    """Yield the errors of the physics model and of the best baseline in free run, beside the grey box's."""
    tests, own = accuracy.predictions, accuracy.free_run()
    few = len(tests.names) < MIN_TESTS
    physics = accuracy.free_run(BENCHMARK)
    if physics.errs_less(own):
        worse = not few and tests.is_significantly_better(BENCHMARK, FREE_RUN)
        words = f"{model_name(BENCHMARK)} alone errs less, {physics.rmse:.3g} {unit}"
        yield Rating.BAD if worse else Rating.CAUTION, words
    baselines = {
        name: np.inf if figures.free_run.rmse is None else figures.free_run.rmse
        for name, figures in accuracy.models.items()
        if name not in (BENCHMARK, GREYBOX) and figures.free_run is not None
    }
    if not baselines:
        yield Rating.CAUTION, "no baseline was fitted"
        return
    best = min(baselines, key=lambda name: baselines[name])
    if not np.isfinite(baselines[best]):
        yield Rating.CAUTION, "every baseline diverged"
        return
    words = f"best baseline: {model_name(best)}, {baselines[best]:.3g} {unit}"
    if few:
        yield Rating.CAUTION, f"{words}; too few tests for a conclusion"
    elif tests.is_significantly_better(FREE_RUN, best):
        yield Rating.GOOD, words
    else:
        less = own.rmse is not None and own.rmse < baselines[best]
        rank = "not significantly better" if less else "no better"
        yield Rating.CAUTION, f"{words}; the model is {rank}"


def _ahead_finding(section: str, accuracy: Accuracy, unit: str, step_s: float) -> Iterator[Finding]:
    """Yield whether another model errs less than the grey box at some horizon, and where by most."""
    horizons = accuracy.horizons
    own = _errors(horizons.rmse[GREYBOX])
    others = {name: _errors(rmse) for name, rmse in horizons.rmse.items() if name != GREYBOX}
    title = f"{_title(section)}, ahead"
    if not horizons.steps or not others:
        return
    if not np.all(np.isfinite(own)):
        yield Finding(Rating.BAD, f"{title}: the predictions of the grey box diverged.")
        return
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = {name: np.nan_to_num(own / rmse, nan=1.0) for name, rmse in others.items()}
    name = max(ratios, key=lambda name: float(ratios[name].max()))
    at = int(np.argmax(ratios[name]))
    if ratios[name][at] <= MIN_EXCESS:
        last = f"RMSE {own[-1]:.3g} {unit} {_time_ahead(horizons.steps[-1], step_s)}"
        few = len(accuracy.tests) < MIN_TESTS
        words = "too few tests for a conclusion" if few else "no other model errs less at any horizon"
        yield Finding(Rating.CAUTION if few else Rating.GOOD, f"{title}: {last}; {words}.")
        return
    where = np.flatnonzero(ratios[name] > MIN_EXCESS)
    ends = [_time_ahead(horizons.steps[index], step_s) for index in (where[0], where[-1])]
    yield Finding(
        Rating.BAD if ratios[name][at] > MAX_EXCESS else Rating.CAUTION,
        f"{title}: {model_name(name)} errs less {' to '.join(dict.fromkeys(ends))}: RMSE "
        f"{others[name][at]:.3g} against {own[at]:.3g} {unit} {_time_ahead(horizons.steps[at], step_s)}.",
    )


def _errors(rmse: tuple[float | None, ...]) -> np.ndarray:
    return np.array([np.inf if value is None else value for value in rmse])


def _time_ahead(steps: int, step_s: float) -> str:
    return f"{steps * step_s:.3g} s ahead"


def _band_finding(direction: str, bands: BandFigures, count: int, unit: str) -> Finding:
    """Return whether the coverage of the bands agrees with their level, in free run and ahead."""
    text = (
        f"{direction.capitalize()}: {100 * bands.covered:.0f} % of samples fell inside the "
        f"{100 * bands.coverage:.0f} % band (mean width {bands.width:.3g} {unit})"
    )
    return _reserved(text, [*_free_run_coverage(bands, count), *_coverage_ahead(bands)], ", ")


def _reserved(text: str, reservations: Sequence[Reservation], separator: str) -> Finding:
    """Return a finding with its reservations, as bad as the worst of them."""
    # What speaks for a model never outweighs what speaks against it.
    levels = [level for level, _ in reservations] or [Rating.GOOD]
    text = separator.join([text, *(words for _, words in reservations)])
    return Finding(min(levels, key=WORST_FIRST.index), f"{text}.")


def _free_run_coverage(bands: BandFigures, count: int) -> Iterator[Reservation]:
    """Yield what is wrong with the band of the free run, given the number of tests."""
    nominal, covered, error = bands.coverage, bands.covered, bands.covered_error
    if count < MIN_TESTS or error is None:
        yield Rating.CAUTION, "too few tests for a conclusion"
        return
    tolerance = max(COVERAGE_TOLERANCE, 2 * error)
    if covered < nominal - tolerance:
        yield Rating.BAD, "too narrow for these tests"
    elif covered < nominal - COVERAGE_TOLERANCE:
        yield Rating.CAUTION, f"below the level, but with {count} tests not significantly"
    elif covered > nominal + tolerance:
        yield Rating.CAUTION, "wider than necessary for these tests"


def _coverage_ahead(bands: BandFigures) -> Iterator[Reservation]:
    """Yield the smallest coverage of predictions ahead, where it is below the level of the bands."""
    if bands.horizons is None or not bands.horizons.covered:
        return
    least, steps = min(zip(bands.horizons.covered, bands.horizons.steps, strict=True))
    if least < bands.coverage - COVERAGE_TOLERANCE:
        far_below = least < bands.coverage - MAX_SHORTFALL
        words = f"{100 * least:.0f} % {numbers.count(steps, 'sample')} ahead, too narrow there"
        yield Rating.BAD if far_below else Rating.CAUTION, words


def _parameter_finding(direction: str, estimates: Estimates) -> Finding:
    parameters = estimates.parameters
    if all(estimate.determined for estimate in parameters):
        text = f"{direction.capitalize()}: {_all_text(len(parameters), 'parameter')} determined."
        return Finding(Rating.GOOD, text)
    undetermined = [e.symbol for e in parameters if not e.determined and e.method != NOT_ASSESSED]
    unassessed = [e.symbol for e in parameters if e.method == NOT_ASSESSED]
    phrases = [
        f"{len(symbols)} of {len(parameters)} parameters {lacking}: {', '.join(symbols)}"
        for symbols, lacking in (
            (undetermined, "not determined by the tests"),
            (unassessed, "without an interval"),
        )
        if symbols
    ]
    return Finding(Rating.CAUTION, f"{direction.capitalize()}: {'; '.join(phrases)}.")
