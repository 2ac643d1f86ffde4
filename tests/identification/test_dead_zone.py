"""Dead zones found again from made-up ramps and dynamic tests."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from hitchid._support.precision import double_precision
from hitchid.errors import LogError
from hitchid.identification.dead_zone import (
    CANDIDATES,
    LAGS_S,
    SEARCH_TOLERANCE,
    from_onsets,
    from_ramps,
    from_tests,
    ramp_rate,
    response_delay,
    with_dynamics,
)
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.structures import Batch
from hitchid.uncertainty.scores import t_quantile
from truth import STEP_S, held, levels, second_order, shifted

# The current sensor of the bench: 0.3 % of 3 A. Nobody can read a dead zone better off its logs.
SENSOR_A = 0.009
SAMPLES = 1000


@pytest.fixture
def ramp(make_record):
    """Return a function that makes a ramp from 0 to 1 A in 10 s over a valve with a given flow."""

    def make(dead_zone, *, power=1.0, drift=0.0, direction=1, noise=0.0, seed=0, mode=LIFTING):
        time_s = STEP_S * np.arange(SAMPLES)
        command = time_s / time_s[-1]
        # ∫ 30 (u − d)^p dt of a straight ramp, in closed form.
        beyond = np.maximum(command - dead_zone, 0.0)
        travel = 30.0 * beyond ** (power + 1) / (power + 1) * time_s[-1]
        displacement = 80.0 + direction * travel + drift * time_s
        displacement += noise * np.random.default_rng(seed).standard_normal(SAMPLES)
        commands = {mode: command, (LOWERING if mode == LIFTING else LIFTING): 0 * command}
        return make_record(displacement, commands[LIFTING], commands[LOWERING])

    return make


@pytest.mark.parametrize(("mode", "direction", "drift"), [(LIFTING, 1, -0.5), (LOWERING, -1, 0.0)])
@pytest.mark.parametrize("power", [1.0, 2.0])
@pytest.mark.parametrize("dead_zone", [0.2, 0.5])
def test_a_ramps_onset_is_found_whatever_flow_and_drift(ramp, dead_zone, power, mode, direction, drift):
    record = ramp(dead_zone, power=power, drift=drift, direction=direction, noise=0.01, mode=mode)
    zone = from_ramps([record], mode, direction)
    assert abs(zone.value - dead_zone) <= SENSOR_A
    assert (zone.spread, zone.count, zone.origin) == (None, 1, "ramps")


@pytest.mark.parametrize("drift", [-0.5, 0.0])
def test_a_ramp_over_a_valve_without_dead_zone_shows_none(ramp, drift):
    assert from_ramps([ramp(0.0, drift=drift, noise=0.01)], LIFTING, 1).value <= SENSOR_A


def test_repeats_give_their_mean_and_their_spread(ramp):
    zones = (0.33, 0.35, 0.40)
    zone = from_ramps([ramp(zone) for zone in zones], LIFTING, 1)
    half = 0.5 * 0.95 / CANDIDATES
    assert zone.value == pytest.approx(np.mean(zones), abs=half)
    # Three errors of at most half a spacing change a deviation over √2 by √3/√2 of that at most.
    assert zone.spread == pytest.approx(np.std(zones, ddof=1), abs=1.23 * half)
    assert zone.count == 3


@pytest.mark.parametrize(("drift", "noise"), [(0.0, 0.0), (0.5, 0.01), (0.0, 0.01)])
def test_a_ramp_that_ends_before_the_piston_moves_is_refused(ramp, drift, noise):
    with pytest.raises(LogError, match=r"1 A .*piston"):
        from_ramps([ramp(1.5, drift=drift, noise=noise)], LIFTING, 1)


def dynamic(rng, dead_zone, *, time_constant=0.0, dead_samples=0, noise=0.0, signed=False):
    """Return command, travel and which samples count of one test of K/(s(τs+1)) behind a dead zone."""
    command = levels(rng, SAMPLES, low=-1.0 if signed else 0.1, high=1.0)
    effective = np.sign(command) * np.maximum(np.abs(command) - dead_zone, 0.0)
    denominator = [time_constant, 1.0, 0.0] if time_constant else [1.0, 0.0]
    travel = shifted(held([30.0], denominator, effective), dead_samples)
    return command, travel + noise * rng.standard_normal(SAMPLES), np.ones(SAMPLES, dtype=bool)


@pytest.mark.parametrize(("dead_zone", "signed"), [(0.2, False), (0.35, True), (0.5, True)])
def test_tests_of_an_integrator_give_its_dead_zone(dead_zone, signed):
    rng = np.random.default_rng(0)
    zone = from_tests([dynamic(rng, dead_zone, signed=signed) for _ in range(4)], STEP_S)
    assert abs(zone.value - dead_zone) <= 0.95 / CANDIDATES
    assert (zone.count, zone.origin) == (4, "tests")


@pytest.mark.parametrize(("time_constant", "dead_samples"), [(0.08, 0), (0.5, 0), (0.05, 5)])
def test_no_lag_or_dead_time_passes_for_a_dead_zone(time_constant, dead_samples):
    rng = np.random.default_rng(0)
    tests = [dynamic(rng, 0.35, time_constant=time_constant, dead_samples=dead_samples) for _ in range(4)]
    assert abs(from_tests(tests, STEP_S).value - 0.35) <= SENSOR_A


@pytest.mark.parametrize("count", [1, 4])
def test_the_standard_error_tells_how_far_off_it_is(count):
    rng = np.random.default_rng(0)
    zones = [from_tests([dynamic(rng, 0.35, noise=3.0) for _ in range(count)], STEP_S) for _ in range(10)]
    misses, errors = ([zone.value - 0.35 for zone in zones], [zone.spread for zone in zones])
    ratio = np.mean(np.square(misses)) / np.mean(np.square(errors))
    # Ten estimates have ten degrees of freedom about the truth, ten jackknifes over four tests thirty.
    # Stretches of one test err alike, so that they tell less: within a factor of four, not of nought.
    least, most = stats.f.ppf([0.0005, 0.9995], 10, 30) if count > 1 else (0.0, 16.0)
    assert least <= ratio <= most


def test_samples_that_do_not_count_are_not_looked_at():
    rng = np.random.default_rng(0)
    tests = []
    for _ in range(3):
        command, travel, counted = dynamic(rng, 0.35)
        counted[600:] = False
        tests.append((command, np.where(counted, travel, -1e3), counted))
    assert abs(from_tests(tests, STEP_S).value - 0.35) <= 0.95 / CANDIDATES


def test_a_long_log_takes_little_memory():
    command = np.where(np.arange(100_000) % 2000 < 1000, 0.3 + 5e-6 * np.arange(100_000), 0.0)
    travel = np.cumsum(np.maximum(command - 0.35, 0.0)) * 0.3
    tracemalloc.start()
    zone = from_tests([(command, travel, np.ones(command.size, bool))], STEP_S)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # A column of 100 000 numbers for each of 400 candidates and six columns would be 1.9 GB.
    assert peak < 0.5e9
    assert abs(zone.value - 0.35) <= 1.0 / CANDIDATES


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_one_level_of_command_does_not_tell_the_dead_zone(noise):
    rng = np.random.default_rng(0)
    tests = []
    for _ in range(3):
        command = np.where(levels(rng, SAMPLES) > 0.5, 0.8, 0.0)
        travel = held([30.0], [1.0, 0.0], np.maximum(command - 0.35, 0.0))
        travel += noise * rng.standard_normal(SAMPLES)
        tests.append((command, travel, np.ones(SAMPLES, dtype=bool)))
    zone = from_tests(tests, STEP_S)
    # Unknown is not exact: the error is half of the level.
    assert (zone.value, zone.spread, zone.count, zone.origin) == (0.0, 0.4, 3, "none")


def test_a_delay_shorter_than_the_shortest_lag_may_be_half_of_it():
    rng = np.random.default_rng(0)
    assert response_delay([dynamic(rng, 0.35) for _ in range(4)], 0.35, STEP_S) == 0.5 * LAGS_S[0]


@pytest.mark.parametrize("delay_s", [0.1, 0.3])
def test_a_fast_ramp_makes_the_dead_zone_less_sure(ramp, delay_s):
    rng = np.random.default_rng(0)
    tests = [dynamic(rng, 0.35, dead_samples=round(delay_s / STEP_S)) for _ in range(4)]
    delay = response_delay(tests, 0.35, STEP_S)
    assert delay == pytest.approx(delay_s)
    late = delay * ramp_rate(ramp(0.35), LIFTING)
    zone = from_onsets([0.35 + late], late)
    assert zone.error.standard_error == pytest.approx(late)
    lower, upper = zone.to_quantity("A").interval
    assert lower <= 0.35 <= upper


def test_no_dead_zone_is_one_of_about_zero():
    rng = np.random.default_rng(0)
    zone = from_tests([dynamic(rng, 0.0, noise=1.0) for _ in range(4)], STEP_S)
    assert zone.value <= zone.error.standard_error
    assert 0 < zone.error.standard_error < 0.1


def test_on_a_slow_clock_a_lag_is_no_zone():
    rng = np.random.default_rng(0)
    tests = [dynamic(rng, 0.0, time_constant=3 * STEP_S) for _ in range(6)]
    # The same samples on a clock of 1 s, where three of them are longer than the longest lag of a fast clock.
    zone = from_tests([(command, travel / STEP_S, counts) for command, travel, counts in tests], 1.0)
    assert zone.value <= 0.95 / CANDIDATES


def test_a_dead_zone_at_the_grids_end_has_an_error():
    rng = np.random.default_rng(0)
    # Only the largest level moves the piston: any dead zone just below it would do.
    command = np.where(rng.random((4, SAMPLES)) > 0.5, 1.0, 0.9)
    travels = np.cumsum(np.maximum(command - 0.99, 0.0), axis=1) * 30.0 * STEP_S
    zone = from_tests([(u, w, np.ones(SAMPLES, bool)) for u, w in zip(command, travels, strict=True)], STEP_S)
    assert zone.error.standard_error >= 0
    assert zone.value + zone.error.standard_error >= 0.9


def dead_zone_of(records):
    """Return the dead zone of tests with lifting commands, and the tests behind it."""
    tests = [(record.command(LIFTING), record.displacement, np.ones(len(record), bool)) for record in records]
    first = from_tests(tests, STEP_S)
    return first, Batch.of(records, LIFTING, dead_zone=first.value, sign=1)


def lagging(command, omega, damping):
    """Return the travel of a second-order lag behind a dead zone of 0.35."""
    return held(*second_order(30.0, omega, damping), np.maximum(command - 0.35, 0.0))


@pytest.mark.parametrize(
    ("omega", "damping", "dead_samples"), [(6.0, 0.15, 0), (10.0, 1.5, 20), (60.0, 0.3, 20)]
)
@double_precision
def test_dynamics_that_no_sum_of_lags_is_do_not_move_a_dead_zone(make_record, omega, damping, dead_samples):
    rng = np.random.default_rng(0)
    commands = [levels(rng, SAMPLES, low=0.1) for _ in range(4)]
    first, tests = dead_zone_of(
        [make_record(shifted(lagging(u, omega, damping), dead_samples), u) for u in commands]
    )
    zone = with_dynamics(first, tests)
    assert abs(zone.value - 0.35) <= SEARCH_TOLERANCE < abs(first.value - 0.35)
    assert (zone.spread, zone.count, zone.origin) == (first.spread, 4, "tests")


@double_precision
def test_tests_that_are_looked_at_on_a_coarse_clock_have_the_same_dead_zone(make_record):
    time_s = STEP_S * np.arange(6000)
    commands = [0.5 - 0.5 * np.cos(2 * np.pi * hertz * time_s) for hertz in (0.2, 0.3, 0.4, 0.5)]
    first, tests = dead_zone_of([make_record(lagging(command, 6.0, 0.3), command) for command in commands])
    assert tests.coarse().command.shape[1] < tests.command.shape[1]
    assert abs(with_dynamics(first, tests).value - 0.35) <= SEARCH_TOLERANCE < abs(first.value - 0.35)


@double_precision
def test_where_noise_hides_which_is_right_the_difference_is_the_error(make_record):
    rng = np.random.default_rng(0)
    commands = [levels(rng, SAMPLES, low=0.1) for _ in range(4)]
    noisy = [lagging(u, 10.0, 1.5) + 2.0 * rng.standard_normal(SAMPLES) for u in commands]
    first, tests = dead_zone_of([make_record(x, u) for x, u in zip(noisy, commands, strict=True)])
    zone = with_dynamics(replace(first, value=0.37, spread=1e-4), tests)
    assert zone.value == 0.37
    # The difference is known as well as the dead zone that the same tests give.
    assert abs(zone.spread - 0.02) <= t_quantile(first.error.degrees_of_freedom) * first.spread


@double_precision
def test_a_dead_zone_at_the_edge_of_the_search_is_as_uncertain_as_it_moved(make_record):
    rng = np.random.default_rng(0)
    commands = [levels(rng, SAMPLES, low=0.1) for _ in range(4)]
    first, tests = dead_zone_of([make_record(lagging(u, 10.0, 1.5), u) for u in commands])
    zone = with_dynamics(replace(first, value=0.05, spread=1e-4), tests)
    assert zone.value == pytest.approx(0.05 + zone.spread)
    lower, upper = zone.to_quantity("A").interval
    assert lower <= 0.35 <= upper
