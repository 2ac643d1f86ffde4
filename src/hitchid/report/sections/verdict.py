"""The verdict: what a reader of a validation should know who reads no further."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hitchid.report.document import Finding, Level
from hitchid.uncertainty import stated
from hitchid.validation import CYCLES, NAMES, Acceptance, Predictions, Validation
from hitchid.validation.predictions import FEWEST

HOLDS = 0.05
RIVALS = ("transfer_function", "paper", "arx", "narx", "lstm")


def verdict(result: Validation, acceptance: Acceptance | None) -> tuple[Finding, ...]:
    """Return whether limits hold, and of each direction how free run, bands and parameters do."""
    unit = result.metrics["unit"]
    found = [] if acceptance is None else [_accepted(acceptance)]
    for mode, channel in result.metrics["channels"].items():
        tests = result.predictions[mode]
        found.append(_free_run(mode, channel["greybox"]["free_run"], tests, unit))
        if "bands" in channel:
            found.append(_bands(mode, channel["bands"], len(tests.names), unit))
        if channel.get("parameters", {}).get("estimates"):
            found.append(_parameters(mode, channel["parameters"]["estimates"]))
    if CYCLES in result.predictions:
        own = result.metrics[CYCLES]["greybox"]["free_run"]
        found.append(_free_run("mixed cycles", own, result.predictions[CYCLES], unit))
    return tuple(found)


def _accepted(acceptance: Acceptance) -> Finding:
    failed = [check for check in acceptance.checks if not check.passed]
    count = len(acceptance.checks)
    if not failed:
        return Finding(Level.GOOD, f"Accepted: {_all(count, 'limit')} held.")
    names = "; ".join(f"{check.name} {check.found}, required {check.limit}" for check in failed)
    return Finding(Level.BAD, f"Not accepted: {len(failed)} of {count} limits fail: {names}.")


def _all(count: int, what: str) -> str:
    return f"the one {what}" if count == 1 else f"all {count} {what}s"


def _free_run(where: str, own: Mapping[str, Any], tests: Predictions, unit: str) -> Finding:
    """Return how the free run does beside the best baseline; good is what tests tell apart from it."""
    count = len(tests.names)
    on = f"{count} unseen {'cycle' if where == 'mixed cycles' else 'test'}{'s' if count > 1 else ''}"
    if own["rmse"] is None or own["fit"] is None:
        return Finding(Level.BAD, f"{where.capitalize()}: the free run diverged on {on}.")
    errors = tests.rmse("free_run")
    worst = int(np.argmax(errors))
    said = (
        f"{where.capitalize()}, free run: RMSE {stated(own['rmse'], own['rmse_error'])} {unit} on {on} (fit "
        f"{own['fit']:.3g} %)"
    )
    if count > 1:
        said += f", worst {tests.names[worst]} with {errors[worst]:.3g} {unit}"
    if own["fit"] < 0:
        return Finding(Level.BAD, f"{said}: worse than each test's own mean.")
    rivals = {name: _pooled(tests, name) for name in RIVALS if name in tests.models}
    if not rivals:
        return Finding(Level.CAUTION, f"{said}; no baseline stands beside it.")
    best = min(rivals, key=lambda name: rivals[name])
    if not np.isfinite(rivals[best]):
        return Finding(Level.CAUTION, f"{said}; every baseline diverged.")
    said += f"; best baseline: {NAMES[best]}, {rivals[best]:.3g} {unit}"
    if count < FEWEST:
        return Finding(Level.CAUTION, f"{said}: too few tests to tell how the next will go.")
    if tests.errs_surely_less("free_run", best):
        return Finding(Level.GOOD, f"{said}.")
    less = own["rmse"] < rivals[best]
    return Finding(Level.CAUTION, f"{said}: {'not surely better' if less else 'no better'} than that.")


def _pooled(tests: Predictions, model: str) -> float:
    with np.errstate(over="ignore"):
        sizes = [row.size for row in tests.actual]
        return float(np.sqrt(np.average(tests.rmse(model) ** 2, weights=sizes)))


def _bands(mode: str, bands: Mapping[str, Any], count: int, unit: str) -> Finding:
    """Return whether a band holds its share; tests stand and fall together, so few of them tell little."""
    free, asked = bands["free_run"], bands["coverage"]
    covered, error = free["covered"], free["covered_error"]
    said = (
        f"{mode.capitalize()}: the band for {100 * asked:.0f} % of the samples, {free['width']:.3g} {unit} "
        f"wide on average, held {100 * covered:.0f} %"
    )
    if count < FEWEST or error is None:
        return Finding(Level.CAUTION, f"{said}: too few tests to judge it.")
    doubt = max(HOLDS, 2 * error)
    if covered < asked - doubt:
        return Finding(Level.BAD, f"{said}: it is too narrow for these tests.")
    if covered < asked - HOLDS:
        return Finding(Level.CAUTION, f"{said}: less than it is made for, as {count} tests may do by chance.")
    if covered > asked + doubt:
        return Finding(Level.CAUTION, f"{said}: wider than these tests need.")
    return Finding(Level.GOOD, f"{said}.")


def _parameters(mode: str, estimates: Mapping[str, Any]) -> Finding:
    vague = [each["symbol"] for each in estimates.values() if not each["determined"]]
    if not vague:
        return Finding(Level.GOOD, f"{mode.capitalize()}: {_all(len(estimates), 'parameter')} determined.")
    said = f"{len(vague)} of {len(estimates)} parameters not determined by the tests: {', '.join(vague)}"
    return Finding(Level.CAUTION, f"{mode.capitalize()}: {said}.")
