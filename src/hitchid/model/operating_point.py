"""Channel, displacement and load that a steady speed or a linear model is for."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from jax.typing import ArrayLike

from hitchid._support import checks
from hitchid.errors import InputError
from hitchid.model.channel import Channel

if TYPE_CHECKING:
    from hitchid.model.hitch import Hitch

Numbers = ArrayLike | Sequence[ArrayLike]  # a number, or an array or nested list of them


def linear_channel(model: "Hitch", direction: str | None, *, instead: str) -> Channel:
    """Return the channel of a direction; None stands for the only one of a model with one channel.

    Args:
        model: the model.
        direction: of the channel.
        instead: what to use where its structure is not linear, for the message.

    Raises:
        InputError: the model has no such channel, or its structure is not linear.
    """
    if direction is None and len(model.channels) == 1:
        (channel,) = model.channels.values()
    else:
        channel = model.channels[checks.one_of(direction, model.channels, "direction")]
    structure = channel.benchmark.structure
    if structure.linear is None:
        raise InputError(
            f"direction: the {channel.direction} channel has the nonlinear structure '{structure.name}'; "
            f"expected a linear one; use {instead}"
        )
    return channel


def check_load(channel: Channel, load: object) -> None:
    """Raise InputError for a load of a channel that has no second measured input."""
    if load is not None and channel.benchmark.covariate is None:
        raise InputError(f"load: the {channel.direction} channel has no covariate; expected None, got {load}")


def centre(channel: Channel) -> tuple[float, float]:
    """Return the middle of the displacement and the mean load of the tests; zeros without nonlinearities."""
    nonlinearity = channel.benchmark.nonlinearity
    if nonlinearity is None:
        return 0.0, 0.0
    return float(nonlinearity.scales.centre), float(nonlinearity.scales.load_centre)
