"""Parameters that machines of a fleet are compared in, and their estimates from a row."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import digamma, polygamma

from hitchid.data.record import COMMAND, DISPLACEMENT
from hitchid.fleet.row import DirectionRow, Row

GAIN, DEAD_ZONE, DELAY, LOAD_SCATTER = "gain", "dead zone", "delay", "load scatter"
NAMES = (GAIN, DEAD_ZONE, DELAY, LOAD_SCATTER)
LOGARITHMIC = frozenset({GAIN, LOAD_SCATTER})  # compared as logarithms: their errors are relative
FEWEST_TESTS = 6  # from which the logarithm of a scatter is close to normally distributed; chosen
PERCENT = 100.0
MAX_CORRELATION = 0.99  # of ln gain and dead zone; chosen: the covariance has to be positive definite


@dataclass(frozen=True)
class FleetParameter:
    """One parameter of one direction.

    Attributes:
        direction: lifting or lowering.
        name: gain, dead zone, delay or load scatter.
        unit: of its value; a load scatter is in percent of the speed.
    """

    direction: str
    name: str
    unit: str

    @property
    def logarithmic(self) -> bool:
        """Whether the estimate is the natural logarithm of the value."""
        return self.name in LOGARITHMIC

    def value(self, estimate: np.ndarray | float) -> np.ndarray:
        """Return values in the parameter's unit from estimates."""
        return np.asarray(np.exp(estimate) if self.logarithmic else estimate, float)

    def difference(self, deviation: np.ndarray | float) -> np.ndarray:
        """Return a difference of estimates: in the unit, or relative where they are logarithms."""
        return np.asarray(np.expm1(deviation) if self.logarithmic else deviation, float)


@dataclass(frozen=True, order=True)
class Kind:
    """What gains must have in common to be comparable: structure and units."""

    structure: str
    displacement_unit: str
    command_unit: str

    @property
    def speed_unit(self) -> str:
        """Unit of the speed."""
        return f"{self.displacement_unit}/s"

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        gain = f"{self.speed_unit}/{self.command_unit}"
        return {GAIN: gain, DEAD_ZONE: self.command_unit, DELAY: "s", LOAD_SCATTER: "%"}[name]


def kind_of(row: Row, direction: str) -> Kind:
    """Return structure and units of one direction of a machine."""
    return Kind(
        row.directions[direction].structure,
        row.units.get(DISPLACEMENT, ""),
        row.units.get(COMMAND.get(direction, ""), ""),
    )


def estimates_of_row(figures: DirectionRow) -> tuple[Float[np.ndarray, " 4"], Float[np.ndarray, "4 4"]]:
    """Return ln gain, dead zone, delay and ln load scatter with their covariance, NaN where missing.

    For the scatter s of n tests, ν s²/σ² is χ² with ν = n − 1: ln s has the mean ln σ + (ψ(ν/2) − ln(ν/2))/2
    and the variance ψ′(ν/2)/4.

    Args:
        figures: of one direction.
    """
    scatter, half_freedom = figures.load_scatter, (figures.tests - 1) / 2
    log_scatter, scatter_error = np.nan, None
    if scatter is not None and scatter > 0 and figures.tests >= FEWEST_TESTS:
        log_scatter = np.log(PERCENT * scatter) - (digamma(half_freedom) - np.log(half_freedom)) / 2
        scatter_error = float(np.sqrt(polygamma(1, half_freedom))) / 2
    values = np.array(
        [
            np.log(figures.gain) if figures.gain > 0 else np.nan,
            figures.dead_zone,
            np.nan if figures.delay_s is None else figures.delay_s,
            log_scatter,
        ]
    )
    errors = (
        figures.gain_error,
        figures.dead_zone_error,
        figures.delay_error_s,
        scatter_error,
    )
    deviations = np.array([error if error else np.nan for error in errors], float)
    correlation = np.eye(len(NAMES))
    limited = np.clip(figures.correlation, -MAX_CORRELATION, MAX_CORRELATION)
    correlation[0, 1] = correlation[1, 0] = limited
    return np.where(np.isnan(deviations), np.nan, values), correlation * np.outer(deviations, deviations)
