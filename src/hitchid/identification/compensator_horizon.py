"""How far ahead a compensator for predictions corrects: so far that it does not diverge on tests held out."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hitchid._support.summary import count
from hitchid.identification.cross_fitting import HeldOut
from hitchid.identification.held_out_predictions import calibrated_horizons, held_out_errors
from hitchid.model import Channel
from hitchid.networks.error_compensator import MAX_HORIZON
from hitchid.structures import Batch
from hitchid.uncertainty.prediction_spread import HeldOutErrors

MAX_HORIZONS = (MAX_HORIZON, 50, 20, 10, 5, 2, 1)  # that are tried, in samples; chosen
# A compensator whose error is larger than so many times that without it diverges; chosen: trained on three
# quarters of the tests it may be a fifth worse, and one that diverges is worse by any factor.
DIVERGED = 2.0


class JudgedCompensator(NamedTuple):
    """A compensator for predictions, with the horizon up to which it corrects.

    Attributes:
        channel: with the compensator; without it where it diverges from the first sample on.
        held_out: the same for the channels fitted without each fold.
        errors: horizon to the errors of predictions of held-out tests; None where they are not known.
        notices: what was found; none where it corrects all horizons it may.
    """

    channel: Channel
    held_out: tuple[HeldOut, ...]
    errors: Mapping[int, HeldOutErrors] | None
    notices: tuple[str, ...]


def judge_compensator(channel: Channel, held_out: Sequence[HeldOut], batch: Batch) -> JudgedCompensator:
    """Return a channel whose compensator corrects only so far ahead that predictions do not diverge.

    Farther ahead than a sample a compensator reads its own output, for which it was not trained: its error
    may grow from sample to sample. It gets the largest horizon with which no root mean square error, up to
    100 samples or a second ahead, is more than twice that of the load filter alone.

    Args:
        channel: with a compensator.
        held_out: channels with compensators, trained without each fold.
        batch: all tests.
    """
    horizons = calibrated_horizons(batch.step_s)
    uncorrected = held_out_errors(_all_up_to(held_out, 0), batch, horizons)
    reason = ""
    for max_horizon in MAX_HORIZONS:
        limited = _all_up_to(held_out, max_horizon)
        errors = held_out_errors(limited, batch, horizons)
        diverged = diverging(errors, uncorrected)
        if diverged is None:
            break
        reason = (
            f"else the RMSE of held-out tests {count(diverged, 'sample')} ahead is "
            f"{_rmse(errors[diverged]):.3g}, and {_rmse(uncorrected[diverged]):.3g} without it"
        )
    else:
        max_horizon, limited, errors = 0, _all_up_to(held_out, 0), uncorrected
    reach = f"corrects up to {count(max_horizon, 'sample')} ahead" if max_horizon else "is not used"
    notices = (f"the compensator for predictions {reach}; {reason}",) if reason else ()
    return JudgedCompensator(_up_to(channel, max_horizon), limited, errors, notices)


def diverging(errors: Mapping[int, HeldOutErrors], uncorrected: Mapping[int, HeldOutErrors]) -> int | None:
    """Return the first horizon at which errors are more than twice those without a correction; None for none.

    Args:
        errors, uncorrected: horizon, ascending, to the errors of held-out tests.
    """
    # An error that is not finite is larger than any.
    return next((h for h in errors if not _rmse(errors[h]) <= DIVERGED * _rmse(uncorrected[h])), None)


def _rmse(errors: HeldOutErrors) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean(np.concatenate(errors.errors) ** 2)))


def _all_up_to(held_out: Iterable[HeldOut], max_horizon: int) -> tuple[HeldOut, ...]:
    return tuple(HeldOut(tests, _up_to(channel, max_horizon)) for tests, channel in held_out)


def _up_to(channel: Channel, max_horizon: int) -> Channel:
    """Return a channel whose compensator corrects up to a horizon; without it for 0."""
    compensator = channel.compensator
    if compensator is None or max_horizon == 0:
        return replace(channel, compensator=None)
    return replace(channel, compensator=replace(compensator, max_horizon=max_horizon))
