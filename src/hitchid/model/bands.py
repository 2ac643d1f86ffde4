"""Bands around predictions: their record, and the half width from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field
from scipy.special import ndtri

from hitchid._support.bounded import MAX_MAGNITUDE, CountFromOne, Factor, Level, Number
from hitchid._support.records import short_repr
from hitchid.errors import InputError

Movement = Annotated[float, Field(ge=1e-300, lt=MAX_MAGNITUDE)]  # is divided by


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
    weight: Number = 1.0


@short_repr
@dataclass(frozen=True)
class PredictionSpread:
    """How uncertain predictions are, by horizon and by the movement that is predicted.

    Over h samples in which the predicted displacement moves by m the half width of a band is
    √(z² n² + q_h² (n² + g_h² (m/m_h)^(2p))): n is the noise of the sensor, z its normal quantile, and q_h a
    factor from held-out tests. Of a piston that does not move only the noise is uncertain.

    Attributes:
        noise: n, in the displacement's unit.
        exponent: p.
        horizons: h, in samples, ascending.
        movements: m_h, root mean square of the movement over each horizon, in the displacement's unit.
        growths: g_h, error of the model over each horizon at the movement m_h, in the displacement's unit.
        multipliers: q_h for each horizon and level.
    """

    noise: Factor
    exponent: Factor
    horizons: tuple[CountFromOne, ...]
    movements: tuple[Movement, ...]
    growths: tuple[Factor, ...]
    multipliers: tuple[tuple[Factor, ...], ...]

    def spread(self, horizon: int, movement: np.ndarray) -> np.ndarray:
        """Return √(n² + g_h² (m/m_h)^(2p)), in the displacement's unit.

        Args:
            horizon: h, in samples; interpolated between the horizons. Beyond the last, for which no test is
                long enough or nothing was calibrated, g_h and m_h grow in proportion to h.
            movement: m, in the displacement's unit, any shape.
        """
        beyond = max(1.0, horizon / self.horizons[-1])
        growth, typical = (beyond * self._at(horizon, values) for values in (self.growths, self.movements))
        return np.asarray(np.hypot(self.noise, growth * (np.abs(movement) / typical) ** self.exponent))

    def multiplier(self, horizon: int, coverage: float, levels: Sequence[float]) -> float:
        """Return q_h for a coverage, interpolated between the horizons and the levels."""
        return self._at(horizon, [np.interp(coverage, levels, row) for row in self.multipliers])

    def _at(self, horizon: int, values: Sequence[float]) -> float:
        # Over the logarithm: there the calibrated horizons are about evenly spaced.
        return float(np.interp(np.log(horizon), np.log(self.horizons), values))


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
        predictions: of predictions from a measured displacement.
        tests: number of held-out tests for the bands in free run, and for those of predictions.
    """

    ensemble: tuple[EnsembleMember, ...]
    noise: Factor
    levels: tuple[Level, ...]
    free_run: tuple[Factor, ...]
    predictions: PredictionSpread
    tests: tuple[int, int]

    def multiplier(self, coverage: float) -> float:
        """Return q for a coverage, interpolated between the levels.

        Raises:
            InputError: the coverage is outside the levels.
        """
        return float(np.interp(self._checked_coverage(coverage), self.levels, self.free_run))

    def half_width(self, coverage: float, horizon: int, movement: np.ndarray) -> np.ndarray:
        """Return the half width of the band around predictions, see `PredictionSpread`.

        Args:
            coverage: share of samples within the band.
            horizon: samples since the last measured displacement.
            movement: predicted displacement minus the last measured one, in the displacement's unit.

        Returns:
            Half width, in the displacement's unit, of the shape of `movement`.

        Raises:
            InputError: the coverage is outside the levels.
        """
        multiplier = self.predictions.multiplier(horizon, self._checked_coverage(coverage), self.levels)
        floor = float(ndtri(0.5 + coverage / 2)) * self.predictions.noise
        return np.asarray(np.hypot(floor, multiplier * self.predictions.spread(horizon, movement)))

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

    √(z² n² + Σ q² s²), the sum over channels; n is the largest noise of any channel, and the spread of a
    channel's ensemble at each sample is s = √(Σ w² (y_a − y)²).

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
