"""Limits on quantities that simulations are differentiated through."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Values = Float[Array, "..."] | float


@jax.custom_jvp
def limited(values: Values, lowest: Values = -jnp.inf, highest: Values = jnp.inf) -> Float[Array, "..."]:
    """Return min(max(x, a), b), with the derivative of the value returned, that of x where equal.

    `jnp.clip` returns the same, but has the mean of both derivatives where two are equal. Of a play without
    width that is not its derivative by the width; and the division is a loop of its own in each sample of a
    simulation, so that the derivatives of a model take twice the time.
    """
    return jnp.clip(values, lowest, highest)


@limited.defjvp
def _derivative(
    primals: tuple[Values, Values, Values], tangents: tuple[Values, Values, Values]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    values, lowest, highest = primals
    by_values, by_lowest, by_highest = tangents
    result = limited(values, lowest, highest)
    tangent = jnp.where(values < lowest, by_lowest, jnp.where(values > highest, by_highest, by_values))
    return result, jnp.broadcast_to(tangent, result.shape)
