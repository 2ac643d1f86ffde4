"""Bands around predictions: their record, and the half width from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from hitchid._support.short_repr import short_repr
from hitchid.errors import InputError


@short_repr
class Band(NamedTuple):
    """Lower and upper limit of a displacement or a speed, each of its shape and in its unit."""

    lower: np.ndarray
    upper: np.ndarray


@short_repr
@dataclass(frozen=True)
class EnsembleMember:
    """Perturbation of a channel with about the likelihood of the identified one.

    Attributes:
        benchmark: parameters of the structure, dead time, and nonlinearity where there is one, in one row.
        network: index of the only network that corrects the free run; None for the mean of all.
        weight: factor on the deviation of its free run.
    """

    benchmark: tuple[float, ...]
    network: int | None = None
    weight: float = 1.0


@short_repr
@dataclass(frozen=True)
class Bands:
    """Bands around a channel's predictions.

    In free run the half width is √(z² n² + q² Σ w² (y_a − y)²): n is the noise of the sensor, z its normal
    quantile, y_a the free runs of the ensemble, w their weights, and q a factor from held-out tests.

    Attributes:
        ensemble: perturbed channels.
        noise: standard deviation of the sensor's noise, in the displacement's unit.
        levels: coverages for which there are bands, shares of samples, ascending.
        free_run: q for each level.
        horizons: prediction horizons, in samples, ascending.
        half_widths: half width for each horizon and level, in the displacement's unit.
        tests: number of held-out tests for the bands in free run, and for those of predictions.
    """

    ensemble: tuple[EnsembleMember, ...]
    noise: float
    levels: tuple[float, ...]
    free_run: tuple[float, ...]
    horizons: tuple[int, ...]
    half_widths: tuple[tuple[float, ...], ...]
    tests: tuple[int, int]

    def multiplier(self, coverage: float) -> float:
        """Return q for a coverage, interpolated between the levels.

        Raises:
            InputError: the coverage is outside the levels.
        """
        return float(np.interp(self._checked_coverage(coverage), self.levels, self.free_run))

    def half_width(self, coverage: float, horizon: int) -> float:
        """Return the half width at a prediction horizon, interpolated between horizons and levels.

        Raises:
            InputError: the coverage is outside the levels.
        """
        by_level = [np.interp(self._checked_coverage(coverage), self.levels, row) for row in self.half_widths]
        return float(np.interp(np.log(horizon), np.log(self.horizons), by_level))

    def _checked_coverage(self, coverage: float) -> float:
        if not self.levels[0] <= coverage <= self.levels[-1]:
            raise InputError(
                f"coverage: expected between {self.levels[0]:g} and {self.levels[-1]:g}, got {coverage:g}"
            )
        return coverage


def bands_by_channel(bands: Mapping[str, Bands], directions: Sequence[str]) -> list[Bands]:
    """Return the bands of each direction.

    Raises:
        InputError: a direction has none.
    """
    missing = [direction for direction in directions if direction not in bands]
    if missing:
        raise InputError(
            f"the model has no bands for {' and '.join(missing)}; identification needs at least three "
            "tests for bands"
        )
    return [bands[direction] for direction in directions]


def free_run_half_width(bands: Sequence[Bands], spreads: Sequence[np.ndarray], coverage: float) -> np.ndarray:
    """Return the half width of the band around a free run, in the displacement's unit.

    √(z² n² + Σ q² s²), the sum over channels; n is the largest noise of any channel.

    Args:
        bands: bands of each channel.
        spreads: s = √(Σ w² (y_a − y)²) of each channel's ensemble at each sample.
        coverage: share of samples within the band.

    Raises:
        InputError: the coverage is outside the levels of a channel.
    """
    floor = float(ndtri(0.5 + coverage / 2)) * max(channel_bands.noise for channel_bands in bands)
    pairs = zip(bands, spreads, strict=True)
    return reduce(
        np.hypot,
        (bands_of_channel.multiplier(coverage) * spread for bands_of_channel, spread in pairs),
        np.asarray(floor),
    )
