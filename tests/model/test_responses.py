"""Step and frequency response against closed forms and scipy, with bands of known width."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

import handmade
from hitchid.errors import InputError
from hitchid.handover.responses import (
    Banded,
    default_duration_s,
    default_frequencies_hz,
    default_levels,
    frequency_response,
    step_responses,
)
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.structures import structure_named

DEAD_TIME_S, LEVEL, DURATION_S = 0.0317, 0.8, 1.5
GAIN = handmade.GAINS[LIFTING]
EFFECTIVE = LEVEL - handmade.DEAD_ZONES[LIFTING]
FREQUENCY_HZ = np.geomspace(0.01, 50.0, 97)


@pytest.mark.parametrize("structure", handmade.VALUES)
@pytest.mark.parametrize("direction", [LIFTING, LOWERING])
def test_the_frequency_response_is_scipys_delayed_by_the_dead_time(structure, direction):
    channel = handmade.channel(direction, structure, dead_time_s=DEAD_TIME_S)
    computed = frequency_response(channel, FREQUENCY_HZ, None, None)
    values = tuple(map(float, channel.benchmark.values))
    omega = 2 * np.pi * FREQUENCY_HZ
    _, rational = signal.freqs(*channel.benchmark.structure.transfer_function(values), omega)
    np.testing.assert_allclose(computed.magnitude.value, np.abs(rational), rtol=1e-9)
    # The dead time turns the phase by many quarters at 50 Hz; it stays continuous.
    phase = np.unwrap(np.angle(rational)) - omega * DEAD_TIME_S
    np.testing.assert_allclose(computed.phase_rad.value, phase, rtol=1e-9)
    assert computed.magnitude.lower is computed.phase_rad.upper is None
    tanks = eqx.tree_at(lambda c: c.benchmark.structure, channel, structure_named("cascaded-tanks"))
    with pytest.raises(InputError, match="is not linear; expected a linear structure"):
        frequency_response(tanks, FREQUENCY_HZ, None, None)


def test_a_valve_curve_multiplies_by_slope_gain_and_spool_lag():
    plain = handmade.channel(LIFTING, "integrator-first-order")
    curved = handmade.channel(LIFTING, "integrator-first-order", shape=True)
    nonlinearity = curved.benchmark.nonlinearity
    centre = nonlinearity.scales.centre
    step = 1e-4

    def flow(effective):
        return float(nonlinearity.flow(jnp.asarray(effective)))

    # Central difference: error of the second order, below 1e-6 for curves of size one.
    slope = (flow(EFFECTIVE + step) - flow(EFFECTIVE - step)) / (2 * step)
    spool_lag_s = float(nonlinearity.values[4])
    response = [
        computed.magnitude.value * np.exp(1j * computed.phase_rad.value)
        for computed in (
            frequency_response(channel, FREQUENCY_HZ, LEVEL, None) for channel in (plain, curved)
        )
    ]
    factor = slope * float(nonlinearity.gain(centre)) / (1 + 2j * np.pi * FREQUENCY_HZ * spool_lag_s)
    np.testing.assert_allclose(response[1] / response[0], factor, rtol=1e-6)


@pytest.mark.parametrize("direction", [LIFTING, LOWERING])
def test_travel_and_speed_after_a_step_have_closed_forms(direction):
    channel = handmade.channel(direction, "integrator-first-order", dead_time_s=DEAD_TIME_S)
    within, computed = step_responses(channel, [0.2, LEVEL], DURATION_S, None)
    assert set(within.travel.value) == {0.0}
    (tau,) = handmade.VALUES["integrator-first-order"]
    elapsed = np.maximum(computed.time_s - DEAD_TIME_S, 0.0)
    speed = handmade.GAINS[direction] * (LEVEL - handmade.DEAD_ZONES[direction])
    travel = speed * (elapsed - tau * (1 - np.exp(-elapsed / tau)))
    assert computed.time_s[-1] == pytest.approx(DURATION_S, rel=1e-12)
    np.testing.assert_allclose(computed.travel.value, travel, rtol=1e-9, atol=1e-9)
    step_s = computed.time_s[1]
    np.testing.assert_allclose(computed.speed_time_s, computed.time_s[:-1] + step_s / 2, rtol=1e-12)
    # Differences divide the errors of travel by the step.
    np.testing.assert_allclose(computed.speed.value, np.diff(travel) / step_s, atol=1e-9 / step_s)
    assert computed.level == LEVEL


def test_a_valve_curve_is_part_of_the_step_response():
    curved = handmade.channel(LIFTING, shape=True)
    (computed,) = step_responses(curved, [LEVEL], 10.0, None)
    nonlinearity = curved.benchmark.nonlinearity
    flow = float(nonlinearity.flow(jnp.asarray(EFFECTIVE)))
    # Half a hysteresis of the rising command lies within the dead zone and the play; once the spool's lag
    # has died away, the speed is gain, flow and the gain at each place of the stroke.
    positions = 0.5 * (computed.travel.value[1:] + computed.travel.value[:-1]) + float(
        nonlinearity.scales.centre
    )
    steady = GAIN * flow * np.asarray(nonlinearity.gain(jnp.asarray(positions)))
    # Forward steps: the gain is that at the start of an interval, a relative error below its change in one.
    np.testing.assert_allclose(computed.speed.value[50:], steady[50:], rtol=5e-3)


@pytest.mark.parametrize("shape", [False, True])
def test_bands_of_an_uncertain_gain_are_quantiles_of_the_gain(shape):
    channel = handmade.channel(LIFTING, "integrator-first-order", dead_time_s=DEAD_TIME_S, shape=shape)
    factors = np.exp(0.1 * np.random.default_rng(0).standard_normal(100))
    drawn = np.tile(np.asarray(channel.benchmark.parameter_vector), (len(factors), 1))
    drawn[:, 0] *= factors
    low, high = np.quantile(factors, (0.025, 0.975))
    computed = frequency_response(channel, FREQUENCY_HZ, None, drawn)
    np.testing.assert_allclose(computed.magnitude.lower, low * computed.magnitude.value, rtol=1e-9)
    np.testing.assert_allclose(computed.magnitude.upper, high * computed.magnitude.value, rtol=1e-9)
    np.testing.assert_allclose(computed.phase_rad.lower, computed.phase_rad.value, rtol=1e-12)
    if shape:
        return  # travel is not proportional to a gain that changes along the stroke
    (step,) = step_responses(channel, [LEVEL], DURATION_S, drawn)
    for banded in (step.travel, step.speed):
        np.testing.assert_allclose(banded.lower, low * banded.value, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(banded.upper, high * banded.value, rtol=1e-6, atol=1e-9)


def test_a_function_applies_to_values_and_band():
    doubled = Banded(np.ones(2), np.zeros(2), np.full(2, 3.0)).map(lambda values: 2 * values)
    assert [row.tolist() for row in doubled] == [[2, 2], [0, 0], [6, 6]]
    assert Banded(np.ones(2)).map(np.negative).lower is None


def test_levels_are_the_speed_maps_or_shares_of_the_tests():
    channel = handmade.channel(LIFTING, covered=handmade.envelope(command=(0.0, 0.6)))
    assert default_levels(channel, (0.7, 0.4, 0.5, 0.4, 0.6)) == [0.4, 0.6, 0.7]
    assert default_levels(channel, (0.4,)) == [0.4]
    zone = handmade.DEAD_ZONES[LIFTING]
    assert default_levels(channel, ()) == pytest.approx([zone + 0.2, zone + 0.4, zone + 0.6])
    assert default_levels(handmade.channel(LIFTING), ()) == []


def test_a_step_response_lasts_until_the_speed_is_steady():
    for structure in ("integrator", "integrator-first-order", "integrator-second-order"):
        channel = handmade.channel(LIFTING, structure, dead_time_s=DEAD_TIME_S)
        duration_s = default_duration_s(channel, handmade.STEP_S)
        assert duration_s >= 100 * handmade.STEP_S
        (computed,) = step_responses(channel, [LEVEL], duration_s, None)
        # exp(−6) = 0.25 % of a first-order lag are left.
        assert computed.speed.value[-1] == pytest.approx(GAIN * EFFECTIVE, rel=3e-3)


def test_frequencies_are_three_decades_up_to_half_the_sampling_frequency():
    frequency_hz = default_frequencies_hz(0.01)
    assert (frequency_hz[0], frequency_hz[-1]) == pytest.approx((0.05, 50.0))
    np.testing.assert_allclose(np.diff(np.log10(frequency_hz)), 3 / (frequency_hz.size - 1), rtol=1e-9)
