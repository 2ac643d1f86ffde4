"""Polynomial autoregression with inputs (NARX): terms by forward regression, coefficients by free runs."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations_with_replacement

import numpy as np

from hitchid.baselines.baseline import Baseline, FitContext, Sizes
from hitchid.baselines.linear import Autoregression, LinearInputs, to_displacement
from hitchid.baselines.output_error import refine
from hitchid.structures import Batch, split_validation

# Forward regression with orthogonal least squares (FROLS): candidate terms and their order.

CONSTANT = 1001  # code of the first covariate among the factors of a term; the initial displacement is last
DEPENDENT = 1e-10  # share of a term's square that is left orthogonal to the others; below it is none


def candidate_terms(lags: int, constants: np.ndarray) -> np.ndarray:
    """Return all products of up to two factors; see `Narx`, shape [C, 2].

    A constant that does not vary between tests is no factor.
    """
    lagged = range(1, lags + 1)
    varied = [CONSTANT + number for number, column in enumerate(constants.T) if np.ptp(column) > 0]
    factors = [0, *lagged, *(-i for i in lagged), *varied]
    return np.array(list(combinations_with_replacement(factors, 2)), dtype=np.int64)


def order_of_terms(rows: np.ndarray, target: np.ndarray, most: int) -> list[int]:
    """Return the terms in the order of their error reduction ratio, each orthogonal to those before.

    Rows have shape [K, C]; fewer terms than asked for where all others depend on them.

    Source: Chen, Billings and Luo, Orthogonal least squares methods (1989).
    """
    left, remaining = rows.copy(), target.copy()
    squares = np.sum(rows**2, axis=0)
    order: list[int] = []
    for _ in range(most):
        energies = np.sum(left**2, axis=0)
        usable = energies > DEPENDENT * squares
        usable[order] = False
        if not usable.any():
            break
        reductions = np.where(usable, (remaining @ left) ** 2 / np.where(usable, energies, 1.0), -1.0)
        selected = int(np.argmax(reductions))
        order.append(selected)
        direction = left[:, selected] / np.sqrt(energies[selected])
        left -= np.outer(direction, direction @ left)
        remaining -= direction * (direction @ remaining)
    return order


# Free run of a polynomial model from many starts at once, with its derivative by the coefficients.


@dataclass(frozen=True)
class Sections:
    """Sections of tests, scaled, each preceded by its past; of S sections of N samples.

    Attributes:
        command: command of the past and of the section, shape [S, P + N].
        past: travel before the section, shape [S, P].
        constants: covariates and initial displacement, shape [S, C + 1].
        travel: measured travel of the section, shape [S, N].
        mask: samples that errors are taken over, shape [S, N].
    """

    command: np.ndarray
    past: np.ndarray
    constants: np.ndarray
    travel: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    mask: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))

    def regression(self, terms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return terms from measured travel at all samples of the mask, shape [K, M], and their travel."""
        history = np.concatenate([self.past, self.travel], axis=1)
        count, past = self.travel.shape[1], self.past.shape[1]
        travel, command = (
            np.stack([rows[:, past - i : past - i + count][self.mask] for i in range(1, past + 1)], axis=1)
            for rows in (history, self.command)
        )
        constants = np.repeat(self.constants, self.mask.sum(axis=1), axis=0)
        return products(terms, travel, command, constants), self.travel[self.mask]


def sections_of(
    batch: Batch, inputs: np.ndarray, travel: np.ndarray, *, past: int, longest: int, most: int
) -> Sections:
    """Return the sections of tests.

    Inputs have shape [T, 2 + C, N]; of more samples than `most`, about, every m-th section is returned.
    """
    ends = np.asarray(batch.valid).sum(axis=1)
    width = int(min(longest, ends.max()))
    pad = ((0, 0), (past, width))
    command, history = np.pad(inputs[:, 0], pad), np.pad(travel, pad)
    mask = np.pad(np.asarray(batch.loss_mask), ((0, 0), (0, width)))
    starts = [
        (test, first)
        for test, end in enumerate(ends)
        for first in range(0, end, width)
        if mask[test, first : first + width].any()
    ]
    starts = starts[:: max(1, -(-len(starts) * width // most))]
    return Sections(
        command=np.array([command[test, first : first + past + width] for test, first in starts]),
        past=np.array([history[test, first : first + past] for test, first in starts]),
        constants=np.array([inputs[test, 1:, 0] for test, _ in starts]),
        travel=np.array([history[test, first + past : first + past + width] for test, first in starts]),
        mask=np.array([mask[test, first : first + width] for test, first in starts]),
    )


def products(terms: np.ndarray, travel: np.ndarray, command: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """Return the terms of a polynomial, shape [S, M].

    Args:
        terms: factors of each term, shape [M, 2]; see `Narx`.
        travel, command: scaled, at k−1 … k−n, shape [S, n] each.
        constants: covariates and initial displacement, scaled, shape [S, C + 1].
    """
    signals = np.concatenate([np.ones((len(travel), 1)), travel, command, constants], axis=1)
    columns = _columns(terms, travel.shape[1])
    return signals[:, columns[:, 0]] * signals[:, columns[:, 1]]


def polynomial_run(
    terms: np.ndarray, coefficients: np.ndarray, sections: Sections, lags: int, *, derivative: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return travel simulated from measured pasts, and its derivative by the coefficients.

    A simulation that diverges becomes infinite or NaN, without a warning.

    Returns:
        Scaled travel, shape [S, N], and its derivative, shape [S, N, M], or [S, N, 0].
    """
    past = sections.past.shape[1]
    starts, count = len(sections.past), sections.command.shape[1] - past
    columns = _columns(terms, lags)
    signals = np.concatenate([np.ones((starts, 1)), np.zeros((starts, 2 * lags)), sections.constants], axis=1)
    travel = np.concatenate([sections.past, np.zeros((starts, count))], axis=1)
    sensitivities = np.zeros((starts, past + count, len(terms) if derivative else 0))
    selection = [np.eye(signals.shape[1])[column][:, 1 : lags + 1] for column in columns.T]
    with np.errstate(all="ignore"):
        for k in range(past, past + count):
            signals[:, 1 : lags + 1] = travel[:, k - lags : k][:, ::-1]
            signals[:, lags + 1 : 2 * lags + 1] = sections.command[:, k - lags : k][:, ::-1]
            first, second = signals[:, columns[:, 0]], signals[:, columns[:, 1]]
            values = first * second
            travel[:, k] = values @ coefficients
            if derivative:
                slopes = (coefficients * second) @ selection[0] + (coefficients * first) @ selection[1]
                recent = sensitivities[:, k - lags : k][:, ::-1]
                sensitivities[:, k] = values + (slopes[:, None, :] @ recent)[:, 0]
    return travel[:, past:], sensitivities[:, past:]


def _columns(terms: np.ndarray, lags: int) -> np.ndarray:
    """Return the columns, among 1, w(k−1) …, u(k−1) … and constants, that are the factors of terms."""
    constants = np.where(terms >= CONSTANT, 2 * lags + 1 + terms - CONSTANT, terms)
    return np.where(terms < 0, lags - terms, constants)


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

    def check(self, covariates: int) -> None:
        """Check scaling, scales and factors; see `FittedBaseline.check`."""
        self.scaling.check(covariates)
        known = (np.abs(self.terms) <= LAGS[-1]) | (
            (self.terms >= CONSTANT) & (self.terms <= CONSTANT + covariates)
        )
        if not 1 <= len(self.terms) <= TERMS[-1] or not known.all():
            raise ValueError(
                f"terms: got {len(self.terms)} with {int(np.sum(~known))} unknown factors, expected 1 to "
                f"{TERMS[-1]} of lags up to {LAGS[-1]} and constants"
            )
        if min(self.travel_scale, self.command_scale) <= 0:
            raise ValueError("travel_scale, command_scale: expected more than 0")

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
        return self._travels(inputs[None])[0]

    def free_run(self, batch: Batch) -> np.ndarray:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        return to_displacement(batch, self._travels(self.inputs(batch)))

    def _travels(self, inputs: np.ndarray) -> np.ndarray:
        """Return the travel of all tests at once, from rest, of inputs of shape [T, 2 + C, N]."""
        lag = self.lag
        commands = np.pad(inputs[:, 0], ((0, 0), (lag, 0)))
        sections = Sections(commands, np.zeros((len(inputs), lag)), inputs[:, 1:, 0])
        return self.travel_scale * polynomial_run(self.terms, self.coefficients, sections, lag)[0]


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
        one_step = np.linalg.lstsq(*everything.regression(terms), rcond=None)[0]
        coefficients = _refined(terms, one_step, everything)
        return Narx(scaling, terms, coefficients, *scales)

    def skeleton(self, shapes: Sizes) -> Narx:
        """Return a model of the stored number of terms, all arrays zero."""
        coefficients = np.zeros(shapes["coefficients"])
        terms = np.zeros((*coefficients.shape, 2), np.int64)
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
