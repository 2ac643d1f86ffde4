"""The bench's equations of motion, and one step of them.

Spools, solenoids and compensator are advanced exactly or exponentially; pressures, speed, displacement and
bristle by one stage of the Rosenbrock method with γ = ½ (the linearly implicit midpoint rule, order 2 and
A-stable: Hairer & Wanner 1996, sec. IV.7), its linear system solved in closed form. Oil volumes are a
balance: every flow is added to one volume and subtracted from another, and pressures are computed from the
volumes, so that oil is conserved at any step size.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.bench.linkage import Cylinder, Linkage, Load
from hitchid.bench.sensors import Sensors
from hitchid.bench.valves import (
    TANK_PRESSURE_PA,
    LiftingValve,
    LoweringValve,
    Oil,
    Scalar,
    SpoolState,
    SpoolStep,
    Supply,
    Values,
)

# The bench: its components, and the limits of its motion.


@short_repr
class Rig(eqx.Module):
    """A tractor's electro-hydraulic hitch on its test bench (Sun et al. 2025, sec. 2.1).

    Attributes:
        oil: density, compressibility, viscosity.
        supply: pump, relief valve, line, accumulator.
        lifting_valve: compensated, from supply to cylinder.
        lowering_valve: from cylinder to tank, with the safety valve.
        cylinder: single-acting, with friction and end stops.
        linkage: three-point linkage and implement.
        sensors: angle and current sensors, data acquisition.
    """

    oil: Oil
    supply: Supply
    lifting_valve: LiftingValve
    lowering_valve: LoweringValve
    cylinder: Cylinder
    linkage: Linkage
    sensors: Sensors


@short_repr
class RigLimits(NamedTuple):
    """Limits of currents, travel and speed in a test.

    Attributes:
        stroke_m: travel of the piston between the end stops, m.
        lifting_speed_m_s: pump flow over piston area, m/s.
        lifting_dead_zone_a, lowering_dead_zone_a: rising current at which the valve begins to open, A.
        lifting_saturation_a, lowering_saturation_a: rising current at which the valve is wide open, A.
    """

    stroke_m: float
    lifting_speed_m_s: float
    lifting_dead_zone_a: float
    lowering_dead_zone_a: float
    lifting_saturation_a: float
    lowering_saturation_a: float


@double_precision
def rig_limits(rig: Rig) -> RigLimits:
    """Return stroke, largest lifting speed and the currents at which the valves open and saturate.

    The hysteresis is included: a rising current leads the spool by half the width of the loop.
    """
    lift, lower = rig.lifting_valve.spool, rig.lowering_valve.spool
    return RigLimits(
        float(rig.cylinder.stroke),
        float(rig.supply.pump_flow / rig.cylinder.area),
        float(lift.dead_zone + lift.hysteresis),
        float(lower.dead_zone + lower.hysteresis),
        float(lift.saturation + lift.hysteresis),
        float(lower.saturation + lower.hysteresis),
    )


def at_temperature(rig: Rig, temperature: Scalar) -> Rig:
    """Return the rig with viscous friction and leakage at an oil temperature, °C.

    σ₂ grows with viscosity, leakage falls with it.
    """
    # Once before a run: within it the oil does not warm, unless the rig itself is changed.
    ratio = rig.oil.viscosity_ratio(temperature)
    return eqx.tree_at(
        lambda r: (r.cylinder.friction.viscous, r.cylinder.leakage),
        rig,
        (rig.cylinder.friction.viscous * ratio, rig.cylinder.leakage / ratio),
    )


def hold_pressure(rig: Rig, displacement: Scalar, load_force: Scalar) -> Scalar:
    """Return the chamber pressure that carries weight and load without friction, Pa, at least 0.05 bar."""
    weight, _, lever = rig.linkage.reduced(displacement)
    return jnp.maximum(TANK_PRESSURE_PA + (weight + lever * load_force) / rig.cylinder.area, 5e3)


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

    `bristle` is the deflection z of the LuGre model; `supply_oil` and `cylinder_oil` are the amounts at the
    start; the present amounts are these plus the volumes in `oils`.
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
    """Inputs held during a step: currents, A, and the load at the implement, N, downward."""

    lifting: Values
    lowering: Values
    load_force: Values


class StepFactors(NamedTuple):
    """Factors that depend only on the step's length."""

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

    The friction is that after lifting, directed against it: (p − p₀) A = W + F_load dh/dx + F_c.
    """
    zero = jnp.zeros_like(displacement)
    friction = rig.cylinder.friction
    pressure = hold_pressure(rig, displacement, load_force) + friction.coulomb / rig.cylinder.area
    # Not from neutral friction: its lost motion at the first command would look like a lag.
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


class _Valves(NamedTuple):
    """Spools and compensator at the end of a step, and their mean openings over it, m²."""

    lifting: SpoolState
    lowering: SpoolState
    compensator: Values
    lift_area: Values
    lower_area: Values
    compensator_area: Values


class _Flows(NamedTuple):
    """Flow, m³/s, and its derivative by the pressure that drives it, m³/(s·Pa), of every path."""

    pump: tuple[Values, Values]
    relief: tuple[Values, Values]
    lift: tuple[Values, Values]
    lower: tuple[Values, Values]
    safety: tuple[Values, Values]
    leak: tuple[Values, Values]


class _Friction(NamedTuple):
    """Friction force F, N, bristle speed ż, m/s, and their derivatives.

    `decay` is −∂ż/∂z, 1/s; `gain` is ∂ż/∂v; `damping` is ∂F/∂ż, N·s/m.
    """

    force: Values
    bristle_speed: Values
    decay: Values
    gain: Values
    damping: Values


class _Momentum(NamedTuple):
    """Mass, kg, and force, N, on the piston; −∂F/∂x, N/m, and ∂F/∂v without friction, N·s/m."""

    mass: Values
    force: Values
    stiffness: Values
    damping: Values


class _Increments(NamedTuple):
    """Changes over the step of p_s, p, Pa, v, m/s, and z, m."""

    supply: Values
    pressure: Values
    speed: Values
    bristle: Values


def advance(
    rig: Rig,
    load: Load,
    origin: Values,
    state: RigState,
    inputs: RigInputs,
    ripple: Values,
    steps: StepFactors,
) -> RigState:
    """Advance the bench, with friction and leakage at oil temperature, by one step under held inputs.

    Continuity: C_s ṗ_s = Q_pump − Q_relief − Q_lift, C_c ṗ = Q_lift − Q_lower − Q_leak − Q_safety − A ẋ/σ(p).
    Force: m(x) ẍ + ½ m'(x) ẋ² = (p − p₀) A − W(x) − F_load dh/dx − F_friction + F_stop.

    The load is that at the displacement `origin`, m, and linear around it; the ripple is the pump's flow over
    its mean, averaged over the step.
    """
    dt, cylinder = steps.dt, rig.cylinder
    # First the valves, by the pressures at the start: the flows of the step are those of mean openings.
    valves = _step_valves(rig, state, inputs, steps)
    flows = _flows(rig, state, valves, ripple)
    friction = _friction(rig, state)
    momentum = _momentum(rig, load, origin, state, inputs, friction)
    change = _solve(rig, load, state, flows, friction, momentum, dt)
    updated = RigState(
        lifting=valves.lifting,
        lowering=valves.lowering,
        compensator=valves.compensator,
        supply_pressure=state.supply_pressure,
        pressure=state.pressure,
        displacement=state.displacement + dt * (state.speed + 0.5 * change.speed),
        speed=state.speed + change.speed,
        bristle=state.bristle + change.bristle,
        oils=_book(state.oils, flows, change, dt),
        supply_oil=state.supply_oil,
        cylinder_oil=state.cylinder_oil,
    )
    # Pressures from volumes, not from their own increments, whose error would make or lose oil.
    volume = cylinder.volume(updated.displacement)
    return updated._replace(
        supply_pressure=rig.supply.pressure(rig.oil, supply_amount(updated)),
        pressure=rig.oil.pressure(cylinder_amount(updated), volume, cylinder.compliance),
    )


def _step_valves(rig: Rig, state: RigState, inputs: RigInputs, steps: StepFactors) -> _Valves:
    lift_valve, lower_valve = rig.lifting_valve, rig.lowering_valve
    lifting = lift_valve.spool.advance(state.lifting, inputs.lifting, steps.lifting)
    lowering = lower_valve.spool.advance(state.lowering, inputs.lowering, steps.lowering)
    lift_area = lift_valve.spool.area(0.5 * (state.lifting.position + lifting.position))
    lower_area = lower_valve.spool.area(0.5 * (state.lowering.position + lowering.position))
    # The compensator follows the opening at which both orifices would be in balance now, with its lag.
    drop = state.supply_pressure - state.pressure
    spools = lift_valve.balanced_opening(lift_area, state.compensator, drop - lift_valve.check_pressure)
    compensator = spools + (state.compensator - spools) * steps.compensator
    return _Valves(
        lifting, lowering, compensator, lift_area, lower_area, 0.5 * (state.compensator + compensator)
    )


def _flows(rig: Rig, state: RigState, valves: _Valves, ripple: Values) -> _Flows:
    supply, lift_valve, lower_valve = rig.supply, rig.lifting_valve, rig.lowering_valve
    pressure, drop = state.pressure, state.supply_pressure - state.pressure
    return _Flows(
        pump=supply.pump_delivery(state.supply_pressure, ripple),
        relief=supply.relief_flow(state.supply_pressure),
        lift=lift_valve.flow(valves.lift_area, valves.compensator_area, drop, rig.oil.density),
        lower=lower_valve.flow(valves.lower_area, pressure, rig.oil.density),
        safety=lower_valve.safety_flow(pressure),
        leak=(rig.cylinder.leakage * (pressure - TANK_PRESSURE_PA), rig.cylinder.leakage),
    )


def _friction(rig: Rig, state: RigState) -> _Friction:
    """Return the LuGre friction; see `hitchid.bench.linkage.Friction`."""
    friction, speed = rig.cylinder.friction, state.speed
    stiffness = friction.bristle_stiffness
    stribeck_factor, stribeck_level, stribeck_slope = friction.stribeck(speed)
    damping = friction.bristle_damping * stribeck_factor
    decay = stiffness * jnp.abs(speed) / stribeck_level
    decay_slope = stiffness * jnp.sign(speed) / stribeck_level - decay * stribeck_slope / stribeck_level
    bristle_speed = speed - decay * state.bristle
    force = stiffness * state.bristle + damping * bristle_speed
    force = force + friction.viscous * speed
    return _Friction(force, bristle_speed, decay, 1 - decay_slope * state.bristle, damping)


def _momentum(
    rig: Rig, load: Load, origin: Values, state: RigState, inputs: RigInputs, friction: _Friction
) -> _Momentum:
    cylinder, offset = rig.cylinder, state.displacement - origin
    stop, stop_slope, stop_damping = cylinder.stop_force(state.displacement, state.speed)
    carried_force = load.weight + load.weight_slope * offset
    carried_force = carried_force + (load.lever + load.lever_slope * offset) * inputs.load_force
    force = (state.pressure - TANK_PRESSURE_PA) * cylinder.area - carried_force - friction.force + stop
    return _Momentum(
        mass=load.mass + load.mass_slope * offset,
        force=force - 0.5 * load.mass_slope * state.speed**2,
        stiffness=load.weight_slope + load.lever_slope * inputs.load_force - stop_slope,
        damping=stop_damping,
    )


def _solve(
    rig: Rig, load: Load, state: RigState, flows: _Flows, friction: _Friction, momentum: _Momentum, dt: Values
) -> _Increments:
    """Solve the stage's linear system for the increments, eliminated in the order z, x, p_s, p, v."""
    cylinder, half = rig.cylinder, 0.5 * dt
    supply_capacity = rig.supply.capacity(rig.oil, state.supply_pressure, supply_amount(state))
    capacity = rig.oil.capacity(state.pressure, cylinder_amount(state), cylinder.compliance)
    # Volumes are at tank pressure, but the piston sweeps oil under pressure.
    effective_area = cylinder.area / rig.oil.specific_volume(state.pressure)
    (pump, pump_slope), (relief, relief_slope), (lift, lift_slope) = flows.pump, flows.relief, flows.lift
    (lower, lower_slope), (safety, safety_slope), (leak, leak_slope) = flows.lower, flows.safety, flows.leak

    implicit_factor = 1 / (1 + half * friction.decay)
    bristle_fixed = dt * friction.bristle_speed * implicit_factor
    bristle_by_speed = half * friction.gain * implicit_factor
    bristle_force = cylinder.friction.bristle_stiffness - friction.damping * friction.decay
    drag = cylinder.friction.viscous + friction.damping * friction.gain - momentum.damping
    drag = drag + load.mass_slope * state.speed
    drag = drag + bristle_force * bristle_by_speed + momentum.stiffness * half
    force_fixed = momentum.force - 0.5 * momentum.stiffness * dt * state.speed
    force_fixed = dt * (force_fixed - 0.5 * bristle_force * bristle_fixed)

    supply_denominator = supply_capacity + half * (relief_slope + lift_slope - pump_slope)
    supply_fixed = dt * (pump - relief - lift) / supply_denominator
    supply_by_pressure = half * lift_slope / supply_denominator
    pressure_denominator = capacity + half * (lift_slope + lower_slope + leak_slope + safety_slope)
    pressure_denominator = pressure_denominator - half * lift_slope * supply_by_pressure
    net_flow = lift - lower - leak - safety - effective_area * state.speed
    pressure_by_speed = -half * effective_area / pressure_denominator
    pressure_fixed = (dt * net_flow + half * lift_slope * supply_fixed) / pressure_denominator

    speed_change = (force_fixed + half * cylinder.area * pressure_fixed) / (
        momentum.mass + half * drag - half * cylinder.area * pressure_by_speed
    )
    pressure_change = pressure_fixed + pressure_by_speed * speed_change
    return _Increments(
        supply=supply_fixed + supply_by_pressure * pressure_change,
        pressure=pressure_change,
        speed=speed_change,
        bristle=bristle_fixed + bristle_by_speed * speed_change,
    )


def _book(oils: OilVolumes, flows: _Flows, change: _Increments, dt: Values) -> OilVolumes:
    """Add the volumes of the mean flows over the step."""

    def flowed(flow: tuple[Values, Values], pressure_change: Values) -> Values:
        return dt * (flow[0] + 0.5 * flow[1] * pressure_change)

    return OilVolumes(
        oils.pumped + flowed(flows.pump, change.supply),
        oils.relieved + flowed(flows.relief, change.supply),
        oils.lifted + flowed(flows.lift, change.supply - change.pressure),
        oils.lowered + flowed(flows.lower, change.pressure),
        oils.leaked + flowed(flows.leak, change.pressure),
        oils.safety_relieved + flowed(flows.safety, change.pressure),
    )
