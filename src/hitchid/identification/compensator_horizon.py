"""How far ahead a compensator for predictions corrects: as far as it did so on tests held out."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hitchid._support.summary import count
from hitchid.identification.cross_fitting import HeldOut
from hitchid.identification.held_out_predictions import held_out_errors
from hitchid.model import Channel
from hitchid.networks.error_compensator import MAX_HORIZON
from hitchid.structures import Batch
from hitchid.uncertainty.prediction_spread import CALIBRATED_HORIZONS, HeldOutErrors


class JudgedCompensator(NamedTuple):
    """A compensator for predictions, with the horizon that it was found to correct.

    Attributes:
        channel: with the compensator; without it where it corrects nothing.
        held_out: the same for the channels fitted without each fold.
        notices: what was found; none where it corrects all horizons of the tests.
    """

    channel: Channel
    held_out: tuple[HeldOut, ...]
    notices: tuple[str, ...]


def judge_compensator(channel: Channel, held_out: Sequence[HeldOut], batch: Batch) -> JudgedCompensator:
    """Return a channel whose compensator corrects as far ahead as it lessens the error of held-out tests.

    Farther ahead a compensator reads its own output, for which it was not trained: its error may grow from
    sample to sample. It ends before the first horizon at which the root mean square error with it is larger
    than that of the load filter alone.

    Args:
        channel: with a compensator.
        held_out: channels with compensators, trained without each fold.
        batch: all tests.
    """
    horizons = tuple(horizon for horizon in CALIBRATED_HORIZONS if horizon <= MAX_HORIZON)
    corrected = held_out_errors(held_out, batch, horizons)
    uncorrected = held_out_errors(_all_up_to(held_out, 0), batch, horizons)
    best = largest_horizon(corrected, uncorrected)
    reach = f"up to {count(best, 'sample')} ahead" if best else "not used"
    notices = tuple(
        f"compensator for predictions: {reach}; RMSE of held-out tests {count(horizon, 'sample')} ahead "
        f"{_rmse(corrected[horizon]):.3g} with it, {_rmse(uncorrected[horizon]):.3g} without it"
        for horizon in [each for each in corrected if each > best][:1]
    )
    return JudgedCompensator(_up_to(channel, best), _all_up_to(held_out, best), notices)


def largest_horizon(corrected: Mapping[int, HeldOutErrors], uncorrected: Mapping[int, HeldOutErrors]) -> int:
    """Return the horizon before the first at which a correction makes errors larger; 0 for the first of all.

    Args:
        corrected, uncorrected: horizon, ascending, to the errors of held-out tests.
    """
    best = 0
    for horizon in corrected:
        # An error that is not finite is larger than any.
        if not _rmse(corrected[horizon]) <= _rmse(uncorrected[horizon]):
            break
        best = horizon
    return best


def _rmse(errors: HeldOutErrors) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean(np.concatenate(errors.errors) ** 2)))


def _all_up_to(held_out: Sequence[HeldOut], horizon: int) -> tuple[HeldOut, ...]:
    return tuple(HeldOut(tests, _up_to(channel, horizon)) for tests, channel in held_out)


def _up_to(channel: Channel, horizon: int) -> Channel:
    """Return a channel whose compensator corrects up to a horizon; without it for 0."""
    compensator = channel.compensator
    if compensator is None or horizon == 0:
        return replace(channel, compensator=None)
    return replace(channel, compensator=replace(compensator, max_horizon=horizon))
