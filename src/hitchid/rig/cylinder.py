"""Single-acting lifting cylinder: chamber, leakage, friction, end stops."""

import equinox as eqx
import jax.numpy as jnp

from hitchid.rig.oil import Scalar, Values
from hitchid.rig.quantities import quantity


class Friction(eqx.Module):
    """LuGre friction with the Stribeck effect, of piston, rod and joints together, at the piston.

    ż = v − σ₀|v| z/g(v), F = σ₀ z + σ₁ E ż + σ₂ v, g(v) = F_c + (F_s − F_c) E, E = exp(−(v/v_s)²)
    (Canudas de Wit, Olsson, Åström, Lischinsky 1995, IEEE TAC 40(3), 419-425; the bristle damping falls with
    E so that the model stays dissipative when sliding fast, ibid., sec. III).

    Attributes:
        coulomb, static: F_c and F_s, N.
        stribeck_speed: v_s, m/s.
        bristle_stiffness: σ₀, N/m.
        bristle_damping: σ₁, N·s/m.
        viscous: σ₂ at the oil's reference temperature, N·s/m; proportional to viscosity.
    """

    coulomb: Scalar = quantity("N", 0.0, 1e5)
    static: Scalar = quantity("N", 1e-3, 1e5)
    stribeck_speed: Scalar = quantity("m/s", 1e-5, 1.0)
    bristle_stiffness: Scalar = quantity("N/m", 1e3, 1e10)
    bristle_damping: Scalar = quantity("N·s/m", 0.0, 1e7)
    viscous: Scalar = quantity("N·s/m", 0.0, 1e7)

    def stribeck(self, speed: Values) -> tuple[Values, Values, Values]:
        """Return E(v), g(v) in N and dg/dv in N·s/m."""
        stribeck_factor = jnp.exp(-((speed / self.stribeck_speed) ** 2))
        excess = (self.static - self.coulomb) * stribeck_factor
        return stribeck_factor, self.coulomb + excess, -2 * speed / self.stribeck_speed**2 * excess


class Cylinder(eqx.Module):
    """Rodless chamber with its hose; the rod side is open to the air.

    Attributes:
        bore: piston diameter, m.
        stroke: travel between the end stops, m.
        dead_volume: of chamber and fittings at zero displacement, m³.
        hose_volume: lifting valve to cylinder, m³.
        hose_bulk_modulus: of the hose's wall, Pa: the hose widens by V/β per Pa.
        leakage: past piston and valves to tank at the oil's reference temperature, m³/(s·Pa).
        stop_stiffness: of both end stops, N/m.
        stop_damping: c in F = k δ (1 + c δ̇), s/m (Hunt & Crossley 1975).
        friction: at the piston.
    """

    friction: Friction
    bore: Scalar = quantity("m", 1e-2, 1.0)
    stroke: Scalar = quantity("m", 1e-2, 5.0)
    dead_volume: Scalar = quantity("m3", 1e-6, 1e-1)
    hose_volume: Scalar = quantity("m3", 0.0, 1e-1)
    hose_bulk_modulus: Scalar = quantity("Pa", 1e7, 1e12)
    leakage: Scalar = quantity("m3/(s·Pa)", 0.0, 1e-10)
    stop_stiffness: Scalar = quantity("N/m", 1e5, 1e10)
    stop_damping: Scalar = quantity("s/m", 0.0, 100.0)

    @property
    def area(self) -> Values:
        """Piston area, m²."""
        return jnp.pi / 4 * self.bore**2

    @property
    def compliance(self) -> Values:
        """Widening of the hose, m³/Pa."""
        return self.hose_volume / self.hose_bulk_modulus

    def volume(self, displacement: Values) -> Values:
        """Return the volume of chamber and hose, m³."""
        return self.dead_volume + self.hose_volume + self.area * displacement

    def stop_force(self, displacement: Values, speed: Values) -> tuple[Values, Values, Values]:
        """Return the end stops' force on the piston, N, and its derivatives by displacement and speed."""
        upper_penetration = jnp.maximum(displacement - self.stroke, 0.0)
        lower_penetration = jnp.maximum(-displacement, 0.0)
        upper = jnp.maximum(1 + self.stop_damping * speed, 0.0)
        lower = jnp.maximum(1 - self.stop_damping * speed, 0.0)
        force = self.stop_stiffness * (lower_penetration * lower - upper_penetration * upper)
        contact = jnp.where(upper_penetration > 0, upper, 0.0) + jnp.where(lower_penetration > 0, lower, 0.0)
        damping = self.stop_damping * (
            jnp.where(upper > 0, upper_penetration, 0.0) + jnp.where(lower > 0, lower_penetration, 0.0)
        )
        return force, -self.stop_stiffness * contact, -self.stop_stiffness * damping
