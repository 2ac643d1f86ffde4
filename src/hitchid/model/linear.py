"""Linear state-space model of one direction of a hitch, for other libraries."""

from dataclasses import replace
from typing import TYPE_CHECKING

from hitchid._support import checks
from hitchid.errors import InputError
from hitchid.model.operating_point import check_load, linear_channel
from hitchid.structures import LinearModel, linearise

if TYPE_CHECKING:
    from hitchid.model.hitch import Hitch

INSTEAD = "`simulate` for a record, or `step` in a loop"


def linear_model(
    model: "Hitch",
    direction: str | None,
    step_s: float | None,
    *,
    command: float | None,
    displacement: float | None,
    load: float | None,
) -> LinearModel:
    """Return the linear model from command to displacement; see `Hitch.to_control`."""
    channel = linear_channel(model, direction, instead=INSTEAD)
    check_load(channel, load)
    given = {
        name: checks.number(value, name)
        for name, value in {"command": command, "displacement": displacement, "load": load}.items()
        if value is not None
    }
    if "command" in given:
        given["command"] = abs(given["command"]) - channel.dead_zone
        if not given["command"] > 0:
            raise InputError(
                f"command: expected one beyond the dead zone of {channel.dead_zone:.4g}, got {command}"
            )
    travel = linearise(channel.benchmark, step_s, **given)
    return replace(travel, c=channel.sign * travel.c)
