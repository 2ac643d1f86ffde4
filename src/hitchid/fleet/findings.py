"""What a comparison of machines says, in sentences."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from hitchid._support import numbers
from hitchid.fleet.comparison import FleetComparison
from hitchid.fleet.parameters import DEAD_ZONE, DELAY, GAIN, LOAD_SCATTER, FleetParameter
from hitchid.report import Finding, Rating

MOST_SENTENCES = 10  # machines with a sentence of their own, of each kind; chosen
LEAST_Q = 1e-3  # smaller ones are given as below it; chosen
MINUS = "\N{MINUS SIGN}"
VERBS = {"lifting": "lift", "lowering": "lower"}


def fleet_findings(comparison: FleetComparison) -> tuple[Finding, ...]:
    """Return what stands out, changes, differs between cohorts and failed."""
    findings = [_how_many(comparison)]
    for table, sentences in (
        ("outliers", _outlier_sentences(comparison)),
        ("trends", _trend_sentences(comparison)),
        ("cohorts", _cohort_sentences(comparison)),
    ):
        texts = list(sentences)
        # A verdict of a hundred sentences is none; the tables have all.
        if (more := len(texts) - MOST_SENTENCES) > 0:
            texts[MOST_SENTENCES:] = [f"{more} more: see the table of {table}."]
        findings += [Finding(Rating.CAUTION, text) for text in texts]
    if failed := comparison.failed:
        causes = Counter(row.cause for row in failed).most_common()
        listed = ", ".join(f"{cause} ({count})" for cause, count in causes)
        text = f"{len(failed)} of {len(comparison.rows)} machines could not be identified: {listed}."
        findings.append(Finding(Rating.BAD, text))
    return tuple(findings)


def _how_many(comparison: FleetComparison) -> Finding:
    count, all_machines = len(comparison.standing_out), len(comparison.machines)
    if not all_machines:
        return Finding(Rating.BAD, "No machine is compared.")
    # "None stands out" would be praise that no test has earned.
    if np.all(np.isnan(comparison.outliers.p_value)):
        machines = numbers.count(all_machines, "machine")
        return Finding(Rating.CAUTION, f"{machines} with a model, too few for one to stand out.")
    if not count:
        return Finding(Rating.GOOD, f"None of {all_machines} machines stands out. {detectable(comparison)}")
    verb = "stands" if count == 1 else "stand"
    return Finding(Rating.CAUTION, f"{count} of {all_machines} machines {verb} out.")


def detectable(comparison: FleetComparison) -> str:
    """Return which deviation would be named with a probability of 90 %; empty if nothing is compared."""
    parts = []
    for column, parameter in enumerate(comparison.parameters):
        values = comparison.outliers.detectable[:, column]
        if parameter.name in (GAIN, DEAD_ZONE) and not np.all(np.isnan(values)):
            difference = amount(parameter, parameter.difference(float(np.nanmedian(values))))
            parts.append(f"{parameter.name} of {parameter.direction} by {difference}")
    if not parts:
        return ""
    return f"A single machine is named with a probability of 90 % if it differs in {', '.join(parts)}."


def differences(
    parameter: FleetParameter, cell: tuple[int, int], *estimates: np.ndarray
) -> tuple[float, ...]:
    """Return what stands in one cell of each of some estimates, as differences of the parameter."""
    return tuple(float(parameter.difference(own[cell])) for own in estimates)


def _outlier_sentences(comparison: FleetComparison) -> Iterator[str]:
    """Yield a sentence for each parameter in which a machine stands out, smallest p-value first."""
    outliers = comparison.outliers
    for cell in outliers.ranking:
        parameter = comparison.parameters[cell[1]]
        deviation, lower, upper = differences(
            parameter, cell, outliers.deviation, outliers.lower, outliers.upper
        )
        ends = signed_range(parameter, lower, upper)
        effect = _effect(parameter, deviation)
        yield f"{comparison.machines[cell[0]]} {effect} than the others (interval {ends})."


def _effect(parameter: FleetParameter, deviation: float) -> str:
    """Return what a deviation does, as `lowers 12 % slower`."""
    verb, size, higher = VERBS[parameter.direction], amount(parameter, abs(deviation)), deviation > 0
    return {
        GAIN: f"{verb}s {size} {'faster' if higher else 'slower'}",
        DEAD_ZONE: f"begins to {verb} at a command {size} {'higher' if higher else 'lower'}",
        DELAY: f"begins to {verb} {size} {'later' if higher else 'earlier'}",
        LOAD_SCATTER: f"{verb}s with {size} {'more' if higher else 'less'} scatter between tests",
    }[parameter.name]


def amount(parameter: FleetParameter, difference: float | np.ndarray) -> str:
    """Return a difference to two digits with its unit: % for a logarithm."""
    factor, unit = (100, "%") if parameter.logarithmic else (1, parameter.unit)
    return f"{_two_digits(factor * float(difference))} {unit}"


def signed_range(parameter: FleetParameter, lower: float, upper: float) -> str:
    """Return two ends of a difference with their signs and unit."""
    factor, unit = (100, "%") if parameter.logarithmic else (1, parameter.unit)
    return f"{' … '.join(f'{_sign(end)}{_two_digits(factor * abs(end))}' for end in (lower, upper))} {unit}"


def signed_amount(parameter: FleetParameter, difference: float) -> str:
    """Return a difference to two digits with its sign and unit."""
    return f"{_sign(difference)}{amount(parameter, abs(difference))}"


def _sign(number: float) -> str:
    return "+" if number > 0 else MINUS


def _two_digits(value: float) -> str:
    text = f"{value:.2g}"
    return f"{float(text):.0f}" if "e" in text and abs(value) >= 1 else text


def _trend_sentences(comparison: FleetComparison) -> Iterator[str]:
    trends = comparison.trends
    if trends is None:
        return
    for machine, column in trends.ranking:
        cell = int(np.flatnonzero(trends.machines == machine)[0]), column
        if not trends.q_values[cell] <= comparison.false_discovery_rate:
            return  # the ranking goes by p-value, as q does
        parameter = comparison.parameters[column]
        slope, lower, upper = differences(parameter, cell, trends.slopes, trends.lower, trends.upper)
        verb = "rises" if slope > 0 else "falls"
        yield (
            f"{comparison.machines[machine]}: {parameter.name} of {parameter.direction} {verb} by "
            f"{amount(parameter, abs(slope))} a year (95 %: {signed_range(parameter, lower, upper)})."
        )


def _cohort_sentences(comparison: FleetComparison) -> Iterator[str]:
    """Yield how a parameter differs over a column of the metadata, smallest p-value first."""
    for effect in sorted(comparison.cohorts, key=lambda effect: effect.p_value):
        if not effect.q_value <= comparison.false_discovery_rate:
            continue
        parameter = comparison.parameters[effect.parameter]
        name, q = f"{parameter.name} of {parameter.direction}", q_text(effect.q_value)
        if effect.labels:
            values = (
                f"{label} {numbers.digits(float(parameter.value(value)))}"
                for label, value in zip(effect.labels, effect.values, strict=True)
            )
            yield f"The {name} depends on {effect.column}: {', '.join(values)} {parameter.unit} ({q})."
        else:
            slope = float(parameter.difference(effect.values[0]))
            verb, size = "rises" if slope > 0 else "falls", amount(parameter, abs(slope))
            yield f"The {name} {verb} with {effect.column}, by {size} for each unit ({q})."


def q_text(q_value: float) -> str:
    """Return a q-value with two digits, `< 0.001` below that."""
    return f"q {'< 0.001' if q_value < LEAST_Q else f'= {q_value:.2g}'}"
