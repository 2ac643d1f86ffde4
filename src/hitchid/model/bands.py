"""Bands around predictions: the record of what they are made of."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from hitchid.errors import InputError


class Band(NamedTuple):
    """Between what displacement is expected, in the record's unit, each of shape [N]."""

    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True)
class EnsembleMember:
    """A perturbed channel that is about as likely as the identified one.

    Attributes:
        benchmark: parameters of the structure, dead time, and curves where there are any, in one row.
        network: index of the one network that corrects the free run; None for all together.
        weight: factor on its deviation.
    """

    benchmark: tuple[float, ...]
    network: int | None = None
    weight: float = 1.0


@dataclass(frozen=True)
class Bands:
    """Bands around a channel's predictions.

    In free run its half width is √(z² n² + q² Σ w² (y_a − y)²): n the noise of the sensor and z its normal
    quantile, y_a the free runs of the ensemble and w their weights, q found from tests that were held out.

    Attributes:
        ensemble: perturbed channels.
        noise: standard deviation of the sensor's noise, in the displacement's unit.
        levels: shares of samples that bands may be asked to cover, ascending.
        free_run: q for each of them.
        horizons: samples looked ahead, ascending.
        half_widths: half width for each horizon and level, in the displacement's unit.
        tests: held-out tests they were found from, for free run and for looking ahead.
    """

    ensemble: tuple[EnsembleMember, ...]
    noise: float
    levels: tuple[float, ...]
    free_run: tuple[float, ...]
    horizons: tuple[int, ...]
    half_widths: tuple[tuple[float, ...], ...]
    tests: tuple[int, int]

    def multiplier(self, coverage: float) -> float:
        """Return q for a share of samples, interpolated between the levels.

        Raises:
            InputError: the share lies beyond the levels.
        """
        return float(np.interp(self._checked_coverage(coverage), self.levels, self.free_run))

    def half_width(self, coverage: float, horizon: int) -> float:
        """Return the half width so many samples ahead, interpolated between horizons and levels.

        Raises:
            InputError: the share lies beyond the levels.
        """
        by_level = [np.interp(self._checked_coverage(coverage), self.levels, row) for row in self.half_widths]
        return float(np.interp(np.log(horizon), np.log(self.horizons), by_level))

    def _checked_coverage(self, coverage: float) -> float:
        if not self.levels[0] <= coverage <= self.levels[-1]:
            raise InputError(
                f"coverage: required between {self.levels[0]:g} and {self.levels[-1]:g}, came {coverage:g}"
            )
        return coverage


def free_run_half_width(bands: Sequence[Bands], spreads: Sequence[np.ndarray], coverage: float) -> np.ndarray:
    """Return the half width of the band around a free run, in the displacement's unit.

    √(z² n² + Σ q² s²), the sum over channels; n is the largest noise of them.

    Args:
        bands: of each channel.
        spreads: s = √(Σ w² (y_a − y)²) of each channel's ensemble at each sample.
        coverage: share of samples.

    Raises:
        InputError: the share lies beyond the levels.
    """
    floor = float(ndtri(0.5 + coverage / 2)) * max(channel_bands.noise for channel_bands in bands)
    pairs = zip(bands, spreads, strict=True)
    return reduce(np.hypot, (each.multiplier(coverage) * spread for each, spread in pairs), np.asarray(floor))
