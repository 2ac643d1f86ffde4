"""Speed map, dead zone, delay and response time hold what was simulated, with the coverage they claim."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal, stats

import handmade
from hitchid.estimation import Objective, refine
from hitchid.handover.responses import speed_lag, step_times
from hitchid.identification.dead_zone import DeadZone
from hitchid.logs.record import LIFTING
from hitchid.report.parameters_section import characteristic_sentences
from hitchid.structures import (
    NONLINEARITY_PARAMETERS,
    ModelSpec,
    PhysicalModel,
    Scales,
    StaticNonlinearity,
    speeds_at,
    structure_named,
)
from hitchid.structures.nonlinearity import NEUTRAL
from hitchid.uncertainty import DeadZoneError, characteristics
from hitchid.uncertainty.influence import Influence, compute_influence
from hitchid.uncertainty.profile import Profile
from hitchid.uncertainty.speed_map import measured_speeds, operating_levels
from truth import STEP_S, held, second_order, shifted

UNITS = {"x": "mm", "u": "A"}
FIRST_ORDER = ModelSpec(structure_named("integrator-first-order"), dead_time=True)
INTEGRATOR = ModelSpec(structure_named("integrator"))
GAIN, LAG_S, LATE = 30.0, 0.1, 5
LEVELS = (0.4, 0.7, 1.0)
SAMPLES = 200


def step(level, *, rest=20):
    return np.concatenate([np.zeros(rest), np.full(SAMPLES - rest, level)])


@cache
def unit_gain_travel(level):
    return held([1.0], [LAG_S, 1.0, 0.0], shifted(step(level), LATE))


def steps(rng, *, scatter, noise, levels=LEVELS * 3):
    """Return steps of plants whose gains scatter, K / (s (τ s + 1)) with a dead time, and sensor noise."""
    gains = [GAIN * (1 + scatter * rng.standard_normal()) for _ in levels]
    return [
        (step(level), gain * unit_gain_travel(level) + noise * rng.standard_normal(SAMPLES))
        for level, gain in zip(levels, gains, strict=True)
    ]


def fitted(batch, form, values, *, error=DeadZoneError(), profiles=()):  # noqa: B008
    """Return the characteristics from the least squares next to known values."""
    misfit = Objective.of(batch, form)
    problem = misfit.problem()
    position = refine(problem, misfit.position(np.array(values)), limit=30).position
    moved = compute_influence(misfit, position, np.ones(position.size, bool), error, seed=0)
    moved = moved._replace(profiles=tuple(profile(misfit, position) for profile in profiles))
    zone = DeadZone(float(batch.dead_zone[0]), None, 0, "given").to_quantity("A")
    return (
        characteristics(misfit, position, moved, dead_zone=zone, dead_zone_error=error, units=UNITS),
        moved,
        position,
    )


def test_the_speed_of_integrators_has_students_interval(batch_of):
    gains = GAIN * (1 + 0.02 * np.random.default_rng(1).standard_normal(6))
    command = step(0.5)
    outcome, _, _ = fitted(
        batch_of([(command, k * held([1.0], [1.0, 0.0], command)) for k in gains]), INTEGRATOR, [GAIN]
    )
    (point,) = outcome.speed_map
    reach = stats.t.ppf(0.975, gains.size - 1) * gains.std(ddof=1) / np.sqrt(gains.size)
    assert (point.command, point.load, point.determined) == (0.5, None, True)
    assert point.speed == pytest.approx(0.5 * gains.mean(), rel=1e-6)
    assert point.interval == pytest.approx(
        (0.5 * (gains.mean() - reach), 0.5 * (gains.mean() + reach)), rel=1e-5
    )
    assert (outcome.delay, outcome.response_time, outcome.opening) == (None, None, None)
    assert outcome.speed_unit == "mm/s"


def test_intervals_hold_the_truth_as_often_as_they_say(batch_of):
    draws, rng = 30, np.random.default_rng(5)
    values, ends = [], []
    for _ in range(draws):
        batch = batch_of(steps(rng, scatter=0.03, noise=0.05))
        outcome, _, _ = fitted(batch, FIRST_ORDER, [GAIN, LAG_S, LATE * STEP_S])
        quantities = [*outcome.speed_map, outcome.delay, outcome.response_time]
        values.append([getattr(quantity, "speed", None) or quantity.value for quantity in quantities])
        ends.append([quantity.interval for quantity in quantities])
        assert all(quantity.determined for quantity in quantities)
    late = LATE * STEP_S
    truth = [*(GAIN * level for level in LEVELS), late - LAG_S * np.log(0.95), late + LAG_S]
    lower, upper = np.moveaxis(np.array(ends), 2, 0)
    held_in = np.sum((lower <= truth) & (truth <= upper), axis=0)
    # Of 30 draws at 95 % fewer than 24 hold the truth once in a thousand times.
    assert held_in.min() >= stats.binom.ppf(1e-3, draws, 0.95)
    reach = stats.t.ppf(0.975, 6) * np.std(values, axis=0)
    assert np.mean(upper - lower, axis=0) == pytest.approx(2 * reach, rel=0.5)


def test_a_speed_that_occurred_is_known_without_dead_zone(batch_of):
    tests = steps(np.random.default_rng(2), scatter=0.01, noise=0.0, levels=(0.7,) * 9)
    values = [GAIN * 0.7 / 0.4, LAG_S, LATE * STEP_S]
    sure, _, _ = fitted(batch_of(tests, dead_zone=0.3), FIRST_ORDER, values)
    zone = DeadZoneError(0.05, 6)
    vague, moved, _ = fitted(batch_of(tests, dead_zone=0.3), FIRST_ORDER, values, error=zone)
    # The gain is K (c − d) over c − d: off by 0.05/0.4 with the dead zone, the speed not at all.
    assert moved.by_dead_zone[0] * np.log(1e4) == pytest.approx(0.05 / 0.4, rel=0.2)
    assert vague.speed_map[0].interval == pytest.approx(sure.speed_map[0].interval, rel=1e-4)


def profile_of(reach, fitness, *, lower=0.4, upper=0.6):
    """Return what makes a profile of the gain that others do not follow."""

    def make(misfit, position):
        positions = np.stack([position + shift * np.eye(position.size)[0] for shift in (-reach, 0.0, reach)])
        along = np.tile(np.eye(position.size)[0], (3, 1))
        room = float(np.log(misfit.bounds.upper[0] / misfit.bounds.lower[0]))
        return Profile(0, lower, upper, positions, np.array(fitness), np.ones(3, bool), along, room)

    return make


def test_a_profile_widens_a_speed_or_opens_it(batch_of):
    batch = batch_of(steps(np.random.default_rng(3), scatter=0.01, noise=0.02))
    values = [GAIN, LAG_S, LATE * STEP_S]
    plain, _, _ = fitted(batch, FIRST_ORDER, values)
    ratio = np.exp(0.05 * np.log(1e4))

    def profiled(*profiles):
        return fitted(batch, FIRST_ORDER, values, profiles=profiles)[0].speed_map[1]

    point = plain.speed_map[1]
    widened = profiled(profile_of(0.05, [1.1, 1.0, 1.1])).interval
    assert widened == pytest.approx((point.speed / ratio, point.speed * ratio), rel=1e-6)
    assert profiled(profile_of(0.05, [3.0, 1.0, 3.0])).interval == pytest.approx(point.interval)
    opened = profiled(profile_of(0.05, [1.1, 1.0, 1.1], upper=None))
    assert opened.interval[1] is None
    assert not opened.determined


def shaped(**values):
    neutral = {parameter.name: NEUTRAL.get(parameter.name, 0.0) for parameter in NONLINEARITY_PARAMETERS}
    scales = Scales(*map(jnp.asarray, (2.0, 100.0, 50.0)))
    return StaticNonlinearity(
        jnp.asarray([{**neutral, **values}[parameter.name] for parameter in NONLINEARITY_PARAMETERS]), scales
    )


def test_steady_speed_follows_the_valve_curve_and_the_load():
    curves = shaped(opening=0.1, exponent=1.5, saturation=0.6, position_curve=0.3).values.tolist()
    shape = handmade.scheduled(
        INTEGRATOR.structure, curves, (2.0, 100.0, 50.0), 10.0, 4.0, opening=0.05, gain=-0.2
    )
    benchmark = PhysicalModel(INTEGRATOR.structure, jnp.asarray([20.0]), jnp.zeros(()), *shape)
    commands, loads = np.array([0.4, 1.0, 2.2]), np.array([10.0, 14.0, 14.0])
    z, load = (np.maximum(commands - 0.3, 0) / 2.0), (loads - 10.0) / 4.0
    v = np.maximum(z - 0.05 * load - 0.1, 0) ** 1.5
    largest = 0.9**1.5  # of v, at the largest command and the load that the gain is of
    w = 2.0 * v / (1 + (v / 0.6) ** 4) ** 0.25 * (1 + (largest / 0.6) ** 4) ** 0.25 / largest
    expected = 20.0 * w * np.exp(-0.3 / 3 - 0.2 * load)
    computed = speeds_at(
        benchmark, jnp.asarray(commands), jnp.full(3, 100.0), jnp.asarray(loads)[:, None], 0.3
    )
    np.testing.assert_allclose(computed, expected, rtol=1e-12)


@pytest.mark.parametrize(("omega", "damping"), [(12.0, 0.3), (5.0, 1.0), (40.0, 8.0)])
def test_delay_and_response_time_are_those_of_the_step_response(omega, damping):
    structure = structure_named("integrator-second-order")
    benchmark = PhysicalModel(structure, jnp.asarray([30.0, omega, damping]), jnp.asarray(0.07))
    (num,), den = second_order(1.0, omega, damping)
    time_s, speed = signal.step(([num], den[:-1]), T=np.linspace(0, 40 * damping / omega, 200_001))
    for computed, part in zip(
        step_times(benchmark, 1.0, 0.3, speed_lag(structure, np.asarray(benchmark.values))),
        (0.05, 1 - np.exp(-1)),
        strict=True,
    ):
        exact = time_s[np.argmax(speed >= part)]
        assert float(computed) == pytest.approx(0.07 + exact, abs=0.01 * exact + 1e-4)


def test_a_lagging_spool_delays_motion():
    benchmark = PhysicalModel(
        INTEGRATOR.structure, jnp.asarray([30.0]), jnp.asarray(0.02), shaped(spool_lag=0.2)
    )
    delay, response_time = step_times(benchmark, 1.0, 0.5, 0.0)
    # c (1 − exp(−t/τ)) − d is a part p of c − d at t = τ ln(c / ((1 − p) (c − d))).
    for computed, part in ((delay, 0.05), (response_time, 1 - np.exp(-1))):
        assert float(computed) == pytest.approx(0.02 + 0.2 * np.log(2 / (1 - part)), rel=0.01)


def test_levels_are_those_of_tests_or_a_grid(batch_of):
    rng = np.random.default_rng(0)
    stood = [(step(level) + 1e-3 * rng.standard_normal(SAMPLES), np.zeros(SAMPLES)) for level in LEVELS]
    assert operating_levels(batch_of(stood), 0.1) == pytest.approx(LEVELS, abs=1e-3)
    swung = 0.6 + 0.3 * np.sin(np.arange(SAMPLES) / 9)
    computed = operating_levels(batch_of([(swung, np.zeros(SAMPLES))]), 0.5)
    assert computed.size == 7
    assert np.ptp(np.diff(computed)) == pytest.approx(0, abs=1e-12)
    assert 0.5 < computed[0] < computed[-1] < 0.9
    assert operating_levels(batch_of([(swung, np.zeros(SAMPLES))]), 2.0).size == 0


def test_measured_speeds_are_those_of_the_plant_around_mid_stroke(batch_of):
    batch = batch_of(steps(np.random.default_rng(0), scatter=0.0, noise=0.0, levels=(1.0, 0.95, -0.9)))
    computed = measured_speeds(batch, 0.3, 0.15, None)
    assert [quantity.command for quantity in computed] == pytest.approx([0.9, 0.95, 1.0])
    assert [quantity.speed for quantity in computed] == pytest.approx(
        [0.9 * GAIN, 0.95 * GAIN, GAIN], rel=0.01
    )


def test_characteristics_are_told_and_scaled_with_the_gain(batch_of):
    batch = batch_of(steps(np.random.default_rng(4), scatter=0.01, noise=0.02))
    outcome, _, _ = fitted(batch, FIRST_ORDER, [GAIN, LAG_S, 0.05])
    zone, speeds, times = characteristic_sentences(outcome, LIFTING)
    point = outcome.speed_map[-1]
    assert zone == "dead zone 0 A"
    assert f"{point.speed:.3g} mm/s ({point.interval[0]:.4g} … {point.interval[1]:.4g}) at 1 A" in speeds
    assert speeds.startswith("the piston lifts at mid stroke")
    assert times.startswith("after a step to 0.7 A motion starts")
    scaled = outcome.scaled(1.1)
    for before, after in zip(outcome.speed_map, scaled.speed_map, strict=True):
        assert (after.speed, *after.interval) == pytest.approx(
            [1.1 * v for v in (before.speed, *before.interval)]
        )
    assert replace(scaled, speed_map=outcome.speed_map) == outcome


def test_a_structure_without_a_steady_speed_has_no_speed_map(batch_of):
    batch = batch_of(steps(np.random.default_rng(0), scatter=0.0, noise=0.0))
    misfit = Objective.of(batch, ModelSpec(structure_named("inertia-with-friction")))
    zone = DeadZone(0.0, None, 0, "structure")
    zones = {"dead_zone": zone.to_quantity("A"), "dead_zone_error": zone.error}
    assert characteristics(misfit, np.full(8, 0.5), Influence.zeros(1, 8), **zones, units=UNITS) is None


@pytest.mark.parametrize(
    ("zone", "interval", "determined"),
    [
        (DeadZone(0.3, None, 0, "given"), (0.3, 0.3), True),
        (DeadZone(0.3, None, 2, "tests"), (None, None), False),
        (DeadZone(0.0, None, 2, "none"), (None, None), False),
        (DeadZone(0.3, 0.03, 4, "ramps"), (0.3 - 3.182 * 0.015, 0.3 + 3.182 * 0.015), True),
        (DeadZone(0.3, 0.2, 4, "tests"), (0.0, 0.3 + 3.182 * 0.2), False),
    ],
)
def test_a_dead_zone_is_determined_by_its_standard_error(zone, interval, determined):
    outcome = zone.to_quantity("A")
    assert outcome.determined is determined
    assert outcome.interval == (interval if None in interval else pytest.approx(interval, rel=1e-3))
