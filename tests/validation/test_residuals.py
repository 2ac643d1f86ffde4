"""Residual tests: their level and their power against known errors, and what holds for all errors."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import lfilter

from hitchid.errors import InputError
from hitchid.validation.residuals import BOUND, residual_tests

STEP_S = 0.01
SEEDS = 200


def found_in(errors, commands=None, displacements=None, speeds=None, **settings):
    """Test errors where nothing but what is given varies."""
    still = [np.zeros(len(e)) for e in errors]
    return residual_tests(
        errors, commands or still, displacements or still, speeds or still, step_s=STEP_S, **settings
    )


def autoregressive(rng, samples, phi):
    """Return e(t) = φ e(t − 1) + white noise, stationary from the first sample."""
    noise = rng.normal(size=samples)
    noise[0] /= np.sqrt(1 - phi**2)
    return lfilter([1.0], [1.0, -phi], noise)


def held_command(rng, samples, hold=10):
    return np.repeat(rng.choice([0.0, 40.0, 100.0], samples // hold + 1), hold)[:samples]


def test_white_normal_errors_pass_all_tests_at_their_level():
    tests = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        errors = [rng.normal(0.3, 2.0, n) for n in (300, 500)]
        tests.append(found_in(errors, [held_command(rng, e.size) for e in errors]))
    # At 1 % seven or more of 200 are rejected in 1 of 200 cases.
    for name in ("white", "independent", "normal"):
        assert np.mean([getattr(result, name) for result in tests]) >= 0.97
    outside = np.mean([np.abs(r.autocorrelation) > r.autocorrelation_bounds for r in tests])
    assert 0.005 < outside < 0.015
    assert tests[0].mean == pytest.approx(0.3, abs=4 * 2 / np.sqrt(800))
    assert tests[0].deviation == pytest.approx(2.0, abs=4 * 2 / np.sqrt(2 * 800))


@pytest.mark.parametrize("phi", [-0.6, 0.8])
def test_first_order_errors_have_their_autocorrelation_and_are_not_white(phi):
    rng = np.random.default_rng(1)
    tests = found_in([autoregressive(rng, 30_000, phi), autoregressive(rng, 20_000, phi)])
    lag = np.arange(1, 26)
    # Bartlett's variance of the estimate; 25 lags stay within 4.5 deviations but in 1 of 5000 cases.
    decay = phi ** (2 * lag)
    spread = np.sqrt(((1 + phi**2) * (1 - decay) / (1 - phi**2) - 2 * lag * decay) / 50_000)
    assert np.all(np.abs(tests.autocorrelation - phi**lag) < 4.5 * spread)
    assert not tests.white
    assert tests.whiteness_p < 1e-6


def test_correlated_errors_without_the_command_are_found_independent():
    results, naive = [], []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        tests = found_in(
            [autoregressive(rng, 700, 0.9) for _ in range(2)], [held_command(rng, 700) for _ in "ab"]
        )
        results.append(tests)
        naive.append(np.abs(tests.cross_correlation) > BOUND / np.sqrt(1400))
    assert np.mean([r.independent for r in results]) >= 0.97
    # The lags of one case go together, so their level is less certain than of as many cases.
    assert 0.002 < np.mean([len(r.lags_outside) / 51 for r in results]) < 0.02
    assert np.mean(naive) > 0.1


@pytest.mark.parametrize("lag", [3, -4, 0])
def test_an_error_after_the_command_is_found_at_its_lag(lag):
    rng = np.random.default_rng(2)
    commands = [rng.choice([0.0, 50.0], n) for n in (400, 300)]
    errors = [0.1 * np.roll(u, lag) + rng.normal(0, 2.5, u.size) for u in commands]
    tests = found_in(errors, commands)
    assert not tests.independent
    assert lag in tests.lags_outside
    assert tests.cross_lags[int(np.argmax(np.abs(tests.cross_correlation)))] == lag
    # An error of deviation 2.5 from the command and as much noise.
    index = tests.cross_lags.index(lag)
    assert tests.cross_correlation[index] == pytest.approx(np.sqrt(0.5), abs=4 / np.sqrt(700))
    # A command without memory: the bounds are those of white errors, not widened by what was found.
    assert tests.cross_bounds[25] == pytest.approx(BOUND / np.sqrt(700), rel=0.15)


@pytest.mark.parametrize("phi", [-0.6, 0.8])
def test_normality_is_judged_by_what_autocorrelation_leaves_open(phi):
    tests = found_in([autoregressive(np.random.default_rng(0), 50_000, phi)])
    # Σ φ^(p|j|) over all j is (1 + φ^p)/(1 − φ^p); 5 % is what 50 000 samples leave open.
    third, fourth = ((1 + phi**p) / (1 - phi**p) for p in (3, 4))
    statistic = 50_000 * (
        tests.skewness**2 / (6 * max(third, 1.0)) + tests.excess_kurtosis**2 / (24 * fourth)
    )
    assert -2 * np.log(tests.normality_p) == pytest.approx(statistic, rel=0.05)


def test_skewed_errors_are_found_not_normal():
    tests = found_in([np.random.default_rng(4).exponential(size=100_000)])
    assert not tests.normal
    # The exponential distribution's are 2 and 6; with a moment of order 8 of 8! few samples decide.
    assert tests.skewness == pytest.approx(2.0, abs=0.2)
    assert tests.excess_kurtosis == pytest.approx(6.0, abs=2.0)


def test_ljung_and_box_of_a_hand_worked_example():
    # ρ̂₁ = −7/8 and ρ̂₂ = 6/8: Q = 8·10·((7/8)²/7 + (6/8)²/6) = 16.25, and of χ²₂ p = exp(−Q/2).
    tests = found_in([np.tile([1.0, -1.0], 4) + 5.0], lags=2)
    assert tests.autocorrelation == pytest.approx((-1.0, 1.0), rel=1e-12)
    assert (tests.whiteness, tests.freedom) == (pytest.approx(16.25, rel=1e-12), 2)
    assert tests.whiteness_p == pytest.approx(np.exp(-8.125), rel=1e-12)
    assert (tests.mean, tests.deviation) == (5.0, 1.0)


def test_no_product_goes_from_one_test_into_another():
    up, down = np.ones(8), -np.ones(8)
    apart = found_in([up, down], [up, down], lags=2)
    joined = found_in([np.concatenate([up, down])], [np.concatenate([up, down])], lags=2)
    assert apart.autocorrelation == pytest.approx((1.0, 1.0), rel=1e-12)
    assert apart.cross_correlation == pytest.approx([1.0] * 5, rel=1e-12)
    assert apart.whiteness == pytest.approx(18 / 16 * (14 + 12), rel=1e-12)
    # One and two products in 15 and 14 are across the seam.
    assert joined.autocorrelation == pytest.approx((13 / 15, 10 / 14), rel=1e-12)
    assert joined.cross_correlation == pytest.approx((10 / 14, 13 / 15, 1.0, 13 / 15, 10 / 14), rel=1e-12)


def test_errors_that_step_with_speed_are_explained_by_speed_alone():
    rng = np.random.default_rng(5)
    speed = rng.permutation(np.repeat([-20.0, 0.0, 30.0], 400))
    error = np.select([speed < 0, speed > 0], [0.5, -1.0], 0.25)
    tests = found_in([error], [rng.normal(size=1200)], [rng.normal(size=1200)], [speed])
    assert tests.by_speed.share == pytest.approx(1.0, rel=1e-12)
    assert [(b.lower, b.upper, b.count, b.mean, b.rmse) for b in tests.by_speed.bins] == [
        (-20.0, -20.0, 400, 0.5, 0.5),
        (0.0, 0.0, 400, 0.25, 0.25),
        (30.0, 30.0, 400, -1.0, 1.0),
    ]
    # By chance 8 bins explain 7 in 1200, as χ²₇.
    for other in (tests.by_position, tests.by_command):
        assert [b.count for b in other.bins] == [150] * 8
        assert other.share < 25 / 1200


def test_a_frequent_value_is_not_divided():
    command = np.concatenate([np.zeros(500), np.arange(1.0, 501.0)])
    bins = found_in([np.sin(np.arange(1000.0))], [command]).by_command.bins
    assert [(b.lower, b.upper, b.count) for b in bins] == [
        (0.0, 0.0, 500),
        *[(125.0 * n + 1, 125.0 * (n + 1), 125) for n in range(4)],
    ]


# What another test left open may be collected here.
@pytest.mark.filterwarnings("error", "default::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("level", "lengths"), [(0.0, (100,)), (0.1, (3, 5)), (-1e300, (1,) * 8), (5e-324, (3, 5))]
)
def test_constant_errors_and_commands_prove_nothing(level, lengths):
    errors = [np.full(n, level) for n in lengths]
    tests = found_in(errors, [np.full(n, 0.7) for n in lengths])
    assert (tests.white, tests.independent, tests.normal, tests.lags_outside) == (True, True, True, ())
    assert (tests.whiteness_p, tests.independence_p, tests.normality_p) == (1.0, 1.0, 1.0)
    assert (tests.mean, tests.deviation, tests.by_command.share) == (level, 0.0, 0.0)


# What another test left open may be collected here.
@pytest.mark.filterwarnings("error", "default::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("scale", [1e300, 1e-300])
def test_results_are_plain_numbers_at_any_size(scale):
    rng = np.random.default_rng(7)
    noise = rng.normal(size=(3, 50))
    commands = list(rng.choice([0.0, 1.0], (3, 50)))
    large = found_in(list(scale * noise), commands)
    usual = found_in(list(noise), commands)
    assert large.whiteness_p == pytest.approx(usual.whiteness_p, rel=1e-9)
    assert large.by_command.bins[0].rmse == pytest.approx(scale * usual.by_command.bins[0].rmse, rel=1e-9)
    again = json.loads(json.dumps(asdict(large), allow_nan=False))
    assert again["by_command"]["bins"][1]["upper"] == 1.0
    assert again["cross_lags"] == list(range(-25, 26))


@pytest.mark.parametrize(
    ("lengths", "used"), [((8,), 4), ((30, 30), 15), ((100, 4), 25), ((40, 4), 18), ((1,) * 8, 0)]
)
def test_short_tests_have_fewer_lags(lengths, used):
    rng = np.random.default_rng(8)
    tests = [rng.normal(size=n) for n in lengths]
    tests = found_in(tests, tests)
    pairs = [sum(max(n - k, 0) for n in lengths) for k in range(used + 1)]
    assert tests.freedom == len(tests.autocorrelation) == used
    assert tests.cross_lags == tuple(range(-used, used + 1))
    assert tests.autocorrelation_bounds == pytest.approx([2.5758293 / np.sqrt(n) for n in pairs[1:]])


@pytest.mark.parametrize("lengths", [(), (3, 0, 4)])
def test_fewer_than_eight_samples_are_refused(lengths):
    with pytest.raises(InputError, match=rf"^expected at least 8 samples, got {sum(lengths)}"):
        found_in([np.arange(float(n)) for n in lengths])


@st.composite
def made_up_tests(draw):
    """Draw one to three tests of 8 to 30 samples of whole numbers, so that shifts are exact."""
    lengths = draw(st.lists(st.integers(8, 30), min_size=1, max_size=3))
    whole = st.integers(-50, 50).map(float)
    return [[draw(arrays(np.float64, n, elements=whole)) for n in lengths] for _ in range(4)]


@given(made_up_tests())
def test_bins_hold_every_error_in_any_order(made_up):
    here = residual_tests(*made_up, step_s=STEP_S)
    there = residual_tests(*[name[::-1] for name in made_up], step_s=STEP_S)
    for name in ("whiteness_p", "independence_p", "normality_p"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), rel=1e-8, abs=1e-9)
    for group in (here.by_position, here.by_speed, here.by_command):
        assert sum(b.count for b in group.bins) == here.count
        assert 1 <= len(group.bins) <= 8
        assert 0.0 <= group.share <= 1.0
        # Bins do not overlap, and together they hold the mean square.
        assert all(one.upper < other.lower for one, other in zip(group.bins, group.bins[1:], strict=False))
        total = sum(b.count * b.rmse**2 for b in group.bins) / here.count
        assert total == pytest.approx(here.mean**2 + here.deviation**2, rel=1e-9)
