"""The lifting chain linearised by hand around steady lifting."""

from typing import NamedTuple

import jax.numpy as jnp

from hitchid.precision import double_precision
from hitchid.rig.bench import Rig, adjusted, hold_pressure
from hitchid.rig.oil import Scalar


class OperatingPoint(NamedTuple):
    """Steady lifting to linearise around.

    Attributes:
        displacement_m: m.
        current_a: current in the lifting coil less the hysteresis, A.
        load_force_n: at the implement, N.
        oil_temperature_c: °C, None for the rig's own.
    """

    displacement_m: float
    current_a: float
    load_force_n: float = 0.0
    oil_temperature_c: float | None = None


class SmallSignal(NamedTuple):
    """K, mm/(s·A), ωh, rad/s, and ξh of K/(s (s²/ωh² + 2 ξh s/ωh + 1))."""

    gain: float
    natural_frequency: float
    damping_ratio: float


@double_precision
def small_signal(rig: Rig, operating_point: OperatingPoint) -> SmallSignal:
    """Return gain, natural frequency and damping of the lifting chain, spool current to displacement.

    With flow gain k_q k_v, flow-pressure coefficient k_c, leakage C_p, C = V/β_e, piston area A, effective
    mass m, B = σ₂ + dg/dv and load stiffness k = dW/dx, Sun et al. 2025, sec. 2.2.2, but for k, which they
    drop:

        D = A + B (C_p + k_c)/A + k C/A
        K = k_q k_v/D,  ωh² = A D/(m C),  2 ξh/ωh = (B C/A + m (C_p + k_c)/A)/D

    k (C_p + k_c), which bends the integrator far below 0.1 rad/s, is left out. The lags of solenoid, spool
    and compensator are no part of it. Flows are counted at tank pressure, hence A/σ(p) for A in continuity.
    """
    temperature = rig.oil.temperature
    if operating_point.oil_temperature_c is not None:
        temperature = jnp.asarray(operating_point.oil_temperature_c)
    warm = adjusted(rig, temperature)
    displacement = jnp.asarray(operating_point.displacement_m)
    load = rig.linkage.load(displacement)
    mass, stiffness = load.mass, load.weight_slope + operating_point.load_force_n * load.lever_slope
    pressure, speed, gain, flow_pressure = _steady(warm, operating_point)

    cylinder, area = warm.cylinder, warm.cylinder.area
    swept = area / rig.oil.specific_volume(pressure)
    amount = rig.oil.amount(pressure, cylinder.volume(displacement), cylinder.yielding)
    capacity = rig.oil.capacity(pressure, amount, cylinder.yielding)
    losses = cylinder.leakage + flow_pressure
    damping = cylinder.friction.viscous + cylinder.friction.level(speed)[2]

    divisor = swept + (damping * losses + stiffness * capacity) / area
    omega = jnp.sqrt(area * divisor / (mass * capacity))
    lag = (damping * capacity + mass * losses) / area / divisor
    return SmallSignal(float(1e3 * gain / divisor), float(omega), float(0.5 * lag * omega))


def _steady(rig: Rig, point: OperatingPoint) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Return pressure, Pa, speed, m/s, flow gain k_q k_v, m³/(s·A), and k_c, m³/(s·Pa), of steady lifting."""
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

    pressure = hold_pressure(rig, displacement, jnp.asarray(point.load_force_n))
    supply_pressure, opening = rig.supply.idle_pressure(), jnp.zeros_like(area)
    flow = speed = jnp.zeros_like(area)
    for _ in range(50):  # friction raises the pressure, lifting lowers the supply's: a contraction
        drop = supply_pressure - pressure - valve.check_pressure
        opening = valve.balanced(area, opening, drop)
        flow, _ = valve.flow(area, opening, drop + valve.check_pressure, rig.oil.density)
        supply_pressure = rig.supply.idle_pressure() - flow / (
            rig.supply.relief_gain + rig.supply.pump_flow * rig.supply.pump_slip
        )
        speed = flow * rig.oil.specific_volume(pressure) / cylinder.area
        rub = cylinder.friction.level(speed)[1] + cylinder.friction.viscous * speed
        pressure = hold_pressure(rig, displacement, jnp.asarray(point.load_force_n)) + rub / cylinder.area
    # In balance Q = C_d a √(2 Δp_m/ρ) with Δp_m = Δp₀ (1 + d (1 − a_k/a_K)), a_k = a √(Δp_m/(Δp − Δp_m)).
    metering = valve.metering_drop(opening)
    rest = supply_pressure - pressure - valve.check_pressure - metering
    stiff = valve.offset_pressure * valve.droop / valve.compensator_area
    by_metering = opening / (2 * metering) + opening / (2 * rest)
    by_load = stiff * opening / (2 * rest) / (1 + stiff * by_metering)
    by_area = -stiff * (opening / area) / (1 + stiff * by_metering)
    flow_gain = flow / area + flow / (2 * metering) * by_area
    return pressure, speed, flow_gain * area_slope, flow / (2 * metering) * by_load
