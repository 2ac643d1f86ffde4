"""Proportional valves: from coil current to spool, from spool to opening, from opening to flow."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.bench.quantities import quantity

# Oil with entrained air: compressibility, viscosity, and flow through an orifice.
#
# Amounts of oil are volumes at tank pressure, so that they are conserved; every pressure is absolute.

Scalar = Float[Array, ""]
Values = Float[Array, "..."]

TANK_PRESSURE_PA = 101325.0  # Pa, standard atmosphere (ISO 2533)


class Oil(eqx.Module):
    """Mineral oil with air bubbles that stay at oil temperature.

    An amount M fills the volume M·σ(p), σ(p) = (1 − α)(1 − (p − p₀)/β) + α p₀/p: the oil of constant bulk
    modulus β, the air of share α at tank pressure p₀ compressed isothermally, bubbles being small
    (Merritt 1967, sec. 1-4; Jelali & Kroll 2003, sec. 2.2). A wall that yields by h(p − p₀) adds volume.

    Attributes:
        density: kg/m³.
        bulk_modulus: of oil without air, β, Pa.
        air_fraction: volume of entrained air over the whole at tank pressure, α.
        temperature: of the oil in a test that gives no other, °C.
        reference_temperature: that the viscous parameters refer to, °C.
        viscosity_slope: λ in μ(T) = μ_ref·exp(−λ (T − T_ref)), 1/K.
    """

    density: Scalar = quantity("kg/m3", 700.0, 1100.0)
    bulk_modulus: Scalar = quantity("Pa", 1e8, 3e9)
    air_fraction: Scalar = quantity("1", 1e-4, 0.2)
    temperature: Scalar = quantity("degC", -30.0, 110.0)
    reference_temperature: Scalar = quantity("degC", -30.0, 110.0)
    viscosity_slope: Scalar = quantity("1/K", 0.0, 0.1)

    def specific_volume(self, pressure: Values) -> Values:
        """Return σ(p), the volume of a unit amount."""
        oil = (1 - self.air_fraction) * (1 - (pressure - TANK_PRESSURE_PA) / self.bulk_modulus)
        return oil + self.air_fraction * TANK_PRESSURE_PA / pressure

    def amount(self, pressure: Values, volume: Values, compliance: Values) -> Values:
        """Return the amount in a volume, m³, with compliant walls, m³/Pa: M = (V + h (p − p₀))/σ(p)."""
        return (volume + compliance * (pressure - TANK_PRESSURE_PA)) / self.specific_volume(pressure)

    def capacity(self, pressure: Values, amount: Values, compliance: Values) -> Values:
        """Return ∂M/∂p at constant volume, m³/Pa; V over the effective bulk modulus."""
        softness = (1 - self.air_fraction) / self.bulk_modulus
        softness = softness + self.air_fraction * TANK_PRESSURE_PA / pressure**2
        return (compliance + amount * softness) / self.specific_volume(pressure)

    def pressure(
        self, amount: Values, volume: Values, compliance: Values, gas: Values | float = 0.0
    ) -> Values:
        """Return the pressure at which an amount fills a volume; the inverse of `amount`, always positive.

        M σ(p) = V + h (p − p₀) − G/p is a quadratic in p; its positive root.

        Args:
            amount: M, m³ at tank pressure.
            volume: V, m³.
            compliance: h, m³/Pa.
            gas: pressure times volume of the gas in an accumulator, G, Pa·m³, its volume counted in V.
        """
        # In closed form: no iteration in a step, and no pressure below zero.
        liquid_fraction = 1 - self.air_fraction
        a = amount * liquid_fraction / self.bulk_modulus + compliance
        b = (
            amount * liquid_fraction * (1 + TANK_PRESSURE_PA / self.bulk_modulus)
            - volume
            + compliance * TANK_PRESSURE_PA
        )
        c = amount * self.air_fraction * TANK_PRESSURE_PA + gas
        # Of the two forms of one root that in which nothing cancels.
        root = jnp.sqrt(b * b + 4 * a * c)
        return jnp.where(b > 0, (root + jnp.abs(b)) / (2 * a), 2 * c / (root + jnp.abs(b)))

    def viscosity_ratio(self, temperature: Values) -> Values:
        """Return μ(T)/μ(T_ref)."""
        return jnp.exp(-self.viscosity_slope * (temperature - self.reference_temperature))


def orifice_flow(
    conductance: Values, drop: Values, laminar_drop: Values | float = 2e4
) -> tuple[Values, Values]:
    """Return the flow through an orifice, m³/s, and its derivative by the pressure drop, m³/(s·Pa).

    Q = g Δp/(Δp² + Δp_l²)^¼, g = C_d a √(2/ρ), Δp of either sign: g √Δp, but linear within Δp_l, so that it
    can be differentiated at zero.
    """
    square = drop * drop + laminar_drop * laminar_drop
    root = jnp.sqrt(jnp.sqrt(square))
    return conductance * drop / root, conductance * (square - 0.5 * drop * drop) / (square * root)


# Pressure supply: motor-driven pump, relief valve, line, accumulator.


class Supply(eqx.Module):
    """Pump against a relief valve, with a line and a gas accumulator between them and the lifting valve.

    Attributes:
        pump_flow: at zero pressure, m³/s.
        pump_slip: loss of volumetric efficiency with pressure, 1/Pa: Q = Q₀ (1 − c (p − p₀)).
        ripple: amplitude of the flow ripple over the mean flow.
        shaft_speed: rad/s.
        displacements: pumping strokes per revolution, which give the ripple's frequency.
        relief_pressure: at which the relief valve opens, Pa above tank.
        relief_gain: flow of the relief valve per Pa above that, m³/(s·Pa).
        line_volume: pump to lifting valve, m³.
        line_bulk_modulus: of the line's wall, Pa: the line widens by V/β per Pa.
        accumulator_volume: gas volume at precharge, m³, 0 for none.
        accumulator_precharge: Pa above tank.
    """

    pump_flow: Scalar = quantity("m3/s", 1e-6, 1e-2)
    pump_slip: Scalar = quantity("1/Pa", 0.0, 4e-8)
    ripple: Scalar = quantity("1", 0.0, 0.5)
    shaft_speed: Scalar = quantity("rad/s", 1.0, 1000.0)
    displacements: Scalar = quantity("1", 1.0, 100.0)
    relief_pressure: Scalar = quantity("Pa", 1e6, 5e7)
    relief_gain: Scalar = quantity("m3/(s·Pa)", 1e-12, 1e-8)
    line_volume: Scalar = quantity("m3", 1e-5, 1e-1)
    line_bulk_modulus: Scalar = quantity("Pa", 1e7, 1e12)
    accumulator_volume: Scalar = quantity("m3", 0.0, 1e-1)
    accumulator_precharge: Scalar = quantity("Pa", 1e5, 5e7)

    @property
    def compliance(self) -> Values:
        """Widening of the line, m³/Pa."""
        return self.line_volume / self.line_bulk_modulus

    @property
    def ripple_frequency(self) -> Values:
        """Angular frequency of the flow ripple, rad/s."""
        return self.shaft_speed * self.displacements

    def pump_delivery(self, pressure: Values, ripple: Values) -> tuple[Values, Values]:
        """Return the pump's flow, m³/s, and its derivative by pressure; `ripple` is 1 on average."""
        slope = -self.pump_flow * self.pump_slip * ripple
        return self.pump_flow * ripple + slope * (pressure - TANK_PRESSURE_PA), slope

    def relief_flow(self, pressure: Values) -> tuple[Values, Values]:
        """Return the relief valve's flow, m³/s, and its derivative by pressure."""
        over = pressure - TANK_PRESSURE_PA - self.relief_pressure
        return self.relief_gain * jnp.maximum(over, 0.0), jnp.where(over > 0, self.relief_gain, 0.0)

    def idle_pressure(self) -> Values:
        """Return the pressure at which the relief flow equals the pump flow, Pa."""
        excess = self.pump_flow * (1 - self.pump_slip * self.relief_pressure)
        slope = self.relief_gain + self.pump_flow * self.pump_slip
        return TANK_PRESSURE_PA + self.relief_pressure + excess / slope

    def _gas(self) -> Values:
        return self.accumulator_volume * (self.accumulator_precharge + TANK_PRESSURE_PA)

    def amount(self, oil: Oil, pressure: Values) -> Values:
        """Return the oil held at a pressure, m³ at tank pressure; the gas is compressed isothermally."""
        precharge = self.accumulator_precharge + TANK_PRESSURE_PA
        accumulator_oil = self.accumulator_volume * jnp.maximum(1 - precharge / pressure, 0.0)
        return oil.amount(pressure, self.line_volume + accumulator_oil, self.compliance)

    def pressure(self, oil: Oil, amount: Values) -> Values:
        """Return the pressure at which an amount is held, Pa; the inverse of `amount`."""
        # Below its precharge the accumulator is empty, and the line alone holds the oil.
        line_pressure = oil.pressure(amount, self.line_volume, self.compliance)
        volume = self.line_volume + self.accumulator_volume
        charged_pressure = oil.pressure(amount, volume, self.compliance, self._gas())
        return jnp.where(
            line_pressure > self.accumulator_precharge + TANK_PRESSURE_PA, charged_pressure, line_pressure
        )

    def capacity(self, oil: Oil, pressure: Values, amount: Values) -> Values:
        """Return ∂M/∂p, m³/Pa."""
        gas = jnp.where(
            pressure > self.accumulator_precharge + TANK_PRESSURE_PA, self._gas() / pressure**2, 0.0
        )
        return oil.capacity(pressure, amount, self.compliance + gas)


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
        # At critical damping μ is zero, by which the sine is divided: it is kept off it.
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
        # Within the travel: the exact step of an undamped spool may overshoot its stop.
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
        # Never zero: the square root below must have a derivative where the pressure does not suffice.
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
