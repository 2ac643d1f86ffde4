"""Proportional valves: from coil current to spool, from spool to opening, from opening to flow."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from hitchid.rig.oil import TANK_PRESSURE_PA, Scalar, Values, orifice_flow
from hitchid.rig.quantities import quantity

TINY_AREA = 1e-12  # m²; keeps two closed orifices in series differentiable (chosen, far below any opening)


class SpoolState(NamedTuple):
    """Lagged current, A; output of the hysteresis, A; spool position over its travel; its speed, 1/s."""

    force: Values
    play_output: Values
    position: Values
    speed: Values


class SpoolStep(NamedTuple):
    """Exact step of solenoid lag and spool for a fixed time: decay, and the entries of exp(A dt)."""

    decay: Values
    pp: Values
    pv: Values
    vp: Values
    vv: Values


class Spool(eqx.Module):
    """Coil current to opening area: solenoid lag, hysteresis, second-order spool, overlap, notches.

    Attributes:
        solenoid_lag: time constant from current to force, s.
        hysteresis: half width of the play between force and spool, A.
        natural_frequency, damping_ratio: of the spool on its spring, rad/s and 1.
        dead_zone: current at the end of the spool's overlap, A.
        saturation: current at the spool's stop, A.
        full_area: opening at the stop, m².
        notch: travel beyond the overlap, as a fraction of the remaining travel, at which the growth of the
            area changes from quadratic to linear.
        discharge: discharge coefficient C_d.
    """

    solenoid_lag: Scalar = quantity("s", 1e-4, 1.0)
    hysteresis: Scalar = quantity("A", 0.0, 1.0)
    natural_frequency: Scalar = quantity("rad/s", 1.0, 5000.0)
    damping_ratio: Scalar = quantity("1", 0.1, 10.0)
    dead_zone: Scalar = quantity("A", 0.0, 3.0)
    saturation: Scalar = quantity("A", 0.0, 3.0)
    full_area: Scalar = quantity("m2", 1e-9, 1e-2)
    notch: Scalar = quantity("1", 1e-3, 10.0)
    discharge: Scalar = quantity("1", 0.1, 1.0)

    def rest(self) -> SpoolState:
        """Return the state without current."""
        zero = jnp.zeros_like(self.dead_zone)
        return SpoolState(zero, zero, zero, zero)

    def discretise(self, step_s: Values | float) -> SpoolStep:
        """Return the exact step: exp(A dt) by its closed form with μ = ωn √(ζ² − 1), real or imaginary."""
        omega, damped = self.natural_frequency, self.damping_ratio * self.natural_frequency
        mu = omega * jnp.sqrt(jnp.asarray(self.damping_ratio**2 - 1 + 1e-12, dtype=jnp.complex128))
        decay = jnp.exp(-damped * step_s)
        cosine = decay * jnp.real(jnp.cosh(mu * step_s))
        sine = decay * jnp.real(jnp.sinh(mu * step_s) / mu)
        return SpoolStep(
            jnp.exp(-step_s / self.solenoid_lag),
            cosine + damped * sine,
            sine,
            -(omega**2) * sine,
            cosine - damped * sine,
        )

    def advance(self, state: SpoolState, current: Values, step: SpoolStep) -> SpoolState:
        """Advance by one step under a constant current.

        The play operator h ← min(max(h, i − w), i + w) (Brokate & Sprekels 1996) is evaluated at the step's
        end; the spool's input is the mean over the step.
        """
        force = current + (state.force - current) * step.decay
        play_output = jnp.clip(state.play_output, force - self.hysteresis, force + self.hysteresis)
        target = jnp.clip(0.5 * (state.play_output + play_output) / self.saturation, 0.0, 1.0)
        offset = state.position - target
        position = target + step.pp * offset + step.pv * state.speed
        speed = step.vp * offset + step.vv * state.speed
        return SpoolState(force, play_output, position, speed)

    def area(self, position: Values) -> Values:
        """Return the opening, m²: a₁ (√(y² + y₀²) − y₀)/(√(1 + y₀²) − y₀), y the travel past the overlap."""
        overlap = self.dead_zone / self.saturation
        travel = jnp.clip((position - overlap) / (1 - overlap), 0.0, 1.0)
        shape = jnp.sqrt(travel**2 + self.notch**2) - self.notch
        return self.full_area * shape / (jnp.sqrt(1 + self.notch**2) - self.notch)


class LiftingValve(eqx.Module):
    """Metering orifice downstream of a pressure compensator, followed by a check valve.

    Attributes:
        spool: current to metering area.
        compensator_lag: time constant from balanced to actual opening of the compensator, s.
        offset_pressure: drop over the metering orifice set by the compensator's spring, Pa.
        droop: relative increase of that drop until the compensator is closed.
        compensator_area: opening of the compensator at its stop, m², which limits the flow.
        check_pressure: opening pressure of the check valve, Pa.
    """

    spool: Spool
    compensator_lag: Scalar = quantity("s", 1e-4, 1.0)
    offset_pressure: Scalar = quantity("Pa", 1e4, 1e7)
    droop: Scalar = quantity("1", 0.0, 2.0)
    compensator_area: Scalar = quantity("m2", 1e-8, 1e-2)
    check_pressure: Scalar = quantity("Pa", 0.0, 2e6)

    def metering_drop(self, compensator: Values) -> Values:
        """Return the drop set by the spring, Pa: Δp₀ (1 + d (1 − a_k/a_k,max))."""
        return self.offset_pressure * (1 + self.droop * (1 - compensator / self.compensator_area))

    def balanced_opening(self, area: Values, compensator: Values, drop: Values) -> Values:
        """Return the compensator's opening in balance, m².

        Two orifices in series share the whole drop as the inverse squares of their areas, so the metering one
        has Δp_m where a_k = a_m √(Δp_m/(Δp − Δp_m)); with too little pressure the compensator is fully open.
        """
        metering = self.metering_drop(compensator)
        rest = jnp.maximum(drop - metering, 1e-3 * metering)
        return jnp.minimum(area * jnp.sqrt(metering / rest), self.compensator_area)

    def flow(self, area: Values, compensator: Values, drop: Values, density: Values) -> tuple[Values, Values]:
        """Return flow, m³/s, and its derivative by the drop from supply to cylinder; never backward."""
        conductance = series_area(area, compensator) * self.spool.discharge * jnp.sqrt(2 / density)
        return orifice_flow(conductance, jnp.maximum(drop - self.check_pressure, 0.0))


class LoweringValve(eqx.Module):
    """Metering orifice to tank without compensation, a damper in series, and the safety valve in parallel.

    Attributes:
        spool: current to metering area.
        damper_area: fixed throttle that limits the lowering speed, m².
        safety_pressure: at which the safety valve opens, Pa above tank.
        safety_gain: flow of the safety valve per Pa above that, m³/(s·Pa).
    """

    spool: Spool
    damper_area: Scalar = quantity("m2", 1e-8, 1e-2)
    safety_pressure: Scalar = quantity("Pa", 1e6, 1e8)
    safety_gain: Scalar = quantity("m3/(s·Pa)", 1e-12, 1e-8)

    def flow(self, area: Values, pressure: Values, density: Values) -> tuple[Values, Values]:
        """Return flow to tank, m³/s, and its derivative by pressure; Q = C_d a √(2 (p − p₀)/ρ)."""
        conductance = series_area(area, self.damper_area) * self.spool.discharge * jnp.sqrt(2 / density)
        return orifice_flow(conductance, pressure - TANK_PRESSURE_PA)

    def safety_flow(self, pressure: Values) -> tuple[Values, Values]:
        """Return the safety valve's flow, m³/s, and its derivative by pressure."""
        over = pressure - TANK_PRESSURE_PA - self.safety_pressure
        return self.safety_gain * jnp.maximum(over, 0.0), jnp.where(over > 0, self.safety_gain, 0.0)


def series_area(first: Values, second: Values) -> Values:
    """Return the area of one orifice equivalent to two in series: a₁ a₂/√(a₁² + a₂²)."""
    return first * second / jnp.sqrt(first**2 + second**2 + TINY_AREA**2)
