"""Simulated motion against conservation, static balance, flow laws and a finer step."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.bench import rig_limits, simulate
from hitchid.bench.simulation import SUBSTEPS
from hitchid.bench.valves import TANK_PRESSURE_PA
from hitchid.errors import InputError


def test_no_oil_is_made_or_lost(any_rig, binary):
    """Pump + initial = stored + relief + leak + returned, the stored oil taken from pressure and volume."""
    currents = binary()
    currents[0, 500:700] = 2.0  # both valves wide open at once
    motion = simulate(any_rig, currents, initial_displacement_m=[0.03, 0.22, 0.2, 0.1], load_force_n=500.0)
    cylinder = any_rig.cylinder
    held = any_rig.oil.amount(
        motion.pressure_pa, cylinder.volume(motion.displacement_m), cylinder.compliance
    ) + any_rig.supply.amount(any_rig.oil, motion.supply_pressure_pa)
    left = motion.relieved_m3 + motion.leaked_m3 + motion.lowered_m3 + motion.safety_relieved_m3
    there = np.asarray(held + left - motion.pumped_m3)
    assert np.all(np.asarray(motion.pumped_m3)[:, -1] > 1e-3)
    np.testing.assert_allclose(there, np.broadcast_to(there[:, :1], there.shape), rtol=1e-9)


def test_the_oil_fills_chamber_fittings_and_hose(any_rig):
    cylinder = any_rig.cylinder
    assert float(cylinder.hose_volume) > 0
    empty = cylinder.volume(jnp.asarray(0.0))
    np.testing.assert_allclose(empty, cylinder.dead_volume + cylinder.hose_volume, rtol=1e-12)
    swept = np.pi / 4 * cylinder.bore**2 * 0.1
    np.testing.assert_allclose(cylinder.volume(jnp.asarray(0.1)) - empty, swept, rtol=1e-9)


def test_pressure_carries_the_load_at_hold(any_rig, held):
    currents = held(0.0, 0.0)
    force = np.array([[0.0], [800.0], [-500.0], [0.0]])
    motion = simulate(any_rig, currents, initial_displacement_m=[0.05, 0.12, 0.2, 0.1], load_force_n=force)
    weight, _, lever = any_rig.linkage.reduced(motion.displacement_m)
    excess = (motion.pressure_pa - TANK_PRESSURE_PA) * any_rig.cylinder.area - weight - lever * force
    assert np.all(np.abs(np.asarray(excess)) <= 1.02 * float(any_rig.cylinder.friction.static))
    assert np.all(np.abs(np.diff(np.asarray(motion.displacement_m))) < 2e-5)


def test_steady_lifting_speed_is_flow_over_area(any_rig, held):
    motion = simulate(any_rig, held([0.5, 0.65], 0.0), initial_displacement_m=0.05, load_force_n=200.0)
    late = slice(400, None)
    swept = motion.lifting_flow_m3_s - any_rig.cylinder.leakage / any_rig.oil.viscosity_ratio(
        any_rig.oil.temperature
    ) * (motion.pressure_pa - TANK_PRESSURE_PA)
    # the rising load compresses oil and widens the hose on the way: that share of the flow moves no piston
    pressure = np.asarray(motion.pressure_pa)[:, late]
    capacity = any_rig.oil.capacity(motion.pressure_pa, motion.cylinder_oil_m3, any_rig.cylinder.compliance)
    storing = np.asarray(capacity)[:, late] * np.gradient(pressure, 0.01, axis=1)
    sigma = np.asarray(any_rig.oil.specific_volume(motion.pressure_pa))[:, late]
    speed = (np.asarray(swept)[:, late] - storing) * sigma / float(any_rig.cylinder.area)
    np.testing.assert_allclose(
        np.asarray(motion.speed_m_s)[:, late].mean(axis=1), speed.mean(axis=1), rtol=5e-3
    )


def test_steady_lowering_follows_the_orifice_law(any_rig, held):
    """The flows of a light and a heavy load are as the roots of their pressures, Q = C_d a √(2 Δp/ρ)."""
    valve = any_rig.lowering_valve
    motion = simulate(
        any_rig, held([0.0, 0.0], 0.65), initial_displacement_m=0.2, load_force_n=[[0.0], [2500.0]] * 2
    )
    late = slice(300, 800)
    drop = np.asarray(motion.pressure_pa)[:, late] - TANK_PRESSURE_PA
    area = np.asarray(valve.spool.area(motion.lowering_spool))[:, late]
    whole = 1 / np.sqrt(1 / area**2 + 1 / float(valve.damper_area) ** 2)
    law = float(valve.spool.discharge) * whole * np.sqrt(2 * drop / float(any_rig.oil.density))
    flow = np.asarray(motion.lowering_flow_m3_s)[:, late]
    np.testing.assert_allclose(flow, law, rtol=3e-3)
    assert np.all(flow[1] > 1.05 * flow[0])


def test_lifting_is_compensated_and_lowering_is_not(rig, held):
    force = np.array([[0.0], [2500.0], [0.0], [2500.0]])
    currents = held([0.6, 0.6, 0.0, 0.0], [0.0, 0.0, 0.6, 0.6])
    motion = simulate(rig, currents, initial_displacement_m=0.12, load_force_n=force)
    moved = np.abs(np.asarray(motion.displacement_m)[:, 600] - 0.12)
    assert abs(moved[1] / moved[0] - 1) < 0.05
    assert moved[3] / moved[2] > 1.08


def test_the_pump_bounds_the_lifting_speed(any_rig, held):
    wide = eqx.tree_at(lambda r: r.lifting_valve.spool.full_area, any_rig, jnp.asarray(3e-5))
    motion = simulate(wide, held([3.0], 0.0), initial_displacement_m=0.02)
    speed = np.asarray(motion.speed_m_s)[0, 150:250].mean()
    assert 0.7 * rig_limits(wide).lifting_speed_m_s < speed < rig_limits(wide).lifting_speed_m_s


def test_halving_the_step_changes_nothing_that_matters(any_rig, binary):
    currents = binary()
    start = np.where(np.arange(4) % 2 == 0, 0.03, 0.22)
    coarse = simulate(any_rig, currents, initial_displacement_m=start)
    fine = simulate(any_rig, currents, initial_displacement_m=start, substeps=2 * SUBSTEPS)
    away = np.abs(np.asarray(coarse.displacement_m) - np.asarray(fine.displacement_m))
    assert away.max() < 1e-5
    assert np.ptp(np.asarray(fine.displacement_m), axis=1).min() > 0.01


def test_no_energy_is_made(any_rig, binary):
    """Work of the oil on the piston covers weight and motion; friction only takes."""
    motion = simulate(any_rig, binary(), initial_displacement_m=[0.03, 0.22, 0.1, 0.12], substeps=20)
    linkage, cylinder = any_rig.linkage, any_rig.cylinder
    gauge = np.asarray(motion.pressure_pa) - TANK_PRESSURE_PA
    displacement, speed = np.asarray(motion.displacement_m), np.asarray(motion.speed_m_s)
    work = float(cylinder.area) * np.cumsum(
        0.5 * (gauge[:, 1:] + gauge[:, :-1]) * np.diff(displacement, axis=1), axis=1
    )
    _, mass, _ = linkage.reduced(motion.displacement_m)
    weight = float(linkage.implement_mass + linkage.link_mass / 2) * 9.80665
    energy = weight * np.asarray(linkage.height(motion.displacement_m)) + 0.5 * np.asarray(mass) * speed**2
    energy = energy + 0.5 * float(cylinder.friction.bristle_stiffness) * np.asarray(motion.bristle_m) ** 2
    lost = work - (energy[:, 1:] - energy[:, :1])
    scale = np.max(np.abs(work))
    assert np.all(lost > -1e-4 * scale)
    assert np.all(
        lost[:, -1]
        > 0.5 * float(cylinder.friction.coulomb) * np.abs(displacement[:, -1] - displacement[:, 0])
    )
    # upstream: the supply puts in at least what arrives at the piston and what the oil's compression stores
    supplied = np.sum(
        (np.asarray(motion.supply_pressure_pa) - TANK_PRESSURE_PA)[:, 1:]
        * 0.01
        * np.asarray(motion.lifting_flow_m3_s)[:, 1:],
        axis=1,
    )
    assert np.all(supplied[::2] > work[::2, -1])


def test_cold_oil_drags(rig, held):
    motion = simulate(
        rig, held([0.6, 0.6], 0.0), initial_displacement_m=0.05, oil_temperature_c=[0.0, 80.0] * 2
    )
    pressure = np.asarray(motion.pressure_pa)[:, 300]
    assert pressure[0] > pressure[1]


def test_derivatives_by_parameters_are_finite_differences(rig, held):
    currents = held(0.6, 0.0)

    def end(area):
        changed = eqx.tree_at(lambda r: r.lifting_valve.spool.full_area, rig, area)
        return simulate(changed, currents, initial_displacement_m=0.05).displacement_m[0, 60]

    area = rig.lifting_valve.spool.full_area
    slope = (end(area * (1 + 1e-4)) - end(area * (1 - 1e-4))) / (2e-4 * area)
    np.testing.assert_allclose(jax.jvp(end, (area,), (jnp.ones_like(area),))[1], slope, rtol=1e-4)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"currents": np.zeros((1001, 2))}, r"got shape \(1001, 2\)"),
        ({"currents": np.full((1, 9, 2), -0.5)}, r"currents: got -0\.5"),
        ({"initial_displacement_m": 0.3}, r"initial_displacement_m: .*0\.3.*0 to 0\.25"),
        ({"load_force_n": np.zeros(7)}, "load_force_n: got shape"),
        ({"oil_temperature_c": np.nan}, r"oil_temperature_c: .*finite"),
        ({"substeps": 0}, "substeps: got 0"),
    ],
)
def test_misuse_is_refused(rig, changed, said):
    with pytest.raises(InputError, match=said):
        simulate(rig, **{"currents": np.zeros((1, 9, 2)), "initial_displacement_m": 0.1, **changed})
