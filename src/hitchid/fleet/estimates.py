"""Figures of an identified model that machines of a fleet are compared by.

They stand apart from the row that holds them: a worker reads rows before it has its core, and NumPy counts
the cores when it is imported.
"""

from collections.abc import Mapping

import numpy as np
from scipy.stats import norm

from hitchid.fleet.row import DirectionRow
from hitchid.identification import Identification
from hitchid.logs import Campaign
from hitchid.model import NOT_ASSESSED, Estimate, Information, Quantity

HALF_WIDTH = float(norm.ppf(0.975))  # of a 95 % interval, in standard errors


def direction_rows(identification: Identification, campaign: Campaign) -> Mapping[str, DirectionRow]:
    """Return direction to the figures of an identified model; its held-out tests are simulated."""
    model, rows = identification.model, {}
    for direction, trace in identification.channels.items():
        estimates, structure = trace.phase1.assessment, model.channels[direction].benchmark.structure
        gain = next(estimate for estimate in estimates.parameters if estimate.name == structure.gain)
        information = None if trace.uncertainty is None else trace.uncertainty.information
        delay = None if trace.characteristics is None else trace.characteristics.delay
        scatter = None if trace.uncertainty is None else trace.uncertainty.load_scatter
        gain_error = None
        if gain.error is not None and gain.method != NOT_ASSESSED and gain.value > 0:  # not at a bound
            gain_error = gain.error / gain.value  # of ln gain
        held_out = [
            (model.simulate(record).displacement - record.displacement) ** 2
            for record in campaign.held_out(direction)
        ]
        rows[direction] = DirectionRow(
            structure=f"{structure.name}: {', '.join(estimate.name for estimate in estimates.parameters)}",
            gain=gain.value,
            dead_zone=model.channels[direction].dead_zone,
            gain_error=gain_error,
            dead_zone_error=trace.dead_zone.error.standard_error,
            correlation=_correlation(information, gain, gain_error),
            delay_s=None if delay is None else delay.value,
            delay_error_s=None if delay is None else _error(delay),
            load_scatter=None if scatter is None or not scatter.determined else scatter.scatter,
            rmse=trace.phase1.rmse,
            held_out_rmse=float(np.sqrt(np.nanmean(np.concatenate(held_out)))) if held_out else None,
            tests=estimates.tests,
        )
    return rows


def _correlation(information: Information | None, gain: Estimate, gain_error: float | None) -> float:
    """Return the correlation of the errors of ln gain and dead zone.

    The dead zone is identified first and held. Its error δ moves the gain by ∂ ln K/∂δ, the only common part
    of both errors: ρ = sd(∂ ln K/∂δ δ)/sd(ln K). A larger dead zone leaves less command, so that the gain
    grows.
    """
    if information is None or gain.name not in information.names or not gain_error:
        return 0.0
    number = information.names.index(gain.name)
    variance = information.dead_zone_covariance[number][number] * information.slopes[number] ** 2
    # Both errors are estimates, so that their ratio may exceed one.
    return float(min(np.sqrt(max(variance, 0.0)) / gain.value / gain_error, 1.0))


def _error(quantity: Quantity) -> float | None:
    """Return the standard error that a closed 95 % interval has; None for an open one."""
    lower, upper = quantity.interval
    return None if lower is None or upper is None else (upper - lower) / (2 * HALF_WIDTH)
