"""A mass moved by a force against friction: electric axes, and cylinders commanded in force."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.nonlinear import NonlinearStructure
from hitchid.structures.structure import Parameter, Scale

# Shares of the speed at which viscous friction equals Coulomb friction: v₀ and v₁.
SIGN_SMOOTHING, STRIBECK = 0.01, 0.2


class InertiaWithFriction(NonlinearStructure):
    """Double integrator with viscous and Coulomb friction, both unequal in the two directions.

    With the speed v = ẋ and the smooth sign g = tanh(v/v₀),

        ẍ = K (u − o − g (c + s exp(−(v/v₁)²))) − (B + a g) v,  ȯ = d abs(v)

    c is Coulomb friction, s what static friction has beyond it, o an offset that changes by d with the
    distance travelled, as guides and amplifiers warm up with use; time is no input. v₀ is 1 % and v₁ 20 % of
    the speed K c/B at which viscous friction equals Coulomb friction. Friction of this form:
    Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083, sec. 2.
    """

    name: ClassVar[str] = "inertia-with-friction"
    formula: ClassVar[str] = "ẍ = K (u - o - sgn(ẋ) (c + s exp(-(ẋ/v₁)²))) - (B + a sgn(ẋ)) ẋ, ȯ = d |ẋ|"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("gain", "{x}/(s²·{u})", 1.0, 1000.0, scale=Scale.SPEED),
        Parameter("viscous_friction", "1/s", 0.2, 20.0),
        Parameter("coulomb_friction", "{u}", 0.01, 1.0, scale=Scale.COMMAND),
        Parameter("offset", "{u}", -0.2, 0.2, scale=Scale.COMMAND, linear=True),
        Parameter("asymmetry", "1/s", -1.0, 1.0, linear=True),
        Parameter("static_friction", "{u}", -0.1, 0.1, scale=Scale.COMMAND, linear=True),
        # At its bounds the offset changes by 1 % of the largest command over one range of displacement.
        Parameter(
            "offset_per_travel",
            "{u}/{x}",
            -0.01,
            0.01,
            scale=Scale.COMMAND_PER_TRAVEL,
            linear=True,
            symbol="d",
        ),
        Parameter("initial_speed", "{x}/s", -0.1, 0.1, scale=Scale.TRAVEL, linear=True),
    )
    substeps: ClassVar[int] = 1
    local_starts: ClassVar[int] = 3

    def init_state(self, values: Float[Array, " p"], displacement: Float[Array, " t"]) -> Float[Array, "n t"]:
        """Return displacement, speed and offset before the first sample."""
        one = jnp.ones_like(displacement)
        return jnp.stack([displacement, values[7] * one, values[3] * one])

    def vector_field(
        self, values: Float[Array, " p"], state: Float[Array, "n t"], command: Float[Array, " t"]
    ) -> Float[Array, "n t"]:
        """Return speed, acceleration and the rate of the offset."""
        gain, viscous, coulomb, _, asymmetry, static, offset_per_travel, _ = values
        _, speed, offset = state
        equal_friction_speed = gain * coulomb / viscous
        sign = jnp.tanh(speed / (SIGN_SMOOTHING * equal_friction_speed))
        dry = sign * (coulomb + static * jnp.exp(-((speed / (STRIBECK * equal_friction_speed)) ** 2)))
        acceleration = gain * (command - offset - dry) - (viscous + asymmetry * sign) * speed
        return jnp.stack([speed, acceleration, offset_per_travel * jnp.abs(speed)])
