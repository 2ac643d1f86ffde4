"""The bench: its components, and the limits of its motion."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from hitchid._support.precision import double_precision
from hitchid._support.short_repr import short_repr
from hitchid.rig.cylinder import Cylinder
from hitchid.rig.linkage import Linkage
from hitchid.rig.oil import TANK_PRESSURE_PA, Oil, Scalar
from hitchid.rig.sensors import Sensors
from hitchid.rig.supply import Supply
from hitchid.rig.valves import LiftingValve, LoweringValve


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
