"""Integrator with second-order lag and dry friction, its natural frequency varying along the stroke."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.integrator_second_order_friction import IntegratorSecondOrderFriction
from hitchid.structures.structure import DryFriction, Parameter


class IntegratorSecondOrderStroke(IntegratorSecondOrderFriction):
    """Integrator with second-order lag and dry friction, its natural frequency ω = ωh exp(c ξ).

    v̇ = ω q − δ ω² φ, q̇ = ω (K u − v) − 2 ξh v̇: as in `IntegratorSecondOrderFriction`, with a = ω q. ξ is the
    displacement in half ranges from the middle of its range. The volume of oil under the piston and
    the lever between load and piston change along the stroke, and with them the stiffness of the oil column
    and the mass that it carries (Merritt 1967, Hydraulic Control Systems, sec. 6-2). The damping ratio and
    the displacement by which the friction force compresses the oil are taken to stay.
    """

    name: ClassVar[str] = "integrator-second-order-stroke"
    formula: ClassVar[str] = f"{IntegratorSecondOrderFriction.formula} and ωh = ω₀ exp(c ξ) along the stroke"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *IntegratorSecondOrderFriction.parameters,
        # At one, the frequency is e² times as high at one end of the range as at the other.
        Parameter(
            "frequency_slope",
            "1",
            -1.0,
            1.0,
            linear=True,
            symbol="c",
            excitation_hint="tests over more of the stroke",
        ),
    )
    varies_along_stroke: ClassVar[bool] = True

    def dry_friction(self, values: Float[Array, " p"]) -> DryFriction:
        """Return the friction in the middle of the stroke; see `IntegratorSecondOrderFriction`."""
        return super().dry_friction(values[:-1])

    def state_at_speed(self, values: Float[Array, " p"], speed: Float[Array, ""]) -> Float[Array, " n"]:
        """Return the state in the middle of the stroke; see `IntegratorSecondOrderFriction`."""
        return super().state_at_speed(values[:-1], speed)

    def values_at(self, values: Float[Array, " p"], position: Float[Array, ""]) -> Float[Array, " p"]:
        """Return the parameters with the natural frequency of a place on the stroke."""
        return values.at[1].multiply(jnp.exp(values[-1] * position))
