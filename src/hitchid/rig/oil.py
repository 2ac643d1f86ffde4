"""Oil with entrained air: compressibility, viscosity, and flow through an orifice.

Amounts of oil are volumes at tank pressure, so that they are conserved; every pressure is absolute.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.rig.quantities import quantity

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
        liquid_fraction = 1 - self.air_fraction
        a = amount * liquid_fraction / self.bulk_modulus + compliance
        b = (
            amount * liquid_fraction * (1 + TANK_PRESSURE_PA / self.bulk_modulus)
            - volume
            + compliance * TANK_PRESSURE_PA
        )
        c = amount * self.air_fraction * TANK_PRESSURE_PA + gas
        root = jnp.sqrt(b * b + 4 * a * c)
        return jnp.where(b > 0, (root + jnp.abs(b)) / (2 * a), 2 * c / (root + jnp.abs(b)))

    def viscosity_ratio(self, temperature: Values) -> Values:
        """Return μ(T)/μ(T_ref)."""
        return jnp.exp(-self.viscosity_slope * (temperature - self.reference_temperature))


def orifice_flow(
    conductance: Values, drop: Values, laminar_drop: Values | float = 2e4
) -> tuple[Values, Values]:
    """Return the flow through an orifice, m³/s, and its derivative by the pressure drop, m³/(s·Pa).

    Q = g Δp/(Δp² + Δp_l²)^¼, which is g √Δp but linear within Δp_l, so that it can be differentiated at zero.

    Args:
        conductance: g = C_d a √(2/ρ).
        drop: Δp, Pa, of either sign.
        laminar_drop: Δp_l, Pa.
    """
    square = drop * drop + laminar_drop * laminar_drop
    root = jnp.sqrt(jnp.sqrt(square))
    return conductance * drop / root, conductance * (square - 0.5 * drop * drop) / (square * root)
