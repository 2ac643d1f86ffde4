"""Operating range of the identification tests, and the trust factor beyond it."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

MARGIN = 0.1  # share of a range: distance beyond its ends at which the trust is zero; chosen


class SignalRange(eqx.Module):
    """Lowest and highest value of a signal in the tests, each of shape []."""

    lowest: Float[Array, ""]
    highest: Float[Array, ""]

    @eqx.filter_jit
    def trust(self, values: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return 1 within the range, falling to 0 over a tenth of its width beyond."""
        distance = jnp.maximum(jnp.maximum(self.lowest - values, values - self.highest), 0.0)
        width = self.highest - self.lowest
        return 1 - jnp.minimum(distance / jnp.where(width > 0, MARGIN * width, 1.0), 1.0)


class OperatingRange(eqx.Module):
    """Ranges of the signals in the identification tests of a channel.

    Attributes:
        command: effective command.
        displacement: measured displacement.
        load: covariate; a range without width where there is none.
    """

    command: SignalRange
    displacement: SignalRange
    load: SignalRange

    @classmethod
    def unbounded(cls) -> "OperatingRange":
        """Return unlimited ranges: the trust is 1 everywhere."""
        return cls(*(SignalRange(jnp.asarray(-jnp.inf), jnp.asarray(jnp.inf)) for _ in range(3)))

    def trust(
        self, command: Float[Array, "*#b"], displacement: Float[Array, "*#b"], load: Float[Array, "*#b"]
    ) -> Float[Array, "*b"]:
        """Return the product of the three trust factors, 0 to 1; see `SignalRange.trust`."""
        return self.command.trust(command) * self.displacement.trust(displacement) * self.load.trust(load)
