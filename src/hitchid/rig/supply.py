"""Pressure supply: motor-driven pump, relief valve, line, accumulator."""

import equinox as eqx
import jax.numpy as jnp

from hitchid.rig.oil import TANK_PRESSURE_PA, Oil, Scalar, Values
from hitchid.rig.quantities import quantity


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
