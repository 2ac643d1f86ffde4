"""The estimate from strokes against the conditional distribution that defines it, computed at once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import machine
from hitchid.live import AdaptationSettings, Changes
from hitchid.live.channel_state import BandFactor, ChannelEstimates, ChannelState
from hitchid.live.estimator import (
    Estimate,
    conditional_mean,
    speed_distance,
    updated,
    window_estimate,
    with_scatter,
)
from hitchid.live.gates import Bounds
from hitchid.live.stroke_errors import StrokeErrors, StrokeFit
from hitchid.logs.record import LIFTING

SAMPLES, STROKES = 12, 5
DRIFT = np.diag([0.3, 0.2, 0.1]) ** 2
PRIOR = Estimate(np.array([0.1, -0.2, 0.3]), np.array([[1.0, 0.3, 0.0], [0.3, 0.8, 0.1], [0.0, 0.1, 0.5]]))
# Products of matrices of 60 rows in double precision, of condition below 10⁴.
ROUNDING = 60 * 1e4 * float(np.finfo(np.float64).eps)


def fit(slopes, errors, at):
    """Return the fit of standardised errors r(θ) = errors − slopes (θ − at)."""
    return StrokeFit(at, float(errors @ errors), slopes.T @ errors, slopes.T @ slopes, 1.0)


def linear_strokes(seed=0, count=STROKES):
    """Return fits of linear strokes, and z and J of their errors z − J θ, shapes [M, N] and [M, N, 3]."""
    rng = np.random.default_rng(seed)
    slopes = rng.standard_normal((count, SAMPLES, 3)) * [2.0, 1.0, 0.3]
    ats = 0.2 * rng.standard_normal((count, 3))
    errors = rng.standard_normal((count, SAMPLES))
    fits = [fit(*stroke) for stroke in zip(slopes, errors, ats, strict=True)]
    return fits, errors + np.einsum("mnk,mk->mn", slopes, ats), slopes


def posterior(measured, slopes, drift, scatter):
    """Return mean and covariance of the last of all θ, given all errors at once.

    With θ(i) = θ(0) + w(1) + … + w(i) their joint covariance is P + min(i, j) Q.
    """
    count, samples, _ = slopes.shape
    number = np.arange(1, count + 1)
    among = np.kron(np.ones((count, count)), PRIOR.covariance)
    among = among + np.kron(np.minimum.outer(number, number), drift)
    rows = np.zeros((count * samples, 3 * count))
    for index, slope in enumerate(slopes):
        rows[index * samples : (index + 1) * samples, 3 * index : 3 * index + 3] = slope
    seen = rows @ (among + np.kron(np.eye(count), scatter)) @ rows.T + np.eye(count * samples)
    weights = np.linalg.solve(seen, rows @ among[:, -3:]).T
    mean = PRIOR.mean + weights @ (measured.ravel() - rows @ np.tile(PRIOR.mean, count))
    return mean, among[-3:, -3:] - weights @ rows @ among[:, -3:]


def assert_near(estimate, mean, covariance):
    np.testing.assert_allclose(estimate.mean, mean, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(estimate.covariance, covariance, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("count", [1, 2, STROKES])
@pytest.mark.parametrize("scatter", [np.zeros((3, 3)), np.diag([0.4, 0.3, 0.2]) ** 2], ids=["none", "own"])
def test_it_is_the_conditional_mean_and_covariance_of_the_changes(count, scatter):
    """Also where each stroke has a scatter of its own."""
    fits, measured, slopes = linear_strokes(count=count)
    estimate = PRIOR
    for own in fits:
        estimate = updated(estimate, with_scatter(own, scatter), DRIFT)
    assert_near(estimate, *posterior(measured, slopes, DRIFT, scatter))


@given(st.integers(0, 2**16), st.tuples(*3 * [st.floats(0.0, 2.0)]))
def test_a_scatter_is_the_inverse_of_the_errors_covariance(seed, deviations):
    rng = np.random.default_rng(seed)
    slopes, errors = rng.standard_normal((SAMPLES, 3)), rng.standard_normal(SAMPLES)
    scatter = np.diag(deviations) ** 2
    inverse = np.linalg.inv(np.eye(SAMPLES) + slopes @ scatter @ slopes.T)
    scattered = with_scatter(fit(slopes, errors, np.zeros(3)), scatter)
    np.testing.assert_allclose(scattered.squares, errors @ inverse @ errors, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(scattered.gradient, slopes.T @ inverse @ errors, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(scattered.information, slopes.T @ inverse @ slopes, rtol=0, atol=ROUNDING)


def test_a_stroke_that_tells_nothing_changes_nothing():
    nothing = StrokeFit(np.ones(3), 0.0, np.zeros(3), np.zeros((3, 3)), 0.0)
    later = updated(PRIOR, nothing, DRIFT)
    np.testing.assert_array_equal(later.mean, PRIOR.mean)
    np.testing.assert_allclose(later.covariance, PRIOR.covariance + DRIFT, rtol=1e-15)


FREE = np.ones(3, bool)


def linear_fits_at(measured, slopes):
    """Return the function that linearises the same strokes anywhere."""
    return lambda mean: [fit(J, z - J @ mean, np.array(mean)) for z, J in zip(measured, slopes, strict=True)]


def test_without_wandering_the_window_is_one_least_squares_fit():
    _, measured, slopes = linear_strokes(seed=2)
    latest, first = window_estimate(linear_fits_at(measured, slopes), PRIOR, np.zeros((3, 3)), FREE)
    weight = np.linalg.inv(PRIOR.covariance)
    for estimate, used in ((latest, slice(None)), (first, slice(1))):
        rows, values = slopes[used].reshape(-1, 3), measured[used].ravel()
        information = rows.T @ rows + weight
        mean = np.linalg.solve(information, rows.T @ values + weight @ PRIOR.mean)
        assert_near(estimate, mean, np.linalg.inv(information))


def test_a_window_goes_on_as_if_none_had_left():
    _, measured, slopes = linear_strokes(seed=3)
    whole, first = window_estimate(linear_fits_at(measured, slopes), PRIOR, DRIFT, FREE)
    later, _ = window_estimate(linear_fits_at(measured[1:], slopes[1:]), first, DRIFT, FREE)
    assert_near(later, *whole)


@pytest.mark.parametrize("free", [(True, False, False), (True, True, False), (False, True, True)])
def test_what_is_not_free_stays_beside_the_rest(free):
    free = np.array(free)
    _, measured, slopes = linear_strokes(seed=4)
    prior = Estimate(PRIOR.mean, np.diag([1.0, 0.8, 0.5]))
    latest, _ = window_estimate(linear_fits_at(measured, slopes), prior, np.zeros((3, 3)), free)
    np.testing.assert_array_equal(latest.mean[~free], prior.mean[~free])
    stays = np.diag(prior.covariance)[~free]
    np.testing.assert_allclose(np.diag(latest.covariance)[~free], stays, rtol=1e-12)
    rows = slopes.reshape(-1, 3)
    rest = measured.ravel() - rows[:, ~free] @ prior.mean[~free]
    weight = np.linalg.inv(prior.covariance)[np.ix_(free, free)]
    information = rows[:, free].T @ rows[:, free] + weight
    mean = np.linalg.solve(information, rows[:, free].T @ rest + weight @ prior.mean[free])
    np.testing.assert_allclose(latest.mean[free], mean, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("free", [(True, False, False), (True, False, True), (True, True, True)])
def test_the_conditional_mean_is_that_of_least_squares(free):
    free, held_at = np.array(free), np.array([9.0, 0.3, -0.2])
    precision = np.linalg.inv(PRIOR.covariance)
    shift = np.where(free, 0.0, held_at - PRIOR.mean)
    expected = np.where(free, PRIOR.mean, held_at)
    # The minimum of (θ − m)ᵀ P⁻¹ (θ − m) over the free parameters.
    expected[free] -= np.linalg.solve(precision[np.ix_(free, free)], (precision @ shift)[free])
    mean = conditional_mean(PRIOR, free, held_at)
    np.testing.assert_allclose(mean, expected, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(mean[~free], held_at[~free])


SETTINGS, CHANNEL = AdaptationSettings(), machine.MODEL.channels[LIFTING]
BOUNDS = Bounds.of(CHANNEL, SETTINGS, "A")


def candidate(levels, gain, dead_zone=0.0):
    """Return what strokes of a machine with another gain tell, each of one level of its own, A."""
    errors = StrokeErrors(CHANNEL, machine.STEP_S, np.zeros(0), SETTINGS.window)
    estimates = ChannelEstimates(errors, BOUNDS, [0.03, 0.02 * machine.LARGEST, 0.03], 2)
    prior = Estimate(np.zeros(3), estimates.identified)
    state = ChannelState(Changes(), Changes(), (Changes(),), prior, prior, BandFactor())
    options = {"samples": 200, "gain": gain, "dead_zone": dead_zone}
    strokes = [(number, machine.stroke(LIFTING, (own,), **options)) for number, own in enumerate(levels)]
    latest, _ = estimates.of_window(state, strokes, state.arrival)
    changes = estimates.known(state, latest)
    return changes, estimates.cautious(state, strokes, changes)


def test_at_one_level_the_gain_moves_alone():
    changes, cautious = candidate([0.3] * 5, 1.1)
    # Five strokes of 1.5 % scatter against 3 % as identified: short by 1 / (1 + 5 · 2²) = 5 %; twice that.
    assert changes[0] == pytest.approx(np.log(1.1), rel=0.1)
    assert (changes[1], changes[2]) == (0.0, 0.0)
    np.testing.assert_array_equal(cautious, changes)


@pytest.mark.parametrize("levels", [[0.3], [0.3] * 3, [0.3, 0.3, 0.3, 0.37, 0.3]])
def test_a_gain_alone_goes_half_the_way(levels):
    changes, cautious = candidate(levels, 1.1)
    assert changes[1] == 0.0
    np.testing.assert_array_equal(cautious, 0.5 * changes)


def test_commands_that_differ_tell_gain_and_dead_zone_apart():
    changes, cautious = candidate([0.1, 0.4] * 8, 1.1, 0.01)
    # Strokes of 1.5 % scatter in gain and 0.004 of the command in dead zone, 8 of each level: standard errors
    # of the gain 0.015 / √8 and of the dead zone below a half of its scatter; three of them.
    assert changes[0] == pytest.approx(np.log(1.1), abs=3 * 0.015 / np.sqrt(8))
    assert changes[1] == pytest.approx(0.01, abs=1.5 * 0.004 * machine.LARGEST)
    np.testing.assert_array_equal(cautious, changes)


PIECES, DRAWS = 10, 4000


@pytest.mark.parametrize("correlation", [0.0, 0.99])
def test_distances_of_strokes_have_a_variance_of_one(correlation):
    """However gain and dead zone are known apart, against draws from the distribution that is assumed."""
    rng = np.random.default_rng(3)
    # A larger gain and a smaller dead zone give the same speed: their slopes are alike.
    slopes = rng.uniform(20.0, 40.0, (PIECES, 1)) * [1.0, -2.0, 0.0] + rng.standard_normal((PIECES, 3))
    deviations, correlations = np.array([0.1, 0.05, 0.05]), np.eye(3)
    correlations[0, 1] = correlations[1, 0] = correlation
    predicted = Estimate(np.array([0.1, 0.01, 0.0]), correlations * np.outer(deviations, deviations))
    covariance = predicted.covariance + np.diag(BOUNDS.drift**2)
    changes = rng.multivariate_normal(predicted.mean, covariance, DRAWS)
    errors = (changes - predicted.mean) @ slopes.T + rng.standard_normal((DRAWS, PIECES))
    distances = [speed_distance(fit(slopes, own, predicted.mean), predicted, BOUNDS) for own in errors]
    # Four standard deviations of a variance of so many draws.
    assert np.var(distances) == pytest.approx(1.0, abs=4 * np.sqrt(2 / DRAWS))
