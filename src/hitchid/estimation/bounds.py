"""Bounds of parameters, and the map between values and positions in the unit cube."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hitchid.structures import Parameter


class Bounds(eqx.Module):
    """Bounds of d parameters, searched as positions in the unit cube.

    Attributes:
        lower, upper: in the parameters' units, shape [d].
        linear: which of them are searched as they are; of the others the logarithm is, shape [d].
    """

    lower: Float[Array, " d"]
    upper: Float[Array, " d"]
    linear: Bool[Array, " d"]

    @classmethod
    def of(cls, parameters: Sequence[Parameter], limits: Sequence[tuple[float, float]]) -> "Bounds":
        """Return the bounds of parameters from their limits, lower and upper."""
        lower, upper = np.array(limits).T
        linear = np.array([parameter.linear for parameter in parameters])
        return cls(*jax.device_put((lower, upper, linear)))

    def values(self, position: Float[Array, "*p d"]) -> Float[Array, "*p d"]:
        """Return the parameters at a position."""
        width, span = self._spans()
        logarithmic = jnp.where(self.linear, 1.0, self.lower) * jnp.exp(position * span)
        return jnp.where(self.linear, self.lower + position * width, logarithmic)

    def slopes(self, position: Float[Array, " d"]) -> Float[Array, " d"]:
        """Return the derivatives of the parameters with respect to their positions."""
        width, span = self._spans()
        return jnp.where(self.linear, width, self.values(position) * span)

    def position(self, values: np.ndarray) -> np.ndarray:
        """Return the position of values, clipped to the bounds."""
        return np.clip(self.unclipped_position(values), 0.0, 1.0)

    def unclipped_position(self, values: np.ndarray) -> np.ndarray:
        """Return the position of values, outside the unit cube where they lie beyond a bound."""
        bounds = zip(np.asarray(self.lower), np.asarray(self.upper), np.asarray(self.linear), strict=True)
        return np.array(
            [
                (value - lower) / (upper - lower) if linear else np.log(value / lower) / np.log(upper / lower)
                for value, (lower, upper, linear) in zip(values, bounds, strict=True)
            ]
        )

    def _spans(self) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
        """Return the widths between the bounds, and between their logarithms."""
        return self.upper - self.lower, jnp.log(self.upper / jnp.where(self.linear, self.upper, self.lower))
