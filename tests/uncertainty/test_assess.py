"""What is said of parameters agrees with closed forms where there are any, and with what was simulated."""

import numpy as np
import pytest
from scipy import stats

from hitchid.estimation import MultiStart, Objective, refine_subset
from hitchid.identification.phase1 import find_parameters
from hitchid.structures import ModelSpec, structure_named
from hitchid.uncertainty import DeadZoneError
from hitchid.uncertainty.intervals import assess
from hitchid.uncertainty.profile import profile
from truth import STEP_S, held, lag, levels, shifted

UNITS = {"x": "mm", "u": "A"}
INTEGRATOR = ModelSpec(structure_named("integrator"))
LAG = ModelSpec(structure_named("first-order-lag"))
SECOND_ORDER = ModelSpec(structure_named("integrator-second-order"))
SAMPLES = 250


def noisy(tests, noise):
    """Return tests with white noise of the sensor."""
    rng = np.random.default_rng(0)
    return [(command, travel + noise * rng.standard_normal(travel.size)) for command, travel in tests]


def alike(gains):
    """Return tests of integrators that share one command and differ by their gain."""
    command = levels(np.random.default_rng(0), SAMPLES, low=0.2)
    travel = held([1.0], [1.0, 0.0], command)
    return [(command, gain * travel) for gain in gains]


def assessed(batch, form, *, dead_zone=DeadZoneError(), starts=3):  # noqa: B008
    fit = find_parameters(batch, form, MultiStart(evaluations=10**4, starts=starts), 0)
    assessment, moved = assess(fit.objective, fit.position, units=UNITS, dead_zone=dead_zone)
    return {quantity.name: quantity for quantity in assessment.parameters}, assessment, moved


def t_interval(values):
    """Return mean, standard error and 95 % interval of a mean, as any textbook has them."""
    mean, error = np.mean(values), np.std(values, ddof=1) / np.sqrt(len(values))
    reach = stats.t.ppf(0.975, len(values) - 1) * error
    return mean, error, reach


def test_the_gain_of_tests_alike_has_students_interval(batch_of):
    gains = 15.0 * (1 + 0.01 * np.random.default_rng(1).standard_normal(8))
    estimates, assessment, moved = assessed(batch_of(alike(gains)), INTEGRATOR)
    gain_estimate, (mean, error, reach) = estimates["gain"], t_interval(gains)
    assert gain_estimate.value == pytest.approx(mean, rel=1e-9)
    assert gain_estimate.error == pytest.approx(error, rel=1e-6)
    assert moved.degrees_of_freedom == pytest.approx([7.0], rel=1e-6)
    # The interval is one of the logarithm: of the second order in the relative reach beside the mean's.
    second = (reach / mean) ** 2
    assert gain_estimate.interval == pytest.approx((mean - reach, mean + reach), rel=second)
    assert (gain_estimate.method, gain_estimate.determined, gain_estimate.verdict) == (
        "Gauss-Newton",
        True,
        "determined",
    )
    assert (assessment.tests, assessment.rows) == (8, 8)
    # One test is cut into stretches.
    command = levels(np.random.default_rng(0), 2 * SAMPLES, low=0.2)
    estimates, assessment, _ = assessed(
        batch_of(noisy([(command, held(*lag(15.0, 0.7), command))], 0.3)), LAG
    )
    assert (assessment.tests, assessment.rows) == (1, 6)
    assert all(np.isfinite(quantity.error) for quantity in estimates.values())


def test_the_profile_of_tests_alike_ends_where_students_interval_does(batch_of):
    # Gains that differ by a third make the interval wide, so that it is profiled; held at K, a test's slope
    # is as its own gain less K, so that the tests contradict K where Student's test of their mean does.
    gains = np.array([11.0, 24.0, 12.0, 19.0, 9.0, 16.0])
    estimates, _, _ = assessed(batch_of(alike(gains)), INTEGRATOR)
    gain_estimate, (mean, _, reach) = estimates["gain"], t_interval(gains)
    assert gain_estimate.method == "profile"
    # Halving ends within 1/16 of the last step; steps grow from 0.02 of ln(10⁴) to at most twice the reach.
    tolerance = max(0.02 * np.log(1e4), 2 * reach / mean) / 16
    assert np.log(gain_estimate.interval) == pytest.approx(
        np.log([mean - reach, mean + reach]), abs=tolerance
    )
    held_at, rmse = np.array(gain_estimate.profile).T
    _, travel = alike([1.0])[0]
    spread = np.sqrt(np.mean(travel**2) * np.mean((gains[:, None] - held_at) ** 2, axis=0))
    np.testing.assert_allclose(rmse, spread, rtol=1e-9)


def test_the_bootstrap_of_tests_alike_is_that_of_their_mean(batch_of):
    gains = 15.0 * (1 + 0.02 * np.random.default_rng(2).standard_normal(20))
    estimates, _, _ = assessed(batch_of(alike(gains)), INTEGRATOR)
    rng = np.random.default_rng(3)
    means = rng.choice(gains, (20000, 20)).mean(axis=1)
    # Percentiles at 2.5 % of 999 draws scatter by √(0.025·0.975/999)/φ(1.96) = 0.084 standard errors.
    close = 4 * 0.084 * np.std(gains) / np.sqrt(20)
    assert estimates["gain"].bootstrap == pytest.approx(np.percentile(means, [2.5, 97.5]), abs=close)


def test_the_dead_zones_error_moves_the_gain(batch_of):
    tests, size = alike([15.0, 15.1, 14.9, 15.2, 15.0]), 1e-4
    estimates, _, moved = assessed(batch_of(tests), INTEGRATOR, dead_zone=DeadZoneError(size, 3))
    other, _, _ = assessed(batch_of(tests, dead_zone=size), INTEGRATOR)
    shift = np.log(other["gain"].value / estimates["gain"].value) / np.log(1e4)
    # Fitted anew above and below: of the second order in a shift of 2·10⁻⁴.
    assert moved.by_dead_zone[0] == pytest.approx(shift, rel=1e-3)
    without, _, _ = assessed(batch_of(tests), INTEGRATOR)
    of_zone = moved.by_dead_zone[0] * np.log(1e4) * estimates["gain"].value
    assert estimates["gain"].error == pytest.approx(np.hypot(without["gain"].error, of_zone), rel=1e-6)


@pytest.mark.parametrize(
    ("structure", "verdict"),
    [
        ("integrator", "determined as delay and lag together: this form has no lag"),
        ("integrator-first-order", "determined"),
    ],
)
def test_without_a_lag_dead_time_is_delay_and_lag(batch_of, structure, verdict):
    rng = np.random.default_rng(0)
    commands = [levels(rng, SAMPLES, low=0.2) for _ in range(6)]
    tests = [(command, held([15.0], [0.15, 1.0, 0.0], shifted(command, 8))) for command in commands]
    form = ModelSpec(structure_named(structure), dead_time=True)
    estimates, _, _ = assessed(batch_of(noisy(tests, 0.05)), form)
    assert estimates["dead_time"].verdict == verdict
    # A lag delays a constant speed by its time constant; from step to step it does so by less.
    low, high = (0.08, 0.23) if structure == "integrator" else (0.075, 0.085)
    assert low < estimates["dead_time"].value < high


def test_a_parameter_that_moves_nothing_is_not_determined(batch_of):
    command = levels(np.random.default_rng(0), SAMPLES, low=0.2)
    tests = [(command, held(*lag(15.0, 0.05), command)) for _ in range(12)]
    form = ModelSpec(structure_named("integrator-first-order"), valve_curve=True)
    fit = find_parameters(batch_of(noisy(tests, 0.3)), form, MultiStart(evaluations=10**4, starts=3), 0)
    names = [parameter.name for parameter in form.parameters]
    index, others = names.index("saturation"), [n for n, name in enumerate(names) if name != "saturation"]
    position = fit.position.copy()
    position[index] = 0.9
    position[others] = refine_subset(fit.objective, others, [position], 50, 1e-12).position
    assessment, _ = assess(fit.objective, position, units=UNITS)
    saturation = next(quantity for quantity in assessment.parameters if quantity.name == "saturation")
    assert saturation.error is None
    assert not saturation.determined
    assert saturation.interval[1] is None


def test_a_profile_allows_what_another_dead_zone_would(batch_of):
    command = levels(np.random.default_rng(0), SAMPLES, low=0.4)
    tests = [(command, held(*lag(15.0, 0.7), command)) for _ in range(8)]
    batch = batch_of(noisy(tests, 0.3))
    misfit = Objective.of(batch, LAG)
    position = misfit.position(np.array([15.0, 0.7]))
    sure = profile(misfit, position, 0)
    unsure = profile(misfit, position, 0, DeadZoneError(0.02, 3))
    assert unsure.lower < sure.lower
    assert unsure.upper > sure.upper


def test_what_follows_from_parameters_has_their_interval(batch_of):
    command = levels(np.random.default_rng(0), SAMPLES, low=0.2)
    tests = [(command, held(*lag(15.0, 0.7), command)) for _ in range(8)]
    estimates, assessment, moved = assessed(batch_of(noisy(tests, 0.3)), LAG)
    derived = {quantity.name: quantity for quantity in assessment.derived}
    tau, gain = estimates["time_constant"], estimates["gain"]
    assert derived["beta4 = tau"].value == tau.value
    assert derived["alpha2 = K"].value == pytest.approx(gain.value * tau.value, rel=1e-12)
    # ln K = ln K/τ + ln τ: its variance is the sum of theirs and twice their covariance.
    errors = np.array([gain.error / gain.value, tau.error / tau.value])
    correlation = np.array(assessment.correlation)
    assert correlation[0, 1] == pytest.approx(correlation[1, 0])
    assert np.diag(correlation) == pytest.approx([1.0, 1.0])
    variance = errors @ correlation @ errors
    lower, upper = derived["alpha2 = K"].interval
    reach = stats.t.ppf(0.975, np.min(moved.degrees_of_freedom)) * np.sqrt(variance)
    assert np.log(upper / lower) == pytest.approx(2 * reach, rel=1e-3)
    assert derived["alpha2 = K"].determined


def test_a_lag_without_end_leaves_its_gain_open(batch_of):
    command = levels(np.random.default_rng(0), SAMPLES, low=0.2)
    tests = [(command, 15.0 * held([1.0], [1.0, 0.0], command)) for _ in range(8)]
    estimates, assessment, _ = assessed(batch_of(noisy(tests, 0.1)), LAG)
    tau = estimates["time_constant"]
    assert tau.interval[1] is None
    assert tau.interval[0] > SAMPLES * STEP_S
    assert not tau.determined
    assert tau.verdict == f"only K/τ is determined: τ > {tau.interval[0]:.3g} s at 95 %"
    assert estimates["gain"].determined
    derived = {quantity.name: quantity for quantity in assessment.derived}
    assert derived["alpha2 = K"].interval[1] is None
    assert not derived["alpha2 = K"].determined


def test_only_the_lag_of_a_fast_plant_is_determined(batch_of):
    # ωh = 2000 rad/s lies beyond the bound of 1000 rad/s and the samples; damping 40 makes a lag of 0.04 s.
    command = levels(np.random.default_rng(0), SAMPLES, low=0.2)
    travel = held([15.0], [0.04, 1.0, 0.0], command)
    estimates, assessment, _ = assessed(batch_of(noisy([(command, travel)] * 8, 0.02)), SECOND_ORDER)
    derived = {quantity.name: quantity for quantity in assessment.derived}
    assert derived["lag 2ξh/ωh"].determined
    lower, upper = derived["lag 2ξh/ωh"].interval
    assert lower <= 0.04 <= upper
    for name in ("natural_frequency", "damping_ratio"):
        assert estimates[name].interval[1] is None
        assert estimates[name].verdict.startswith("only lag 2ξh/ωh is determined: ")
    assert not derived["beta1 (beta3 = 1)"].determined


def test_sensitivities_are_those_of_the_error_to_a_hundredth(batch_of):
    batch = batch_of(alike([15.0, 14.0, 16.0, 15.5, 14.5]))
    estimates, _, _ = assessed(batch, INTEGRATOR)
    misfit = Objective.of(batch, INTEGRATOR)
    gains = estimates["gain"].value * np.array([1.0, 0.99, 1.01])
    best, *perturbed = (float(misfit(misfit.position(np.array([gain]))[None])[0]) for gain in gains)
    assert estimates["gain"].sensitivity == pytest.approx(
        np.mean(np.abs(np.array(perturbed) / best - 1)), rel=1e-6
    )
