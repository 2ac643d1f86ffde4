"""The linearised lifting chain against the simulated one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.bench import OperatingPoint, lowering_small_signal, simulate
from hitchid.bench.small_signal import small_signal

CURRENT_A = 0.62
AMPLITUDE_A = 0.004
SAMPLE_S = 0.01


@pytest.fixture(scope="module")
def linear_rig(rig):
    """Return the nominal bench without hysteresis, without ripple."""
    return eqx.tree_at(
        lambda r: (r.lifting_valve.spool.hysteresis, r.lowering_valve.spool.hysteresis, r.supply.ripple),
        rig,
        (jnp.asarray(0.0),) * 3,
    )


def phasor(signal: np.ndarray, omega: float, time_s: np.ndarray) -> complex:
    """Return amplitude and phase of a sine in a signal that drifts, by least squares."""
    basis = np.column_stack([np.cos(omega * time_s), np.sin(omega * time_s), *(time_s**k for k in range(5))])
    cosine, sine = np.linalg.lstsq(basis, signal, rcond=None)[0][:2]
    return complex(cosine, -sine)


@pytest.mark.parametrize(
    ("column", "start", "frequencies_hz", "late"),
    [
        (0, 0.1, (0.5, 1.0, 2.5, 5.0), slice(200, 900)),
        # Up to, at and beyond its resonance; the swing at the start has died away by 4 s:
        # exp(−ξh ωh · 4 s) < 1e-4.
        (1, 0.2, (0.5, 1.0, 1.5, 5.0), slice(400, 800)),
    ],
    ids=["lifting", "lowering"],
)
def test_small_motions_follow_the_third_order_transfer_function(
    linear_rig, column, start, frequencies_hz, late
):
    """Spool current to travel is K/(s(s²/ωh² + 2ξh s/ωh + 1)), lifting behind the compensator's lag."""
    omegas, time_s = 2 * np.pi * np.array(frequencies_hz), SAMPLE_S * np.arange(1001)
    currents = np.zeros((4, time_s.size, 2))
    currents[..., column] = CURRENT_A + AMPLITUDE_A * np.sin(omegas[:, None] * time_s)
    motion = simulate(linear_rig, currents, initial_displacement_m=start, substeps=20)
    valve = (linear_rig.lifting_valve, linear_rig.lowering_valve)[column]
    spool = (motion.lifting_spool, motion.lowering_spool)[column]
    linearised = (small_signal, lowering_small_signal)[column]
    for row, omega in enumerate(omegas):
        travel = (1e3, -1e3)[column] * np.asarray(motion.displacement_m)[row, late]
        current = float(valve.spool.saturation) * np.asarray(spool)[row, late]
        response = phasor(travel, omega, time_s[late]) / phasor(current, omega, time_s[late])
        middle = float(np.mean(np.asarray(motion.displacement_m)[row, late]))
        chain, s = linearised(linear_rig, OperatingPoint(middle, CURRENT_A)), 1j * omega
        lagged = (s / chain.natural_frequency) ** 2 + 2 * chain.damping_ratio * s / chain.natural_frequency
        expected = chain.gain / (s * (lagged + 1))
        if column == 0:
            # The metering edge acts at once on its share of the drop, the compensator later on the rest.
            drop = float(np.mean(np.asarray(motion.supply_pressure_pa - motion.pressure_pa)[row, late]))
            opening = jnp.asarray(np.mean(np.asarray(motion.compensator_m2)[row, late]))
            share = float(valve.metering_drop(opening)) / (drop - float(valve.check_pressure))
            lag = float(valve.compensator_lag) * s
            expected *= (1 + share * lag) / (1 + lag)
        assert abs(response / expected - 1) < 0.05


def test_gain_is_the_slope_of_steady_speed(linear_rig):
    levels = np.array([CURRENT_A - 0.01, CURRENT_A + 0.01])
    currents = np.zeros((4, 1001, 2))
    currents[:, :, 0] = np.resize(levels, 4)[:, None]
    motion = simulate(linear_rig, currents, initial_displacement_m=0.1)
    moved = 1e3 * np.asarray(motion.displacement_m[:, 500] - motion.displacement_m[:, 300]) / 2.0
    chain = small_signal(linear_rig, OperatingPoint(0.12, CURRENT_A))
    assert (moved[1] - moved[0]) / 0.02 == pytest.approx(chain.gain, rel=0.02)


def test_hydraulic_stiffness_and_mass_set_the_frequency(rig):
    """ωh² ≈ A²/(m C), C the compliance of chamber and hose, load stiffness and losses being small."""
    point = OperatingPoint(0.12, CURRENT_A)
    chain = small_signal(rig, point)
    _, mass, _ = rig.linkage.reduced(jnp.asarray(0.12))
    hose = float(rig.cylinder.compliance)
    oil = float(rig.cylinder.volume(jnp.asarray(0.12)) / rig.oil.bulk_modulus)
    about = float(rig.cylinder.area) / np.sqrt(float(mass) * (hose + oil))
    assert chain.natural_frequency == pytest.approx(about, rel=0.15)


def test_cold_oil_damps(rig):
    cold = small_signal(rig, OperatingPoint(0.12, CURRENT_A, oil_temperature_c=0.0))
    warm = small_signal(rig, OperatingPoint(0.12, CURRENT_A, oil_temperature_c=80.0))
    assert cold.damping_ratio > warm.damping_ratio
    assert cold.natural_frequency == pytest.approx(warm.natural_frequency, rel=1e-3)


def test_the_answer_does_not_depend_on_the_caller_s_precision(rig):
    point = OperatingPoint(0.12, CURRENT_A)
    with jax.enable_x64(False):
        assert small_signal(rig, point) == small_signal(rig, point)
