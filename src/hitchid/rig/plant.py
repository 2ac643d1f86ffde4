"""The bench's equations of motion, and one step of them.

Spools, solenoids and compensator are advanced exactly or exponentially; pressures, speed, displacement and
bristle by one stage of the Rosenbrock method with γ = ½ (the linearly implicit midpoint rule, order 2 and
A-stable: Hairer & Wanner 1996, sec. IV.7), its linear system solved by hand. Oil is booked by volume: every
flow is added to one account and taken from another, and pressures follow from the accounts, so that no oil is
made or lost whatever the step.
"""

from typing import NamedTuple

import jax.numpy as jnp

from hitchid.rig.linkage import Load
from hitchid.rig.oil import TANK_PRESSURE_PA, Values
from hitchid.rig.test_bench import Rig, hold_pressure
from hitchid.rig.valves import SpoolState, SpoolStep


class OilVolumes(NamedTuple):
    """Volumes at tank pressure that have flowed since the start, m³."""

    pumped: Values
    relieved: Values
    lifted: Values
    lowered: Values
    leaked: Values
    safety_relieved: Values


class RigState(NamedTuple):
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
    oils: OilVolumes
    supply_oil: Values
    cylinder_oil: Values


class RigInputs(NamedTuple):
    """What is held during a step: currents, A, and the load at the implement, N, downward."""

    lifting: Values
    lowering: Values
    load_force: Values


class StepFactors(NamedTuple):
    """What depends on the step's length alone."""

    dt: Values
    lifting: SpoolStep
    lowering: SpoolStep
    compensator: Values


def step_factors(rig: Rig, dt: Values) -> StepFactors:
    """Return the exact factors of the linear parts for a step, s."""
    return StepFactors(
        dt,
        rig.lifting_valve.spool.discretise(dt),
        rig.lowering_valve.spool.discretise(dt),
        jnp.exp(-dt / rig.lifting_valve.compensator_lag),
    )


def at_rest(rig: Rig, displacement: Values, load_force: Values) -> RigState:
    """Return the bench holding its load at a displacement, valves closed, pump on relief.

    It was lifted there, so friction is still deflected against lifting: (p − p₀) A = W + F_load dh/dx + F_c.
    """
    zero = jnp.zeros_like(displacement)
    friction = rig.cylinder.friction
    pressure = hold_pressure(rig, displacement, load_force) + friction.coulomb / rig.cylinder.area
    supply_pressure = rig.supply.idle_pressure()
    return RigState(
        lifting=rig.lifting_valve.spool.rest(),
        lowering=rig.lowering_valve.spool.rest(),
        compensator=zero,
        supply_pressure=supply_pressure,
        pressure=pressure,
        displacement=displacement,
        speed=zero,
        bristle=friction.coulomb / friction.bristle_stiffness,
        oils=OilVolumes(zero, zero, zero, zero, zero, zero),
        supply_oil=rig.supply.amount(rig.oil, supply_pressure),
        cylinder_oil=rig.oil.amount(pressure, rig.cylinder.volume(displacement), rig.cylinder.compliance),
    )


def supply_amount(state: RigState) -> Values:
    """Return the oil in the supply line now, m³ at tank pressure."""
    return state.supply_oil + state.oils.pumped - state.oils.relieved - state.oils.lifted


def cylinder_amount(state: RigState) -> Values:
    """Return the oil in chamber and hose now, m³ at tank pressure."""
    oils = state.oils
    return state.cylinder_oil + oils.lifted - oils.lowered - oils.leaked - oils.safety_relieved


def advance(
    rig: Rig,
    load: Load,
    origin: Values,
    state: RigState,
    inputs: RigInputs,
    ripple: Values,
    steps: StepFactors,
) -> RigState:
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
    balanced = lift_valve.balanced_opening(lift_area, state.compensator, drop - lift_valve.check_pressure)
    compensator = balanced + (state.compensator - balanced) * steps.compensator
    mean_compensator = 0.5 * (state.compensator + compensator)

    pump, pump_slope = rig.supply.pump_delivery(supply_pressure, ripple)
    relief, relief_slope = rig.supply.relief_flow(supply_pressure)
    lift, lift_slope = lift_valve.flow(lift_area, mean_compensator, drop, oil.density)
    lower, lower_slope = lower_valve.flow(lower_area, pressure, oil.density)
    safety, safety_slope = lower_valve.safety_flow(pressure)
    leak = cylinder.leakage * (pressure - TANK_PRESSURE_PA)

    supply_capacity = rig.supply.capacity(oil, supply_pressure, supply_amount(state))
    capacity = oil.capacity(pressure, cylinder_amount(state), cylinder.compliance)
    effective_area = cylinder.area / oil.specific_volume(pressure)

    stribeck_factor, stribeck_level, stribeck_slope = friction.stribeck(speed)
    bristle_damping = friction.bristle_damping * stribeck_factor
    rate = friction.bristle_stiffness * jnp.abs(speed) / stribeck_level
    rate_slope = (
        friction.bristle_stiffness * jnp.sign(speed) / stribeck_level - rate * stribeck_slope / stribeck_level
    )
    bristle_speed = speed - rate * state.bristle
    bristle_gain = 1 - rate_slope * state.bristle
    friction_force = friction.bristle_stiffness * state.bristle + bristle_damping * bristle_speed
    friction_force = friction_force + friction.viscous * speed

    offset = state.displacement - origin
    stop, stop_slope, stop_damping = cylinder.stop_force(state.displacement, speed)
    carried_force = load.weight + load.weight_slope * offset
    carried_force = carried_force + (load.lever + load.lever_slope * offset) * inputs.load_force
    carried_force_slope = load.weight_slope + load.lever_slope * inputs.load_force
    mass = load.mass + load.mass_slope * offset
    force = (pressure - TANK_PRESSURE_PA) * cylinder.area - carried_force - friction_force + stop
    force = force - 0.5 * load.mass_slope * speed**2

    # Unknown increments Δ of p_s, p, v, x, z over the step; eliminated in the order z, x, p_s, p, v.
    half = 0.5 * dt
    implicit_factor = 1 / (1 + half * rate)
    bristle_fixed, bristle_by_speed = (
        dt * bristle_speed * implicit_factor,
        half * bristle_gain * implicit_factor,
    )
    stiffness = carried_force_slope - stop_slope
    bristle_force = friction.bristle_stiffness - bristle_damping * rate
    drag = friction.viscous + bristle_damping * bristle_gain - stop_damping + load.mass_slope * speed
    drag = drag + bristle_force * bristle_by_speed + stiffness * half
    force_fixed = dt * (force - 0.5 * stiffness * dt * speed - 0.5 * bristle_force * bristle_fixed)

    supply_denominator = supply_capacity + half * (relief_slope + lift_slope - pump_slope)
    supply_fixed = dt * (pump - relief - lift) / supply_denominator
    supply_by_pressure = half * lift_slope / supply_denominator
    pressure_denominator = capacity + half * (lift_slope + lower_slope + cylinder.leakage + safety_slope)
    pressure_denominator = pressure_denominator - half * lift_slope * supply_by_pressure
    pressure_rhs = (
        dt * (lift - lower - leak - safety - effective_area * speed) + half * lift_slope * supply_fixed
    )
    pressure_by_speed = -half * effective_area / pressure_denominator
    pressure_fixed = pressure_rhs / pressure_denominator

    speed_change = (force_fixed + half * cylinder.area * pressure_fixed) / (
        mass + half * drag - half * cylinder.area * pressure_by_speed
    )
    pressure_change = pressure_fixed + pressure_by_speed * speed_change
    supply_change = supply_fixed + supply_by_pressure * pressure_change
    bristle_change = bristle_fixed + bristle_by_speed * speed_change

    oils = OilVolumes(
        state.oils.pumped + dt * (pump + 0.5 * pump_slope * supply_change),
        state.oils.relieved + dt * (relief + 0.5 * relief_slope * supply_change),
        state.oils.lifted + dt * (lift + 0.5 * lift_slope * (supply_change - pressure_change)),
        state.oils.lowered + dt * (lower + 0.5 * lower_slope * pressure_change),
        state.oils.leaked + dt * (leak + 0.5 * cylinder.leakage * pressure_change),
        state.oils.safety_relieved + dt * (safety + 0.5 * safety_slope * pressure_change),
    )
    updated = RigState(
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
    volume = cylinder.volume(updated.displacement)
    return updated._replace(
        supply_pressure=rig.supply.pressure(oil, supply_amount(updated)),
        pressure=oil.pressure(cylinder_amount(updated), volume, cylinder.compliance),
    )
