"""Phase 1 finds the parameters of plants simulated by scipy, and tells how well."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hitchid.errors import FitError, InputError
from hitchid.estimation import Search, SearchResult
from hitchid.estimation.objective import GAIN_RIDGE, RIDGE_FLOOR, Objective, _per_test_gain_residuals
from hitchid.identification import ModelSpec, MultiStart
from hitchid.identification.direction import _within_update_interval
from hitchid.identification.phase1 import identify_benchmark
from hitchid.logs.record import LIFTING
from hitchid.structures import Batch, structure_named
from truth import STEP_S, held, lag, levels, second_order, shifted

UNITS = {"x": "mm", "u": "A"}
SAMPLES = 250
SECOND_ORDER = structure_named("integrator-second-order")
LAG = structure_named("first-order-lag")
INTEGRATOR = structure_named("integrator")


def plants(fraction, *, tests=2, dead_samples=0.0):
    """Return commands and travels of tests of one plant, each of shape [N], dead time in tenths exact."""
    rng = np.random.default_rng(0)
    commands = [levels(rng, SAMPLES, low=0.2) for _ in range(tests)]
    fine = [shifted(np.repeat(command, 10), round(10 * dead_samples)) for command in commands]
    return [(u, held(*fraction, v, STEP_S / 10)[::10]) for u, v in zip(commands, fine, strict=True)]


@pytest.fixture
def batch_of(make_record):
    def make(tests, *, direction=1, noise=0.0, rng=None, end_stop=None, start=None):
        records = []
        for command, travel in tests:
            shown = travel if end_stop is None else np.minimum(travel, end_stop)
            noisy = shown + (noise * rng.standard_normal(travel.size) if rng else 0.0)
            records.append(make_record(80.0 + direction * noisy, command))
        stop = None if end_stop is None else 80.0 + direction * end_stop
        initial = None if start is None else [start] * len(records)
        return Batch.of(records, LIFTING, dead_zone=0.0, sign=direction, end_stop=stop, initial=initial)

    return make


def identified(batch, structure, *, search=None, seed=0, **form):
    return identify_benchmark(
        batch, ModelSpec(structure, **form), search or MultiStart(evaluations=150), seed, units=UNITS
    )


def values(phase1):
    return {estimate.name: estimate.value for estimate in phase1.parameter_estimates}


@pytest.mark.parametrize(("omega", "damping", "direction"), [(18.0, 0.3, 1), (25.0, 0.8, -1), (18.0, 1.8, 1)])
def test_gain_natural_frequency_and_damping_are_found_again(batch_of, omega, damping, direction):
    batch = batch_of(plants(second_order(21.0, omega, damping)), direction=direction)
    phase1 = identified(batch, SECOND_ORDER)
    expected = {"gain": 21.0, "natural_frequency": omega, "damping_ratio": damping}
    assert values(phase1) == pytest.approx(expected, rel=1e-6)
    assert {estimate.verdict for estimate in phase1.parameter_estimates} == {"determined"}
    # Rounding of displacements of 80 mm and of sums over 250 samples.
    assert phase1.rmse <= 250 * np.finfo(float).eps * 100.0
    assert phase1.rmse <= phase1.search_rmse


@pytest.mark.parametrize("direction", [1, -1])
def test_speed_and_time_constant_of_a_lag_are_found_again(batch_of, direction):
    phase1 = identified(batch_of(plants(lag(15.0, 0.7)), direction=direction), LAG)
    assert values(phase1) == pytest.approx({"gain": 15.0, "time_constant": 0.7}, rel=1e-6)
    follows = {quantity.name: (quantity.value, quantity.unit) for quantity in phase1.assessment.derived}
    assert follows["alpha2 = K"] == (pytest.approx(15.0 * 0.7, rel=1e-6), "mm/A")
    assert follows["beta4 = tau"] == (pytest.approx(0.7, rel=1e-6), "s")
    assert phase1.parameter_estimates[0].unit == "mm/(s·A)"


@pytest.mark.parametrize("dead_samples", [3.7, 12.4])
def test_a_dead_time_is_found_again(batch_of, dead_samples):
    batch = batch_of(plants(lag(15.0, 0.7), dead_samples=dead_samples))
    phase1 = identified(batch, LAG, dead_time=True, search=MultiStart(evaluations=600))
    expected = {"gain": 15.0, "time_constant": 0.7, "dead_time": dead_samples * STEP_S}
    assert values(phase1) == pytest.approx(expected, rel=1e-6)
    assert phase1.benchmark.named_values() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("update_s", "determined"), [(0.02, True), (0.1, False)])
def test_a_dead_time_is_unsure_by_the_sensors_interval(batch_of, update_s, determined):
    phase1 = identified(
        batch_of(plants(lag(15.0, 0.7), dead_samples=12.4)), LAG, dead_time=True, search=MultiStart(600)
    )
    *others, widened = _within_update_interval(phase1, update_s).parameter_estimates
    low, high = phase1.parameter_estimates[-1].interval
    assert widened.interval == pytest.approx((low - update_s, high))
    assert widened.determined == determined
    assert determined or "the sensor is updated every 0.1 s, by which it may be shorter" in widened.verdict
    assert tuple(others) == phase1.parameter_estimates[:-1]


class EndsInALocalMinimum(Search):
    """A search that ends at a dead time of 0.25 s before hardly any lag, from where nothing descends."""

    name = "ends in a local minimum"

    def minimise(self, problem, seed, callback=None):
        best = np.array([0.5, 0.95, 0.0, np.log(0.25 / 1e-4) / np.log(1.0 / 1e-4)])
        return SearchResult(best, 1.0, 1, 0, "", np.ones(1), best[None])


def test_a_dead_time_does_not_stand_for_the_lag_too(batch_of):
    fraction = ([21.0], [0.15, 1.0, 0.0])
    rng = np.random.default_rng(0)
    commands = [np.repeat(rng.permutation([0.1, 1.0] * 5), 25) for _ in range(3)]
    tests = [(command, held(*fraction, shifted(command, 8))) for command in commands]
    phase1 = identified(batch_of(tests), SECOND_ORDER, dead_time=True, search=EndsInALocalMinimum())
    # The lag 2ξ/ω and the delay; a second-order lag at its bound of 1000 rad/s is a little less than one.
    gain, omega, damping, dead_time = values(phase1).values()
    assert (gain, 2 * damping / omega, dead_time) == pytest.approx((21.0, 0.15, 0.08), rel=0.01)


def test_samples_at_an_end_stop_do_not_spoil_the_parameters(batch_of):
    tests = plants(lag(15.0, 0.7))
    stop = 0.6 * max(float(travel.max()) for _, travel in tests)
    phase1 = identified(batch_of(tests, end_stop=stop), LAG)
    assert values(phase1) == pytest.approx({"gain": 15.0, "time_constant": 0.7}, rel=1e-6)


def test_standard_errors_cover_plants_that_differ_from_test_to_test(batch_of):
    # The gain varies by 5 % from test to test: residuals of one test hang together, and one estimate from
    # eight tests scatters by what the textbook's white residuals would understate many times.
    estimates, rng = [], np.random.default_rng(1)
    tests = plants(([1.0], [1.0, 0.0]), tests=8)
    for _ in range(30):
        varied = [(command, 15.0 * (1 + 0.05 * rng.standard_normal()) * travel) for command, travel in tests]
        batch = batch_of(varied, noise=0.05, rng=rng)
        phase1 = identified(batch, INTEGRATOR, search=MultiStart(20, starts=1))
        estimates.append(phase1.parameter_estimates[0])
    scatter = np.std([estimate.value for estimate in estimates], ddof=1)
    reported = np.sqrt(np.mean([estimate.error**2 for estimate in estimates]))
    # Between these lies the standard deviation of thirty draws, but for 1 in 1000 cases.
    least, most = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], 29) / 29)
    # The mean square of 30 errors of 7 degrees of freedom each scatters by √(2/210) more.
    assert least / 1.2 <= scatter / reported <= most * 1.2


def test_a_lag_far_beyond_the_tests_is_not_determined(batch_of):
    # With τ = 500 s a test of 2.5 s bends by K u t²/2τ ≈ 0.05 mm, below the 0.1 mm by which the start, a mean
    # of six samples, is uncertain: a standard error of 1/τ of more than 1/τ itself. That an estimate lies two
    # standard errors out, which is 50 % of itself, has probability 0.023 for a normal distribution and 0.12
    # for four degrees of freedom (one-sided 0.06); more than three of ten seeds, 0.002.
    tests = plants(lag(15.0, 500.0), tests=6)
    called = []
    for seed in range(10):
        batch = batch_of(tests, noise=0.3, rng=np.random.default_rng(seed))
        phase1 = identified(batch, LAG, search=MultiStart(evaluations=60))
        called.append(phase1.parameter_estimates[1].determined)
    assert called.count(True) <= 3


@pytest.mark.parametrize(
    ("bounds", "verdict"),
    [((1.0, 2.0), "at its lower bound: "), ((0.1, 0.5), "at its upper bound: "), ((0.5, 1.0), "determined")],
)
def test_bounds_are_kept_and_named_in_the_verdict(batch_of, bounds, verdict):
    phase1 = identified(batch_of(plants(lag(15.0, 0.7))), LAG, bounds={"time_constant": bounds})
    estimate = phase1.parameter_estimates[1]
    assert (estimate.lower, estimate.upper) == pytest.approx(bounds)
    assert bounds[0] <= estimate.value * (1 + 1e-12)
    assert estimate.value <= bounds[1] * (1 + 1e-12)
    assert estimate.verdict.startswith(verdict)
    # Bounds that are given are knowledge: they end the interval.
    assert bounds[0] <= estimate.interval[0] <= estimate.interval[1] <= bounds[1]


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"tau": (0.1, 1.0)}, "no parameter 'tau'; expected one of gain, time_constant"),
        ({"dead_time": (0.1, 1.0)}, "no parameter 'dead_time'"),
        ({"gain": (2.0, 1.0)}, "'gain': expected 0 < lower < upper, got 2 and 1"),
        ({"gain": (0.0, 1.0)}, "expected 0 < lower < upper"),
        ({"gain": (1.0, float("inf"))}, "expected 0 < lower < upper"),
        ({"gain": (float("nan"), 1.0)}, "expected 0 < lower < upper"),
    ],
)
def test_bounds_that_make_no_sense_are_refused(batch_of, bounds, message):
    with pytest.raises(InputError, match=message):
        identified(batch_of(plants(lag(15.0, 0.7))), LAG, bounds=bounds)


def test_tests_in_which_nothing_happens_are_refused(batch_of):
    ((command, travel), _) = plants(lag(15.0, 0.7))
    with pytest.raises(FitError, match="command never exceeds the dead zone"):
        identified(batch_of([(0 * command, travel)]), LAG)
    with pytest.raises(FitError, match="piston does not move"):
        identified(batch_of([(command, 0 * travel)]), LAG)


def sloping(slope, factors, *, gain=15.0):
    """Return tests of an integrator whose gain grows by exp(slope · travel), each by a factor of its own.

    Travel goes on by one step a sample, as the benchmark's does.
    """
    rng, tests = np.random.default_rng(0), []
    for factor in factors:
        command = levels(rng, SAMPLES, low=rng.uniform(0.2, 0.6))
        travel = np.zeros(SAMPLES)
        for k, u in enumerate(command[:-1]):
            travel[k + 1] = travel[k] + factor * gain * np.exp(slope * travel[k]) * u * STEP_S
        tests.append((command, travel))
    return tests


@pytest.mark.parametrize("slope", [0.015, 0.0, -0.01])
def test_a_slope_is_found_again_although_tests_differ(batch_of, slope):
    rng = np.random.default_rng(0)
    tests = sloping(slope, 1 + 0.03 * rng.choice([-1.0, 1.0], 8))
    batch = batch_of(tests, noise=0.02, rng=rng, start=80.0)
    # A slope is measured in half of the range of displacement, mm.
    half_range = 0.5 * float(np.ptp(np.asarray(batch.displacement)[np.asarray(batch.loss_mask)]))
    estimates = identified(batch, INTEGRATOR, stroke_gain_linear=True).parameter_estimates
    (estimate,) = (quantity for quantity in estimates if quantity.name == "position_slope")
    # Noise of 0.02 mm at 2000 samples of some 15 mm of travel: the slope is known to a hundredth.
    assert estimate.error < 0.05 * (abs(slope) or 0.01) * half_range
    # Four standard errors: 1 in 16000 for each.
    assert abs(estimate.value - slope * half_range) <= 4 * estimate.error
    assert estimate.verdict == "determined"


def test_the_gain_beside_a_slope_fits_all_tests_together(batch_of):
    tests = sloping(0.015, 1 + 0.03 * np.array([-1.0, 1.0, 1.0, 1.0, -1.0, 1.0]))
    batch = batch_of(tests, start=80.0)
    phase1 = identified(batch, INTEGRATOR, stroke_gain_linear=True)
    pooled = Objective.of(batch, ModelSpec(INTEGRATOR, stroke_gain_linear=True)).pooled()
    gain, slope = (estimate.value for estimate in phase1.parameter_estimates)

    def rmse(factor):
        return float(pooled(jnp.asarray(pooled.position(np.array([factor * gain, slope])))[None])[0])

    assert rmse(1.0) == pytest.approx(phase1.rmse, rel=1e-9)
    # No gain a hundredth larger or smaller fits better, and none fits tests that differ by 6 %.
    assert rmse(1.0) < min(rmse(0.99), rmse(1.01))
    assert phase1.rmse > 0.01 * float(np.abs(tests[0][1]).max())


def test_only_a_slope_sets_enough_tests_apart(batch_of):
    made = plants(lag(15.0, 0.7), tests=6)
    batch, sloped = batch_of(made), ModelSpec(INTEGRATOR, stroke_gain_linear=True)
    assert Objective.of(batch, sloped).per_test_gain
    assert not Objective.of(batch_of(made[:5]), sloped).per_test_gain
    assert not Objective.of(batch, sloped).pooled().per_test_gain
    assert not Objective.of(batch, ModelSpec(INTEGRATOR)).per_test_gain
    assert not Objective.of(batch, ModelSpec(INTEGRATOR, stroke_gain_quadratic=True)).per_test_gain


@given(seed=st.integers(0, 2**16), size=st.floats(-2.0, 3.0), other=st.floats(-5.0, 5.0))
def test_misses_apart_are_those_of_the_best_factors(seed, size, other):
    rng = np.random.default_rng(seed)
    measured = np.concatenate([np.zeros((3, 1)), rng.normal(size=(3, 20))], axis=1)
    travel = size * measured + np.concatenate([np.zeros((3, 1)), rng.normal(size=(3, 20))], axis=1)
    residuals = np.asarray(_per_test_gain_residuals(jnp.asarray(travel), jnp.asarray(measured)))
    squares = np.sum(residuals**2, axis=1)
    moved = np.sum(measured**2, axis=1)
    held = GAIN_RIDGE * (moved + RIDGE_FLOOR * moved.mean())

    def objective(factor):
        return np.sum((factor * travel - measured) ** 2, axis=1) + held * (factor - 1) ** 2

    best = (np.sum(travel * measured, axis=1) + held) / (np.sum(travel**2, axis=1) + held)
    rounding = 1e-12 * np.sum(measured**2 + travel**2, axis=1)
    exact = np.sum((best[:, None] * travel - measured) ** 2, axis=1) + held * (best - 1) ** 2
    np.testing.assert_allclose(squares, exact, rtol=0, atol=rounding.max())
    assert np.all(squares <= objective(other) + rounding * (1 + other**2))


def test_tests_that_fill_up_a_batch_change_nothing(batch_of):
    """Five tests are laid beside three that count nowhere, so that five to eight compile once."""
    batch = batch_of(plants(second_order(21.0, 18.0, 0.3), tests=5), noise=0.1, rng=np.random.default_rng(3))
    misfit = Objective.of(batch, ModelSpec(INTEGRATOR, stroke_gain_linear=True))
    position = np.full(len(misfit.spec.parameters), 0.4)
    residuals, test = misfit.errors(position)
    assert misfit.with_data(batch.pad_batch()).batch.command.shape[0] == 8
    plain = np.asarray(misfit.residuals(jnp.asarray(position)))[np.asarray(batch.loss_mask)]
    # The same sums in programs of two shapes.
    bound = 10 * SAMPLES * np.finfo(float).eps * np.abs(plain).max()
    np.testing.assert_allclose(residuals, plain, rtol=0, atol=bound)
    jacobian = np.asarray(jax.jacfwd(misfit.residuals)(jnp.asarray(position)))[np.asarray(batch.loss_mask)]
    equations = misfit.problem().normal_equations(position)
    assert equations.cost == pytest.approx(float(plain @ plain), rel=1e-12)
    size = 1e-9 * np.abs(jacobian.T) @ np.abs(plain)
    assert np.all(np.abs(equations.gradient - jacobian.T @ plain) <= size)
    np.testing.assert_allclose(equations.curvature, jacobian.T @ jacobian, rtol=1e-9)
    assert set(test) == {0, 1, 2, 3, 4}
    assert misfit.rmse_by_test(position).shape == (5,)
    mean_square = float(np.mean(misfit.rmse_by_test(position) ** 2))
    assert mean_square == pytest.approx(float(misfit(jnp.asarray(position)[None])[0]) ** 2, rel=1e-9)
