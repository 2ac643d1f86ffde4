"""Figures of an identified model that machines of a fleet are compared by."""

from collections.abc import Mapping

import numpy as np
from scipy.stats import norm

from hitchid.data.campaign import Campaign
from hitchid.fleet.row import DirectionRow
from hitchid.identification import ChannelTrace, Identification
from hitchid.model import Estimate, Estimates, Hitch, Information, Interval, Quantity
from hitchid.model.estimates import NOT_ASSESSED

HALF_WIDTH = float(norm.ppf(0.975))  # of a 95 % interval, in standard errors


def direction_rows(identification: Identification, campaign: Campaign) -> Mapping[str, DirectionRow]:
    """Return direction to the figures of an identified model.

    Args:
        identification: of the machine.
        campaign: it was identified from; held-out tests are simulated.
    """
    held_out = held_out_errors(identification.model, campaign)
    return {
        direction: _direction_row(identification.model, direction, trace, held_out.get(direction))
        for direction, trace in identification.channels.items()
    }


def held_out_errors(model: Hitch, campaign: Campaign) -> dict[str, float]:
    """Return direction to the free-run RMSE over all samples of its held-out tests."""
    errors = {}
    for direction in model.channels:
        squares = [
            (model.simulate(record).displacement - record.displacement) ** 2
            for record in campaign.held_out(direction)
        ]
        if squares:
            errors[direction] = float(np.sqrt(np.nanmean(np.concatenate(squares))))
    return errors


def _direction_row(
    model: Hitch, direction: str, trace: ChannelTrace, held_out_rmse: float | None
) -> DirectionRow:
    estimates, structure = trace.phase1.assessment, model.channels[direction].benchmark.structure
    gain = next(estimate for estimate in estimates.parameters if estimate.name == structure.gain)
    information = None if trace.uncertainty is None else trace.uncertainty.information
    delay = None if trace.characteristics is None else trace.characteristics.delay
    scatter = None if trace.uncertainty is None else trace.uncertainty.load_scatter
    gain_error, dead_zone_error = _relative_error(gain), trace.dead_zone.error.standard_error
    return DirectionRow(
        structure=f"{structure.name}: {', '.join(_names(estimates))}",
        gain=gain.value,
        dead_zone=model.channels[direction].dead_zone,
        gain_error=gain_error,
        dead_zone_error=dead_zone_error,
        correlation=_correlation(information, gain, gain_error),
        delay_s=None if delay is None else delay.value,
        delay_error_s=None if delay is None else _error(delay),
        load_scatter=None if scatter is None or not scatter.determined else scatter.scatter,
        rmse=trace.phase1.rmse,
        held_out_rmse=held_out_rmse,
        tests=estimates.tests,
    )


def _names(estimates: Estimates) -> tuple[str, ...]:
    return tuple(estimate.name for estimate in estimates.parameters)


def _relative_error(gain: Estimate) -> float | None:
    """Return the standard error of ln gain; None for a gain at a bound or without an error."""
    if gain.error is None or gain.method == NOT_ASSESSED or gain.value <= 0:
        return None
    return gain.error / gain.value


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
    return float(min(np.sqrt(max(variance, 0.0)) / gain.value / gain_error, 1.0))


def _error(quantity: Quantity) -> float | None:
    """Return the standard error that a closed 95 % interval has; None for an open one."""
    ends: Interval = quantity.interval
    lower, upper = ends
    return None if lower is None or upper is None else (upper - lower) / (2 * HALF_WIDTH)
