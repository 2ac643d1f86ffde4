"""Reference of the position: what the lever asks for, within the speed and acceleration of the hitch."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.short_repr import short_repr

Scalar = Float[Array, ""]


@short_repr
class Reference(NamedTuple):
    """Where the hitch should be.

    Attributes:
        position: of the hitch.
        speed: its speed.
        acceleration: over the sample before.
    """

    position: Scalar
    speed: Scalar
    acceleration: Scalar

    @classmethod
    def at_rest(cls, position: Scalar) -> "Reference":
        """Return the reference that stands at a position."""
        return cls(position, jnp.zeros(()), jnp.zeros(()))


@short_repr
class ReferenceLimits(eqx.Module):
    """Limits of the reference, each for lifting and lowering, shape [2].

    Attributes:
        speed: v̂, largest of the hitch; the reference may be faster, but accelerates within it only.
        deceleration: of a speed that falls.
    """

    speed: Float[Array, "2"]
    deceleration: Float[Array, "2"]

    def step(self, reference: Reference, target: Scalar, target_speed: Scalar, step_s: float) -> Reference:
        """Return the reference one sample later, on the fastest way to a target that moves at a speed.

        With the distance e to the target and the deceleration a, the speed beyond that of the target is
        v = −a h/2 + √((a h/2)² + 2 a abs(e)), from which a deceleration that changes every h stops there, and
        at most abs(e)/h, with which it is reached in this sample. Far away it asks for the largest current.

        Args:
            reference: now.
            target: of the position.
            target_speed: of the target.
            step_s: sampling time h, s.
        """
        distance = target - reference.position
        upward = distance > 0
        braking = jnp.where(upward, *self.deceleration)
        half = 0.5 * braking * step_s
        closing = jnp.minimum(
            jnp.sqrt(half**2 + 2 * braking * jnp.abs(distance)) - half, jnp.abs(distance) / step_s
        )
        speed = target_speed + jnp.sign(distance) * closing
        within = [jnp.clip(each, -self.speed[1], self.speed[0]) for each in (reference.speed, speed)]
        limit = jnp.where(jnp.where(speed == 0, reference.speed, speed) > 0, *self.deceleration)
        acceleration = jnp.clip((within[1] - within[0]) / step_s, -limit, limit)
        return Reference(reference.position + step_s * speed, speed, acceleration)
