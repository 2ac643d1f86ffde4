"""The verdict of a report: its summary findings."""

import numpy as np

from hitchid.model import Estimates
from hitchid.model.estimates import NOT_ASSESSED
from hitchid.report import numbers
from hitchid.report.document import Finding, Rating
from hitchid.validation import Acceptance, Accuracy, BandFigures, Validation
from hitchid.validation.names import BENCHMARK, GREYBOX, model_name
from hitchid.validation.predictions import MIN_TESTS

COVERAGE_TOLERANCE = 0.05  # deviation of coverage from its level without a caution, share of samples; chosen


def verdict(result: Validation, acceptance: Acceptance | None) -> tuple[Finding, ...]:
    """Return the findings on limits, and for each direction on free run, bands and parameters."""
    findings = [] if acceptance is None else [_acceptance_finding(acceptance)]
    for direction, channel in result.channels.items():
        accuracy = channel.accuracy
        findings.append(_free_run_finding(direction, accuracy, result.unit))
        if accuracy.bands is not None:
            findings.append(_band_finding(direction, accuracy.bands, len(accuracy.tests), result.unit))
        if channel.parameters is not None and channel.parameters.parameters:
            findings.append(_parameter_finding(direction, channel.parameters))
    if result.cycles is not None:
        findings.append(_free_run_finding("mixed cycles", result.cycles.accuracy, result.unit))
    return tuple(findings)


def _acceptance_finding(acceptance: Acceptance) -> Finding:
    failed = [check for check in acceptance.checks if not check.passed]
    count = len(acceptance.checks)
    if not failed:
        return Finding(Rating.GOOD, f"Accepted: {_all_text(count, 'limit')} met.")
    names = "; ".join(f"{check.name} {check.figure}, required {check.limit}" for check in failed)
    return Finding(Rating.BAD, f"Not accepted: {len(failed)} of {count} limits violated: {names}.")


def _all_text(count: int, what: str) -> str:
    return f"the one {what}" if count == 1 else f"all {count} {what}s"


def _free_run_finding(subset: str, accuracy: Accuracy, unit: str) -> Finding:
    """Return the RMSE of the free run and of the best baseline; good if significantly smaller."""
    tests, free_run = accuracy.predictions, accuracy.free_run()
    count = len(tests.names)
    tests_text = numbers.count(count, "unseen cycle" if subset == "mixed cycles" else "unseen test")
    if free_run.rmse is None or free_run.fit is None:
        return Finding(Rating.BAD, f"{subset.capitalize()}: the free run diverged on {tests_text}.")
    errors = tests.rmse("free_run")
    worst = int(np.argmax(errors))
    rmse = numbers.with_error(free_run.rmse, free_run.rmse_error)
    text = f"{subset.capitalize()}, free run: RMSE {rmse} {unit} on {tests_text} (fit {free_run.fit:.3g} %)"
    if count > 1:
        text += f", worst {tests.names[worst]}: {errors[worst]:.3g} {unit}"
    if free_run.fit < 0:
        return Finding(Rating.BAD, f"{text}: worse than the mean of each test.")
    baselines = {
        name: np.inf if figures.free_run.rmse is None else figures.free_run.rmse
        for name, figures in accuracy.models.items()
        if name not in (BENCHMARK, GREYBOX) and figures.free_run is not None
    }
    if not baselines:
        return Finding(Rating.CAUTION, f"{text}; no baseline was fitted.")
    best = min(baselines, key=lambda name: baselines[name])
    if not np.isfinite(baselines[best]):
        return Finding(Rating.CAUTION, f"{text}; every baseline diverged.")
    text += f"; best baseline: {model_name(best)}, {baselines[best]:.3g} {unit}"
    if count < MIN_TESTS:
        return Finding(Rating.CAUTION, f"{text}; too few tests for a conclusion.")
    if tests.is_significantly_better("free_run", best):
        return Finding(Rating.GOOD, f"{text}.")
    less = free_run.rmse < baselines[best]
    rank = "not significantly better" if less else "no better"
    return Finding(Rating.CAUTION, f"{text}; the model is {rank}.")


def _band_finding(direction: str, bands: BandFigures, count: int, unit: str) -> Finding:
    """Return whether the coverage of a band agrees with its level, given the number of tests."""
    nominal, covered, error = bands.coverage, bands.covered, bands.covered_error
    text = (
        f"{direction.capitalize()}: {100 * covered:.0f} % of samples fell inside the "
        f"{100 * nominal:.0f} % band (mean width {bands.width:.3g} {unit})"
    )
    if count < MIN_TESTS or error is None:
        return Finding(Rating.CAUTION, f"{text}; too few tests for a conclusion.")
    tolerance = max(COVERAGE_TOLERANCE, 2 * error)
    if covered < nominal - tolerance:
        return Finding(Rating.BAD, f"{text}: the band is too narrow for these tests.")
    if covered < nominal - COVERAGE_TOLERANCE:
        return Finding(
            Rating.CAUTION,
            (
                f"{text}: below the nominal coverage of the band, but with {count} tests the "
                "difference is not significant."
            ),
        )
    if covered > nominal + tolerance:
        return Finding(Rating.CAUTION, f"{text}: the band is wider than necessary for these tests.")
    return Finding(Rating.GOOD, f"{text}.")


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
