"""Operating range of the identification tests, and the trust factor beyond it."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

RANGE_MARGIN = 0.1  # share of a range: distance beyond its ends at which the trust is zero; chosen


class SignalRange(eqx.Module):
    """Lowest and highest value of a signal in the tests, each of shape [], or [C] of several signals."""

    lowest: Float[Array, "*c"]
    highest: Float[Array, "*c"]

    @eqx.filter_jit
    def trust(self, values: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return 1 within the range, falling to 0 over a tenth of its width beyond."""
        distance = jnp.maximum(jnp.maximum(self.lowest - values, values - self.highest), 0.0)
        width = self.highest - self.lowest
        return 1 - jnp.minimum(distance / jnp.where(width > 0, RANGE_MARGIN * width, 1.0), 1.0)


class OperatingRange(eqx.Module):
    """Ranges of the signals in the identification tests of a channel.

    Attributes:
        command: effective command.
        displacement: measured displacement.
        load: covariates, ends of shape [C]; one range without width where there is none.
    """

    command: SignalRange
    displacement: SignalRange
    load: SignalRange

    @classmethod
    def unbounded(cls) -> "OperatingRange":
        """Return unlimited ranges: the trust is 1 everywhere."""
        shapes = ((), (), (1,))
        return cls(*(SignalRange(jnp.full(shape, -jnp.inf), jnp.full(shape, jnp.inf)) for shape in shapes))

    def trust(
        self, command: Float[Array, "*#b"], displacement: Float[Array, "*#b"], load: Float[Array, "*#b c"]
    ) -> Float[Array, "*b"]:
        """Return the product of the trust factors, 0 to 1; see `SignalRange.trust`."""
        signals = self.command.trust(command) * self.displacement.trust(displacement)
        return signals * self.load_trust(load)

    def load_trust(self, load: Float[Array, "*b c"]) -> Float[Array, "*b"]:
        """Return the product of the trust factors of the covariates."""
        return jnp.prod(self.load.trust(load), axis=-1)
