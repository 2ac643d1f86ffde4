"""What tests say of the parameters together, and what one more would."""

from dataclasses import asdict, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from hitchid.estimation import MultiStart
from hitchid.identification.phase1 import identify_benchmark
from hitchid.model import Information, Uncertainty
from hitchid.structures import ModelSpec, structure_named
from hitchid.uncertainty import NO_ERROR, DeadZoneError
from hitchid.uncertainty.influence import (
    _autocovariance,
    information_of,
    profile_out_gain,
    standard_errors,
    standard_errors_with,
    standard_errors_with_repeat,
)
from truth import held, lag, levels

READ = TypeAdapter(Uncertainty)
LAG = ModelSpec(structure_named("first-order-lag"))
UNITS = {"x": "mm", "u": "A"}
TESTS, SAMPLES = 8, 250
SURE = 3.3  # standard errors, beyond which 1 in 1000 lies


@pytest.fixture(scope="module")
def identified(batch_of):
    """Return a function that identifies a form from eight noisy tests of a lag."""

    @cache
    def identify(form=LAG, *, dead_zone=NO_ERROR):
        rng, tests = np.random.default_rng(0), []
        for _ in range(TESTS):
            command = levels(rng, SAMPLES, low=0.2)
            travel = held(*lag(15.0, 0.7), command) + 0.3 * rng.standard_normal(SAMPLES)
            tests.append((np.where(command > 0, command + 0.35, 0.0), travel))
        batch = batch_of(tests, dead_zone=0.35)
        return identify_benchmark(batch, form, MultiStart(100, starts=2), 0, units=UNITS, dead_zone=dead_zone)

    return identify


def gathered(phase1):
    return information_of(phase1.fit.objective, phase1.fit.position, phase1.influence)


def by_hand(jacobian, *, tests=5, size=0.3, every=1, fixed=0.0):
    """Return what tests of one Jacobian each say whose errors are white."""
    one = jacobian.T @ jacobian
    return Information(
        names=tuple("abcdef"[: one.shape[0]]),
        slopes=(1.0,) * one.shape[0],
        curvature=tuple(map(tuple, tests * one)),
        score_covariance=tuple(map(tuple, tests * size**2 * one)),
        dead_zone_covariance=tuple(map(tuple, fixed * np.eye(one.shape[0]))),
        # The mean of so many white errors.
        autocovariance=(size**2 / every, 0.0, 0.0),
        block_size=every,
        per_test_gain=False,
        tests=tests,
        samples=float(len(jacobian)),
    )


@pytest.mark.parametrize("dead_zone", [NO_ERROR, DeadZoneError(0.01, 3)], ids=["known", "from ramps"])
def test_widths_are_the_standard_errors_of_the_estimates(identified, dead_zone):
    phase1 = identified(dead_zone=dead_zone)
    information = gathered(phase1)
    assert information.names == ("gain", "time_constant")
    # H⁻¹ H is one to rounding times the condition of H, from either side.
    rounding = 100 * np.linalg.cond(np.array(information.curvature)) * np.finfo(float).eps
    errors = np.array([estimate.error for estimate in phase1.parameter_estimates])
    np.testing.assert_allclose(standard_errors(information) * information.slopes, errors, rtol=rounding)
    assert (information.tests, information.samples) == (TESTS, SAMPLES)
    assert np.any(information.dead_zone_covariance) == (dead_zone.standard_error > 0)


def test_a_parameter_at_a_bound_is_left_out(identified):
    form = replace(LAG, bounds={"time_constant": (2.0, 9.0)})
    information = gathered(identified(form))
    assert information.names == ("gain",)
    assert np.shape(information.curvature) == np.shape(information.score_covariance) == (1, 1)


def test_white_errors_have_their_variance_and_one_more_test_narrows(identified):
    information = gathered(identified())
    share = standard_errors_with_repeat(information) / standard_errors(information)
    np.testing.assert_allclose(share, np.sqrt(TESTS / (TESTS + 1)), rtol=1e-9)
    variance, *others = information.autocovariance
    # Every second sample: means of two errors of 0.3 mm. A mean of 1000 squares scatters by √(2/1000), its
    # lagged products by √(1/1000); the dozen lags looked at are a dozen chances, so 4.5 standard errors.
    assert variance == pytest.approx(0.3**2 / 2, rel=SURE * np.sqrt(2 / 1000))
    assert np.abs(others[:12]).max() <= 4.5 * variance / np.sqrt(1000)


shapes = st.tuples(st.integers(12, 60), st.integers(1, 4), st.integers(0, 99), st.integers(1, 20))


@given(shape=shapes)
def test_a_repeated_jacobian_narrows_as_one_more_test(shape):
    samples, dimensions, seed, tests = shape
    jacobian = np.random.default_rng(seed).normal(size=(samples, dimensions))
    information = by_hand(jacobian, tests=tests)
    # H' = (T + 1)/T H and so its scatter: V' = V T/(T + 1); rounding by the condition of H.
    rounding = 100 * np.linalg.cond(jacobian) ** 2 * np.finfo(float).eps
    share = standard_errors_with(information, jacobian) / standard_errors(information)
    np.testing.assert_allclose(share, np.sqrt(tests / (tests + 1)), rtol=rounding)


def test_a_test_narrows_only_what_it_excites():
    information = by_hand(np.eye(2)[np.arange(40) % 2])
    first, second = standard_errors_with(information, np.eye(2)[np.zeros(40, int)]) / standard_errors(
        information
    )
    assert second == pytest.approx(1.0, rel=1e-12)
    # Five tests gave 20 samples to each parameter; forty more are two tests' worth: √(5/7).
    assert first == pytest.approx(np.sqrt(5 / 7), rel=1e-12)


def test_what_the_dead_zone_adds_no_test_takes_away():
    jacobian = 100 * np.random.default_rng(3).normal(size=(50, 2))
    information = by_hand(jacobian, fixed=0.04)
    many = standard_errors_with(information, np.tile(100 * jacobian, (40, 1)))
    assert np.all(many >= 0.2)
    # The rest, 0.3/(100 √250) = 2e-4 before the test, is a millionth beside it in squares.
    assert many == pytest.approx([0.2, 0.2], rel=1e-6)


@pytest.mark.parametrize(("left", "every"), [(0.0, 1), (0.6, 1), (0.9, 1), (0.9, 4)])
def test_the_autocovariance_of_a_markov_process_is_found(left, every):
    tests, samples, rng = 20, 2000, np.random.default_rng(4)
    errors = np.sqrt(1 - left**2) * rng.standard_normal((tests, samples))
    errors[:, 0] = rng.standard_normal(tests)
    for k in range(1, samples):
        errors[:, k] += left * errors[:, k - 1]
    test = np.repeat(np.arange(tests), samples)
    covariance = np.array(_autocovariance(errors.ravel(), test, every))[:20]
    between = np.arange(every)
    lags = every * np.arange(20)[:, None, None] + between[:, None] - between
    # Of means over so many samples, less the share of lagged pairs that lie beyond the end of a test.
    expected = np.mean(left ** np.abs(lags), axis=(1, 2)) * (1 - np.arange(20) * every / samples)
    # Bartlett: a lagged mean product of N samples scatters by √(2 Σρ²/N) at most, Σρ² = (1 + a²)/(1 − a²);
    # twenty lags that hang together, 4 standard errors.
    error = np.sqrt(2 * (1 + left**2) / (1 - left**2) / (tests * samples))
    np.testing.assert_allclose(covariance, expected, rtol=0, atol=4 * error)


@pytest.mark.parametrize("spoil", [{"curvature": [[1.0, None]]}, {"block_size": "often"}, {"names": "gain"}])
def test_a_description_of_another_kind_is_refused(identified, spoil):
    uncertainty = Uncertainty(identified().assessment)
    described = asdict(replace(uncertainty, information=by_hand(np.ones((12, 1)))))
    described["information"].update(spoil)
    with pytest.raises(ValueError, match=f"information.{next(iter(spoil))}"):
        READ.validate_python(described)


def test_what_a_tests_own_speed_absorbs_is_left_out():
    rng = np.random.default_rng(4)
    travel, other = np.cumsum(rng.random(50)), rng.standard_normal(50)
    jacobian = np.stack([3.0 * travel, other], axis=1)
    information = by_hand(jacobian)
    np.testing.assert_array_equal(profile_out_gain(information, travel, jacobian), jacobian)
    profiled = profile_out_gain(replace(information, per_test_gain=True), travel, jacobian)
    # A speed that is tied to one with ρ = 0.01 leaves ρ/(1 + ρ) of what goes with the travel itself.
    np.testing.assert_allclose(profiled[:, 0], 3.0 * travel * 0.01 / 1.01, rtol=1e-9)
    assert abs(travel @ profiled[:, 1]) <= 0.01 * abs(travel @ other)
