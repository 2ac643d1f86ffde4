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
    restricted,
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
    fits = [fit(*each) for each in zip(slopes, errors, ats, strict=True)]
    return fits, errors + np.einsum("mnk,mk->mn", slopes, ats), slopes


def posterior(measured, slopes, drift, prior=PRIOR, scatter=None):
    """Return mean and covariance of the last of all θ, given all errors at once.

    With θ(i) = θ(0) + w(1) + … + w(i) their joint covariance is P + min(i, j) Q.
    """
    count, samples, _ = slopes.shape
    number = np.arange(1, count + 1)
    among = np.kron(np.ones((count, count)), prior.covariance)
    among = among + np.kron(np.minimum.outer(number, number), drift)
    rows = np.zeros((count * samples, 3 * count))
    for index, slope in enumerate(slopes):
        rows[index * samples : (index + 1) * samples, 3 * index : 3 * index + 3] = slope
    own = np.kron(np.eye(count), np.zeros((3, 3)) if scatter is None else scatter)
    seen = rows @ (among + own) @ rows.T + np.eye(count * samples)
    weights = np.linalg.solve(seen, rows @ among[:, -3:]).T
    mean = np.tile(prior.mean, count)
    return (
        prior.mean + weights @ (measured.ravel() - rows @ mean),
        among[-3:, -3:] - weights @ rows @ among[:, -3:],
    )


@pytest.mark.parametrize("count", [1, 2, STROKES])
def test_it_is_the_conditional_mean_and_covariance_of_the_changes(count):
    fits, measured, slopes = linear_strokes(count=count)
    estimate = PRIOR
    for each in fits:
        estimate = updated(estimate, each, DRIFT)
    mean, covariance = posterior(measured, slopes, DRIFT)
    np.testing.assert_allclose(estimate.mean, mean, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(estimate.covariance, covariance, rtol=0, atol=ROUNDING)


def test_it_is_so_with_a_scatter_of_each_stroke():
    fits, measured, slopes = linear_strokes(seed=1)
    scatter = np.diag([0.4, 0.3, 0.2]) ** 2
    estimate = PRIOR
    for each in fits:
        estimate = updated(estimate, with_scatter(each, scatter), DRIFT)
    mean, covariance = posterior(measured, slopes, DRIFT, scatter=scatter)
    np.testing.assert_allclose(estimate.mean, mean, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(estimate.covariance, covariance, rtol=0, atol=ROUNDING)


@given(st.integers(0, 2**16), st.tuples(*3 * [st.floats(0.0, 2.0)]))
def test_a_scatter_is_the_inverse_of_the_covariance_of_the_errors(seed, deviations):
    rng = np.random.default_rng(seed)
    slopes, errors = rng.standard_normal((SAMPLES, 3)), rng.standard_normal(SAMPLES)
    scatter = np.diag(deviations) ** 2
    inverse = np.linalg.inv(np.eye(SAMPLES) + slopes @ scatter @ slopes.T)
    found = with_scatter(fit(slopes, errors, np.zeros(3)), scatter)
    np.testing.assert_allclose(found.squares, errors @ inverse @ errors, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(found.gradient, slopes.T @ inverse @ errors, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(found.information, slopes.T @ inverse @ slopes, rtol=0, atol=ROUNDING)


@given(st.integers(0, 2**16))
def test_a_stroke_never_makes_the_estimate_less_certain(seed):
    (one,), _, _ = linear_strokes(seed, count=1)
    later = updated(PRIOR, one, np.zeros((3, 3)))
    np.testing.assert_array_equal(later.covariance, later.covariance.T)
    assert np.linalg.eigvalsh(PRIOR.covariance - later.covariance).min() >= -ROUNDING
    assert np.linalg.eigvalsh(later.covariance).min() > 0


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
    for estimate, used in ((latest, slice(None)), (first, slice(1))):
        rows, values = slopes[used].reshape(-1, 3), measured[used].ravel()
        weight = np.linalg.inv(PRIOR.covariance)
        information = rows.T @ rows + weight
        mean = np.linalg.solve(information, rows.T @ values + weight @ PRIOR.mean)
        np.testing.assert_allclose(estimate.mean, mean, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(estimate.covariance, np.linalg.inv(information), rtol=0, atol=ROUNDING)


def test_a_window_and_its_arrival_cost_go_on_as_if_no_stroke_had_left_it():
    _, measured, slopes = linear_strokes(seed=3)
    whole, first = window_estimate(linear_fits_at(measured, slopes), PRIOR, DRIFT, FREE)
    later, _ = window_estimate(linear_fits_at(measured[1:], slopes[1:]), first, DRIFT, FREE)
    np.testing.assert_allclose(later.mean, whole.mean, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(later.covariance, whole.covariance, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("free", [(True, False, False), (True, True, False), (False, True, True)])
def test_what_is_not_free_stays_and_the_rest_is_fitted_beside_it(free):
    free = np.array(free)
    _, measured, slopes = linear_strokes(seed=4)
    prior = Estimate(PRIOR.mean, np.diag([1.0, 0.8, 0.5]))
    latest, _ = window_estimate(linear_fits_at(measured, slopes), prior, np.zeros((3, 3)), free)
    np.testing.assert_array_equal(latest.mean[~free], prior.mean[~free])
    np.testing.assert_allclose(
        np.diag(latest.covariance)[~free], np.diag(prior.covariance)[~free], rtol=1e-12
    )
    rows = slopes.reshape(-1, 3)
    rest = measured.ravel() - rows[:, ~free] @ prior.mean[~free]
    weight = np.linalg.inv(prior.covariance)[np.ix_(free, free)]
    information = rows[:, free].T @ rows[:, free] + weight
    mean = np.linalg.solve(information, rows[:, free].T @ rest + weight @ prior.mean[free])
    np.testing.assert_allclose(latest.mean[free], mean, rtol=0, atol=ROUNDING)


def test_a_restricted_fit_is_that_of_errors_with_the_others_held():
    (one,), measured, slopes = linear_strokes(seed=6, count=1)
    held_at = np.array([0.5, 0.6, 0.7])
    found = restricted(one, np.array([True, False, True]), held_at)
    at = np.array([one.at[0], held_at[1], one.at[2]])
    errors = measured[0] - slopes[0] @ at
    np.testing.assert_array_equal(found.at, at)
    np.testing.assert_allclose(found.gradient[[0, 2]], slopes[0][:, [0, 2]].T @ errors, rtol=0, atol=ROUNDING)
    assert (found.gradient[1], *found.information[1], *found.information[:, 1]) == 7 * (0.0,)


@pytest.mark.parametrize("free", [(True, False, False), (True, False, True), (True, True, True)])
def test_the_conditional_mean_is_that_of_least_squares_with_the_others_held(free):
    free, held_at = np.array(free), np.array([9.0, 0.3, -0.2])
    precision = np.linalg.inv(PRIOR.covariance)
    shift = np.where(free, 0.0, held_at - PRIOR.mean)
    expected = np.where(free, PRIOR.mean, held_at)
    # The minimum of (θ − m)ᵀ P⁻¹ (θ − m) over the free parameters.
    expected[free] -= np.linalg.solve(precision[np.ix_(free, free)], (precision @ shift)[free])
    found = conditional_mean(PRIOR, free, held_at)
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(found[~free], held_at[~free])


def estimates_and_state():
    """Return estimates of the lifting channel by hand, and the state before any stroke."""
    known = AdaptationSettings()
    channel = machine.MODEL.channels[LIFTING]
    errors = StrokeErrors(channel, machine.STEP_S, np.zeros(0), known.window)
    bounds = Bounds.of(channel, known, "A")
    found = ChannelEstimates(errors, bounds, [0.03, 0.02 * machine.LARGEST, 0.03], 2)
    estimate = Estimate(np.zeros(3), found.identified)
    return found, ChannelState(Changes(), Changes(), (Changes(),), estimate, estimate, BandFactor())


def candidate(levels, gain, dead_zone=0.0):
    """Return what strokes of a machine with another gain tell, each of one level of its own, A."""
    estimates, state = estimates_and_state()
    strokes = [
        (number, machine.stroke(LIFTING, (each,), samples=200, gain=gain, dead_zone=dead_zone))
        for number, each in enumerate(levels)
    ]
    latest, _ = estimates.of_window(state, strokes, state.arrival)
    known = estimates.known(state, latest)
    return known, estimates.cautious(state, strokes, known)


def test_at_one_level_of_command_the_gain_moves_alone_and_all_the_way():
    known, cautious = candidate([0.3] * 5, 1.1)
    # Five strokes of 1.5 % scatter against 3 % as identified: short by 1 / (1 + 5 · 2²) = 5 %; twice that.
    assert known[0] == pytest.approx(np.log(1.1), rel=0.1)
    assert (known[1], known[2]) == (0.0, 0.0)
    np.testing.assert_array_equal(cautious, known)


@pytest.mark.parametrize("levels", [[0.3], [0.3] * 3, [0.3, 0.3, 0.3, 0.37, 0.3]])
def test_where_other_commands_may_follow_a_gain_alone_goes_half_the_way(levels):
    known, cautious = candidate(levels, 1.1)
    assert known[1] == 0.0
    np.testing.assert_array_equal(cautious, 0.5 * known)


def test_at_commands_that_differ_gain_and_dead_zone_are_told_apart():
    known, cautious = candidate([0.1, 0.4] * 8, 1.1, 0.01)
    # Strokes of 1.5 % scatter in gain and 0.004 of the command in dead zone, 8 of each level: standard errors
    # of the gain 0.015 / √8 and of the dead zone below a half of its scatter; three of them.
    assert known[0] == pytest.approx(np.log(1.1), abs=3 * 0.015 / np.sqrt(8))
    assert known[1] == pytest.approx(0.01, abs=1.5 * 0.004 * machine.LARGEST)
    np.testing.assert_array_equal(cautious, known)
