"""Test for two modes: one shared linear model against one for each direction."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int
from scipy.optimize import least_squares

from hitchid._support.metrics import better_on_held_out_tests
from hitchid.estimation import Objective, refine_subset
from hitchid.identification.preparation import ChannelData
from hitchid.logs.record import Record
from hitchid.model import Channel, Hitch, TwoModes
from hitchid.model.provenance import DifferenceTest
from hitchid.structures import Batch, ModelSpec, structure_named
from hitchid.uncertainty import difference_test
from hitchid.uncertainty.parameter_result import AT_BOUND
from hitchid.uncertainty.scores import Scores

# Calibration of the gains of a hitch that was identified from strokes, so that whole logs agree.

MAX_LOG_FACTOR = 0.1  # largest logarithm of a factor: a gain from strokes is known better than that
SAMPLE_STRIDE = 10  # samples; errors in free run change slowly against the clock
STEP = 1e-3  # of the logarithm, for finite differences


def calibrate_gains(hitch: Hitch, records: Sequence[Record]) -> dict[str, float]:
    """Return the factors on the gains with which free runs of whole records fit the measurement best.

    Each stroke begins at a measured displacement, so a small error of the gain has little effect in it; over
    a whole record it adds up. Least squares over the logarithms of the factors, each test weighing the
    same.

    Returns:
        Direction to factor, within ±10 %; a channel without a gain is left out.
    """
    directions = _with_gains(hitch)

    def residuals(logarithms: np.ndarray) -> np.ndarray:
        return np.concatenate(_residuals(hitch, directions, logarithms, records))

    start, bounds = np.zeros(len(directions)), (-MAX_LOG_FACTOR, MAX_LOG_FACTOR)
    best = least_squares(residuals, start, bounds=bounds, diff_step=STEP, x_scale=STEP)
    return dict(zip(directions, np.exp(best.x).tolist(), strict=True))


def calibration_improves(hitch: Hitch, records: Sequence[Record]) -> bool:
    """Return whether factors fitted to the other records improve records held out in turn.

    To first order in the logarithms of the factors; see `better_on_held_out_tests`. False for one record.
    """
    if len(records) < 2:
        return False
    directions = _with_gains(hitch)
    nominal = _residuals(hitch, directions, np.zeros(len(directions)), records)
    perturbed = [_residuals(hitch, directions, step, records) for step in STEP * np.eye(len(directions))]
    jacobians = [
        np.stack([(rows[number] - residuals) / STEP for rows in perturbed], axis=1)
        for number, residuals in enumerate(nominal)
    ]
    held_out = []
    for number, residuals in enumerate(nominal):
        others = [index for index in range(len(records)) if index != number]
        log_factors = np.linalg.lstsq(
            np.concatenate([jacobians[index] for index in others]),
            -np.concatenate([nominal[index] for index in others]),
            rcond=None,
        )[0]
        held_out.append(residuals + jacobians[number] @ np.clip(log_factors, -MAX_LOG_FACTOR, MAX_LOG_FACTOR))
    errors, nominal_errors = (np.array([np.linalg.norm(row) for row in rows]) for rows in (held_out, nominal))
    return better_on_held_out_tests(errors, nominal_errors)


def _with_gains(hitch: Hitch) -> list[str]:
    """Return the directions whose channels have a gain."""
    channels = hitch.channels.items()
    return [direction for direction, channel in channels if channel.benchmark.structure.gain]


def _residuals(
    hitch: Hitch, directions: Sequence[str], logarithms: np.ndarray, records: Sequence[Record]
) -> list[np.ndarray]:
    """Return the free-run errors of each record; their norm is the root mean square."""
    scaled_hitch = scaled(hitch, dict(zip(directions, np.exp(logarithms), strict=True)))
    all_errors = [
        (scaled_hitch.simulate(record).displacement - record.displacement)[::SAMPLE_STRIDE]
        for record in records
    ]
    return [errors / np.sqrt(errors.size) for errors in all_errors]


def scaled(hitch: Hitch, factors: Mapping[str, float]) -> Hitch:
    """Return a hitch with factors on the gains of its channels."""
    scaled_channels = {name: with_gain(hitch.channels[name], factor) for name, factor in factors.items()}
    return replace(hitch, channels={**hitch.channels, **scaled_channels})


def with_gain(channel: Channel, factor: float) -> Channel:
    """Return a channel with its gain multiplied by a factor.

    Raises:
        InputError: its structure has no gain.
    """
    return replace(channel, benchmark=channel.benchmark.with_gain(factor))


SPEC = ModelSpec(structure_named("integrator-first-order"), dead_time=True)
# Positions of gain, time constant and dead time between their bounds; time constants of 0.1, 0.01 and 3 s.
STARTS = ((0.5, 0.4, 0.5), (0.5, 0.2, 0.5), (0.5, 0.7, 0.2))
FOLDS = 4  # every fourth test of a direction is held out together
STEPS, REFIT_STEPS = 40, 10  # positions of least squares, over all tests and without a fold
TOLERANCE = 1e-12  # relative change of the sum of squares at which least squares stops; chosen
SAMPLES = 1024  # largest number of samples of a test
SIGNIFICANT = 0.05  # largest p-value of a significant difference


def compare_modes(channel_data: Mapping[str, ChannelData]) -> TwoModes | None:
    """Compare one linear model for both directions with one for each.

    K/(s (τ s + 1)) with a dead time, from effective command to travel, fitted in free run to all tests and to
    those of each direction. Two modes are needed where the parameters of the two directions differ
    significantly at 5 %; see `difference_test`. A parameter that lies at a bound of its search in one of the
    three fits has no standard error: it stays at its value in the shared model and is not compared.

    Returns:
        The comparison, with the free-run errors of both on every fourth test held out in turn; None where
        there is one direction only, or fewer tests than parameters and one.
    """
    if len(channel_data) < 2:
        return None
    batch, direction_index = _pool_directions(
        [data.all_tests.decimate(SAMPLES) for data in channel_data.values()]
    )
    if min(np.bincount(direction_index)) <= len(SPEC.parameters):
        return None
    objective = Objective.of(batch, SPEC)
    every_test = np.ones(direction_index.size, bool)
    directions = [direction_index == index for index in np.unique(direction_index)]

    def best_fit(tests: Bool[np.ndarray, " t"]) -> np.ndarray:
        fits = [_fit(objective, tests, np.array(start), STEPS) for start in STARTS]
        return min(fits, key=lambda fit: float(np.sum(objective.rmse_by_test(fit)[tests] ** 2)))

    shared, *separate = [best_fit(tests) for tests in (every_test, *directions)]
    two_errors = [
        _held_out_errors(objective, tests, best) for tests, best in zip(directions, separate, strict=True)
    ]
    difference = _difference(objective, directions, shared, separate)
    return TwoModes(
        needed=difference is not None and difference.p_value < SIGNIFICANT,
        shared_rmse=_rms(_held_out_errors(objective, every_test, shared, direction_index)),
        two_rmse=_rms(np.concatenate(two_errors)),
        tests=int(direction_index.size),
        difference=difference,
    )


def _difference(
    objective: Objective,
    directions: list[Bool[np.ndarray, " t"]],
    shared: np.ndarray,
    separate: list[np.ndarray],
) -> DifferenceTest | None:
    """Test the difference of the two directions' estimates; None where each parameter is at a bound."""
    fits = np.stack([shared, *separate])
    free = np.all((fits > AT_BOUND) & (fits < 1 - AT_BOUND), axis=0)
    if not free.any():
        return None
    held, scores = [], []
    for tests, position in zip(directions, separate, strict=True):
        position = np.where(free, position, shared)
        if not free.all():
            position = _fit(objective, tests, position, STEPS, free)
        held.append(position)
        scores.append(Scores.by_test(objective.over(tests), position).select_parameters(free))
    names = [parameter.name for parameter, is_free in zip(SPEC.parameters, free, strict=True) if is_free]
    return difference_test(held[0][free] - held[1][free], scores[0], scores[1], names)


def _held_out_errors(
    objective: Objective,
    tests: Bool[np.ndarray, " t"],
    best: np.ndarray,
    direction_index: Int[np.ndarray, " t"] | None = None,
) -> np.ndarray:
    """Return the RMSE of each of some tests, every fourth of a direction held out in turn."""
    groups = np.zeros(tests.size, int) if direction_index is None else direction_index
    fold_index = np.zeros(tests.size, int)
    for group in np.unique(groups):
        members = np.flatnonzero(tests & (groups == group))
        fold_index[members] = np.arange(members.size) % FOLDS
    errors = np.zeros(tests.size)
    for number in range(FOLDS):
        held_tests = tests & (fold_index == number)
        refitted = _fit(objective, tests & ~held_tests, best, REFIT_STEPS)
        errors[held_tests] = objective.rmse_by_test(refitted)[held_tests]
    return errors[tests]


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _pool_directions(batches: list[Batch]) -> tuple[Batch, np.ndarray]:
    """Return the tests of both directions as travel from zero, and the direction index of each test."""
    width = max(batch.command.shape[1] for batch in batches)

    def pad_and_stack(name: str) -> jnp.ndarray:
        rows = [np.asarray(getattr(batch, name)) for batch in batches]
        return jnp.asarray(np.concatenate([np.pad(r, ((0, 0), (0, width - r.shape[1]))) for r in rows]))

    direction_index = np.repeat(np.arange(len(batches)), [batch.command.shape[0] for batch in batches])
    zeros = jnp.zeros(direction_index.size)
    return Batch(
        command=pad_and_stack("command"),
        raw_command=pad_and_stack("raw_command"),
        dead_zone=jnp.concatenate([batch.dead_zone for batch in batches]),
        displacement=pad_and_stack("travel"),
        valid=pad_and_stack("valid"),
        loss_mask=pad_and_stack("loss_mask"),
        initial=zeros,
        covariates=jnp.zeros((direction_index.size, 0)),
        step_s=batches[0].step_s,
        sign=1,
    ), direction_index


def _fit(
    objective: Objective,
    tests: Bool[np.ndarray, " t"],
    start: np.ndarray,
    limit: int,
    free: Bool[np.ndarray, " d"] | None = None,
) -> np.ndarray:
    """Return the least-squares position over some tests; the parameters that are not free stay."""
    columns = np.arange(start.size) if free is None else np.flatnonzero(free)
    position = start.copy()
    fit = refine_subset(objective.over(tests), columns.tolist(), [start], limit, TOLERANCE)
    position[columns] = fit.position
    return position
