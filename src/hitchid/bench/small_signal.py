"""Lifting and lowering chain linearised around steady motion."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.bench.plant import Rig, at_temperature, hold_pressure
from hitchid.bench.valves import TANK_PRESSURE_PA, Scalar


@short_repr
class OperatingPoint(NamedTuple):
    """Steady lifting or lowering to linearise around.

    Attributes:
        displacement_m: m.
        current_a: current in the direction's coil less the hysteresis, A.
        load_force_n: at the implement, N.
        oil_temperature_c: °C; None for that of the rig.
    """

    displacement_m: float | Scalar
    current_a: float | Scalar
    load_force_n: float | Scalar = 0.0
    oil_temperature_c: float | Scalar | None = None


@short_repr
class SmallSignal(NamedTuple):
    """K, mm/(s·A), ωh, rad/s, and ξh of K/(s (s²/ωh² + 2 ξh s/ωh + 1)), and the steady speed, mm/s."""

    gain: float
    natural_frequency: float
    damping_ratio: float
    speed: float


class SteadyState(NamedTuple):
    """Pressure, Pa, speed, m/s, and oil flow, m³/s, of steady motion; k_q k_v, m³/(s·A); k_c, m³/(s·Pa)."""

    pressure: Scalar
    speed: Scalar
    flow: Scalar
    flow_gain: Scalar
    flow_pressure: Scalar


@double_precision
def small_signal(rig: Rig, operating_point: OperatingPoint) -> SmallSignal:
    """Return gain, natural frequency and damping of the lifting chain, spool current to displacement.

    With flow gain k_q k_v, flow-pressure coefficient k_c, leakage C_p, C = V/β_e, piston area A, effective
    mass m, B = σ₂ + dg/dv and load stiffness k = dW/dx, Sun et al. 2025, sec. 2.2.2, except k, which they
    neglect:

        D = A + B (C_p + k_c)/A + k C/A
        K = k_q k_v/D,  ωh² = A D/(m C),  2 ξh/ωh = (B C/A + m (C_p + k_c)/A)/D

    k (C_p + k_c), which limits the integrator far below 0.1 rad/s, is neglected. The lags of solenoid, spool
    and compensator are not included. Flows are volumes at tank pressure, hence A/σ(p) for A in continuity.
    The steady speed is v = (Q − C_p (p − p₀))/(A + k C/A).
    """
    return _small_signal(rig, operating_point, is_lifting=True)


@double_precision
def lowering_small_signal(rig: Rig, operating_point: OperatingPoint) -> SmallSignal:
    """Return gain, natural frequency and damping of the lowering chain, spool current to downward travel.

    Gravity drives the flow Q = C_d a(i) √(2 (p − p₀)/ρ) through notches and damper to tank pressure p₀, so

        p − p₀ = (W − g(v) − σ₂ v)/A,  k_q k_v = ∂Q/∂i,  k_c = ∂Q/∂p = Q/(2 (p − p₀)),

    and chamber, mass and friction are those of `small_signal`, with leakage added to the valve's flow:
    v = (Q + C_p (p − p₀))/(A + k C/A). Two slow terms are neglected: k (C_p + k_c), by which speed falls with
    the load's pressure, and v C dk/dx, by which it rises as the hose releases less oil.
    """
    return _small_signal(rig, operating_point, is_lifting=False)


def _small_signal(rig: Rig, point: OperatingPoint, *, is_lifting: bool) -> SmallSignal:
    temperature = rig.oil.temperature if point.oil_temperature_c is None else point.oil_temperature_c
    complete = point._replace(oil_temperature_c=temperature)
    # Arrays, so that all points use one compiled program.
    arrays = OperatingPoint(*(jnp.asarray(value, jnp.float64) for value in complete))
    return SmallSignal(*map(float, _chain(rig, arrays, is_lifting)))


@eqx.filter_jit
def _chain(rig: Rig, point: OperatingPoint, is_lifting: bool) -> Array:
    """Return the fields of a `SmallSignal`, shape [4]."""
    rig = at_temperature(rig, jnp.asarray(point.oil_temperature_c))
    steady = _steady_lifting(rig, point) if is_lifting else _steady_lowering(rig, point)
    # Leakage goes to tank: it takes from the flow that lifts, and adds to the one that lowers.
    leakage_sign = -1.0 if is_lifting else 1.0
    displacement = jnp.asarray(point.displacement_m)
    load = rig.linkage.load(displacement)
    mass, stiffness = load.mass, load.weight_slope + point.load_force_n * load.lever_slope

    cylinder, area = rig.cylinder, rig.cylinder.area
    effective_area = area / rig.oil.specific_volume(steady.pressure)
    amount = rig.oil.amount(steady.pressure, cylinder.volume(displacement), cylinder.compliance)
    capacity = rig.oil.capacity(steady.pressure, amount, cylinder.compliance)
    losses = cylinder.leakage + steady.flow_pressure
    damping = cylinder.friction.viscous + cylinder.friction.stribeck(steady.speed)[2]

    stiffened_area = effective_area + stiffness * capacity / area
    speed = (
        steady.flow + leakage_sign * cylinder.leakage * (steady.pressure - TANK_PRESSURE_PA)
    ) / stiffened_area
    divisor = stiffened_area + damping * losses / area
    omega = jnp.sqrt(area * divisor / (mass * capacity))
    lag = (damping * capacity + mass * losses) / area / divisor
    return jnp.stack([1e3 * steady.flow_gain / divisor, omega, 0.5 * lag * omega, 1e3 * speed])


def _steady_lowering(rig: Rig, point: OperatingPoint) -> SteadyState:
    valve, cylinder, density = rig.lowering_valve, rig.cylinder, rig.oil.density
    current, load_force = jnp.asarray(point.current_a), jnp.asarray(point.load_force_n)
    frictionless_pressure = hold_pressure(rig, jnp.asarray(point.displacement_m), load_force)

    def flow_at(coil: Scalar, pressure: Scalar) -> tuple[Scalar, Scalar]:
        return valve.flow(valve.spool.area(coil / valve.spool.saturation), pressure, density)

    def fixed_point_step(_round: Array, carry: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        pressure, _ = carry
        speed = flow_at(current, pressure)[0] * rig.oil.specific_volume(pressure) / cylinder.area
        friction_force = cylinder.friction.stribeck(speed)[1] + cylinder.friction.viscous * speed
        return frictionless_pressure - friction_force / cylinder.area, speed

    # Friction carries part of the weight; the iteration is a contraction.
    pressure, speed = jax.lax.fori_loop(
        0, 20, fixed_point_step, (frictionless_pressure, jnp.zeros_like(frictionless_pressure))
    )
    flow, flow_pressure = flow_at(current, pressure)
    # At the pressure of the steady state: how that changes with the flow is the term of k_c.
    flow_gain = jax.grad(lambda coil: flow_at(coil, pressure)[0])(current)
    return SteadyState(pressure, speed, flow, flow_gain, flow_pressure)


def _steady_lifting(rig: Rig, point: OperatingPoint) -> SteadyState:
    valve, cylinder, displacement = rig.lifting_valve, rig.cylinder, jnp.asarray(point.displacement_m)
    spool = valve.spool
    overlap = spool.dead_zone / spool.saturation
    position = jnp.asarray(point.current_a) / spool.saturation
    travel = (position - overlap) / (1 - overlap)
    area = spool.area(position)
    # a = a₁ (√(y² + y₀²) − y₀)/(√(1 + y₀²) − y₀), y = (i/i_s − s₀)/(1 − s₀)
    notch = spool.notch
    area_slope = spool.full_area * travel / jnp.sqrt(travel**2 + notch**2)
    area_slope = area_slope / (jnp.sqrt(1 + notch**2) - notch) / (spool.saturation * (1 - overlap))

    frictionless_pressure = hold_pressure(rig, displacement, jnp.asarray(point.load_force_n))
    idle = rig.supply.idle_pressure()

    def fixed_point_step(_round: Array, carry: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        pressure, supply_pressure, opening = carry[:3]
        drop = supply_pressure - pressure - valve.check_pressure
        opening = valve.balanced_opening(area, opening, drop)
        flow, _ = valve.flow(area, opening, drop + valve.check_pressure, rig.oil.density)
        supply_pressure = idle - flow / (rig.supply.relief_gain + rig.supply.pump_flow * rig.supply.pump_slip)
        speed = flow * rig.oil.specific_volume(pressure) / cylinder.area
        friction_force = cylinder.friction.stribeck(speed)[1] + cylinder.friction.viscous * speed
        return frictionless_pressure + friction_force / cylinder.area, supply_pressure, opening, flow, speed

    # Friction raises the pressure, flow lowers the supply pressure; the iteration is a contraction.
    none = jnp.zeros_like(area)
    pressure, supply_pressure, opening, flow, speed = jax.lax.fori_loop(
        0, 50, fixed_point_step, (frictionless_pressure, idle, none, none, none)
    )
    # In balance Q = C_d a √(2 Δp_m/ρ) with Δp_m = Δp₀ (1 + d (1 − a_k/a_K)), a_k = a √(Δp_m/(Δp − Δp_m)).
    metering = valve.metering_drop(opening)
    rest = supply_pressure - pressure - valve.check_pressure - metering
    stiff = valve.offset_pressure * valve.droop / valve.compensator_area
    by_metering = opening / (2 * metering) + opening / (2 * rest)
    by_load = stiff * opening / (2 * rest) / (1 + stiff * by_metering)
    by_area = -stiff * (opening / area) / (1 + stiff * by_metering)
    flow_gain = flow / area + flow / (2 * metering) * by_area
    return SteadyState(pressure, speed, flow, flow_gain * area_slope, flow / (2 * metering) * by_load)
