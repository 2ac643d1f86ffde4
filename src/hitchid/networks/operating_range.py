"""Operating range of the identification tests, and the trust in a model beyond it."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

MARGIN = 0.1  # share of a range beyond its ends over which the trust falls to zero: a choice


class SignalRange(eqx.Module):
    """From the lowest to the highest value that the tests reached, each of shape []."""

    lowest: Float[Array, ""]
    highest: Float[Array, ""]

    @eqx.filter_jit
    def trust(self, values: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return 1 within the range, falling to 0 over a tenth of its width beyond."""
        distance = jnp.maximum(jnp.maximum(self.lowest - values, values - self.highest), 0.0)
        width = self.highest - self.lowest
        return 1 - jnp.minimum(distance / jnp.where(width > 0, MARGIN * width, 1.0), 1.0)


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

    @classmethod
    def unbounded(cls) -> "OperatingRange":
        """Return ranges without ends: every sample is trusted."""
        return cls(*(SignalRange(jnp.asarray(-jnp.inf), jnp.asarray(jnp.inf)) for _ in range(3)))

    def trust(
        self, command: Float[Array, "*#b"], displacement: Float[Array, "*#b"], load: Float[Array, "*#b"]
    ) -> Float[Array, "*b"]:
        """Return 1 where all three lie in their ranges, 0 where one is a tenth of its range beyond."""
        return self.command.trust(command) * self.displacement.trust(displacement) * self.load.trust(load)
