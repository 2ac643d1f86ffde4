"""Loops and their margins: closed forms, python-control, the matrices of the same models."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import handmade
from hitchid.control.controller import Gains
from hitchid.control.loops import frequencies, margins, open_loop, plant_response
from hitchid.structures import PhysicalModel, small_signal_at, structure_named

OMEGA = np.geomspace(0.05, 300.0, 40_000)
LOOPS = [(1.0, 0.1), (2.0, 0.2), (5.0, 0.05), (0.5, 0.9)]


def integrator(gain: float, dead_time_s: float, omega=OMEGA):
    return gain * np.exp(-1j * omega * dead_time_s) / (1j * omega)


@pytest.mark.parametrize(("gain", "dead_time_s"), LOOPS)
def test_margins_of_an_integrator_with_dead_time_are_exact(gain, dead_time_s) -> None:
    margin = margins(integrator(gain, dead_time_s), OMEGA)
    assert margin.gain_db == pytest.approx(20 * np.log10(np.pi / (2 * gain * dead_time_s)), rel=1e-3)
    assert margin.phase_deg == pytest.approx(90 - np.rad2deg(gain * dead_time_s), rel=1e-3)
    assert margin.delay_s == pytest.approx((np.pi / 2 - gain * dead_time_s) / gain, rel=1e-3)


def test_loops_with_a_leading_axis_have_the_margins_of_each() -> None:
    loops = np.stack([integrator(*loop) for loop in LOOPS])
    together = margins(loops, OMEGA)
    for number, loop in enumerate(loops):
        for rows, one in zip(together, margins(loop, OMEGA), strict=True):
            assert rows[number] == one


def test_without_half_a_turn_the_gain_margin_is_infinite() -> None:
    margin = margins(2 / (1j * OMEGA), OMEGA)
    assert margin.gain_db == np.inf
    assert margin.phase_deg == pytest.approx(90.0, rel=1e-6)
    assert margin.sensitivity == pytest.approx(1.0, rel=1e-3)
    assert margin.disk == pytest.approx(2.0, rel=1e-6)


def test_a_loop_of_zero_at_the_end_has_margins() -> None:
    loop = integrator(2.0, 0.2)
    with np.errstate(all="raise"):
        margin = margins(np.append(loop[:-1], 0.0), OMEGA)
    assert margin.gain_db == margins(loop, OMEGA).gain_db


def test_margins_of_a_double_integrator_with_lead_are_exact() -> None:
    s = 1j * OMEGA
    margin = margins((1 + s) / s**2, OMEGA)
    crossover = np.sqrt((1 + np.sqrt(5)) / 2)
    assert margin.phase_deg == pytest.approx(np.rad2deg(np.arctan(crossover)), rel=1e-3)
    assert margin.delay_s == pytest.approx(np.arctan(crossover) / crossover, rel=1e-3)


@pytest.mark.parametrize(("gain", "dead_time_s"), [(20.0, 0.1), (2.0, 1.0)])
def test_an_unstable_loop_has_negative_margins_and_none_of_delay(gain, dead_time_s) -> None:
    margin = margins(integrator(gain, dead_time_s), OMEGA)
    assert margin.gain_db == pytest.approx(20 * np.log10(np.pi / (2 * gain * dead_time_s)), rel=1e-3)
    assert margin.gain_db < 0
    assert margin.phase_deg < 0
    assert margin.delay_s == 0


def test_sensitivity_and_disk_margin_are_those_of_python_control() -> None:
    control = pytest.importorskip("control")
    if not hasattr(control, "disk_margins"):
        pytest.skip("python-control has no disk_margins")
    system = control.tf([6.0, 12.0], [0.02, 0.5, 1.0, 0.0])
    omega = np.geomspace(0.1, 100.0, 500)
    try:
        disk = control.disk_margins(system, omega, skew=0.0)[0]
    except control.ControlMIMONotImplemented:
        pytest.skip("python-control without slycot")
    loop = system(1j * omega)
    margin = margins(loop, omega)
    assert margin.disk == pytest.approx(float(np.squeeze(disk)), rel=1e-6)
    assert margin.sensitivity == pytest.approx(np.abs(1 / (1 + loop)).max(), rel=1e-12)


# --- frequency responses of plants and loops ----------------------------------------------------------------

STEP_S = 0.01
RAD_S = frequencies(STEP_S)
CURVES = (*handmade.CURVES[:4], 0.0, *handmade.CURVES[5:])
LAGGED_CURVES = handmade.CURVES


def physical(structure: str, dead_time_s: float, curves=None, factor: float = 1.0) -> PhysicalModel:
    values = factor * jnp.array([30.0, *handmade.VALUES[structure]])
    if curves is None:
        return PhysicalModel(structure_named(structure), values, jnp.asarray(dead_time_s))
    shape = handmade.scheduled(structure_named(structure), curves)
    return PhysicalModel(structure_named(structure), values, jnp.asarray(dead_time_s), *shape)


def signal_of(model: PhysicalModel):
    return small_signal_at(model.at_load(jnp.array([120.0])) if model.covariates else model, 0.3, 100.0)


def matrix_response(system):
    a, b, c = (np.asarray(part) for part in (system.a, system.b, system.c))
    z = np.exp(1j * RAD_S * STEP_S)
    states = np.linalg.solve(
        z[:, None, None] * np.eye(a.shape[0]) - a, np.broadcast_to(b, (z.size, *b.shape))
    )
    d = getattr(system, "d", None)
    return (c @ states)[:, 0, 0] + (0.0 if d is None else float(np.squeeze(d)))


@pytest.mark.parametrize("structure", ["integrator", "integrator-first-order", "integrator-second-order"])
@pytest.mark.parametrize("dead_time_s", [0.0, 0.05, 0.064])
@pytest.mark.parametrize("curves", [None, CURVES, LAGGED_CURVES], ids=["linear", "shaped", "spool"])
def test_a_plant_responds_as_its_matrices_do(structure: str, dead_time_s: float, curves) -> None:
    signal = signal_of(physical(structure, dead_time_s, curves))
    assert (float(signal.spool_lag_s) > 0) == (curves is LAGGED_CURVES)
    response = plant_response(signal, RAD_S, STEP_S)
    expected = matrix_response(signal.state_space(STEP_S))
    np.testing.assert_allclose(response.undelayed * response.delay, expected, rtol=1e-9)


def test_draws_respond_as_each_alone() -> None:
    signals = [
        signal_of(physical("integrator-first-order", dead_time_s, LAGGED_CURVES, factor))
        for dead_time_s, factor in ((0.03, 1.0), (0.064, 1.2), (0.0, 0.8))
    ]
    together = jax.tree.map(lambda *rows: np.stack([np.asarray(row) for row in rows]), *signals)
    for exact in (True, False):
        rows = plant_response(together, RAD_S, STEP_S, exact_fraction=exact)
        for number, signal in enumerate(signals):
            for several, one in zip(
                rows, plant_response(signal, RAD_S, STEP_S, exact_fraction=exact), strict=True
            ):
                np.testing.assert_allclose(several[number], one, rtol=1e-12)


def test_the_speed_gain_is_that_of_low_frequencies() -> None:
    response = plant_response(
        signal_of(physical("integrator-first-order", 0.064, LAGGED_CURVES)), RAD_S, STEP_S
    )
    assert abs(response.undelayed[0]) * RAD_S[0] == pytest.approx(float(response.speed_gain), rel=1e-3)


def test_a_whole_dead_time_is_the_same_interpolated() -> None:
    signal = signal_of(physical("integrator-first-order", 0.05))
    exact, between = (plant_response(signal, RAD_S, STEP_S, exact_fraction=own) for own in (True, False))
    np.testing.assert_allclose(exact.delay, between.delay, rtol=1e-9)


def test_a_perfect_model_leaves_the_loop_of_its_undelayed_part() -> None:
    plant = plant_response(signal_of(physical("integrator-first-order", 0.05)), RAD_S, STEP_S)
    gains = Gains(3.0, 1.1)
    loop = open_loop(gains, plant, plant, RAD_S, STEP_S)
    z = np.exp(1j * RAD_S * STEP_S)
    forward = (3.0 + 1.1 * STEP_S * z / (z - 1)) / plant.speed_gain * plant.undelayed
    # Of a Smith predictor: L/(1 + L) is that without dead time, delayed.
    np.testing.assert_allclose(loop / (1 + loop), forward / (1 + forward) * plant.delay, rtol=1e-9)
