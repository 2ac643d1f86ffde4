"""What the identification tests have covered, and how far a simulation goes beyond it."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

MARGIN = 0.1


class SignalRange(eqx.Module):
    """From the lowest to the highest value that the tests reached, each of shape []."""

    lowest: Float[Array, ""]
    highest: Float[Array, ""]

    @eqx.filter_jit
    def trust(self, values: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return 1 within the range, falling to 0 over a tenth of its width beyond."""
        distance = jnp.maximum(self.lowest - values, values - self.highest)
        width = self.highest - self.lowest
        return 1 - jnp.clip(distance / jnp.where(width > 0, MARGIN * width, 1.0), 0.0, 1.0)


class OperatingRange(eqx.Module):
    """The ranges a model was identified in.

    Attributes:
        command: effective command.
        displacement: measured displacement.
        load: second input, a range without width where there is none.
    """

    command: SignalRange
    displacement: SignalRange
    load: SignalRange

    def trust(
        self, command: Float[Array, "*#b"], displacement: Float[Array, "*#b"], load: Float[Array, "*#b"]
    ) -> Float[Array, "*b"]:
        """Return 1 where all three lie in their ranges, 0 where one is a tenth of its range beyond."""
        return self.command.trust(command) * self.displacement.trust(displacement) * self.load.trust(load)
