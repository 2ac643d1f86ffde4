"""Prediction bands of a channel, calibrated by cross-fitting on all identification tests."""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from hitchid.identification.cross_fitting import HeldOut, held_out_free_runs
from hitchid.identification.held_out_predictions import calibrated_horizons, held_out_errors, rows_of_tests
from hitchid.identification.phase1 import Phase1
from hitchid.model import Channel
from hitchid.model.bands import Bands, EnsembleMember
from hitchid.model.ensemble import ensemble_deviations
from hitchid.structures import Batch
from hitchid.uncertainty.conformal import LEVELS, fewest_tests, growing_quantiles, sensor_noise
from hitchid.uncertainty.prediction_spread import HeldOutErrors, prediction_spread

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

    Args:
        channel: benchmark and compensators.
        phase1: its benchmark.
        batch: all identification tests.
        held_out: channels fitted without each fold of them; every test is held out once.
        predicted: `held_out_errors` of their predictions where they are known.
    """
    tests = batch.command.shape[0]
    ensemble, spreads = _selected_ensemble(channel, phase1, batch)
    errors = np.asarray(batch.displacement) - held_out_free_runs(held_out, batch)
    loss_mask = np.asarray(batch.loss_mask)
    residuals, spread_by_test = rows_of_tests(errors, loss_mask), rows_of_tests(spreads, loss_mask)
    noise = sensor_noise(residuals)
    if predicted is None:
        predicted = held_out_errors(held_out, batch, calibrated_horizons(batch.step_s))
    return Bands(
        ensemble=ensemble,
        noise=noise,
        levels=LEVELS,
        free_run=growing_quantiles(residuals, spread_by_test, noise),
        predictions=prediction_spread(predicted, noise),
        tests=(tests, tests),
    )


def band_notices(tests: int) -> list[str]:
    """Return sentences on the levels for which there are too few tests.

    Args:
        tests: number of identification tests.
    """
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
    sizes, axes = np.linalg.eigh(influence.covariance)
    ensemble = []
    for size, axis in zip(np.sqrt(np.maximum(sizes, 0.0)), axes.T, strict=True):
        step = size * axis
        step *= min(1.0, MAX_STEP / max(float(np.abs(step).max()), MAX_STEP))
        shifted = position + step if np.all(np.abs(position + step - 0.5) <= 0.5) else position - step
        ensemble.append(EnsembleMember(_parameter_vector(channel, phase1, np.clip(shifted, 0.0, 1.0))))
    if channel.speed_compensator is not None:
        members = channel.speed_compensator.members
        parameter_vector = tuple(map(float, channel.benchmark.parameter_vector))
        ensemble += [
            EnsembleMember(parameter_vector, member, 1 / np.sqrt(max(members - 1, 1)))
            for member in range(members)
        ]
    return ensemble


def _parameter_vector(channel: Channel, phase1: Phase1, position: np.ndarray) -> tuple[float, ...]:
    """Return the benchmark's parameter vector at a position, with the gain calibration of the channel."""
    objective = phase1.fit.objective
    vector = np.array(
        objective.spec.physical_model(
            jnp.asarray(objective.values(position)), objective.scales
        ).parameter_vector
    )
    if objective.spec.structure.gain:
        vector[objective.spec.structure.gain_index] *= float(channel.benchmark.gain) / phase1.fit.gain
    return tuple(map(float, vector))
