"""Pure integrator: speed follows the command at once."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.structure import LinearStructure, Parameter, Scale

GAIN = Parameter("gain", "{x}/(s·{u})", 1 / 100, 100.0, scale=Scale.SPEED, symbol="K")


class Integrator(LinearStructure):
    """Integrator with gain, G(s) = K / s."""

    name: ClassVar[str] = "integrator"
    formula: ClassVar[str] = "K / s"
    parameters: ClassVar[tuple[Parameter, ...]] = (GAIN,)

    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B; the state is the displacement."""
        return jnp.zeros((1, 1), values.dtype), values[:1]

    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of K / s."""
        return [values[0]], [1.0, 0.0]
