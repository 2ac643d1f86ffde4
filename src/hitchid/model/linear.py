"""Linear state-space model of one direction of a hitch, for other libraries."""

from dataclasses import replace
from typing import TYPE_CHECKING

import jax.numpy as jnp

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid.errors import InputError
from hitchid.model.loads import Load
from hitchid.model.operating_point import linear_channel, load_of_channel
from hitchid.structures import LinearModel, linearise

if TYPE_CHECKING:
    from hitchid.model.hitch import Hitch

INSTEAD = "`simulate` for a record, or `step` in a loop"


@double_precision
def linear_model(
    model: "Hitch",
    direction: str | None,
    step_s: float | None,
    *,
    command: float | None,
    displacement: float | None,
    load: Load | None,
) -> LinearModel:
    """Return the linear model from command to displacement; see `Hitch.to_control`."""
    channel = linear_channel(model, direction, instead=INSTEAD)
    at_load = load_of_channel(channel, load)
    if at_load.ndim > 1:
        raise checks.input_error("load", "one load", load)
    given = {
        name: checks.number(value, name)
        for name, value in {"command": command, "displacement": displacement}.items()
        if value is not None
    }
    if "command" in given:
        given["command"] = abs(given["command"]) - channel.dead_zone
        if not given["command"] > 0:
            raise InputError(
                f"command: expected one beyond the dead zone of {channel.dead_zone:.4g}, got {command}"
            )
    travel = linearise(channel.benchmark.at_load(jnp.asarray(at_load)), step_s, **given)
    return replace(travel, c=channel.sign * travel.c)
