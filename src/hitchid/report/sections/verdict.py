"""The verdict: what a reader of a validation should know who reads no further."""

from collections.abc import Mapping
from typing import Any

from hitchid.report.document import Finding, Level
from hitchid.uncertainty import stated
from hitchid.validation import NAMES, Acceptance, Validation

HOLDS, FEWEST = 0.05, 3


def verdict(result: Validation, acceptance: Acceptance | None) -> tuple[Finding, ...]:
    """Return whether limits hold, and of each direction how free run, bands and parameters do."""
    unit = result.metrics["unit"]
    found = [] if acceptance is None else [_accepted(acceptance)]
    for mode, channel in result.metrics["channels"].items():
        found.append(_free_run(mode, channel, unit))
        if "bands" in channel:
            found.append(_bands(mode, channel["bands"], unit))
        if channel.get("parameters", {}).get("estimates"):
            found.append(_parameters(mode, channel["parameters"]["estimates"]))
    cycles = result.metrics["cycles"]
    if cycles["tests"]:
        found.append(_cycles(cycles, unit))
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


def _free_run(mode: str, channel: Mapping[str, Any], unit: str) -> Finding:
    own = channel["greybox"]["free_run"]
    count = len(channel["tests"])
    tests = f"{count} unseen test{'s' if count > 1 else ''}"
    if own["rmse"] is None:
        return Finding(Level.BAD, f"{mode.capitalize()}: the free run diverged on {tests}.")
    rivals = {
        NAMES[name]: figures["free_run"]["rmse"]
        for name, figures in channel["baselines"].items()
        if figures.get("free_run", {}).get("rmse") is not None
    }
    said = f"{mode.capitalize()}, free run: RMSE {stated(own['rmse'], own['rmse_error'])} {unit} on {tests}"
    if own["fit"] is not None:
        said += f" (fit {own['fit']:.3g} %)"
    name, best = min(rivals.items(), key=lambda pair: pair[1], default=("", 0.0))
    if not name:
        return Finding(Level.CAUTION, f"{said}; no baseline stands beside it.")
    worst, figures = max(channel["per_test"].items(), key=lambda pair: pair[1]["free_run"]["rmse"] or 0.0)
    said += f"; best baseline: {name}, {best:.3g} {unit}; worst test: {worst}, "
    said += f"{figures['free_run']['rmse']:.3g} {unit}."
    if own["fit"] is not None and own["fit"] < 0:
        return Finding(Level.BAD, f"{said[:-1]}: worse than a line through each test's mean.")
    if count < FEWEST:
        return Finding(Level.CAUTION, f"{said[:-1]}: too few tests to tell how the next will go.")
    return Finding(Level.GOOD if own["rmse"] < best else Level.CAUTION, said)


def _bands(mode: str, bands: Mapping[str, Any], unit: str) -> Finding:
    covered, asked = bands["free_run"]["covered"], bands["coverage"]
    said = (
        f"{mode.capitalize()}: the band for {100 * asked:.0f} % of the samples, "
        f"{bands['free_run']['width']:.3g} {unit} wide on average, held {100 * covered:.0f} %"
    )
    if covered < asked - HOLDS:
        return Finding(Level.BAD, f"{said}: it is too narrow for these tests.")
    if covered > asked + HOLDS:
        return Finding(Level.CAUTION, f"{said}: wider than these tests need.")
    return Finding(Level.GOOD, f"{said}.")


def _parameters(mode: str, estimates: Mapping[str, Any]) -> Finding:
    vague = [each["symbol"] for each in estimates.values() if not each["determined"]]
    if not vague:
        return Finding(Level.GOOD, f"{mode.capitalize()}: {_all(len(estimates), 'parameter')} determined.")
    said = f"{len(vague)} of {len(estimates)} parameters not determined by the tests: {', '.join(vague)}"
    return Finding(Level.CAUTION, f"{mode.capitalize()}: {said}.")


def _cycles(cycles: Mapping[str, Any], unit: str) -> Finding:
    own, count = cycles["greybox"]["free_run"], len(cycles["tests"])
    if own["rmse"] is None:
        return Finding(Level.BAD, "Mixed cycles: the free run diverged.")
    said = f"Mixed cycles, free run: RMSE {stated(own['rmse'], own['rmse_error'])} {unit} on {count} unseen"
    said += f", largest error {own['max_abs']:.3g} {unit}"
    if "transfer_function" not in cycles:
        return Finding(Level.CAUTION, f"{said}; no baseline stands beside it.")
    other = cycles["transfer_function"]["free_run"]["rmse"]
    better = other is None or own["rmse"] < other
    rival = "diverged" if other is None else f"{other:.3g} {unit}"
    return Finding(
        Level.GOOD if better else Level.CAUTION, f"{said}; the paper's transfer functions: {rival}."
    )
