"""Training of the compensator for free run by least squares on whole free runs, and its judgement."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hitchid._support.checkpoints import DISABLED, Arrays, Checkpoints
from hitchid._support.metrics import better_on_held_out_tests
from hitchid._support.records import short_repr
from hitchid.estimation.least_squares import minimise
from hitchid.estimation.search_problem import NormalEquations
from hitchid.identification.held_out import HeldOut
from hitchid.model import Channel
from hitchid.networks.speed_compensator import SIGNALS, SpeedCompensator, SpeedNetworks, simulate_compensated
from hitchid.structures import Batch

# Result of the test of the compensator for free run on tests held out from its training.

FEWEST_TESTS = 3  # two to fit to and one to judge on, in turn


@short_repr
@dataclass(frozen=True)
class HoldoutTest:
    """Free runs of tests held out, with and without the compensator for free run.

    Attributes:
        accepted: whether the compensator becomes part of the model.
        benchmark, compensated: free-run RMSE of each test while it was held out, in the displacement's unit,
            shape [T]; empty where there were too few tests to hold any out.
    """

    accepted: bool
    benchmark: np.ndarray
    compensated: np.ndarray

    @property
    def log_ratio(self) -> tuple[float, float]:
        """Mean over tests of ln(RMSE with/RMSE without), and its standard error."""
        ratios = np.log(self.compensated / self.benchmark)
        return float(ratios.mean()), float(ratios.std(ddof=1) / np.sqrt(ratios.size))

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if not self.benchmark.size:
            return f"no network correction in free run: cross-validation needs {FEWEST_TESTS} tests"
        benchmark_rmse, compensated_rmse = (
            float(np.sqrt(np.mean(errors**2))) for errors in (self.benchmark, self.compensated)
        )
        better = int(np.sum(self.compensated < self.benchmark))
        figures = (
            f"cross-validation RMSE {benchmark_rmse:.4g} without the network correction, "
            f"{compensated_rmse:.4g} with it"
        )
        outcome = "network correction" if self.accepted else "no network correction"
        return f"{outcome} in free run: {figures}, smaller in {better} of {self.benchmark.size} tests"


SAMPLES = 512  # largest number of samples of a test in training; chosen for speed
LARGEST_WEIGHT = 8.0  # bound of a weight: a unit then switches within an eighth of its input's range; chosen
STEPS, TOLERANCE = 40, 1e-4  # least-squares positions, relative change of the cost at which to stop; chosen
SMALL_OUTPUT = 0.05  # spread of the initial output weights; chosen


@dataclass(frozen=True)
class SpeedCompensatorConfig:
    """Settings of the compensator for free run.

    Attributes:
        units: of each network.
        members: networks whose outputs are averaged.
        ridge: weight of the squared weights, as a share of the benchmark's squared error.
    """

    units: int = 4
    members: int = 2
    ridge: float = 0.1


class TrainedSpeedCompensator(NamedTuple):
    """A compensator for free run and its test on tests held out.

    Attributes:
        compensator: trained on all tests; None where it was not accepted.
        holdout_test: result of the test.
        held_out: channels fitted without each fold, with their compensator if it was accepted.
    """

    compensator: SpeedCompensator | None
    holdout_test: HoldoutTest
    held_out: tuple[HeldOut, ...]


def train_speed_compensator(
    channel: Channel,
    held_out: tuple[HeldOut, ...],
    batch: Batch,
    settings: SpeedCompensatorConfig,
    seed: int,
    checkpoints: Checkpoints = DISABLED,
) -> TrainedSpeedCompensator:
    """Train networks on free runs, and accept them if they improve the free runs of tests held out.

    For each fold, benchmark and all networks are fitted to the other tests; the mean of these networks, which
    is what ships, gives the free runs of the fold. It is accepted where these are better than those of the
    benchmark fitted to the same tests; see `better_on_held_out_tests`.
    """
    tests = batch.command.shape[0]
    if tests < FEWEST_TESTS:
        return TrainedSpeedCompensator(None, HoldoutTest(False, np.zeros(0), np.zeros(0)), held_out)

    def train(channel: Channel, tests: Bool[np.ndarray, " t"], name: str) -> Channel:
        trained = _trained(channel, batch, tests, settings, seed, checkpoints.child(name))
        return replace(channel, speed_compensator=trained)

    compensated = tuple(
        HeldOut(fold, train(fold_channel, ~fold, f"free run {number}"))
        for number, (fold, fold_channel) in enumerate(held_out)
    )
    benchmark_errors, errors = (_held_out_errors(channels, batch) for channels in (held_out, compensated))
    accepted = better_on_held_out_tests(errors, benchmark_errors)
    holdout_test = HoldoutTest(accepted, benchmark_errors, errors)
    if not holdout_test.accepted:
        return TrainedSpeedCompensator(None, holdout_test, held_out)
    shipped = train(channel, np.ones(tests, bool), "free run").speed_compensator
    return TrainedSpeedCompensator(shipped, holdout_test, compensated)


def _held_out_errors(held_out: Sequence[HeldOut], batch: Batch) -> Float[np.ndarray, " t"]:
    """Return the free-run error of each test by the channel fitted without it."""
    rmse = np.zeros(batch.command.shape[0])
    for tests, channel in held_out:
        errors = np.asarray(channel.simulate(batch)) - np.asarray(batch.displacement)
        for test in np.flatnonzero(tests):
            row = errors[test][np.asarray(batch.loss_mask[test])]
            rmse[test] = float(np.sqrt(np.mean(row**2))) if row.size else 0.0
    return rmse


class _FreeRuns(NamedTuple):
    """Free runs of the benchmark and what was measured, on a coarser clock; arrays of shape [T, N] or [T]."""

    benchmark: Float[Array, "t n"]
    command: Float[Array, "t n"]
    initial: Float[Array, " t"]
    load: Float[Array, "t c"]
    measured: Float[Array, "t n"]
    weight: Float[Array, "t n"]
    step_s: Float[Array, ""]

    @property
    def inputs(self) -> int:
        """Number of inputs of a network."""
        return SIGNALS + self.load.shape[1]

    @classmethod
    def of(cls, channel: Channel, batch: Batch, tests: Bool[np.ndarray, " t"]) -> "_FreeRuns":
        """Return the free runs of some tests, each of the same weight."""
        coarse = batch.decimate(SAMPLES)
        travel = channel.benchmark.travel(batch)[:, :: round(coarse.step_s / batch.step_s)]
        loss_mask = np.asarray(coarse.loss_mask) & tests[:, None]
        weight = loss_mask / np.maximum(loss_mask.sum(axis=1, keepdims=True), 1) / max(tests.sum(), 1)
        return cls(
            travel,
            coarse.command,
            coarse.initial,
            coarse.load(channel.benchmark.covariates),
            coarse.travel,
            jnp.asarray(weight),
            jnp.asarray(coarse.step_s),
        )


def _trained(
    channel: Channel,
    batch: Batch,
    tests: Bool[np.ndarray, " t"],
    settings: SpeedCompensatorConfig,
    seed: int,
    checkpoints: Checkpoints,
) -> SpeedCompensator:
    """Return the networks fitted to some tests; one whose least squares fails stays as it starts."""
    runs = _FreeRuns.of(channel, batch, tests)
    compensator = _untrained(channel, runs, settings)
    rng = np.random.default_rng(seed)
    initial_cost = float(jnp.sum(runs.weight * (runs.benchmark - runs.measured) ** 2))
    ridge = settings.ridge * max(initial_cost, np.finfo(float).tiny)

    shape = settings.members, (runs.inputs + 2) * settings.units

    def work() -> Arrays:
        # Weights and biases of spread one, and small output weights: the start is nearly the benchmark.
        starts = rng.standard_normal(shape)
        starts[:, -settings.units :] *= SMALL_OUTPUT
        starts = np.clip(starts, -LARGEST_WEIGHT, LARGEST_WEIGHT)
        return {"weights": np.stack([_fitted(compensator, runs, start, ridge) for start in starts])}

    weights = checkpoints.cached_arrays("weights", work, {"weights": shape})["weights"]
    return replace(compensator, networks=_networks(jnp.asarray(weights), settings.units))


def _fitted(
    compensator: SpeedCompensator, runs: _FreeRuns, start: np.ndarray, ridge: float
) -> Float[np.ndarray, " w"]:
    """Return the weights of one network that minimise its mean square error plus ρ ‖w‖²."""
    slope = 2 * LARGEST_WEIGHT

    def normal_equations(position: np.ndarray) -> NormalEquations:
        weights = slope * (position - 0.5)
        cost, gradient, curvature = map(np.asarray, _equations(compensator, runs, jnp.asarray(weights)))
        return NormalEquations(
            float(cost) + ridge * float(weights @ weights),
            slope * (gradient + ridge * weights),
            slope**2 * (curvature + ridge * np.eye(weights.size)),
        )

    minimum = minimise(normal_equations, start / slope + 0.5, limit=STEPS, tolerance=TOLERANCE)
    return start if minimum is None else slope * (minimum.position - 0.5)


@jax.jit
def _equations(
    compensator: SpeedCompensator, runs: _FreeRuns, weights: Float[Array, " w"]
) -> tuple[Float[Array, ""], Float[Array, " w"], Float[Array, "w w"]]:
    """Return the weighted squared error of a free run, to second order."""

    def errors(weights: Float[Array, " w"]) -> Float[Array, "t n"]:
        single = replace(compensator, networks=_networks(weights[None], compensator.networks.biases.shape[1]))
        travel = simulate_compensated(
            single, runs.benchmark, runs.command, runs.initial, runs.load, runs.step_s
        )
        return jnp.sqrt(runs.weight) * (travel - runs.measured)

    residuals, columns = jax.vmap(
        lambda tangent: jax.jvp(errors, (weights,), (tangent,)), out_axes=(None, 0)
    )(jnp.eye(weights.size))
    rows = columns.reshape(weights.size, -1)
    return jnp.sum(residuals**2), rows @ residuals.ravel(), rows @ rows.T


def _networks(weights: Float[Array, "m w"], units: int) -> SpeedNetworks:
    """Return networks of so many units from their weights in rows: W, b, v."""
    return SpeedNetworks(
        weights[:, : -2 * units].reshape(weights.shape[0], units, -1),
        weights[:, -2 * units : -units],
        weights[:, -units:],
    )


def _untrained(channel: Channel, runs: _FreeRuns, settings: SpeedCompensatorConfig) -> SpeedCompensator:
    """Return a compensator with the scales of the tests, its networks zero."""
    counts = np.asarray(runs.weight) > 0
    speed = np.gradient(np.asarray(runs.benchmark), float(runs.step_s), axis=1)
    acceleration = np.gradient(speed, float(runs.step_s), axis=1)

    def rms(rows: np.ndarray) -> Array:
        return jnp.asarray(float(np.sqrt(np.mean(rows[counts] ** 2))) or 1.0)

    return SpeedCompensator(
        networks=_networks(jnp.zeros((settings.members, (runs.inputs + 2) * settings.units)), settings.units),
        command_scale=jnp.asarray(float(np.abs(np.asarray(runs.command)[counts]).max()) or 1.0),
        speed_scale=rms(speed),
        acceleration_scale=rms(acceleration),
        operating_range=channel.operating_range,
        sign=channel.sign,
    )
