"""Predictions of the error of a benchmark over several horizons, from every sample of measured tests."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.model.load_filter import ErrorEstimate, LoadFilter
from hitchid.networks.error_compensator import Compensator, CompensatorState, Sample


class ErrorPredictor(NamedTuple):
    """What predicts the error of a benchmark.

    Attributes:
        load_filter: estimates offset and load.
        compensator: predicts the innovations of the filter; None for none.
    """

    load_filter: LoadFilter
    compensator: Compensator | None


@eqx.filter_jit
def predict_errors(
    predictor: ErrorPredictor,
    tests: Sample,
    trust: Float[Array, "t n"],
    horizons: tuple[int, ...],
    step_s: float,
    every: int = 1,
) -> Float[Array, "h t n"]:
    """Return the prediction ê at every sample from measurements up to h samples before, for each h.

    Near the start of a test, sample k < h is predicted from sample 0.

    Args:
        predictor: filter and compensator.
        tests: arrays of shape [T, N].
        trust: factor on the predicted increments, 0 to 1, shape [T, N].
        horizons: prediction horizons h, in samples.
        step_s: sampling time, s.
        every: predictions start from every so many samples; those from other samples are NaN.
    """

    def errors_of_test(test_and_trust: tuple[Sample, Array]) -> Float[Array, "h n"]:
        test, test_trust = test_and_trust
        errors_ahead = multi_step_errors(predictor, test, test_trust, max(horizons), step_s, every)
        # errors_ahead[h − 1, i] is for sample i · every + h; the origin of the first samples is sample 0.
        sample_index = jnp.arange(test_trust.size)
        rows = []
        for horizon in horizons:
            steps = jnp.minimum(sample_index, horizon)
            origin = sample_index - steps
            errors = errors_ahead[jnp.maximum(steps - 1, 0), origin // every]
            errors = jnp.where(origin % every == 0, errors, jnp.nan)
            rows.append(jnp.where(sample_index > 0, errors, 0.0))
        return jnp.stack(rows)

    return jnp.moveaxis(jax.lax.map(errors_of_test, (tests, trust)), 1, 0)


def multi_step_errors(
    predictor: ErrorPredictor,
    test: Sample,
    trust: Float[Array, " n"],
    horizon: int,
    step_s: float,
    every: int = 1,
) -> Float[Array, "h m"]:
    """Return ê(i+h) for h = 1 … horizon from every m-th sample i of one measured test.

    To the error that the filter predicts the compensator adds the innovation to come, up to its largest
    horizon. Up to the origin filter and features use measurements, beyond it the model's own output.

    Args:
        predictor: filter and compensator.
        test: one test, arrays of shape [N].
        trust: factor on the predicted increments, shape [N].
        horizon: largest prediction horizon, in samples.
        step_s: sampling time, s.
        every: m, samples from one origin to the next.
    """
    count = trust.shape[0]
    origins = np.arange(0, count, every)
    load_filter, compensator = predictor
    _, estimates = load_filter.estimates(test.benchmark, test.displacement, step_s, every)

    def filtered(estimates: ErrorEstimate, first: int) -> Float[Array, "k m"]:
        """Return the errors after samples first + 1 … horizon, from the estimates after sample `first`."""
        ahead = origins + jnp.arange(first, horizon + 1)[:, None]
        increments = jnp.diff(test.benchmark[jnp.minimum(ahead, count - 1)], axis=0)
        return load_filter.ahead(estimates, increments, np.arange(1, horizon - first + 1), step_s)[0]

    if compensator is None:
        return filtered(estimates, 0)
    corrected = min(horizon, compensator.max_horizon)

    def advance_measured(
        state: CompensatorState, inputs: tuple[Sample, Array]
    ) -> tuple[CompensatorState, tuple[CompensatorState, Array]]:
        sample, factor = inputs
        state, innovation = compensator.step(state, sample, step_s)
        return state, (state, factor * innovation)

    first = jax.tree.map(lambda array: array[0], test)
    _, measured = jax.lax.scan(advance_measured, compensator.init_state(first), (test, trust))
    states, innovations = jax.tree.map(lambda values: values[::every], measured)

    def from_origin(
        origin: Array, state: CompensatorState, estimate: ErrorEstimate, innovation: Array
    ) -> tuple[ErrorEstimate, Float[Array, " c"]]:
        def advance(carry: tuple, index: Array) -> tuple[tuple, Array]:
            state, estimate, innovation = carry
            increment = test.benchmark[index] - test.benchmark[jnp.maximum(index - 1, origin)]
            estimate = load_filter.advance(estimate, increment, step_s)
            error = estimate.error + innovation
            sample = jax.tree.map(lambda array: array[index], test)
            state, ahead = compensator.step(
                state, sample._replace(displacement=sample.benchmark + error), step_s
            )
            return (state, estimate.with_innovation(innovation), trust[index] * ahead), error

        ahead = jnp.minimum(origin + jnp.arange(1, corrected + 1), count - 1)
        (_, estimate, _), errors = jax.lax.scan(advance, (state, estimate, innovation), ahead)
        return estimate, errors

    by_origin = jax.vmap(from_origin, in_axes=(0, 0, -1, 0), out_axes=-1)
    estimates, errors = by_origin(jnp.asarray(origins), states, estimates, innovations)
    if corrected == horizon:
        return errors
    return jnp.concatenate([errors, filtered(estimates, corrected)])
