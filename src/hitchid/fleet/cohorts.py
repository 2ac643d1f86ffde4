"""Cohorts: do machines of other types, oils or ages have other parameters?"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc, stdtrit

from hitchid._support.short_repr import short_repr
from hitchid.errors import InputError
from hitchid.fleet.arguments import checked_estimates
from hitchid.fleet.multiple_testing import adjusted_p_values
from hitchid.fleet.random_effects import fit_random_effects
from hitchid.fleet.robustness import normal_constants

LEVEL = 0.95  # of the intervals
FEWEST = 3  # machines of a category that is compared; chosen
FEWEST_LEFT = 3  # machines more than coefficients, from which there is a test; chosen

Column = Sequence[str | float | None] | np.ndarray  # texts or numbers


@short_repr
@dataclass(frozen=True)
class CohortEffect:
    """Comparison of one parameter over one column of the metadata.

    Attributes:
        column: its name.
        parameter: index of the parameter.
        labels: categories, sorted; empty for a column of numbers.
        machines: number of machines that are compared.
        values: mean of each category, in the parameter's unit, or the slope alone, per unit of the column.
        intervals: 95 % interval of each value.
        p_value: of equal means, or of no slope.
        q_value: smallest false discovery rate at which it is a discovery, over columns and parameters.
    """

    column: str
    parameter: int
    labels: tuple[str, ...]
    machines: int
    values: tuple[float, ...]
    intervals: tuple[tuple[float, float], ...]
    p_value: float
    q_value: float = np.nan


def compare_cohorts(
    estimates: Float[np.ndarray, "n p"],
    covariances: Float[np.ndarray, "n p p"],
    columns: Mapping[str, Column],
) -> tuple[CohortEffect, ...]:
    """Return the effect of each column on each parameter.

    y = X β + b + e, b ~ N(0, τ²), e ~ N(0, s²): X indicates the categories of a column of texts, or contains
    one and the numbers. With C β = 0 for equal means or no slope and β ~ N(·, φ Cov):
    (C β)ᵀ(C φ Cov Cᵀ)⁻¹(C β)/q is F(q, ν), φ = max(1, Σ min(z², c²)/κ/(n − k)).

    Args:
        estimates: of each machine, shape [N, P], NaN where missing.
        covariances: of the errors, shape [N, P, P].
        columns: name to a text or a number for each machine; None, an empty text or NaN where unknown. A
            category of fewer than three machines is left out.

    Raises:
        InputError: estimates that cannot be used, or a column of another length.

    Source: Knapp & Hartung 2003, Improved tests for a random effects meta-regression with a single covariate;
        Benjamini & Hochberg 1995.
    """
    values, errors = checked_estimates(estimates, covariances)
    for name, column in columns.items():
        if len(column) != len(values):
            raise InputError(f"columns: '{name}': got {len(column)} values, expected {len(values)}")
    effects = [
        effect
        for name, column in columns.items()
        for effect in _effects(name, column, values, np.diagonal(errors, axis1=1, axis2=2))
    ]
    q_values = adjusted_p_values(np.array([effect.p_value for effect in effects]))
    return tuple(replace(effect, q_value=float(q)) for effect, q in zip(effects, q_values, strict=True))


def _effects(name: str, column: Column, values: np.ndarray, variances: np.ndarray) -> Iterator[CohortEffect]:
    numeric = not any(isinstance(cell, str) for cell in column)
    for parameter in range(values.shape[1]):
        known = ~np.isnan(values[:, parameter])
        labels, design, known = _slope(column, known) if numeric else _categories(column, known)
        machines = int(known.sum())
        coefficients = design.shape[1]
        if coefficients < 2 or machines < coefficients + FEWEST_LEFT or np.linalg.matrix_rank(design) < 2:
            continue
        beta, covariance, freedom = _regression(values[known, parameter], variances[known, parameter], design)
        tested = np.eye(coefficients)[1:] - (0 if numeric else np.eye(coefficients)[0])
        difference = tested @ beta
        squares = difference @ np.linalg.solve(tested @ covariance @ tested.T, difference)
        p_value = float(fdtrc(len(tested), freedom, squares / len(tested)))
        half_width = stdtrit(freedom, (1 + LEVEL) / 2) * np.sqrt(np.diagonal(covariance))
        shown = slice(1, None) if numeric else slice(None)
        ends = zip((beta - half_width)[shown], (beta + half_width)[shown], strict=True)
        intervals = tuple((float(lower), float(upper)) for lower, upper in ends)
        yield CohortEffect(name, parameter, labels, machines, tuple(beta[shown].tolist()), intervals, p_value)


def _slope(column: Column, known: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Return no labels, the columns one and number about its mean, and which machines are compared."""
    numbers = np.array([np.nan if cell is None else cell for cell in column], float)
    known = known & np.isfinite(numbers)
    centred = numbers[known] - (numbers[known].mean() if known.any() else 0.0)
    return (), np.stack([np.ones_like(centred), centred], axis=1), known


def _categories(column: Column, known: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Return the categories, their indicators, and which machines are compared."""
    texts = np.array([cell if isinstance(cell, str) else "" for cell in column])
    names, counts = np.unique(texts[known & (texts != "")], return_counts=True)
    labels = tuple(names[counts >= FEWEST].tolist())
    known = known & np.isin(texts, labels)
    return labels, (texts[known, None] == np.array(labels, texts.dtype)).astype(float), known


def _regression(
    values: np.ndarray, variances: np.ndarray, design: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return coefficients, their covariance and its degrees of freedom."""
    fit = fit_random_effects(values, variances, design, np.ones((1, len(values)), bool))
    constants = normal_constants()
    beta = fit.coefficients[0]
    squared = (values - design @ beta) ** 2 / (variances + fit.between[0])
    left = len(values) - len(beta)
    scatter = np.minimum(squared, constants.clip).sum() / constants.consistency / left
    return beta, max(1.0, float(scatter)) * fit.covariance[0], constants.efficiency * left
