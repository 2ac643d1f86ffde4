"""Frequency responses of plants and loops against the matrices of the same models."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import handmade
from hitchid.control.controller import Gains
from hitchid.control.loops import frequencies, open_loop, plant_response
from hitchid.structures import PhysicalModel, small_signal_at, structure_named

STEP_S = 0.01
OMEGA = frequencies(STEP_S)
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
    z = np.exp(1j * OMEGA * STEP_S)
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
    response = plant_response(signal, OMEGA, STEP_S)
    expected = matrix_response(signal.state_space(STEP_S))
    np.testing.assert_allclose(response.undelayed * response.delay, expected, rtol=1e-9)


def test_draws_respond_as_each_alone() -> None:
    signals = [
        signal_of(physical("integrator-first-order", dead_time_s, LAGGED_CURVES, factor))
        for dead_time_s, factor in ((0.03, 1.0), (0.064, 1.2), (0.0, 0.8))
    ]
    together = jax.tree.map(lambda *rows: np.stack([np.asarray(row) for row in rows]), *signals)
    for exact in (True, False):
        rows = plant_response(together, OMEGA, STEP_S, exact_fraction=exact)
        for number, signal in enumerate(signals):
            for several, one in zip(
                rows, plant_response(signal, OMEGA, STEP_S, exact_fraction=exact), strict=True
            ):
                np.testing.assert_allclose(several[number], one, rtol=1e-12)


def test_the_speed_gain_is_that_of_low_frequencies() -> None:
    response = plant_response(
        signal_of(physical("integrator-first-order", 0.064, LAGGED_CURVES)), OMEGA, STEP_S
    )
    assert abs(response.undelayed[0]) * OMEGA[0] == pytest.approx(float(response.speed_gain), rel=1e-3)


def test_a_whole_dead_time_is_the_same_interpolated() -> None:
    signal = signal_of(physical("integrator-first-order", 0.05))
    exact, between = (plant_response(signal, OMEGA, STEP_S, exact_fraction=own) for own in (True, False))
    np.testing.assert_allclose(exact.delay, between.delay, rtol=1e-9)


def test_a_perfect_model_leaves_the_loop_of_its_undelayed_part() -> None:
    plant = plant_response(signal_of(physical("integrator-first-order", 0.05)), OMEGA, STEP_S)
    gains = Gains(3.0, 1.1)
    loop = open_loop(gains, plant, plant, OMEGA, STEP_S)
    z = np.exp(1j * OMEGA * STEP_S)
    forward = (3.0 + 1.1 * STEP_S * z / (z - 1)) / plant.speed_gain * plant.undelayed
    # Of a Smith predictor: L/(1 + L) is that without dead time, delayed.
    np.testing.assert_allclose(loop / (1 + loop), forward / (1 + forward) * plant.delay, rtol=1e-9)
