"""A speed that does not follow the command: of a pump that cannot deliver, or behind a flow divider."""

import numpy as np

from hitchid.adaptation.stroke_errors import PIECES, StrokeRuns

LIMITS = np.linspace(0.3, 0.9, 25)  # of the fastest simulated speed, that are tried; chosen
LEAST_EVIDENCE = 100.0  # likelihood ratio in favour of a limit at which a stroke is refused; chosen


def speed_limit(runs: StrokeRuns, run: int, gain_run: int, variance: float) -> float:
    """Return the limit of speed that explains a stroke better than another gain does; 1 where none does.

    Both have one parameter: the free run y with its increments within ±c max|Δy|, and that with the stroke's
    own gain. A pump that cannot deliver gives the same speed at each command that requires more.

    Args:
        runs: free runs of a stroke.
        run: number of that of the model.
        gain_run: number of that with the stroke's own gain.
        variance: of an error, in the displacement's unit squared.

    Returns:
        The limit, over the fastest simulated speed.
    """
    simulated = runs.displacement[run]
    measured = simulated + runs.errors[run]
    speed = np.diff(simulated, prepend=simulated[0])
    highest = LIMITS[:, None] * np.abs(speed).max()
    limited = simulated[0] + np.cumsum(np.clip(speed, -highest, highest), axis=1)
    squares = np.mean((measured - limited)[:, runs.measured] ** 2, axis=1)
    best = int(np.argmin(squares))
    evidence = PIECES / 2 * float(runs.mean_squares[gain_run] - squares[best]) / variance
    return float(LIMITS[best]) if evidence > np.log(LEAST_EVIDENCE) else 1.0
