"""Integrator with second-order lag and dry friction of the load."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.integrator_second_order import IntegratorSecondOrder
from hitchid.structures.structure import DryFriction, Parameter, Scale

REVERSALS = "strokes that start from rest or reverse"  # what a test must contain to determine friction


class IntegratorSecondOrderFriction(IntegratorSecondOrder):
    """Integrator with second-order lag whose mass slides with dry (Coulomb) friction.

    v̇ = a − δ ωh² φ, ȧ = ωh² (K u − v) − 2 ξh ωh v̇, where a is the acceleration by the pressure, δ the
    displacement by which the friction force compresses the oil column, and φ the share of the friction force
    that acts, against positive travel: sign(v) in motion, between −1 and 1 at rest. Before motion it is φ₀:
    −1 where the load came to rest against the direction of travel, +1 where it came to rest along it.
    """

    name: ClassVar[str] = "integrator-second-order-friction"
    formula: ClassVar[str] = "K / (s (s²/ωh² + 2 ξh s/ωh + 1)) with dry friction δ ωh² sign(v)"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *IntegratorSecondOrder.parameters,
        # Share of the range of displacement: a millionth is far below any sensor, a tenth far above any seal.
        Parameter(
            "friction_travel", "{x}", 1e-6, 0.1, scale=Scale.TRAVEL, symbol="δ", excitation_hint=REVERSALS
        ),
        Parameter("friction_at_rest", "1", -1.0, 1.0, linear=True, symbol="φ₀", excitation_hint=REVERSALS),
    )

    has_dry_friction: ClassVar[bool] = True

    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B without friction; the states are displacement, speed, and a over ωh."""
        return super().state_space(values[:3])

    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator without friction; see `IntegratorSecondOrder`."""
        return super().transfer_function(values[:3])

    def derived(self, values: tuple[float, ...]) -> dict[str, tuple[float, str]]:
        """Return the derived quantities of the linear part; see `IntegratorSecondOrder`."""
        return super().derived(values[:3])

    def dry_friction(self, values: Float[Array, " p"]) -> DryFriction:
        """Return the friction's input vector, and the share of it that acts before motion."""
        _, omega, damping, travel, at_rest = values
        acceleration = travel * omega**2
        return DryFriction(jnp.stack([0 * omega, -acceleration, 2 * damping * acceleration]), at_rest)

    def state_at_speed(self, values: Float[Array, " p"], speed: Float[Array, ""]) -> Float[Array, " n"]:
        """Return the state at travel zero and a speed, its pressure in balance with the friction."""
        _, omega, _, travel, at_rest = values
        share = jnp.where(speed == 0, at_rest, jnp.sign(speed))
        return jnp.stack([jnp.zeros_like(speed), speed, travel * omega * share])
