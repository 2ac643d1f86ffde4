"""Sensors and data acquisition against their data sheet."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.bench import measure, simulate
from hitchid.bench.measurement import _first_order_filter
from hitchid.errors import InputError

FULL_SCALE = 0.003


@pytest.fixture(scope="module")
def at_rest(any_rig):
    """Return currents and motion of tests that stand still over the whole stroke."""
    currents = np.zeros((4, 1001, 2))
    currents[:, :, 0] = np.linspace(0.0, 0.25, 4)[:, None]
    currents[:, :, 1] = np.linspace(0.2, 0.0, 4)[:, None]
    return currents, simulate(any_rig, currents, initial_displacement_m=np.linspace(0.002, 0.248, 4))


def test_columns_are_those_of_the_bench_s_logs(any_rig, at_rest):
    currents, motion = at_rest
    log = measure(any_rig, motion, currents, jax.random.key(0))
    assert list(log) == ["time_s", "current_up_A", "current_down_A", "displacement_mm"]
    for column in log.values():
        assert type(column) is np.ndarray
        assert column.dtype == np.float64
        assert column.shape == (4, 1001)
    np.testing.assert_allclose(log["time_s"][3], 0.01 * np.arange(1001), atol=1e-12)


def test_errors_stay_within_three_thousandths_of_full_scale(any_rig, at_rest):
    currents, motion = at_rest
    log = measure(any_rig, motion, currents, jax.random.key(1))
    angle = any_rig.linkage.sensor_angle(jnp.asarray(log["displacement_mm"] / 1e3))
    error = np.abs(np.asarray(angle - any_rig.linkage.sensor_angle(motion.displacement_m)))
    assert error.max() < FULL_SCALE * np.pi / 2
    assert error.max() > 0.1 * FULL_SCALE * np.pi / 2
    for column, row in (("current_up_A", 0), ("current_down_A", 1)):
        away = np.abs(log[column][:, 5:] - currents[:, 5:, row])
        assert away[currents[:, 5:, row] > 0.03].max() < FULL_SCALE * 3


def test_noise_is_white_small_and_of_the_key_alone(any_rig, at_rest):
    currents, motion = at_rest
    first, again, second = (
        measure(any_rig, motion, currents, jax.random.key(seed))["displacement_mm"] for seed in (2, 2, 3)
    )
    np.testing.assert_array_equal(first, again)
    assert np.mean(first != second) > 0.9
    noise = (first - second) / np.sqrt(2)
    assert np.all((noise.std(axis=1) > 0.03) & (noise.std(axis=1) < 0.15))
    assert 0.05 < noise.std() < 0.1
    assert np.all(np.abs(noise.mean(axis=1)) < 4 * noise.std(axis=1) / np.sqrt(1001))
    neighbours = np.mean(noise[:, 1:] * noise[:, :-1]) / noise.var()
    assert abs(neighbours) < 4 / np.sqrt(noise.size)
    true = 1e3 * np.asarray(motion.displacement_m).mean(axis=1)
    curves = [log.mean(axis=1) - true for log in (first, second)]
    assert np.abs(curves[0] - curves[1]).max() < 0.05
    assert np.abs(curves[0]).max() > 0.1


def test_readings_are_whole_steps_of_the_converter(any_rig, at_rest):
    currents, motion = at_rest
    log = measure(any_rig, motion, currents, jax.random.key(4))
    steps = log["current_up_A"] / 3.0 * 2**16
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    angle = np.asarray(any_rig.linkage.sensor_angle(jnp.asarray(log["displacement_mm"] / 1e3)))
    steps = angle / (np.pi / 2) * 2**16
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-5)


def test_the_filter_lags_a_straight_run_by_its_time_constant():
    corner = 2.5
    ramp = jnp.asarray(0.01 * np.arange(200.0))[None, :]
    lag = np.asarray(ramp - _first_order_filter(ramp, jnp.asarray(corner)))[0, 50:]
    np.testing.assert_allclose(lag, 0.01 / corner, rtol=1e-9)


def test_jittered_stamps_tell_when_samples_were_taken(rig):
    currents = np.zeros((4, 1001, 2))
    currents[:, 20:, 0] = 0.65
    motion = simulate(rig, currents, initial_displacement_m=0.05)
    silent = eqx.tree_at(lambda r: r.sensors.angle_noise, rig, jnp.asarray(0.0))
    even = measure(silent, motion, currents, jax.random.key(0))
    uneven = measure(silent, motion, currents, jax.random.key(0), jitter=0.05)
    period = np.diff(uneven["time_s"][0])
    assert np.all(period > 0)
    assert np.std(uneven["time_s"] - even["time_s"]) == pytest.approx(0.05 * 0.01, rel=0.1)
    onto = np.interp(uneven["time_s"][0], even["time_s"][0], even["displacement_mm"][0])
    assert np.abs(onto - uneven["displacement_mm"][0]).max() < 0.02


def test_misuse_is_refused(rig):
    currents = np.zeros((4, 1001, 2))
    motion = simulate(rig, currents, initial_displacement_m=0.1)
    with pytest.raises(InputError, match="expected"):
        measure(rig, motion, np.zeros((4, 1000, 2)), jax.random.key(0))
    with pytest.raises(InputError, match=r"jitter: .*0\.5.*0 to 0\.1"):
        measure(rig, motion, currents, jax.random.key(0), jitter=0.5)
