"""Spread of predictions by horizon and predicted movement, calibrated on errors of held-out tests."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hitchid.model.bands import PredictionSpread
from hitchid.uncertainty.conformal import growing_quantiles

# Horizons at which errors are measured, in samples; between them everything is interpolated. Chosen: half
# widths of neighbours differ by less than a tenth.
CALIBRATED_HORIZONS = (1, 2, 3, 5, 7, 10, 14, 20, 30, 50, 70, 100)
FURTHER_HORIZONS = (200, 500, 1000)  # where they are no further than a second
# Powers of the movement that are compared; chosen: errors of a wrong gain grow with the movement, those of
# random disturbances with its root, those of a wrong time constant hardly.
EXPONENTS = (0.25, 0.5, 0.75, 1.0)
TINY = np.finfo(np.float64).tiny  # smallest variance, so that its logarithm is finite


class HeldOutErrors(NamedTuple):
    """Errors of predictions over one horizon, one array of shape [N_i] for each held-out test.

    Attributes:
        errors: measured minus predicted, in the displacement's unit.
        movements: predicted displacement minus the last measured one, in the displacement's unit.
    """

    errors: Sequence[np.ndarray]
    movements: Sequence[np.ndarray]


def prediction_spread(held_out: Mapping[int, HeldOutErrors], noise: float) -> PredictionSpread:
    """Return the spread of predictions, and the factors of its bands.

    The mean square of the errors over a horizon is that of the noise, in the measured displacement and in the
    one that is predicted, and g_h², which thus follows. The exponent is that of the largest likelihood of
    normal errors.

    Args:
        held_out: horizon to the errors of held-out tests.
        noise: standard deviation of the sensor's noise, in the displacement's unit.
    """
    candidates = [_with_exponent(held_out, noise, exponent) for exponent in EXPONENTS]
    spread = max(candidates, key=lambda candidate: _log_likelihood(candidate, held_out))
    multipliers = tuple(
        growing_quantiles(errors, [spread.spread(horizon, row) for row in movements], noise)
        for horizon, (errors, movements) in held_out.items()
    )
    return replace(spread, multipliers=multipliers)


def _with_exponent(held_out: Mapping[int, HeldOutErrors], noise: float, exponent: float) -> PredictionSpread:
    """Return the spread with a given exponent, without factors."""
    movements, growths = [], []
    for errors, movement_rows in held_out.values():
        # Where nothing moves any movement is typical.
        typical = float(np.sqrt(_mean([row**2 for row in movement_rows]))) or 1.0
        relative = _mean([(np.abs(row) / typical) ** (2 * exponent) for row in movement_rows]) or 1.0
        excess = max(_mean([row**2 for row in errors]) - 2 * noise**2, 0.0)
        movements.append(typical)
        growths.append(float(np.sqrt(excess / relative)))
    return PredictionSpread(noise, exponent, tuple(held_out), tuple(movements), tuple(growths), ())


def _log_likelihood(spread: PredictionSpread, held_out: Mapping[int, HeldOutErrors]) -> float:
    """Return the mean log likelihood of normal errors, up to a constant."""

    def of_test(horizon: int, errors: np.ndarray, movement: np.ndarray) -> np.ndarray:
        variance = np.maximum(spread.noise**2 + spread.spread(horizon, movement) ** 2, TINY)
        return -0.5 * (np.log(variance) + errors**2 / variance)

    return float(
        np.mean(
            [
                _mean([of_test(horizon, *pair) for pair in zip(errors, movements, strict=True)])
                for horizon, (errors, movements) in held_out.items()
            ]
        )
    )


def _mean(rows: Sequence[np.ndarray]) -> float:
    """Return the mean over tests of their means: every test has the same weight."""
    return float(np.mean([row.mean() for row in rows]))
