"""Channel, displacement and load that a steady speed or a linear model is for."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from hitchid._support import checks
from hitchid.errors import InputError
from hitchid.model.channel import Channel
from hitchid.model.loads import Load, load_row

if TYPE_CHECKING:
    from hitchid.model.hitch import Hitch


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


def load_of_channel(channel: Channel, load: Load | None) -> Float[np.ndarray, "*m c"]:
    """Return a load in the order of the channel's covariates; see `load_row`."""
    return load_row(load, [channel], f"{channel.direction} channel")


def centre(channel: Channel) -> float:
    """Return the middle of the displacement in the tests; zero without nonlinearities."""
    nonlinearity = channel.benchmark.nonlinearity
    return 0.0 if nonlinearity is None else float(nonlinearity.scales.centre)
