"""Linear output-error model (OE), fitted to free runs."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product

import numpy as np
from jaxtyping import Float

from hitchid.baselines.baseline import Baseline, FitContext, FittedBaseline, Sizes
from hitchid.baselines.linear import (
    MAX_STEP_SAMPLES,
    Arx,
    LinearInputs,
    UnpaddedTest,
    free_run_error,
    to_displacement,
    unpadded_tests,
)
from hitchid.structures import Batch, split_validation

# Least squares on errors of free runs: the refinement of the parameters of a simulation.

ITERATIONS = 25  # of Levenberg and Marquardt; most fits end earlier by TOLERANCE; chosen
TOLERANCE = 1e-4  # relative decrease of the sum of squares below which a fit has ended; chosen
INITIAL_DAMPING, LESS, MORE, MAX_DAMPING = 1e-3, 0.2, 5.0, 1e8  # of Levenberg and Marquardt: common values

# Parameters to residuals, shape [R], and their derivative, shape [R, P].
Residuals = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def refine(parameters: np.ndarray, residuals: Residuals) -> np.ndarray:
    """Return parameters with a smaller sum of squared residuals; the same where they do not converge.

    Levenberg and Marquardt's method, scaled by the derivative. A start whose simulation diverges is returned
    as it is, a step to parameters whose simulation diverges is not taken.
    """
    damping = INITIAL_DAMPING
    with np.errstate(all="ignore"):
        errors, derivative = residuals(parameters)
        cost = errors @ errors
        if not (np.isfinite(cost) and np.all(np.isfinite(derivative))):
            return parameters
        for _ in range(ITERATIONS):
            step = _step(errors, derivative, damping)
            new_errors, new_derivative = residuals(parameters + step)
            new_cost = new_errors @ new_errors
            if np.isfinite(new_cost) and np.all(np.isfinite(new_derivative)) and new_cost < cost:
                decrease = (cost - new_cost) / cost
                parameters, errors, derivative, cost = parameters + step, new_errors, new_derivative, new_cost
                damping *= LESS
                if decrease < TOLERANCE:
                    break
            else:
                damping *= MORE
                if damping > MAX_DAMPING:
                    break
    return parameters


def _step(errors: np.ndarray, derivative: np.ndarray, damping: float) -> np.ndarray:
    """Return the damped step; a parameter without influence stays."""
    norms = np.linalg.norm(derivative, axis=0)
    scaled = derivative / np.where(norms > 0, norms, 1.0)
    normal = scaled.T @ scaled + damping * np.eye(norms.size)
    return -np.linalg.solve(normal, scaled.T @ errors) / np.where(norms > 0, norms, 1.0)


ORDERS, DELAYS = (1, 2, 3, 4), (0, 2, 5)  # orders n, further delays d in samples, that are compared; chosen
FILTERED_FITS = 3  # of Steiglitz and McBride; most of their gain comes from the first; chosen
REFINED = 3  # choices that are refined before the last choice; chosen, it bounds the time
MAX_SAMPLES = 2048  # of a test; a longer one is computed on a coarser clock; chosen


class OutputError(FittedBaseline):
    """Linear model of travel w (displacement relative to the start), with errors at its output only.

    w(k) = Σ aᵢ w(k−i) + Σⱼ Σ bⱼᵢ uⱼ(k−d−i), i = 1 … n; w is simulated, never measured.

    Attributes:
        scaling: the inputs u.
        past: coefficients a of past simulated travel, shape [n].
        gains: coefficients b of past inputs, shape [m, n].
        delay: d, in steps, shape [].
        samples: samples in a step, over which inputs are averaged, shape [].
    """

    scaling: LinearInputs
    past: np.ndarray
    gains: np.ndarray
    delay: np.ndarray
    samples: np.ndarray

    def check(self, covariates: int) -> None:
        """Check scaling, order, inputs, delay and step; see `FittedBaseline.check`."""
        Arx(self.scaling, self.past, self.gains).check(covariates)
        if not (0 <= self.delay <= DELAYS[-1] and 1 <= self.samples <= MAX_STEP_SAMPLES):
            raise ValueError(
                f"got a delay of {self.delay} steps of {self.samples} samples, expected 0 to {DELAYS[-1]} "
                f"steps of 1 to {MAX_STEP_SAMPLES} samples"
            )

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        count, step = batch.command.shape[1], int(self.samples)
        coarse = batch.decimate(-(-count // step))
        times, ends = np.arange(count), step * np.arange(coarse.command.shape[1])
        model = Arx(self.scaling, self.past, self.gains)
        inputs = _delayed(self.scaling.rows(coarse, len(self.gains)), int(self.delay))
        return to_displacement(
            batch, np.array([np.interp(times, ends, model.simulate(row)) for row in inputs])
        )

    def predict(self, batch: Batch, horizons: Sequence[int]) -> None:
        """Return None: the model only simulates; it takes no measured displacement after the start."""


class OutputErrorBaseline(Baseline):
    """OE model with order, delay and inputs of the smallest error in free run on the validation tests."""

    name, title = "oe", "OE"

    def fit(self, tests: Batch, context: FitContext) -> OutputError:
        """Return the model that minimises the error of free runs.

        It starts from ARX, refitted to filtered signals (Steiglitz and McBride 1965). The three choices with
        the smallest error in free run are refined by least squares on errors of free runs (Ljung, System
        Identification (1999), section 4.2); a refinement that diverges leaves the start.
        """
        step = -(-tests.command.shape[1] // MAX_SAMPLES)
        coarse = tests.decimate(MAX_SAMPLES)
        scaling = LinearInputs.of(tests)
        training, validation, _ = split_validation(coarse)

        def prepared(batch: Batch, delay: int, count: int) -> list[UnpaddedTest]:
            return unpadded_tests(batch, _delayed(scaling.rows(batch, count), delay))

        def error(fit: Fit, choice: tuple[int, int, int]) -> float:
            order, delay, count = choice
            model = fit(scaling, prepared(training, delay, count), order)
            return free_run_error(model, prepared(validation, delay, count))

        choices = sorted(product(ORDERS, DELAYS, scaling.counts), key=partial(error, _filtered_fit))
        order, delay, count = min(choices[:REFINED], key=partial(error, _refined_fit))
        model = _refined_fit(scaling, prepared(coarse, delay, count), order)
        return OutputError(scaling, model.past, model.gains, np.asarray(delay), np.asarray(step))

    def skeleton(self, shapes: Sizes) -> OutputError:
        """Return a model of the stored order, all coefficients zero."""
        return OutputError(
            LinearInputs.unfilled(*shapes["scaling/load_centre"]),
            np.zeros(shapes["past"]),
            np.zeros((shapes["gains"][0], *shapes["past"])),
            np.zeros((), np.int64),
            np.ones((), np.int64),
        )


Fit = Callable[[LinearInputs, Sequence[UnpaddedTest], int], Arx]


def _filtered_fit(scaling: LinearInputs, tests: Sequence[UnpaddedTest], order: int) -> Arx:
    """Return the best in free run of ARX and its refits to filtered signals."""
    models = [Arx.fit(scaling, tests, order)]
    with np.errstate(all="ignore"):
        for _ in range(FILTERED_FITS):
            filtered = [_filtered(test, models[-1].past) for test in tests]
            if not all(np.all(np.isfinite(test.travel)) for test in filtered):
                break
            models.append(Arx.fit(scaling, filtered, order))
    return min(models, key=lambda model: free_run_error(model, tests))


def _refined_fit(scaling: LinearInputs, tests: Sequence[UnpaddedTest], order: int) -> Arx:
    """Return the model with the smallest error in free run that least squares finds."""
    start = _filtered_fit(scaling, tests, order)
    shape = start.gains.shape

    def model_of(parameters: np.ndarray) -> Arx:
        return Arx(scaling, parameters[:order], parameters[order:].reshape(shape))

    def residuals(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = [_errors(model_of(parameters), test) for test in tests]
        return np.concatenate([errors for errors, _ in parts]), np.concatenate([rows for _, rows in parts])

    return model_of(refine(np.concatenate([start.past, start.gains.ravel()]), residuals))


def _filtered(test: UnpaddedTest, past: np.ndarray) -> UnpaddedTest:
    """Return a test with all signals through 1/A, which turns ARX errors into output errors."""
    from scipy.signal import lfilter

    denominator = np.append(1.0, -past)
    inputs = np.asarray(lfilter([1.0], denominator, test.inputs, axis=1))
    return UnpaddedTest(inputs, np.asarray(lfilter([1.0], denominator, test.travel)), test.loss_mask)


def _errors(model: Arx, test: UnpaddedTest) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of a free run and their derivative by the coefficients, over the loss mask."""
    from scipy.signal import lfilter

    simulated = model.simulate(test.inputs)
    signals = np.stack([simulated, *test.inputs])
    # ∂w(k)/∂aᵢ = w(k−i)/A and ∂w(k)/∂bⱼᵢ = uⱼ(k−i)/A: each a delay of one filtered signal.
    filtered = np.asarray(lfilter([1.0], np.append(1.0, -model.past), signals, axis=1))
    derivative = np.concatenate(
        [_delayed(filtered[:, None, :], i)[:, 0, :, None] for i in range(1, model.lag + 1)], axis=2
    )
    rows = np.moveaxis(derivative, 1, 0).reshape(simulated.size, -1)
    return (simulated - test.travel)[test.loss_mask], rows[test.loss_mask]


def _delayed(rows: np.ndarray, steps: int) -> np.ndarray:
    """Return signals of shape [T, m, N] delayed, zero before."""
    return np.pad(rows, ((0, 0), (0, 0), (steps, 0)))[:, :, : rows.shape[2]]
