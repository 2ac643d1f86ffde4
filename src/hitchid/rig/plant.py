"""The bench's equations of motion, and one step of them.

Spools, solenoids and compensator are advanced exactly or exponentially; pressures, speed, displacement and
bristle by one stage of the Rosenbrock method with γ = ½ (the linearly implicit midpoint rule, order 2 and
A-stable: Hairer & Wanner 1996, sec. IV.7), its linear system solved by hand. Oil is booked by volume: every
flow is added to one account and taken from another, and pressures follow from the accounts, so that no oil is
made or lost whatever the step.
"""

from typing import NamedTuple

import jax.numpy as jnp

from hitchid.rig.bench import Rig, hold_pressure
from hitchid.rig.linkage import Load
from hitchid.rig.oil import TANK_PRESSURE_PA, Values
from hitchid.rig.valves import SpoolState, SpoolStep


class Oils(NamedTuple):
    """Volumes at tank pressure that have flowed since the start, m³."""

    pumped: Values
    relieved: Values
    lifted: Values
    lowered: Values
    leaked: Values
    secured: Values


class State(NamedTuple):
    """The bench at one instant: SI units, absolute pressures.

    `bristle` is the deflection z of the LuGre model; `supply_oil` and `cylinder_oil` are what was there at
    the start; what is there now is that plus the accounts.
    """

    lifting: SpoolState
    lowering: SpoolState
    compensator: Values
    supply_pressure: Values
    pressure: Values
    displacement: Values
    speed: Values
    bristle: Values
    oils: Oils
    supply_oil: Values
    cylinder_oil: Values


class Inputs(NamedTuple):
    """What is held during a step: currents, A, and the load at the implement, N, downward."""

    lifting: Values
    lowering: Values
    load_force: Values


class Steps(NamedTuple):
    """What depends on the step's length alone."""

    dt: Values
    lifting: SpoolStep
    lowering: SpoolStep
    compensator: Values


def steps_of(rig: Rig, dt: Values) -> Steps:
    """Return the exact factors of the linear parts for a step, s."""
    return Steps(
        dt,
        rig.lifting_valve.spool.discretised(dt),
        rig.lowering_valve.spool.discretised(dt),
        jnp.exp(-dt / rig.lifting_valve.compensator_lag),
    )


def at_rest(rig: Rig, displacement: Values, load_force: Values) -> State:
    """Return the bench holding its load at a displacement, valves closed, pump on relief.

    It was lifted there, so friction is still deflected against lifting: (p − p₀) A = W + F_load dh/dx + F_c.
    """
    zero = jnp.zeros_like(displacement)
    friction = rig.cylinder.friction
    pressure = hold_pressure(rig, displacement, load_force) + friction.coulomb / rig.cylinder.area
    supply_pressure = rig.supply.idle_pressure()
    return State(
        lifting=rig.lifting_valve.spool.rest(),
        lowering=rig.lowering_valve.spool.rest(),
        compensator=zero,
        supply_pressure=supply_pressure,
        pressure=pressure,
        displacement=displacement,
        speed=zero,
        bristle=friction.coulomb / friction.bristle_stiffness,
        oils=Oils(zero, zero, zero, zero, zero, zero),
        supply_oil=rig.supply.amount(rig.oil, supply_pressure),
        cylinder_oil=rig.oil.amount(pressure, rig.cylinder.volume(displacement), rig.cylinder.yielding),
    )


def supply_amount(state: State) -> Values:
    """Return the oil in the supply line now, m³ at tank pressure."""
    return state.supply_oil + state.oils.pumped - state.oils.relieved - state.oils.lifted


def cylinder_amount(state: State) -> Values:
    """Return the oil in chamber and hose now, m³ at tank pressure."""
    oils = state.oils
    return state.cylinder_oil + oils.lifted - oils.lowered - oils.leaked - oils.secured


def advance(
    rig: Rig, load: Load, origin: Values, state: State, inputs: Inputs, ripple: Values, steps: Steps
) -> State:
    """Advance the bench by one step.

    Continuity: C_s ṗ_s = Q_pump − Q_relief − Q_lift, C_c ṗ = Q_lift − Q_lower − Q_leak − Q_safety − A ẋ/σ(p).
    Force: m(x) ẍ + ½ m'(x) ẋ² = (p − p₀) A − W(x) − F_load dh/dx − F_friction + F_stop.

    Args:
        rig: with friction and leakage at oil temperature.
        load: at the displacement `origin`, m; taken as linear around it.
        origin: see `load`.
        state: at the start of the step.
        inputs: held during the step.
        ripple: the pump's flow over its mean, averaged over the step.
        steps: factors that belong to its length.
    """
    dt, oil, cylinder, friction = steps.dt, rig.oil, rig.cylinder, rig.cylinder.friction
    lift_valve, lower_valve = rig.lifting_valve, rig.lowering_valve
    supply_pressure, pressure, speed = state.supply_pressure, state.pressure, state.speed

    lifting = lift_valve.spool.advance(state.lifting, inputs.lifting, steps.lifting)
    lowering = lower_valve.spool.advance(state.lowering, inputs.lowering, steps.lowering)
    lift_area = lift_valve.spool.area(0.5 * (state.lifting.position + lifting.position))
    lower_area = lower_valve.spool.area(0.5 * (state.lowering.position + lowering.position))
    drop = supply_pressure - pressure
    balanced = lift_valve.balanced(lift_area, state.compensator, drop - lift_valve.check_pressure)
    compensator = balanced + (state.compensator - balanced) * steps.compensator
    middle = 0.5 * (state.compensator + compensator)

    pump, pump_slope = rig.supply.delivered(supply_pressure, ripple)
    relief, relief_slope = rig.supply.relieved(supply_pressure)
    lift, lift_slope = lift_valve.flow(lift_area, middle, drop, oil.density)
    lower, lower_slope = lower_valve.flow(lower_area, pressure, oil.density)
    safety, safety_slope = lower_valve.safety(pressure)
    leak = cylinder.leakage * (pressure - TANK_PRESSURE_PA)

    supply_capacity = rig.supply.capacity(oil, supply_pressure, supply_amount(state))
    capacity = oil.capacity(pressure, cylinder_amount(state), cylinder.yielding)
    swept = cylinder.area / oil.specific_volume(pressure)

    fade, level, level_slope = friction.level(speed)
    bristle_damping = friction.bristle_damping * fade
    rate = friction.bristle_stiffness * jnp.abs(speed) / level
    rate_slope = friction.bristle_stiffness * jnp.sign(speed) / level - rate * level_slope / level
    bristle_speed = speed - rate * state.bristle
    bristle_gain = 1 - rate_slope * state.bristle
    rub = friction.bristle_stiffness * state.bristle + bristle_damping * bristle_speed
    rub = rub + friction.viscous * speed

    away = state.displacement - origin
    stop, stop_slope, stop_damping = cylinder.stop_force(state.displacement, speed)
    carried = load.weight + load.weight_slope * away
    carried = carried + (load.lever + load.lever_slope * away) * inputs.load_force
    carried_slope = load.weight_slope + load.lever_slope * inputs.load_force
    mass = load.mass + load.mass_slope * away
    force = (pressure - TANK_PRESSURE_PA) * cylinder.area - carried - rub + stop
    force = force - 0.5 * load.mass_slope * speed**2

    # Unknown increments Δ of p_s, p, v, x, z over the step; eliminated in the order z, x, p_s, p, v.
    half = 0.5 * dt
    soft = 1 / (1 + half * rate)
    bristle_fixed, bristle_by_speed = dt * bristle_speed * soft, half * bristle_gain * soft
    stiffness = carried_slope - stop_slope
    bristle_force = friction.bristle_stiffness - bristle_damping * rate
    drag = friction.viscous + bristle_damping * bristle_gain - stop_damping + load.mass_slope * speed
    drag = drag + bristle_force * bristle_by_speed + stiffness * half
    force_fixed = dt * (force - 0.5 * stiffness * dt * speed - 0.5 * bristle_force * bristle_fixed)

    supply_own = supply_capacity + half * (relief_slope + lift_slope - pump_slope)
    supply_fixed = dt * (pump - relief - lift) / supply_own
    supply_by_pressure = half * lift_slope / supply_own
    own = capacity + half * (lift_slope + lower_slope + cylinder.leakage + safety_slope)
    own = own - half * lift_slope * supply_by_pressure
    net = dt * (lift - lower - leak - safety - swept * speed) + half * lift_slope * supply_fixed
    by_speed = -half * swept / own
    fixed = net / own

    speed_change = (force_fixed + half * cylinder.area * fixed) / (
        mass + half * drag - half * cylinder.area * by_speed
    )
    change = fixed + by_speed * speed_change
    supply_change = supply_fixed + supply_by_pressure * change
    bristle_change = bristle_fixed + bristle_by_speed * speed_change

    oils = Oils(
        state.oils.pumped + dt * (pump + 0.5 * pump_slope * supply_change),
        state.oils.relieved + dt * (relief + 0.5 * relief_slope * supply_change),
        state.oils.lifted + dt * (lift + 0.5 * lift_slope * (supply_change - change)),
        state.oils.lowered + dt * (lower + 0.5 * lower_slope * change),
        state.oils.leaked + dt * (leak + 0.5 * cylinder.leakage * change),
        state.oils.secured + dt * (safety + 0.5 * safety_slope * change),
    )
    booked = State(
        lifting=lifting,
        lowering=lowering,
        compensator=compensator,
        supply_pressure=supply_pressure,
        pressure=pressure,
        displacement=state.displacement + dt * (speed + 0.5 * speed_change),
        speed=speed + speed_change,
        bristle=state.bristle + bristle_change,
        oils=oils,
        supply_oil=state.supply_oil,
        cylinder_oil=state.cylinder_oil,
    )
    volume = cylinder.volume(booked.displacement)
    return booked._replace(
        supply_pressure=rig.supply.pressure(oil, supply_amount(booked)),
        pressure=oil.pressure(cylinder_amount(booked), volume, cylinder.yielding),
    )
