"""The verdict: what a reader of a validation should know who reads no further."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hitchid.report.document import Finding, Rating
from hitchid.uncertainty import format_with_error
from hitchid.validation import CYCLES, NAMES, Acceptance, Predictions, Validation
from hitchid.validation.predictions import MIN_TESTS

COVERAGE_TOLERANCE = 0.05
BASELINES = ("transfer_function", "paper", "arx", "narx", "lstm")


def verdict(result: Validation, acceptance: Acceptance | None) -> tuple[Finding, ...]:
    """Return whether limits hold, and of each direction how free run, bands and parameters do."""
    unit = result.metrics["unit"]
    findings = [] if acceptance is None else [_acceptance_finding(acceptance)]
    for direction, channel in result.metrics["channels"].items():
        tests = result.predictions[direction]
        findings.append(_free_run_finding(direction, channel["greybox"]["free_run"], tests, unit))
        if "bands" in channel:
            findings.append(_band_finding(direction, channel["bands"], len(tests.names), unit))
        if channel.get("parameters", {}).get("estimates"):
            findings.append(_parameter_finding(direction, channel["parameters"]["estimates"]))
    if CYCLES in result.predictions:
        accuracy = result.metrics[CYCLES]["greybox"]["free_run"]
        findings.append(_free_run_finding("mixed cycles", accuracy, result.predictions[CYCLES], unit))
    return tuple(findings)


def _acceptance_finding(acceptance: Acceptance) -> Finding:
    failed = [check for check in acceptance.checks if not check.passed]
    count = len(acceptance.checks)
    if not failed:
        return Finding(Rating.GOOD, f"Accepted: {_all_text(count, 'limit')} held.")
    names = "; ".join(f"{check.name} {check.found}, required {check.limit}" for check in failed)
    return Finding(Rating.BAD, f"Not accepted: {len(failed)} of {count} limits fail: {names}.")


def _all_text(count: int, what: str) -> str:
    return f"the one {what}" if count == 1 else f"all {count} {what}s"


def _free_run_finding(subset: str, accuracy: Mapping[str, Any], tests: Predictions, unit: str) -> Finding:
    """Return how the free run does beside the best baseline; good is what tests tell apart from it."""
    count = len(tests.names)
    tests_text = f"{count} unseen {'cycle' if subset == 'mixed cycles' else 'test'}{'s' if count > 1 else ''}"
    if accuracy["rmse"] is None or accuracy["fit"] is None:
        return Finding(Rating.BAD, f"{subset.capitalize()}: the free run diverged on {tests_text}.")
    errors = tests.rmse("free_run")
    worst = int(np.argmax(errors))
    text = (
        f"{subset.capitalize()}, free run: RMSE {format_with_error(accuracy['rmse'], accuracy['rmse_error'])} {unit} on {tests_text} (fit "
        f"{accuracy['fit']:.3g} %)"
    )
    if count > 1:
        text += f", worst {tests.names[worst]} with {errors[worst]:.3g} {unit}"
    if accuracy["fit"] < 0:
        return Finding(Rating.BAD, f"{text}: worse than each test's own mean.")
    baselines = {name: _pooled(tests, name) for name in BASELINES if name in tests.models}
    if not baselines:
        return Finding(Rating.CAUTION, f"{text}; no baseline stands beside it.")
    best = min(baselines, key=lambda name: baselines[name])
    if not np.isfinite(baselines[best]):
        return Finding(Rating.CAUTION, f"{text}; every baseline diverged.")
    text += f"; best baseline: {NAMES[best]}, {baselines[best]:.3g} {unit}"
    if count < MIN_TESTS:
        return Finding(Rating.CAUTION, f"{text}: too few tests to tell how the next will go.")
    if tests.is_significantly_better("free_run", best):
        return Finding(Rating.GOOD, f"{text}.")
    less = accuracy["rmse"] < baselines[best]
    return Finding(Rating.CAUTION, f"{text}: {'not surely better' if less else 'no better'} than that.")


def _pooled(tests: Predictions, model: str) -> float:
    with np.errstate(over="ignore"):
        sizes = [row.size for row in tests.actual]
        return float(np.sqrt(np.average(tests.rmse(model) ** 2, weights=sizes)))


def _band_finding(direction: str, bands: Mapping[str, Any], count: int, unit: str) -> Finding:
    """Return whether a band holds its share; tests stand and fall together, so few of them tell little."""
    free, nominal = bands["free_run"], bands["coverage"]
    covered, error = free["covered"], free["covered_error"]
    text = (
        f"{direction.capitalize()}: the band for {100 * nominal:.0f} % of the samples, {free['width']:.3g} {unit} "
        f"wide on average, held {100 * covered:.0f} %"
    )
    if count < MIN_TESTS or error is None:
        return Finding(Rating.CAUTION, f"{text}: too few tests to judge it.")
    tolerance = max(COVERAGE_TOLERANCE, 2 * error)
    if covered < nominal - tolerance:
        return Finding(Rating.BAD, f"{text}: it is too narrow for these tests.")
    if covered < nominal - COVERAGE_TOLERANCE:
        return Finding(
            Rating.CAUTION, f"{text}: less than it is made for, as {count} tests may do by chance."
        )
    if covered > nominal + tolerance:
        return Finding(Rating.CAUTION, f"{text}: wider than these tests need.")
    return Finding(Rating.GOOD, f"{text}.")


def _parameter_finding(direction: str, estimates: Mapping[str, Any]) -> Finding:
    undetermined = [estimate["symbol"] for estimate in estimates.values() if not estimate["determined"]]
    if not undetermined:
        return Finding(
            Rating.GOOD, f"{direction.capitalize()}: {_all_text(len(estimates), 'parameter')} determined."
        )
    text = f"{len(undetermined)} of {len(estimates)} parameters not determined by the tests: {', '.join(undetermined)}"
    return Finding(Rating.CAUTION, f"{direction.capitalize()}: {text}.")
