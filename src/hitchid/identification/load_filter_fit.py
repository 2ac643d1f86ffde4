"""Parameters of the load filters of a channel and of those fitted without each fold, by likelihood."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.optimize import OptimizeResult, minimize

from hitchid.errors import FitError
from hitchid.identification.held_out import HeldOut, held_out_free_runs, within_a_second
from hitchid.model import Channel
from hitchid.model.load_filter import LoadFilter
from hitchid.structures import Batch
from hitchid.uncertainty.conformal import sensor_noise

# Horizons over which predictions are judged, samples; chosen. One step ahead alone the errors of a second
# hardly count, and of several causes of an error that of the shortest memory wins. The further ones are used
# where they are no further than a second: in 100 samples at 1 kHz a load is hardly distinguished from noise.
HORIZONS, FURTHER_HORIZONS = (1, 3, 10, 30, 100), (300, 1000)
MAX_TESTS = 48  # of more tests every m-th is used, which bounds the time; chosen
MAX_ORIGINS = 1_000  # samples of all tests from which predictions start, which bounds the time; chosen
MAX_EVALUATIONS, REFIT_EVALUATIONS = 100, 6  # of the likelihood; a refit starts at an optimum; chosen
# Of a test: longer ones are searched on a coarser clock, from whose optimum a refit on their own starts. An
# evaluation takes as long as the tests have samples, and a load that lasts needs no kilohertz; chosen.
SEARCH_SAMPLES = 2_048
TOLERANCE = 1e-5  # change of the mean log likelihood at which the search ends; chosen: far below its error
LOAD_SCATTER = 1  # index among the fields of a filter
RANGE = 1e4  # the parameters lie within this factor of their typical values; chosen
# Where the search starts: relative, s, samples; chosen. Of far less than a sample a time has no gradient.
TYPICAL_LOAD_SCATTER, TYPICAL_TIME_S, FEWEST_SAMPLES = 0.02, 0.1, 10
# Largest standard deviation of the load, relative. A load of one stops the piston or doubles its speed;
# without a limit, noise over the first samples of a stroke is taken for loads of 70.
MAX_LOAD_SCATTER = 1.0


class FilteredTests(NamedTuple):
    """What a filter is fitted to.

    Attributes:
        benchmark: displacement that the benchmark simulates from the commands alone, shape [N, T].
        displacement: measured displacement, shape [N, T].
        mask: samples that count, shape [N, T].
    """

    benchmark: Float[Array, "n t"]
    displacement: Float[Array, "n t"]
    mask: Bool[Array, "n t"]


def with_load_filters(
    channel: Channel, held_out: Sequence[HeldOut], batch: Batch
) -> tuple[Channel, tuple[HeldOut, ...]]:
    """Return a channel and those fitted without each fold, each with the filter of its own tests."""
    runs = held_out_free_runs(held_out, batch)
    load_filter = fit_load_filter(batch, runs)
    filtered = []
    for tests, fold in held_out:
        others = batch if tests.all() else batch.masked(jnp.asarray(~tests)[:, None])
        refitted = fit_load_filter(others, runs, load_filter)
        filtered.append(HeldOut(tests, replace(fold, load_filter=refitted)))
    return replace(channel, load_filter=load_filter), tuple(filtered)


def fit_load_filter(
    batch: Batch, benchmark: Float[np.ndarray, "t n"], first_guess: LoadFilter | None = None
) -> LoadFilter:
    """Return the filter of the largest likelihood of predictions 1 to 100 samples ahead, or up to a second.

    It has the smallest mean over the horizons of log S + ε²/S, with the errors ε of the predictions and their
    variances S. Of one sample ahead that is the likelihood of the tests (Schweppe 1965, Evaluation of
    likelihood functions for Gaussian signals), in which loads are integrated out; of several horizons it is a
    composite likelihood (Varin, Reid & Firth 2011, An overview of composite likelihood methods).
    Displacements are those of a benchmark fitted without the test, shape [T, N].

    Raises:
        FitError: what the benchmark simulates is not finite, or no likelihood is.
    """
    if not np.all(np.isfinite(benchmark)):
        raise FitError("the simulated displacement of a test is not finite")
    evaluations = MAX_EVALUATIONS if first_guess is None else REFIT_EVALUATIONS
    if first_guess is None and batch.command.shape[1] > SEARCH_SAMPLES:
        coarse = batch.decimate(SEARCH_SAMPLES)
        first_guess = fit_load_filter(coarse, benchmark[:, :: round(coarse.step_s / batch.step_s)])
    longest = int(np.asarray(batch.loss_mask).sum(axis=1).max())
    judged = (*HORIZONS, *within_a_second(FURTHER_HORIZONS, batch.step_s))
    horizons = tuple(horizon for horizon in judged if horizon < longest) or HORIZONS[:1]
    typical, tests = _typical_values(batch, benchmark), _filtered_tests(batch, benchmark)
    limit = float(np.log(RANGE))
    start = np.zeros(typical.size)
    if first_guess is not None:
        start = np.log(np.array(jax.tree.leaves(first_guess)) / typical)

    def objective(position: np.ndarray) -> tuple[float, np.ndarray]:
        gradient, value = _negative_log_likelihood(
            jnp.asarray(position), jnp.asarray(typical), tests, horizons, batch.step_s
        )
        return float(value), np.asarray(gradient)

    def search(max_load_scatter: float) -> OptimizeResult:
        upper = np.full(typical.size, limit)
        upper[LOAD_SCATTER] = np.log(max_load_scatter)
        return minimize(
            objective,
            np.clip(start, -limit, upper),
            jac=True,
            method="L-BFGS-B",
            bounds=[(-limit, each) for each in upper],
            options={"maxfun": evaluations, "ftol": TOLERANCE},
        )

    found, most = search(RANGE), MAX_LOAD_SCATTER / TYPICAL_LOAD_SCATTER
    # Only where it is needed: a limit changes the path of the search, and with it the optimum where it ends.
    if found.x[LOAD_SCATTER] > np.log(most):
        found = search(most)
    if not np.isfinite(found.fun):
        raise FitError("no parameters give a finite likelihood")
    return LoadFilter(*(jnp.asarray(value) for value in typical * np.exp(found.x)))


def _filtered_tests(batch: Batch, benchmark: np.ndarray) -> FilteredTests:
    """Return the tests; of more than `MAX_TESTS` those that count, thinned out."""
    tests = batch.loss_mask.shape[0]
    if tests > MAX_TESTS:
        counted = np.flatnonzero(np.asarray(batch.loss_mask).any(axis=1))
        used = counted[:: -(-counted.size // MAX_TESTS)]
        batch, benchmark = batch.take(used.tolist()), benchmark[used]
    padded = batch.pad_batch()
    rows = np.resize(benchmark, padded.displacement.shape)
    return FilteredTests(jnp.asarray(rows.T), padded.displacement.T, padded.loss_mask.T)


def _typical_values(batch: Batch, benchmark: np.ndarray) -> Float[np.ndarray, " p"]:
    """Return typical values of the parameters, in the order of the filter's fields; none is zero."""
    mask, displacement = np.asarray(batch.loss_mask), np.asarray(batch.displacement)
    counted = mask.any(axis=1)
    pairs = [
        (run[row], measured[row])
        for run, measured, row in zip(benchmark[counted], displacement[counted], mask[counted], strict=True)
    ]
    errors = [measured - run for run, measured in pairs]
    rms = float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) or 1.0
    distance = float(np.mean([np.abs(np.diff(run)).sum() for run, _ in pairs])) or 1.0
    duration_s = batch.step_s * float(np.mean([error.size for error in errors]))
    noise, time_s = max(sensor_noise(errors), 1e-3 * rms), max(TYPICAL_TIME_S, FEWEST_SAMPLES * batch.step_s)
    drift = 0.01 * rms / np.sqrt(duration_s)
    return np.array([noise, TYPICAL_LOAD_SCATTER, distance, 0.1 * rms, time_s, drift])


@eqx.filter_jit
def _negative_log_likelihood(
    position: Float[Array, " p"],
    typical: Float[Array, " p"],
    tests: FilteredTests,
    horizons: tuple[int, ...],
    step_s: float,
) -> tuple[Float[Array, " p"], Float[Array, ""]]:
    """Return gradient and value; six tangents forward cost less than one scan backward."""

    def value_twice(position: Array) -> tuple[Array, Array]:
        value = _mean_over_horizons(LoadFilter(*(typical * jnp.exp(position))), tests, horizons, step_s)
        return value, value

    return jax.jacfwd(value_twice, has_aux=True)(position)


def _mean_over_horizons(
    load_filter: LoadFilter, tests: FilteredTests, horizons: tuple[int, ...], step_s: float
) -> Float[Array, ""]:
    """Return half the mean of log S + ε²/S over horizons, and over predictions from every m-th sample."""
    count = tests.mask.shape[0]
    every = -(-tests.mask.size // MAX_ORIGINS)
    origins = np.arange(0, count - 1, every)
    _, estimates = load_filter.estimates(tests.benchmark, tests.displacement, step_s, every)
    ahead = origins + np.arange(1, max(horizons) + 1)[:, None]
    inside = np.minimum(ahead, count - 1)
    increments = tests.benchmark[inside] - tests.benchmark[np.minimum(ahead - 1, count - 1)]
    at_origins = jax.tree.map(lambda values: values[..., : origins.size, :], estimates)
    predicted, variance = load_filter.ahead(at_origins, increments, np.array(horizons), step_s)
    rows = np.array(horizons) - 1
    error = (tests.displacement - tests.benchmark)[inside[rows]] - predicted
    counted = tests.mask[inside[rows]] & (ahead[rows] < count)[..., None]
    terms = jnp.where(counted, jnp.log(variance) + error**2 / variance, 0.0)
    return 0.5 * jnp.mean(terms.sum(axis=(1, 2)) / jnp.maximum(counted.sum(axis=(1, 2)), 1))
