"""Limits of the displacement: mechanical stops, or the range of the logs plus a tenth of it."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hitchid.logs.record import Record

MARGIN = 0.1  # share of the range of the logs: distance of a limit that is no stop; chosen
ROUNDING = 1e-9  # share of the distance between the limits: tolerance for rounding errors


class TravelLimits(NamedTuple):
    """Limits of the displacement in free run.

    Attributes:
        lower, upper: the limits, in the displacement's unit.
        lower_stop, upper_stop: whether the limit is a mechanical stop found in the logs; otherwise it lies a
            tenth of the range of the logs beyond that range.
    """

    lower: float
    upper: float
    lower_stop: bool = False
    upper_stop: bool = False

    @classmethod
    def of(cls, records: Iterable[Record], end_stops: Mapping[int, float]) -> "TravelLimits":
        """Return the limits found in logs.

        Args:
            records: the logs of the identification.
            end_stops: sign of the motion (+1, −1) to the displacement of the stop, where one was met.
        """
        ranges = [
            (float(np.min(record.displacement)), float(np.max(record.displacement))) for record in records
        ]
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        margin = MARGIN * (highest - lowest)
        # Each direction finds its stop in tests of its own. In the wrong order they are where plants balance
        # their command, and tests of the other direction have passed them.
        if {-1, 1} <= end_stops.keys() and end_stops[-1] >= end_stops[1]:
            end_stops = {}
        return cls(
            end_stops.get(-1, lowest - margin),
            end_stops.get(1, highest + margin),
            -1 in end_stops,
            1 in end_stops,
        )

    def clip(self, displacement: Float[Array, "*b"], start: Float[Array, "*#b"]) -> Float[Array, "*b"]:
        """Return displacements clipped to the limits, or to the start of a run that begins beyond them."""
        return jnp.clip(displacement, jnp.minimum(self.lower, start), jnp.maximum(self.upper, start))

    def is_inside(self, displacement: Float[Array, "*b"], start: Float[Array, "*#b"]) -> Bool[Array, "*b"]:
        """Return where displacements are inside the limits of a run that begins at `start`."""
        return (displacement > jnp.minimum(self.lower, start)) & (
            displacement < jnp.maximum(self.upper, start)
        )

    def at_soft_limit(self, displacement: Float[np.ndarray, "*b"]) -> np.ndarray:
        """Return where displacements are at or beyond a limit that is no mechanical stop."""
        # Rounding errors from conversion to another unit and back.
        tolerance = ROUNDING * (self.upper - self.lower)
        low = displacement <= self.lower + tolerance
        high = displacement >= self.upper - tolerance
        return (low & (not self.lower_stop)) | (high & (not self.upper_stop))

    def sentence(self, unit: str) -> str:
        """Return a sentence that states the limits."""
        ends = [
            (f"{value:.4g} {unit} ({('a mechanical stop' if stop else 'the logged range extended by 10 %')})")
            for value, stop in ((self.lower, self.lower_stop), (self.upper, self.upper_stop))
        ]
        return f"free runs are limited to {ends[0]} … {ends[1]}"
