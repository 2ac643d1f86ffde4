"""Three-point linkage: piston stroke to lift-arm angle to implement height, and the load at the piston."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from hitchid.bench.quantities import quantity
from hitchid.bench.valves import Scalar, Values

# Single-acting lifting cylinder: chamber, leakage, friction, end stops.


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
        # Never pulling: a stop that the piston leaves fast would hold it back.
        upper = jnp.maximum(1 + self.stop_damping * speed, 0.0)
        lower = jnp.maximum(1 - self.stop_damping * speed, 0.0)
        force = self.stop_stiffness * (lower_penetration * lower - upper_penetration * upper)
        # Where neither stop is touched both slopes are zero, as the linear system of a step needs them.
        contact = jnp.where(upper_penetration > 0, upper, 0.0) + jnp.where(lower_penetration > 0, lower, 0.0)
        damping = self.stop_damping * (
            jnp.where(upper > 0, upper_penetration, 0.0) + jnp.where(lower > 0, lower_penetration, 0.0)
        )
        return force, -self.stop_stiffness * contact, -self.stop_stiffness * damping


GRAVITY = 9.80665  # m/s², standard (ISO 80000-3)


class Load(NamedTuple):
    """Load at the piston at one displacement, and its derivatives by displacement.

    Attributes:
        weight: force of the weights, N.
        weight_slope: N/m.
        mass: equivalent mass, kg.
        mass_slope: kg/m.
        lever: rise of the implement per displacement of the piston, m/m.
        lever_slope: 1/m.
    """

    weight: Values
    weight_slope: Values
    mass: Values
    mass_slope: Values
    lever: Values
    lever_slope: Values


class Linkage(eqx.Module):
    """Cylinder triangle and four-bar of lift arm, lift rod, lower link and frame, in one plane.

    The lift arm turns about the origin, the implement side being +x, up being +y. The cylinder's eye on the
    lift arm is a from the origin, its foot c; at length ℓ the angle between them is
    γ = arccos((a² + c² − ℓ²)/(2 a c)). The lift arm is at ψ = γ − arm_offset above the horizontal.

    Attributes:
        cylinder_arm: a, m.
        cylinder_base: c, m.
        retracted_length: ℓ at zero displacement, m.
        arm_offset: γ at which the lift arm is level, rad.
        sensor_offset: γ at which the angle sensor reads zero, rad.
        lift_arm: origin to lift rod, m.
        lift_rod: m.
        lower_link: pivot to hitch point, m.
        rod_joint: pivot of the lower link to lift rod, m.
        pivot_x, pivot_y: pivot of the lower link, m.
        link_mass: of both lower links, uniform, kg.
        arm_inertia: of both lift arms about the origin, kg·m².
        moving_mass: of piston and rod, kg.
        implement_mass: kg; the upper link runs parallel, so the implement moves as the hitch point does.
    """

    cylinder_arm: Scalar = quantity("m", 0.01, 5.0)
    cylinder_base: Scalar = quantity("m", 0.01, 5.0)
    retracted_length: Scalar = quantity("m", 0.01, 5.0)
    arm_offset: Scalar = quantity("rad", -3.2, 3.2)
    sensor_offset: Scalar = quantity("rad", -3.2, 3.2)
    lift_arm: Scalar = quantity("m", 0.01, 5.0)
    lift_rod: Scalar = quantity("m", 0.01, 5.0)
    lower_link: Scalar = quantity("m", 0.01, 5.0)
    rod_joint: Scalar = quantity("m", 0.01, 5.0)
    pivot_x: Scalar = quantity("m", -5.0, 5.0)
    pivot_y: Scalar = quantity("m", -5.0, 0.0)
    link_mass: Scalar = quantity("kg", 0.0, 1e4)
    arm_inertia: Scalar = quantity("kg·m2", 0.0, 1e4)
    moving_mass: Scalar = quantity("kg", 0.0, 1e4)
    implement_mass: Scalar = quantity("kg", 0.0, 1e5)

    def cylinder_cosine(self, displacement: Values) -> Values:
        """Return cos γ by the law of cosines; beyond ±1 the triangle does not close."""
        a, c, length = self.cylinder_arm, self.cylinder_base, self.retracted_length + displacement
        return (a**2 + c**2 - length**2) / (2 * a * c)

    def rod_cosine(self, arm_angle: Values) -> Values:
        """Return the cosine of the angle between lower link and diagonal; beyond ±1 the four-bar is open."""
        diagonal = self._diagonal(arm_angle)
        square = diagonal[0] ** 2 + diagonal[1] ** 2
        return (self.rod_joint**2 + square - self.lift_rod**2) / (2 * self.rod_joint * jnp.sqrt(square))

    def _diagonal(self, arm_angle: Values) -> tuple[Values, Values]:
        """Return the vector from the lower link's pivot to the end of the lift arm, m."""
        return (
            self.lift_arm * jnp.cos(arm_angle) - self.pivot_x,
            self.lift_arm * jnp.sin(arm_angle) - self.pivot_y,
        )

    def arm_angle(self, displacement: Values) -> Values:
        """Return ψ, rad."""
        return jnp.arccos(self.cylinder_cosine(displacement)) - self.arm_offset

    def sensor_angle(self, displacement: Values) -> Values:
        """Return the reading of an ideal angle sensor on the lift arm, rad."""
        return jnp.arccos(self.cylinder_cosine(displacement)) - self.sensor_offset

    def displacement(self, sensor_angle: Values) -> Values:
        """Return the displacement at a sensor angle, m; the inverse of `sensor_angle`."""
        a, c = self.cylinder_arm, self.cylinder_base
        square = a**2 + c**2 - 2 * a * c * jnp.cos(sensor_angle + self.sensor_offset)
        return jnp.sqrt(square) - self.retracted_length

    def link_angle(self, arm_angle: Values) -> Values:
        """Return φ of the lower link above the horizontal, rad; the link hangs below the diagonal."""
        along, up = self._diagonal(arm_angle)
        return jnp.arctan2(up, along) - jnp.arccos(self.rod_cosine(arm_angle))

    def height(self, displacement: Values) -> Values:
        """Return the height of hitch point and implement above the lower link's pivot, m."""
        return self.lower_link * jnp.sin(self.link_angle(self.arm_angle(displacement)))

    def rates(self, displacement: Values) -> tuple[Values, Values, Values]:
        """Return dψ/dx and dφ/dx, rad/m, and dh/dx.

        dψ/dx = ℓ/(a c sin γ); of the four-bar, dφ/dψ = L₁ sin(ψ − χ)/(d sin(φ − χ)), χ the lift rod's angle.
        """
        a, c, length = self.cylinder_arm, self.cylinder_base, self.retracted_length + displacement
        cosine = self.cylinder_cosine(displacement)
        arm_rate = length / (a * c * jnp.sqrt(1 - cosine**2))
        psi = jnp.arccos(cosine) - self.arm_offset
        phi = self.link_angle(psi)
        along, up = self._diagonal(psi)
        chi = jnp.arctan2(up - self.rod_joint * jnp.sin(phi), along - self.rod_joint * jnp.cos(phi))
        ratio = self.lift_arm * jnp.sin(psi - chi) / (self.rod_joint * jnp.sin(phi - chi))
        return arm_rate, arm_rate * ratio, arm_rate * ratio * self.lower_link * jnp.cos(phi)

    def reduced(self, displacement: Values) -> tuple[Values, Values, Values]:
        """Return weight, N, equivalent mass, kg, and lever dh/dx, all at the piston.

        m_eq = m_p + J (dψ/dx)² + (m_i + m_l/3) L₃² (dφ/dx)², W = (m_i + m_l/2) g dh/dx.
        """
        arm_rate, link_rate, lever = self.rates(displacement)
        mass = self.moving_mass + self.arm_inertia * arm_rate**2
        mass = mass + (self.implement_mass + self.link_mass / 3) * (self.lower_link * link_rate) ** 2
        return (self.implement_mass + self.link_mass / 2) * GRAVITY * lever, mass, lever

    def load(self, displacement: Values) -> Load:
        """Return weight, mass and lever at the piston with their slopes, by automatic differentiation."""
        tangent = jnp.ones_like(displacement)
        values, slopes = jax.jvp(self.reduced, (displacement,), (tangent,))
        (weight, mass, lever), (weight_slope, mass_slope, lever_slope) = values, slopes
        return Load(weight, weight_slope, mass, mass_slope, lever, lever_slope)
