"""The range of a plant's displacement: mechanical stops, or what logs have shown and a tenth more."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hitchid.data.record import Record

MARGIN = 0.1
ROUNDING = 1e-9


class TravelLimits(NamedTuple):
    """Between what displacements a free run is held, in the displacement's unit.

    Attributes:
        lower, upper: the limits.
        lower_stop, upper_stop: whether the logs have shown a mechanical stop there; otherwise the limit lies
            a tenth of the range of the logs beyond what they have shown.
    """

    lower: float
    upper: float
    lower_stop: bool = False
    upper_stop: bool = False

    @classmethod
    def of(cls, records: Iterable[Record], end_stops: Mapping[int, float]) -> "TravelLimits":
        """Return the limits that logs have shown.

        Args:
            records: the logs of the identification.
            end_stops: direction (+1, −1) to the displacement at which it met a stop, where it did.
        """
        ranges = [
            (float(np.min(record.displacement)), float(np.max(record.displacement))) for record in records
        ]
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        margin = MARGIN * (highest - lowest)
        return cls(
            end_stops.get(-1, lowest - margin),
            end_stops.get(1, highest + margin),
            -1 in end_stops,
            1 in end_stops,
        )

    def clip(self, displacement: Float[Array, "*b"], start: Float[Array, "*#b"]) -> Float[Array, "*b"]:
        """Return displacements within the limits, or within the start of a run that begins beyond them."""
        return jnp.clip(displacement, jnp.minimum(self.lower, start), jnp.maximum(self.upper, start))

    def is_inside(self, displacement: Float[Array, "*b"], start: Float[Array, "*#b"]) -> Bool[Array, "*b"]:
        """Tell where displacements are not held, of a run that begins at `start`."""
        return (displacement > jnp.minimum(self.lower, start)) & (
            displacement < jnp.maximum(self.upper, start)
        )

    def at_soft_limit(self, displacement: Float[np.ndarray, "*b"]) -> np.ndarray:
        """Tell where displacements are at a limit that is no stop, or beyond it; shape as given."""
        # Conversion to another unit and back rounds.
        tolerance = ROUNDING * (self.upper - self.lower)
        low = displacement <= self.lower + tolerance
        high = displacement >= self.upper - tolerance
        return (low & (not self.lower_stop)) | (high & (not self.upper_stop))

    def sentence(self, unit: str) -> str:
        """Return the limits in words."""
        ends = [
            f"{value:.4g} {unit} ({'a mechanical stop' if stop else 'a tenth of the range beyond the logs'})"
            for value, stop in ((self.lower, self.lower_stop), (self.upper, self.upper_stop))
        ]
        return f"free runs are held between {ends[0]} and {ends[1]}"
