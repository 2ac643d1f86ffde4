"""Polynomial autoregression with inputs (NARX): terms by forward regression, coefficients by free runs."""

from collections.abc import Iterator

import numpy as np

from hitchid.baselines.autoregression import Autoregression
from hitchid.baselines.baseline import Baseline, FitContext, Sizes
from hitchid.baselines.forward_regression import candidate_terms, order_of_terms
from hitchid.baselines.linear_inputs import LinearInputs
from hitchid.baselines.polynomial_run import Sections, polynomial_run, products, sections_of
from hitchid.baselines.simulation_error import refine
from hitchid.structures import Batch, split_validation

LAGS = (1, 2, 3, 5, 8)  # largest lags that are compared, in samples; chosen
TERMS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 30)  # numbers of terms that are compared; chosen
REFINED = 3  # candidates that are refined before the last choice; chosen, it bounds the time
# Samples of a section and of all sections; longer tests are cut and thinned out; chosen to bound the time.
SECTION_SAMPLES, MAX_SAMPLES = 2000, 20_000


class Narx(Autoregression):
    """Polynomial NARX model of travel w (displacement relative to the start).

    w(k) = Σₘ θₘ fₘ₁(k) fₘ₂(k), each factor f one of 1, w(k−i), u(k−i), a covariate, the initial displacement.

    Attributes:
        scaling: of covariates and initial displacement.
        terms: factors of each term, shape [M, 2]: 0 is the constant 1, i is w(k−i), −i is u(k−i), from
            1001 on the covariates and last the initial displacement.
        coefficients: θ, for scaled signals, shape [M].
        travel_scale, command_scale: divisors of travel and command, shape [].
    """

    scaling: LinearInputs
    terms: np.ndarray
    coefficients: np.ndarray
    travel_scale: np.ndarray
    command_scale: np.ndarray

    @property
    def lag(self) -> int:
        """Largest lag i of any factor, in samples, at least 1."""
        lags = np.abs(self.terms)
        return int(lags.max(initial=1, where=lags <= LAGS[-1]))

    def inputs(self, batch: Batch) -> np.ndarray:
        """Return command, covariates and initial displacement of tests, scaled, shape [T, 2 + C, N]."""
        return narx_inputs(batch, self.scaling, self.command_scale)

    def predict_next(self, inputs: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from inputs, shape [2 + C, n, N], and w(k−1) … w(k−n), shape [n, N]."""
        constants = inputs[1:, 0].T
        values = products(self.terms, travel.T / self.travel_scale, inputs[0].T, constants)
        return self.travel_scale * (values @ self.coefficients)

    def simulate(self, inputs: np.ndarray) -> np.ndarray:
        """Return travel simulated from inputs of shape [2 + C, N] alone, from rest, shape [N].

        A simulation that diverges becomes infinite or NaN, without a warning.
        """
        lag = self.lag
        section = Sections(
            command=np.pad(inputs[0], (lag, 0))[None],
            past=np.zeros((1, lag)),
            constants=inputs[None, 1:, 0],
        )
        return self.travel_scale * polynomial_run(self.terms, self.coefficients, section, lag)[0][0]

    def free_run(self, batch: Batch) -> np.ndarray:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        inputs, lag = self.inputs(batch), self.lag
        sections = Sections(
            command=np.pad(inputs[:, 0], ((0, 0), (lag, 0))),
            past=np.zeros((len(inputs), lag)),
            constants=inputs[:, 1:, 0],
        )
        travel = polynomial_run(self.terms, self.coefficients, sections, lag)[0]
        return np.asarray(batch.initial)[:, None] + batch.sign * self.travel_scale * travel


class NarxBaseline(Baseline):
    """Polynomial NARX by forward regression (FROLS), refined by free runs."""

    name, title = "narx", "NARX"

    def fit(self, tests: Batch, context: FitContext) -> Narx | None:
        """Return the NARX model with the smallest free-run error on the validation tests.

        Lags and number of terms are varied. Candidate terms are all products of up to two factors, ordered by
        error reduction ratio, with coefficients by least squares one step ahead. The three with the smallest
        error in free run are refined by least squares on errors of free runs; the best of them is fitted to
        all tests in the same way. Tests longer than 2000 samples are cut into sections, each starting from
        its measured past; of more than 20 000 samples every m-th section is used.

        Returns:
            The model; None where no candidate has a finite error in free run.

        Source: Billings, Nonlinear System Identification (2013), chapter 3; Piroddi and Spinelli, An
        identification algorithm for polynomial NARX models based on simulation error minimization (2003).
        """
        scaling = LinearInputs.of(tests)
        loss_mask = np.asarray(tests.loss_mask)
        if not loss_mask.any():
            return None
        scales = [
            np.asarray(np.abs(np.asarray(rows)[loss_mask]).max() or 1.0)
            for rows in (tests.travel, tests.command)
        ]
        everything, training, validation = (
            sections_of(
                batch,
                narx_inputs(batch, scaling, scales[1]),
                np.asarray(batch.travel) / scales[0],
                past=LAGS[-1],
                longest=SECTION_SAMPLES,
                most=MAX_SAMPLES,
            )
            for batch in (tests, *split_validation(tests)[:2])
        )
        candidates = [
            (error, lags, terms, coefficients)
            for lags in LAGS
            for terms, coefficients in _candidates(training, lags)
            if np.isfinite(error := _error(terms, coefficients, validation))
        ]
        if not candidates:
            return None
        refined = []
        for error, lags, terms, coefficients in sorted(candidates, key=lambda row: row[0])[:REFINED]:
            better = _refined(terms, coefficients, training)
            refined += [(error, lags, terms), (_error(terms, better, validation), lags, terms)]
        terms = min(refined, key=lambda row: row[0])[2]
        coefficients = _refined(terms, _least_squares(terms, everything), everything)
        return Narx(scaling, terms, coefficients, *scales)

    def skeleton(self, shapes: Sizes) -> Narx:
        """Return a model of the stored number of terms, all arrays zero."""
        terms, coefficients = np.zeros(shapes["terms"], np.int64), np.zeros(shapes["coefficients"])
        return Narx(
            LinearInputs.unfilled(*shapes["scaling/load_centre"]),
            terms,
            coefficients,
            np.zeros(()),
            np.zeros(()),
        )


def narx_inputs(batch: Batch, scaling: LinearInputs, command_scale: np.ndarray) -> np.ndarray:
    """Return command, covariates and initial displacement of tests, scaled, shape [T, 2 + C, N]."""
    load, initial = scaling.constants(batch)
    command = np.asarray(batch.command) / command_scale
    rows = (command, *(np.broadcast_to(row[:, None], command.shape) for row in (*load.T, initial)))
    return np.stack(rows, axis=1)


def _candidates(sections: Sections, lags: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield terms and coefficients of the models of one largest lag, from few to many terms."""
    terms = candidate_terms(lags, sections.constants)
    rows, target = sections.regression(terms)
    most = min(TERMS[-1], len(terms), target.size - 1)
    order = order_of_terms(rows, target, most)
    for size in dict.fromkeys(min(size, len(order)) for size in TERMS):
        chosen = order[:size]
        yield terms[chosen], np.linalg.lstsq(rows[:, chosen], target, rcond=None)[0]


def _least_squares(terms: np.ndarray, sections: Sections) -> np.ndarray:
    """Return the coefficients of the smallest error one step ahead."""
    return np.linalg.lstsq(*sections.regression(terms), rcond=None)[0]


def _refined(terms: np.ndarray, coefficients: np.ndarray, sections: Sections) -> np.ndarray:
    """Return coefficients with a smaller error in free run; the same where they diverge."""

    def residuals(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        travel, derivative = polynomial_run(
            terms, parameters, sections, sections.past.shape[1], derivative=True
        )
        return (travel - sections.travel)[sections.mask], derivative[sections.mask]

    return refine(coefficients, residuals)


def _error(terms: np.ndarray, coefficients: np.ndarray, sections: Sections) -> float:
    """Return the sum of squared errors in free run, infinite for a model that diverges."""
    travel, _ = polynomial_run(terms, coefficients, sections, sections.past.shape[1])
    with np.errstate(all="ignore"):
        squares = float(np.sum((travel - sections.travel)[sections.mask] ** 2))
    return squares if np.isfinite(squares) else np.inf
