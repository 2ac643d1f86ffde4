"""Compensators for predictions trained without each fold of tests, for what is calibrated on the fold."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, PRNGKeyArray, PyTree

from hitchid._support.numbers import count
from hitchid.errors import FitError
from hitchid.estimation.training import every_nth, optimiser, pad_to_batches
from hitchid.identification.held_out import (
    HeldOut,
    calibrated_horizons,
    held_out_errors,
    held_out_free_runs,
    rows_of_tests,
    with_position,
)
from hitchid.identification.phase1 import Phase1
from hitchid.identification.phase2 import (
    MAX_STRETCHES,
    CompensatorConfig,
    Sequences,
    squared_error,
    untrained_compensator,
)
from hitchid.model import Channel
from hitchid.model.bands import Bands, EnsembleMember, free_run_half_width
from hitchid.model.free_run import ensemble_deviations
from hitchid.networks.error_compensator import MAX_HORIZON
from hitchid.networks.lstm import Lstm
from hitchid.structures import Batch
from hitchid.uncertainty.conformal import (
    LEVELS,
    HeldOutErrors,
    fewest_tests,
    growing_quantiles,
    prediction_spread,
    sensor_noise,
)

# How far ahead a compensator for predictions corrects: so far that it does not diverge on tests held out.

STATED_LEVEL = 0.9  # of the bands that reports state
MAX_HORIZONS = (MAX_HORIZON, 50, 20, 10, 5, 2, 1)  # that are tried, in samples; chosen
# A compensator whose error is larger than so many times that without it diverges; chosen: trained on three
# quarters of the tests it may be a fifth worse, and one that diverges is worse by any factor.
DIVERGED = 2.0


class JudgedCompensator(NamedTuple):
    """A compensator for predictions, with the horizon up to which it corrects.

    Attributes:
        channel: with the compensator; without it where it diverges from the first sample on.
        held_out: the same for the channels fitted without each fold.
        errors: horizon to the errors of predictions of held-out tests; None where they are not known.
        notices: what was found; none where it corrects all horizons it may.
    """

    channel: Channel
    held_out: tuple[HeldOut, ...]
    errors: Mapping[int, HeldOutErrors] | None
    notices: tuple[str, ...]


def judge_compensator(channel: Channel, held_out: Sequence[HeldOut], batch: Batch) -> JudgedCompensator:
    """Return a channel whose compensator corrects only so far ahead that predictions do not diverge.

    Farther ahead than a sample a compensator reads its own output, for which it was not trained: its error
    may grow from sample to sample. It gets the largest horizon with which no root mean square error, up to
    100 samples or a second ahead, is more than twice that of the load filter alone.
    """
    horizons = calibrated_horizons(batch.step_s)
    uncorrected = held_out_errors(_all_up_to(held_out, 0), batch, horizons)
    reason = ""
    for max_horizon in MAX_HORIZONS:
        limited = _all_up_to(held_out, max_horizon)
        errors = held_out_errors(limited, batch, horizons)
        diverged = diverging(errors, uncorrected)
        if diverged is None:
            break
        reason = (
            f"else the RMSE of held-out tests {count(diverged, 'sample')} ahead is "
            f"{_rmse(errors[diverged]):.3g}, and {_rmse(uncorrected[diverged]):.3g} without it"
        )
    else:
        max_horizon, limited, errors = 0, _all_up_to(held_out, 0), uncorrected
    reach = f"corrects up to {count(max_horizon, 'sample')} ahead" if max_horizon else "is not used"
    notices = (f"the compensator for predictions {reach}; {reason}",) if reason else ()
    return JudgedCompensator(_up_to(channel, max_horizon), limited, errors, notices)


def diverging(errors: Mapping[int, HeldOutErrors], uncorrected: Mapping[int, HeldOutErrors]) -> int | None:
    """Return the first horizon at which errors exceed twice those without a correction; None for none."""
    # An error that is not finite is larger than any.
    return next((h for h in errors if not _rmse(errors[h]) <= DIVERGED * _rmse(uncorrected[h])), None)


def _rmse(errors: HeldOutErrors) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean(np.concatenate(errors.errors) ** 2)))


def _all_up_to(held_out: Iterable[HeldOut], max_horizon: int) -> tuple[HeldOut, ...]:
    return tuple(HeldOut(tests, _up_to(channel, max_horizon)) for tests, channel in held_out)


def _up_to(channel: Channel, max_horizon: int) -> Channel:
    """Return a channel whose compensator corrects up to a horizon; without it for 0."""
    compensator = channel.compensator
    if compensator is None or max_horizon == 0:
        return replace(channel, compensator=None)
    return replace(channel, compensator=replace(compensator, max_horizon=max_horizon))


# Prediction bands of a channel, calibrated by cross-fitting on all identification tests.

FEWEST_TESTS = 3  # chosen: fewer held-out errors give no usable quantile
MAX_STEP = 0.25  # largest deviation of an ensemble member, share of the range between bounds; chosen
VARIANCE_SHARE = 0.99  # share of the ensemble's variance that the selected members explain; chosen


def calibrate_bands(
    channel: Channel,
    phase1: Phase1,
    batch: Batch,
    held_out: Sequence[HeldOut],
    predicted: Mapping[int, HeldOutErrors] | None = None,
) -> Bands:
    """Return the prediction bands of a channel.

    Each test is predicted by the channel that was fitted without it, in free run and over all horizons
    (cross-fitting; with the tests as groups that of CV+, Barber et al. 2021, around the channel's own
    prediction). The errors, divided by the spread, give the factors of the bands.
    Errors of predictions are computed where they are not given.

    Raises:
        FitError: the bands say nothing: around a free run they are wider than the range of displacement.
    """
    tests = batch.command.shape[0]
    ensemble, spreads = _selected_ensemble(channel, phase1, batch)
    errors = np.asarray(batch.displacement) - held_out_free_runs(held_out, batch)
    loss_mask = np.asarray(batch.loss_mask)
    residuals, spread_by_test = rows_of_tests(errors, loss_mask), rows_of_tests(spreads, loss_mask)
    noise = sensor_noise(residuals)
    if predicted is None:
        predicted = held_out_errors(held_out, batch, calibrated_horizons(batch.step_s))
    bands = Bands(
        ensemble=ensemble,
        noise=noise,
        levels=LEVELS,
        free_run=growing_quantiles(residuals, spread_by_test, noise),
        predictions=prediction_spread(predicted, noise),
        tests=(tests, tests),
    )
    width = 2 * float(np.mean(free_run_half_width([bands], [spreads], STATED_LEVEL)[loss_mask]))
    extent = float(np.ptp(np.asarray(batch.displacement)[loss_mask]))
    if not width <= extent:
        raise FitError(
            f"no band can be given: of {100 * STATED_LEVEL:g} % it would be {width:.3g} wide on average, and "
            f"the displacement has a range of {extent:.3g}; measure more tests"
        )
    return bands


def band_notices(tests: int) -> list[str]:
    """Return sentences on the levels for which there are too few tests."""
    if tests < FEWEST_TESTS:
        return [f"no bands around predictions: they require {FEWEST_TESTS} tests, there are {tests}"]
    wanting = [level for level in LEVELS if tests < fewest_tests(level)]
    if not wanting:
        return []
    levels = " and ".join(f"{100 * level:g} % ({fewest_tests(level)} tests)" for level in wanting)
    return [
        f"{tests} tests are too few to calibrate bands for {levels}: they are at least so wide that they "
        "contain that share of each held-out test"
    ]


def _selected_ensemble(
    channel: Channel, phase1: Phase1, batch: Batch
) -> tuple[tuple[EnsembleMember, ...], np.ndarray]:
    """Return the members that explain nearly all of the ensemble's variance, and their spread, [T, N]."""
    ensemble = _ensemble(channel, phase1)
    _, deviations = ensemble_deviations(channel, ensemble, batch)
    mean_squares = np.mean(deviations[:, np.asarray(batch.loss_mask)] ** 2, axis=1)
    # A member whose free run diverges gives no width to a band.
    mean_squares = np.where(np.isfinite(mean_squares), mean_squares, 0.0)
    order = np.argsort(mean_squares)[::-1]
    count = 1 + int(np.searchsorted(np.cumsum(mean_squares[order]), VARIANCE_SHARE * mean_squares.sum()))
    selected = np.sort(order[:count])
    spread = np.sqrt(np.sum(deviations[selected] ** 2, axis=0))
    return tuple(ensemble[number] for number in selected), spread


def _ensemble(channel: Channel, phase1: Phase1) -> list[EnsembleMember]:
    """Return the ensemble: one standard error along each principal axis, and each single network.

    A member deviates by at most a quarter of the range between bounds and lies within the bounds.
    """
    influence, position = phase1.influence, phase1.fit.position

    def vector_at(position: np.ndarray) -> tuple[float, ...]:
        return tuple(map(float, with_position(channel, phase1, position).benchmark.parameter_vector))

    sizes, axes = np.linalg.eigh(influence.covariance)
    ensemble = []
    for size, axis in zip(np.sqrt(np.maximum(sizes, 0.0)), axes.T, strict=True):
        step = size * axis
        step *= min(1.0, MAX_STEP / max(float(np.abs(step).max()), MAX_STEP))
        shifted = position + step if np.all(np.abs(position + step - 0.5) <= 0.5) else position - step
        ensemble.append(EnsembleMember(vector_at(np.clip(shifted, 0.0, 1.0))))
    if channel.speed_compensator is not None:
        members = channel.speed_compensator.members
        parameter_vector = tuple(map(float, channel.benchmark.parameter_vector))
        ensemble += [
            EnsembleMember(parameter_vector, member, 1 / np.sqrt(max(members - 1, 1)))
            for member in range(members)
        ]
    return ensemble


Tree = TypeVar("Tree")


class CompensatorTraining(NamedTuple):
    """How the compensator for predictions of a channel was trained.

    `epochs` is the number after which its weights were kept, `key` of initial weights and shuffling.
    """

    settings: CompensatorConfig
    epochs: int
    key: PRNGKeyArray


def with_compensators(
    held_out: Sequence[HeldOut], batch: Batch, training: CompensatorTraining
) -> tuple[HeldOut, ...]:
    """Return the channels of all folds, each with a compensator for predictions trained without the fold.

    All are trained by one program, and for as many epochs as that of the channel, so that no further
    tests are needed to stop them: they then learn from as many tests as the channel's own.
    """
    settings, epochs, key = training
    compensators, sequences = [], []
    for number, (tests, channel) in enumerate(held_out):
        training_mask = batch.loss_mask & jnp.asarray(~tests)[:, None]
        compensator, fold_sequences = untrained_compensator(
            batch,
            channel.simulate_benchmark(batch),
            channel.load_filter,
            settings,
            jax.random.fold_in(key, number),
            training_mask,
        )
        compensators.append(compensator)
        sequences.append(pad_to_batches(every_nth(fold_sequences, MAX_STRETCHES), settings.adam.batch))
    stacked_networks = _stacked([compensator.network for compensator in compensators])
    stacked_sequences = _stacked(sequences)
    keys = jax.random.split(key, len(held_out))
    trained = _train(stacked_networks, stacked_sequences, settings, jnp.asarray(epochs), keys)
    trained = jax.tree.map(np.asarray, trained)
    folds = []
    for number, ((tests, channel), compensator) in enumerate(zip(held_out, compensators, strict=True)):
        network = jax.tree.map(lambda leaf, number=number: jax.device_put(leaf[number]), trained)
        folds.append(HeldOut(tests, replace(channel, compensator=replace(compensator, network=network))))
    return tuple(folds)


# By NumPy, as no shape must be compiled for that.
def _stacked(trees: Sequence[Tree]) -> Tree:
    return jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves)), *trees)


@eqx.filter_jit
def _train(
    networks: Lstm, sequences: Sequences, settings: CompensatorConfig, epochs: Array, keys: Array
) -> Lstm:
    """Return networks trained on the stretches outside their folds: mean weights of the last half of epochs.

    At a constant learning rate weights vary from epoch to epoch; the mean removes this, as the choice of the
    best epoch does for the channel's own compensator.
    """
    adam, stretches = settings.adam, sequences.loss_mask.shape[1]
    counts = jnp.sum(jnp.any(sequences.loss_mask, axis=-1), axis=-1)
    batches = -(-jnp.max(counts) // adam.batch)
    descent = optimiser(adam.learning_rate, adam.epochs * (stretches // adam.batch))
    weights, fixed = eqx.partition(networks, eqx.is_inexact_array)

    def mean_square(weights: PyTree, data: Sequences) -> Array:
        squares, count = squared_error(eqx.combine(weights, fixed), data)
        return squares / jnp.maximum(count, 1)

    def train(weights: PyTree, data: Sequences, key: PRNGKeyArray) -> PyTree:
        is_held_out = ~jnp.any(data.loss_mask, axis=-1)

        def epoch(number: Array, carry: tuple) -> tuple:
            weights, state, mean = carry
            uniform = jax.random.uniform(jax.random.fold_in(key, number), (stretches,))
            order = jnp.argsort(uniform + is_held_out)  # stretches of the fold come last

            def step(index: Array, carry: tuple) -> tuple:
                weights, state = carry
                rows = jax.lax.dynamic_slice(order, (index * adam.batch,), (adam.batch,))
                batch = jax.tree.map(lambda array: array[rows], data)
                change, state = descent.update(jax.grad(mean_square)(weights, batch), state, weights)
                return optax.apply_updates(weights, change), state

            weights, state = jax.lax.fori_loop(0, batches, step, (weights, state))
            share = 1 / jnp.maximum(number + 1 - epochs // 2, 1)
            mean = jax.tree.map(lambda old, new: old + (share * (new - old)).astype(old.dtype), mean, weights)
            return weights, state, mean

        start = (weights, descent.init(weights), weights)
        return jax.lax.fori_loop(0, epochs, epoch, start)[2]

    # One after the other: XLA is slow at batched products of small matrices.
    trained = jax.lax.map(lambda fold: train(*fold), (weights, sequences, keys))
    return eqx.combine(trained, fixed)
