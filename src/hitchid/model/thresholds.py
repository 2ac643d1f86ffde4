"""Dead zones and thresholds of a model's commands, in the units of logs."""

from collections.abc import Mapping

from hitchid.logs.kinds import CommandThreshold
from hitchid.logs.record import COMMAND
from hitchid.logs.units import conversion_factor
from hitchid.model.channel import Channel


def command_thresholds(
    channels: Mapping[str, Channel], model_units: Mapping[str, str], units: Mapping[str, str]
) -> dict[str, CommandThreshold]:
    """Return direction to the threshold of its command; see `Hitch.command_thresholds`."""
    dead_zones = {direction: channel.dead_zone for direction, channel in channels.items()}
    thresholds = {}
    for direction, dead_zone in in_log_units(dead_zones, model_units, units).items():
        benchmark = channels[direction].benchmark
        hysteresis = benchmark.named_values().get("hysteresis", 0.0)
        thresholds[direction] = CommandThreshold(
            dead_zone, hysteresis * dead_zone, float(benchmark.dead_time_s)
        )
    return thresholds


def in_log_units(
    dead_zones: Mapping[str, float], model_units: Mapping[str, str], units: Mapping[str, str]
) -> dict[str, float]:
    """Return direction to dead zone, from the model's units to those of logs where both are known.

    Raises:
        InputError: a unit is of another dimension than the model's.
    """
    converted = {}
    for direction, dead_zone in dead_zones.items():
        role = COMMAND[direction]
        convertible = role in model_units and role in units
        factor = conversion_factor(model_units[role], units[role], role) if convertible else 1.0
        converted[direction] = dead_zone * factor
    return converted
