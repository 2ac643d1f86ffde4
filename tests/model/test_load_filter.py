"""The load filter against the conditional distribution that defines it, computed without a recursion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.precision import double_precision
from hitchid.model.load_filter import ErrorEstimate, LoadFilter

STEP_S = 0.01
SAMPLES = 40
# Products of 3 × 3 matrices through 40 samples in double precision.
ROUNDING = 40 * 27 * float(np.finfo(np.float64).eps)


@double_precision
def load_filter(noise=0.05, load=0.02, length=60.0, transient=0.1, time=0.2, drift=0.03):
    """Return a filter with typical parameters, in mm and s."""
    return LoadFilter(*(jnp.asarray(value) for value in (noise, load, length, transient, time, drift)))


def stroke(seed=0, samples=SAMPLES):
    """Return what a benchmark simulates, and a measured displacement, mm."""
    rng = np.random.default_rng(seed)
    benchmark = 50 + np.cumsum(0.3 * rng.uniform(0, 1, samples))
    return benchmark, benchmark + np.cumsum(0.02 * rng.standard_normal(samples))


def joint(kalman, benchmark):
    """Return mean zero's partner: the covariance of all errors e(0) … e(N−1) without noise, shape [N, N].

    Errors are sums of independent parts: a start, a walk, a transient, and the travel times a load that
    forgets itself over a length.
    """
    noise, load, length, transient, time, drift = (float(value) for value in jax.tree.leaves(kalman))
    count = benchmark.size
    index = np.arange(count)
    start = (noise**2 + drift**2 * STEP_S) * np.ones((count, count))
    walk = drift**2 * STEP_S * np.minimum.outer(index, index)
    increments = np.diff(benchmark)
    distance = np.concatenate([[0.0], np.cumsum(np.abs(increments))])[:-1]
    loads = load**2 * np.exp(-np.abs(np.subtract.outer(distance, distance)) / length)
    sums = np.tril(np.ones((count, count - 1)), -1) * increments
    lag = STEP_S * np.abs(np.subtract.outer(index, index)) / time
    # The transient is zero at rest and grows to its stationary scatter.
    grown = 1 - np.exp(-2 * STEP_S * np.minimum.outer(index, index) / time)
    return start + walk + sums @ loads @ sums.T + transient**2 * np.exp(-lag) * grown


@jax.jit
def estimates_of(kalman, benchmark, displacement):
    return kalman.estimates(benchmark, displacement, STEP_S)


@pytest.mark.parametrize("samples_known", [1, 2, 17, SAMPLES - 1])
@double_precision
def test_the_estimate_is_the_conditional_mean_and_variance(samples_known):
    kalman, (benchmark, displacement) = load_filter(), stroke()
    covariance, errors = joint(kalman, benchmark), displacement - benchmark
    measured = np.arange(samples_known)
    among = covariance[np.ix_(measured, measured)] + float(kalman.noise) ** 2 * np.eye(samples_known)
    weights = np.linalg.solve(among, covariance[measured])
    mean = errors[measured] @ weights
    variance = np.diag(covariance) - np.sum(weights * covariance[measured], axis=0)
    before, after = estimates_of(kalman, benchmark, displacement)
    condition = np.linalg.cond(among)
    last, now = samples_known - 1, samples_known
    np.testing.assert_allclose(after.error[last], mean[last], rtol=0, atol=condition * ROUNDING)
    np.testing.assert_allclose(after.variance[last], variance[last], rtol=0, atol=condition * ROUNDING)
    np.testing.assert_allclose(before.error[now], mean[now], rtol=0, atol=condition * ROUNDING)

    origin = ErrorEstimate(*(values[..., last] for values in after))
    increments = jnp.diff(jnp.asarray(benchmark))[last:]
    ahead, spread = kalman.ahead(origin, increments, np.arange(1, increments.size + 1), STEP_S)
    np.testing.assert_allclose(ahead, mean[now:], rtol=0, atol=condition * ROUNDING)
    expected = variance[now:] + float(kalman.noise) ** 2
    np.testing.assert_allclose(spread, expected, rtol=0, atol=condition * ROUNDING)


@double_precision
def test_without_a_filter_the_last_measured_error_stays():
    benchmark, displacement = stroke()
    none = LoadFilter.none()
    _, after = estimates_of(none, benchmark, displacement)
    np.testing.assert_array_equal(after.error, displacement - benchmark)
    origin = ErrorEstimate(*(values[..., 7] for values in after))
    increments = jnp.diff(jnp.asarray(benchmark))[7:]
    ahead, _ = none.ahead(origin, increments, np.arange(1, increments.size + 1), STEP_S)
    np.testing.assert_array_equal(ahead, np.full(SAMPLES - 8, (displacement - benchmark)[7]))


@double_precision
def test_a_heavier_load_shows_only_while_the_piston_moves():
    kalman = load_filter(length=1e6)
    rng = np.random.default_rng(1)
    benchmark = np.concatenate([np.full(100, 50.0), 50 + 0.2 * np.arange(400.0)])
    displacement = 50 + 0.96 * (benchmark - 50) + 0.05 * rng.standard_normal(500)
    _, after = estimates_of(kalman, benchmark, displacement)
    load, spread = after.mean[1], np.sqrt(after.covariance[1, 1])
    np.testing.assert_allclose(load[:100], 0.0, atol=ROUNDING)
    np.testing.assert_allclose(spread[:100], 0.02, rtol=1e-9)
    assert spread[-1] < 0.005
    assert abs(load[-1] + 0.04) < 3 * spread[-1]


@double_precision
def test_a_jump_is_followed_and_says_nothing_of_the_load():
    kalman = load_filter(length=1e6)
    rng = np.random.default_rng(1)
    benchmark = 50 + 0.2 * np.arange(400.0)
    displacement = 50 + 0.96 * (benchmark - 50) + 0.05 * rng.standard_normal(400)
    moved = displacement + np.where(np.arange(400) < 300, 0.0, 20.0)
    _, undisturbed = estimates_of(kalman, benchmark, displacement)
    _, after = estimates_of(kalman, benchmark, moved)
    np.testing.assert_allclose(after.error[300], moved[300] - benchmark[300], rtol=0, atol=20 * ROUNDING)
    assert float(after.mean[1, 300]) == pytest.approx(float(after.mean[1, 299]), rel=1e-6)
    three_errors = 3 * float(np.sqrt(undisturbed.variance[-1]))
    assert float(after.error[-1]) - 20.0 == pytest.approx(float(undisturbed.error[-1]), abs=three_errors)


@given(
    st.tuples(
        st.floats(1e-6, 1.0),
        st.floats(0.0, 1.0),
        st.floats(1e-3, 1e6),
        st.floats(0.0, 10.0),
        st.floats(1e-3, 1e3),
        st.floats(1e-6, 1.0),
    ),
    st.integers(0, 2**16),
)
@double_precision
def test_covariances_stay_symmetric_and_definite_and_gradients_finite(parameters, seed):
    benchmark, displacement = stroke(seed, 300)
    kalman = load_filter(*parameters)
    _, after = estimates_of(kalman, benchmark, displacement)
    matrices = np.moveaxis(after.covariance, -1, 0)
    scale = np.abs(matrices).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(
        matrices, np.swapaxes(matrices, 1, 2), rtol=0, atol=float(scale.max()) * ROUNDING
    )
    assert np.all(np.linalg.eigvalsh(matrices) >= -ROUNDING * scale[..., 0])
    assert np.all(np.isfinite(gradient_of_last_error(kalman, benchmark, displacement)))


@jax.jit
def gradient_of_last_error(kalman, benchmark, displacement):
    def last_error(kalman):
        before, _ = kalman.estimates(benchmark, displacement, STEP_S)
        return before.error[-1] ** 2 + before.variance[-1]

    return jax.tree.leaves(jax.grad(last_error)(kalman))


@double_precision
def test_a_million_samples_with_gaps_leave_a_definite_covariance():
    kalman = load_filter()

    def advance(state, key):
        estimate, smallest, largest = state
        draws = jax.random.uniform(key, (3,), dtype=jnp.float64)
        corrected = kalman.correct(estimate, 0.1 * (draws[0] - 0.5))
        is_measured = draws[1] < 0.9
        estimate = jax.tree.map(lambda new, old: jnp.where(is_measured, new, old), corrected, estimate)
        estimate = kalman.advance(estimate, jnp.where(draws[2] < 0.5, 0.0, draws[2] - 0.7), STEP_S)
        covariance = estimate.covariance
        minor = covariance[0, 0] * covariance[1, 1] - covariance[0, 1] ** 2
        smallest = jnp.minimum(smallest, jnp.minimum(minor, jnp.linalg.det(covariance)))
        return (estimate, smallest, jnp.maximum(largest, jnp.abs(covariance).max())), None

    state = (kalman.init_estimate(jnp.zeros(()), STEP_S), jnp.asarray(1.0), jnp.asarray(0.0))
    keys = jax.random.split(jax.random.key(0), 1_000_000)
    (estimate, smallest, largest), _ = jax.jit(lambda state: jax.lax.scan(advance, state, keys))(state)
    assert float(smallest) > 0
    assert float(largest) < 1
    assert np.all(np.isfinite(np.asarray(estimate.mean)))


@pytest.mark.parametrize("every", [1, 7, SAMPLES])
@double_precision
def test_thinned_estimates_are_those_of_all_samples_there(every):
    benchmark, displacement = map(jnp.asarray, stroke())
    kalman = load_filter()
    for all_samples, some in zip(
        kalman.estimates(benchmark, displacement, STEP_S),
        kalman.estimates(benchmark, displacement, STEP_S, every),
        strict=True,
    ):
        for whole, thinned in zip(all_samples, some, strict=True):
            np.testing.assert_allclose(thinned, whole[..., ::every], rtol=ROUNDING, atol=ROUNDING)
