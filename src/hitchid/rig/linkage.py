"""Three-point linkage: piston stroke to lift-arm angle to implement height, and the load at the piston."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from hitchid.rig.oil import Scalar, Values
from hitchid.rig.quantities import quantity

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
