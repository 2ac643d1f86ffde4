"""Linear autoregression with inputs (ARX)."""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from itertools import product
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from hitchid.baselines.baseline import Baseline, FitContext, FittedBaseline, Sizes
from hitchid.structures import Batch, split_validation

# Inputs of the linear baselines, and their tests without padding.

# Samples in a step of a stored baseline; chosen: tests of days at 100 Hz have fewer.
MAX_STEP_SAMPLES = 100_000


class LinearInputs(eqx.Module):
    """Inputs of a linear model of travel: command, command times each covariate, 1, initial displacement.

    A covariate multiplies the command, for without one it moves nothing; there is one of zeros where none is
    measured.

    Attributes:
        load_centre, load_scale: scaling of the covariates before motion, shape [C].
        initial_centre, initial_scale: scaling of the initial displacement, shape [].
    """

    load_centre: np.ndarray
    load_scale: np.ndarray
    initial_centre: np.ndarray
    initial_scale: np.ndarray

    @classmethod
    def of(cls, batch: Batch) -> "LinearInputs":
        """Return the inputs scaled to tests."""
        initial = np.asarray(batch.initial)
        scaling = *covariate_scaling(batch), initial.mean(), initial.std() or 1.0
        return cls(*map(np.asarray, scaling))

    @classmethod
    def unfilled(cls, covariates: int) -> "LinearInputs":
        """Return inputs whose scaling is zero, to be filled with the stored one."""
        return cls(*(np.zeros(shape) for shape in ((covariates,), (covariates,), (), ())))

    def constants(self, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
        """Return covariates and initial displacement of each test, scaled, shapes [T, C] and [T]."""
        load = (covariates_of(batch) - self.load_centre) / self.load_scale
        return load, (np.asarray(batch.initial) - self.initial_centre) / self.initial_scale

    def check(self, covariates: int) -> None:
        """Check the scaling; raises ValueError unless it is of so many covariates and divides by no zero."""
        scales = np.append(self.load_scale, self.initial_scale)
        if len(self.load_scale) != covariates or np.min(scales) <= 0:
            raise ValueError(
                f"scaling: got {len(self.load_scale)} covariates and {np.min(scales):g} as smallest scale; "
                f"expected {covariates} and more than 0"
            )

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of inputs that are compared: the command alone and with the covariates, and all."""
        return 1 + self.load_centre.size, 3 + self.load_centre.size

    def rows(self, batch: Batch, count: int) -> np.ndarray:
        """Return the first inputs of each test, shape [T, count, N]."""
        command = np.asarray(batch.command)
        load, initial = self.constants(batch)
        inputs = (
            command,
            *(column[:, None] * command for column in load.T),
            np.ones_like(command),
            np.broadcast_to(initial[:, None], command.shape),
        )
        return np.stack(inputs[:count], axis=1)


def covariates_of(batch: Batch) -> np.ndarray:
    """Return the covariates of each test, one of zeros where there is none, shape [T, C]."""
    return np.asarray(batch.load(batch.covariate_names))


def covariate_scaling(batch: Batch) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of each covariate, one where it does not vary, shape [C] each."""
    loads = covariates_of(batch)
    spread = loads.std(axis=0)
    return loads.mean(axis=0), np.where(spread > 0, spread, 1.0)


class UnpaddedTest(NamedTuple):
    """One test from rest, unpadded: inputs, shape [m, N], travel and the samples that count, shape [N]."""

    inputs: np.ndarray
    travel: np.ndarray
    loss_mask: np.ndarray


def unpadded_tests(batch: Batch, inputs: np.ndarray) -> list[UnpaddedTest]:
    """Return each test without padding; inputs of shape [T, m, N]."""
    rows = zip(inputs, batch.travel, batch.loss_mask, np.asarray(batch.valid), strict=True)
    return [
        UnpaddedTest(u[:, valid], np.asarray(w)[valid], np.asarray(mask)[valid]) for u, w, mask, valid in rows
    ]


def free_run_error(model: "Autoregression", tests: Iterable[UnpaddedTest]) -> float:
    """Return the sum of squared errors of free runs, infinite where one diverged."""
    total = 0.0
    with np.errstate(all="ignore"):
        for test in tests:
            total += float(np.sum((model.simulate(test.inputs) - test.travel)[test.loss_mask] ** 2))
    return total if np.isfinite(total) else np.inf


# Autoregressive models of travel: free run and multi-step prediction.


class Autoregression(FittedBaseline):
    """A model of travel w (displacement relative to the start) from past samples of w and of inputs."""

    @property
    @abstractmethod
    def lag(self) -> int:
        """Largest lag n, in samples."""

    @abstractmethod
    def inputs(self, batch: Batch) -> np.ndarray:
        """Return the inputs of tests, shape [T, m, N]."""

    @abstractmethod
    def predict_next(self, inputs: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n), shape [m, n, N], and w(k−1) … w(k−n), shape [n, N]."""

    @abstractmethod
    def simulate(self, inputs: np.ndarray) -> np.ndarray:
        """Return travel simulated from inputs of shape [m, N] alone, from rest, shape [N]."""

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        return to_displacement(batch, np.array([self.simulate(inputs) for inputs in self.inputs(batch)]))

    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]]:
        """Return the h-step-ahead predictions of displacement, for each h, shape [T, N] each."""
        travels = batch.sign * (np.asarray(batch.displacement) - np.asarray(batch.initial)[:, None])
        rows = [
            predict_ahead(self, inputs, travel, horizons)
            for inputs, travel in zip(self.inputs(batch), travels, strict=True)
        ]
        return [to_displacement(batch, travel) for travel in np.swapaxes(rows, 0, 1)]


def predict_ahead(
    model: Autoregression, inputs: np.ndarray, travel: np.ndarray, horizons: Sequence[int]
) -> np.ndarray:
    """Return h-step-ahead predictions of travel, zero for the first h samples.

    Of one test that starts from rest, inputs of shape [m, N]; iterated from all samples at once.

    Returns:
        Predictions, shape [len(horizons), N].
    """
    lag, count, farthest = model.lag, travel.size, max(horizons)
    past = np.concatenate([np.zeros(lag), travel])
    padded = np.pad(inputs, ((0, 0), (lag, farthest)))
    history = [past[lag - i : lag - i + count] for i in range(lag)]
    predictions = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(1, farthest + 1):
            lagged = [padded[:, lag + step - i : lag + step - i + count] for i in range(1, lag + 1)]
            history = [model.predict_next(np.stack(lagged, axis=1), np.stack(history)), *history[: lag - 1]]
            predictions[step] = history[0]
    return np.stack([np.concatenate([np.zeros(h), predictions[h][: count - h]]) for h in horizons])


def to_displacement(batch: Batch, travel: np.ndarray) -> np.ndarray:
    """Return the displacement that belongs to a travel, shape [T, N]."""
    return np.asarray(batch.initial)[:, None] + batch.sign * travel


ORDERS = (1, 2, 3, 5, 8, 12, 20)  # orders n that are compared, in samples; 20 are 0.2 s at 100 Hz; chosen


class Arx(Autoregression):
    """ARX model of travel w (displacement relative to the start).

    w(k) = Σ aᵢ w(k−i) + Σⱼ Σ bⱼᵢ uⱼ(k−i), i = 1 … n.

    Attributes:
        scaling: the inputs u.
        past: coefficients a of past travel, shape [n].
        gains: coefficients b of past inputs, shape [m, n].
    """

    scaling: LinearInputs
    past: np.ndarray
    gains: np.ndarray

    @classmethod
    def fit(cls, scaling: LinearInputs, tests: Sequence[UnpaddedTest], order: int) -> "Arx":
        """Fit by least squares one step ahead to tests that start from rest."""
        return _solved(scaling, _triangular_factor(tests, order), order, order, len(tests[0].inputs))

    def check(self, covariates: int) -> None:
        """Check the scaling, the order and the number of inputs; see `FittedBaseline.check`."""
        self.scaling.check(covariates)
        if self.lag not in range(1, ORDERS[-1] + 1) or len(self.gains) not in self.scaling.counts:
            raise ValueError(
                f"got {len(self.gains)} inputs of order {self.lag}, expected {self.scaling.counts} inputs of "
                f"order 1 to {ORDERS[-1]}"
            )

    @property
    def lag(self) -> int:
        """Largest lag n, in samples."""
        return self.past.size

    def inputs(self, batch: Batch) -> np.ndarray:
        """Return the inputs of tests, shape [T, m, N]."""
        return self.scaling.rows(batch, len(self.gains))

    def predict_next(self, inputs: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n), shape [m, n, N], and w(k−1) … w(k−n), shape [n, N]."""
        return np.einsum("mn,mnk->k", self.gains, inputs) + self.past @ travel

    def simulate(self, inputs: np.ndarray) -> np.ndarray:
        """Return travel simulated from inputs of shape [m, N] alone, from rest, shape [N]."""
        from scipy.signal import lfilter  # imported here: the import takes half a second

        driven = [
            np.asarray(lfilter(np.append(0.0, gains), [1.0], row))
            for gains, row in zip(self.gains, inputs, strict=True)
        ]
        return np.asarray(lfilter([1.0], np.append(1.0, -self.past), np.sum(driven, axis=0)))


class ArxBaseline(Baseline):
    """ARX with the order and inputs of the smallest error in free run on the validation tests."""

    name, title, quick = "arx", "ARX", True

    def fit(self, tests: Batch, context: FitContext) -> Arx:
        """Return the ARX model: order and inputs by free run, coefficients one step ahead on all tests."""
        scaling = LinearInputs.of(tests)
        training, validation, _ = split_validation(tests)
        largest = max(scaling.counts)

        def error(model: Arx) -> float:
            return free_run_error(model, unpadded_tests(validation, model.inputs(validation)))

        def factor(batch: Batch) -> Float[np.ndarray, "r c"]:
            return _triangular_factor(unpadded_tests(batch, scaling.rows(batch, largest)), max(ORDERS))

        of_training = factor(training)
        models = [
            _solved(scaling, of_training, max(ORDERS), *choice) for choice in product(ORDERS, scaling.counts)
        ]
        best = min(models, key=error)
        return _solved(scaling, factor(tests), max(ORDERS), best.lag, len(best.gains))

    def skeleton(self, shapes: Sizes) -> Arx:
        """Return a model of the stored order, all coefficients zero."""
        return Arx(
            LinearInputs.unfilled(*shapes["scaling/load_centre"]),
            np.zeros(shapes["past"]),
            np.zeros((shapes["gains"][0], *shapes["past"])),
        )


def _triangular_factor(tests: Iterable[UnpaddedTest], max_order: int) -> Float[np.ndarray, "r c"]:
    """Return R of the QR factors of all equations with their right side as last column.

    Least squares of every smaller order and number of inputs are those of some of its columns: the tests are
    read once for all of them. Columns are lags 1 … n of travel, then of each input.
    """
    factor = np.zeros((0, 0))
    for test in tests:
        rows = np.column_stack([_lagged(test, max_order), test.travel])[test.loss_mask]
        factor = np.asarray(np.linalg.qr(np.vstack([factor, rows]) if factor.size else rows, mode="r"))
    return factor


def _solved(
    scaling: LinearInputs, factor: Float[np.ndarray, "r c"], max_order: int, order: int, inputs: int
) -> Arx:
    """Return the ARX model of an order with the first inputs, fitted one step ahead."""
    first_lags = max_order * np.arange(1 + inputs)[:, None] + np.arange(order)
    solution = np.linalg.lstsq(factor[:, first_lags.ravel()], factor[:, -1], rcond=None)[0]
    return Arx(scaling, solution[:order], solution[order:].reshape(-1, order))


def _lagged(test: UnpaddedTest, order: int) -> np.ndarray:
    """Return rows [w(k−1) … w(k−n), u₁(k−1) … u₁(k−n), …], zero before the test, shape [N, (m + 1) n]."""

    def lags(samples: np.ndarray) -> np.ndarray:
        padded = np.concatenate([np.zeros(order), samples[:-1]])
        return np.lib.stride_tricks.sliding_window_view(padded, order)[:, ::-1]

    return np.hstack([lags(row) for row in (test.travel, *test.inputs)])
