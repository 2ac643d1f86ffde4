"""The bench one sample at a time against the simulation of whole tests, and what may change on the way."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.bench import Disturbance, measure, reset, simulate, step
from hitchid.bench.plant import cylinder_amount, supply_amount
from hitchid.bench.valves import TANK_PRESSURE_PA
from hitchid.errors import InputError

START_M = 0.12


def noiseless(rig):
    return eqx.tree_at(
        lambda r: (r.sensors.angle_noise, r.sensors.current_noise), rig, (jnp.zeros(()), jnp.zeros(()))
    )


@jax.jit
def stepped(rigs, currents, disturbances, key):
    """Return states and measurements of a run: rigs, currents and disturbances have a row a sample."""
    first = jax.tree.map(lambda leaf: leaf[0], (rigs, disturbances))
    begin = reset(first[0], key, initial_displacement_m=START_M, disturbance=first[1])

    def advance(state, row):
        state, measurement = step(row[0], state, row[1], row[2])
        return state, (state, measurement)

    rows = jax.lax.scan(advance, begin[0], (rigs, currents, disturbances))[1]
    return jax.tree.map(lambda one, others: jnp.concatenate([one[None], others]), begin, rows)


def run(rig, currents, *, changed=None, seed=0, **disturbances):
    """Return states and measurements; `changed` takes the rig and the time, s, to the rig from then on."""
    samples = len(currents)
    shaped = {name: jnp.broadcast_to(jnp.asarray(value), samples) for name, value in disturbances.items()}
    default = Disturbance()._asdict()
    rows = Disturbance(
        **{name: shaped.get(name, jnp.full(samples, value)) for name, value in default.items()}
    )
    rigs = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (samples, *jnp.shape(leaf))), rig)
    if changed is not None:
        rigs = jax.vmap(partial(changed, rig))(0.01 * jnp.arange(samples))
    return stepped(rigs, jnp.asarray(currents), rows, jax.random.key(seed))


@pytest.fixture
def currents(binary):
    """Return half a second at rest, then lifting and lowering by turns, shape [600, 2]."""
    rows = np.concatenate([binary(1)[0, :300], binary(2)[1, :300]])
    rows[:50] = 0.0
    return rows


def test_single_steps_give_the_run_of_the_whole_test(any_rig, currents):
    """Both evaluate the same sums; rounding grows by the stiffness of the stops and of the oil."""
    rig = noiseless(any_rig)
    force = np.linspace(0.0, 800.0, len(currents))
    states, measured = run(rig, currents, load_force_n=force)
    motion = simulate(rig, currents[None], initial_displacement_m=START_M, load_force_n=force[None])
    whole = measure(rig, motion, currents[None], jax.random.key(0))
    np.testing.assert_allclose(
        np.asarray(states.plant.displacement)[:-1], motion.displacement_m[0], rtol=0, atol=1e-9
    )
    # One step of the converter may fall to either side.
    step_mm = 1e3 * 0.25 * float(rig.sensors.angle_range) / 2 ** float(rig.sensors.converter_bits)
    stepped_mm = np.asarray(measured.displacement_mm)[:-1]
    np.testing.assert_allclose(stepped_mm, whole["displacement_mm"][0], rtol=0, atol=4 * step_mm)
    np.testing.assert_allclose(measured.time_s[:-1], whole["time_s"][0], rtol=0, atol=1e-12)
    # The log's currents are those at the end of their own 10 ms.
    logged = np.stack([whole["current_up_A"][0], whole["current_down_A"][0]], axis=-1)
    np.testing.assert_allclose(np.asarray(measured.currents_a)[1:], logged, rtol=0, atol=1e-4)


def test_seeds_give_the_noise(rig, currents):
    first, again, other = (np.asarray(run(rig, currents, seed=seed)[1].displacement_mm) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    noise = (first - other)[:40] / np.sqrt(2)
    assert 0.03 < noise.std() < 0.15


def test_no_oil_is_made_or_lost_where_the_rig_changes(rig, currents):
    """An implement taken up, oil that warms, a valve and a piston that wear, a pump that slows down."""

    def parts(rig):
        worn = (rig.cylinder.leakage, rig.lowering_valve.spool.dead_zone)
        return (rig.linkage.implement_mass, rig.oil.temperature, *worn, rig.supply.pump_flow)

    def changed(rig, time_s):
        factors = jnp.where(time_s > 3.0, jnp.array([1.3, 1.0, 3.0, 1.1, 0.8]), 1.0)
        mass, temperature, *others = (factor * part for factor, part in zip(factors, parts(rig), strict=True))
        return eqx.tree_at(parts, rig, (mass, temperature + 5.0 * time_s, *others))

    plant = run(rig, currents, changed=changed)[0].plant
    held = rig.oil.amount(
        plant.pressure, rig.cylinder.volume(plant.displacement), rig.cylinder.compliance
    ) + rig.supply.amount(rig.oil, plant.supply_pressure)
    np.testing.assert_allclose(held, cylinder_amount(plant) + supply_amount(plant), rtol=1e-9)
    assert np.all(np.isfinite(plant.displacement))


def test_an_implement_taken_up_is_carried_by_pressure(rig):
    def changed(rig, time_s):
        mass = rig.linkage.implement_mass + jnp.where(time_s > 2.0, 300.0, 0.0)
        return eqx.tree_at(lambda r: r.linkage.implement_mass, rig, mass)

    plant = run(rig, np.zeros((1500, 2)), changed=changed)[0].plant
    heavier = eqx.tree_at(lambda r: r.linkage.implement_mass, rig, rig.linkage.implement_mass + 300.0)
    weight = float(heavier.linkage.reduced(plant.displacement[-1])[0])
    carried = float((plant.pressure[-1] - TANK_PRESSURE_PA) * rig.cylinder.area)
    assert abs(carried - weight) < 1.02 * float(rig.cylinder.friction.static)
    assert plant.displacement[-1] < plant.displacement[150]


def test_a_sensor_that_sticks_jumps_or_drops_out(rig, currents):
    late = np.arange(len(currents)) >= 200
    true = run(noiseless(rig), currents)[1].displacement_mm
    stuck = run(noiseless(rig), currents, sensor_stuck=late)[1].displacement_mm
    np.testing.assert_array_equal(stuck[:201], true[:201])
    assert np.ptp(stuck[200:]) == 0.0 < np.ptp(true[200:])
    lost = run(noiseless(rig), currents, sensor_lost=late)[1].displacement_mm
    assert np.all(np.isfinite(lost[:201]))
    assert np.all(np.isnan(lost[201:]))
    jumped = run(noiseless(rig), currents, sensor_offset_rad=0.02 * late)[1].displacement_mm
    assert np.all(np.abs(jumped[201:] - true[201:]) > 1.0)


@pytest.mark.parametrize("current", [np.nan, np.inf, -1.0])
def test_a_current_that_is_no_number_or_negative_is_none(rig, current):
    still = run(rig, np.zeros((100, 2)))[0].plant.displacement
    driven = run(rig, np.full((100, 2), current))[0].plant.displacement
    np.testing.assert_array_equal(driven, still)


def test_what_the_bench_cannot_do_is_refused(rig):
    key = jax.random.key(0)
    with pytest.raises(InputError, match=r"initial_displacement_m: got 0.3, expected 0 to 0.25"):
        reset(rig, key, initial_displacement_m=0.3)
    state, _ = reset(rig, key, initial_displacement_m=0.1)
    with pytest.raises(InputError, match=r"currents: got shape \(3,\), expected \[2\]"):
        step(rig, state, jnp.zeros(3))
