"""Plots of a model: speed map, step response, Bode diagram; the methods of `Hitch`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid.errors import InputError
from hitchid.handover import responses
from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.model.channel import Channel
from hitchid.model.estimates import Characteristics
from hitchid.model.parameter_draws import draws_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hitchid.model.hitch import Hitch
    from hitchid.model.simulation import Simulation

MAP_IN, STEP_IN, BODE_IN = 3.2, 4.4, 4.4  # heights of new figures, inch; chosen
MAX_RUNS = 8  # of a simulation from several initial displacements or loads; chosen
MAP_POINTS = 25  # of a speed map without characteristics; chosen


def plot_speed_map(model: "Hitch", axes: "Axes | Sequence[Axes] | np.ndarray | None" = None) -> np.ndarray:
    """Draw steady speed over command of each direction, with bands, dead zone and measured speeds.

    Speeds are at mid stroke, positive in the direction of the command; with a load there are three curves.
    Bands and the shaded range of the dead zone are 95 % intervals from the identification tests. A model
    without them is drawn as its parameters give it, up to the largest command of the tests.

    Args:
        axes: one matplotlib axes for each direction; None for a new figure of pyplot.

    Returns:
        The axes, one for each direction.

    Raises:
        InputError: another number of axes is given, or a channel has no steady speed.
    """
    # matplotlib is imported where something is drawn: a model that is loaded and stepped needs none.
    from hitchid.plots import draw_dead_zone
    from hitchid.plots.style import canvas

    with canvas(axes, 1, len(model.channels), height_in=MAP_IN, legend_each=True) as drawn:
        for panel, (direction, channel) in zip(drawn, model.channels.items(), strict=True):
            characteristics = _characteristics(model, direction)
            if characteristics is None:
                _draw_nominal(panel, model, channel)
                draw_dead_zone(panel, channel.dead_zone, None, None)
            else:
                draw_characteristics(panel, characteristics)
            if axes is None:
                title = direction
                if characteristics is not None:
                    name = characteristics.load
                    unit = f" / {model.units[name]}" if name and name in model.units else ""
                    load = "" if name is None else f", by {name}{unit}"
                    title = f"{direction}{load}, 95 % bands"
                panel.set_title(title, loc="left")
    return drawn


def plot_simulation(
    simulation: "Simulation", axes: "Sequence[Axes] | np.ndarray | None" = None
) -> np.ndarray:
    """Draw simulated displacement above and the commands below; see `Simulation.plot`."""
    from hitchid.plots import draw_commands, draw_displacement
    from hitchid.plots.style import canvas

    units = simulation.model.units
    commands = {
        channel.direction: simulation.inputs.commands[:, DIRECTIONS.index(channel.direction)]
        for channel in simulation.model.dynamics.channels
    }
    with canvas(axes, 2, height_in=STEP_IN, sharex=True, height_ratios=[2, 1]) as drawn:
        for run in np.atleast_2d(simulation.displacement)[:MAX_RUNS]:
            draw_displacement(drawn[0], simulation.time_s, run, simulation.unit)
        shown = dict.fromkeys(units[COMMAND[direction]] for direction in commands)
        draw_commands(drawn[1], simulation.model_time_s, commands, ", ".join(shown))
    return drawn


def draw_characteristics(axes: "Axes", characteristics: Characteristics) -> None:
    """Draw the speed map of one direction, a curve for each load, with dead zone and measured speeds."""
    from hitchid.plots import SpeedCurve, draw_dead_zone, draw_speed_map

    curves = []
    loads = sorted({point.load for point in characteristics.speed_map if point.load is not None})
    for load in loads or [None]:
        points = [point for point in characteristics.speed_map if point.load == load]
        # An open end of a band is zero or infinite.
        lower = [0.0 if point.interval[0] is None else point.interval[0] for point in points]
        upper = [np.inf if point.interval[1] is None else point.interval[1] for point in points]
        commands, speeds = [point.command for point in points], [point.speed for point in points]
        label = "benchmark" if load is None else f"{load:.4g}"
        curves.append(SpeedCurve(label, *map(np.array, (commands, speeds, lower, upper))))
    draw_speed_map(
        axes,
        curves,
        [(point.command, point.speed) for point in characteristics.measured],
        command_unit=characteristics.command_unit,
        speed_unit=characteristics.speed_unit,
    )
    draw_dead_zone(axes, characteristics.dead_zone.value, *characteristics.dead_zone.interval)


def plot_step_response(
    model: "Hitch",
    direction: str | None = None,
    commands: Sequence[float] | None = None,
    *,
    duration_s: float | None = None,
    axes: "Axes | Sequence[Axes] | np.ndarray | None" = None,
    seed: int = 0,
) -> np.ndarray:
    """Draw travel and speed after steps of the command from rest.

    The physical model is simulated from mid stroke without end stops and without networks. The band contains
    95 % of the responses of 200 parameter vectors, drawn from the distribution of the estimates at a fixed
    dead zone; a model without estimates has none.

    Args:
        direction: lifting or lowering; None for all directions of the model.
        commands: levels of the command after the step, in the model's unit; None for up to three levels of
            the identification tests.
        duration_s: length of the response, s; None for six lags of the speed after the dead time.
        axes: matplotlib axes, first travel of each direction, then speed of each; None for a new figure of
            pyplot.
        seed: of the parameter vectors.

    Returns:
        The axes in that order, two for each direction.

    Raises:
        InputError: the model has no such direction, another number of axes is given, a command or the
            duration is not positive, or `commands` is None and the model does not know those of its tests.
    """
    from hitchid.plots import LEVEL_COLOURS, BandedCurve, draw_curves
    from hitchid.plots.style import canvas

    directions = _directions(model, direction)
    unit, count = model.units[DISPLACEMENT], len(directions)
    responses_of = {name: _step_responses(model, name, commands, duration_s, seed) for name in directions}
    with canvas(axes, 2, count, height_in=STEP_IN, sharex="col", legend_each=True) as drawn:
        for number, (name, curves) in enumerate(responses_of.items()):
            command_unit = model.units[COMMAND[name]]
            colours = [LEVEL_COLOURS[i % len(LEVEL_COLOURS)] for i in range(len(curves))]
            travels, speeds = [], []
            for curve, colour in zip(curves, colours, strict=True):
                label = f"{curve.level:.4g} {command_unit}"
                travels.append(BandedCurve(label, colour, curve.time_s, curve.travel))
                speeds.append(BandedCurve(None, colour, curve.speed_time_s, curve.speed))
            draw_curves(drawn[number], travels, "", f"travel / {unit}")
            draw_curves(drawn[count + number], speeds, "time after the step / s", f"speed / ({unit}/s)")
            if axes is None:
                banded = curves[0].travel.lower is not None
                drawn[number].set_title(f"{name}, 95 % bands" if banded else name, loc="left")
    return drawn


def plot_bode(
    model: "Hitch",
    direction: str | None = None,
    *,
    frequency_hz: Sequence[float] | np.ndarray | None = None,
    command: float | None = None,
    axes: "Axes | Sequence[Axes] | np.ndarray | None" = None,
    seed: int = 0,
) -> np.ndarray:
    """Draw the Bode diagram from command beyond the dead zone to travel.

    The frequency response is that of the continuous physical model with its dead time, without networks;
    see `hitchid.handover.frequency_response`. The band contains 95 % of the responses of 200 parameter
    vectors, drawn from the distribution of the estimates; a model without estimates has none.

    Args:
        direction: lifting or lowering; None for all directions of the model, in the same axes.
        frequency_hz: frequencies, Hz; None for three decades up to half the sampling frequency.
        command: constant command at which a model with a valve curve is linearised, in the model's unit; None
            for half way from the opening of the valve to the largest command of the tests.
        axes: two matplotlib axes, magnitude and phase; None for a new figure of pyplot.
        seed: of the parameter vectors.

    Returns:
        The axes of magnitude and phase.

    Raises:
        InputError: the model has no such direction, its structure is not linear, other than two axes are
            given, or a frequency is not positive.
    """
    from hitchid.plots import DIRECTION_COLOURS, BandedCurve, draw_bode
    from hitchid.plots.style import canvas

    if command is not None:
        checks.number(command, "command", above=0.0)
    directions = _directions(model, direction)
    frequencies = responses.checked_frequencies_hz(frequency_hz, model.step_s)
    units = dict.fromkeys(f"{model.units[DISPLACEMENT]}/{model.units[COMMAND[name]]}" for name in directions)
    magnitudes, phases = [], []
    for name in directions:
        channel, colour = model.channels[name], DIRECTION_COLOURS[name]
        vectors = draws_of(model, name, seed)
        response = responses.frequency_response(channel, frequencies, command, vectors)
        label = name if vectors is None else f"{name}, 95 % band"
        decibels = response.magnitude.map(lambda magnitude: 20 * np.log10(magnitude))
        degrees = response.phase_rad.map(np.rad2deg)
        magnitudes.append(BandedCurve(label, colour, frequencies, decibels))
        phases.append(BandedCurve(None, colour, frequencies, degrees))
    with canvas(axes, 2, height_in=BODE_IN, sharex=True) as drawn:
        magnitude_axes, phase_axes = drawn
        draw_bode(magnitude_axes, phase_axes, magnitudes, phases, unit=", ".join(units))
    return drawn


def _directions(model: "Hitch", direction: str | None) -> tuple[str, ...]:
    if direction is None:
        return tuple(model.channels)
    return (checks.one_of(direction, model.channels, "direction"),)


def _characteristics(model: "Hitch", direction: str) -> Characteristics | None:
    uncertainty = model.uncertainty.get(direction)
    return None if uncertainty is None else uncertainty.characteristics


@double_precision
def _draw_nominal(axes: "Axes", model: "Hitch", channel: Channel) -> None:
    """Draw the speed map that follows from the parameters alone, at mid stroke and mean load."""
    from hitchid.plots import SpeedCurve, draw_speed_map

    highest = channel.dead_zone + float(channel.operating_range.command.highest)
    if channel.benchmark.structure.linear is None or not np.isfinite(highest):
        raise InputError(
            f"channel '{channel.direction}': the speed map is not known; expected a linear structure with "
            "bands, or with the range of its tests"
        )
    commands = np.linspace(0.0, highest, MAP_POINTS)
    speeds = responses.steady_speeds(channel, commands)
    units = {"command_unit": model.units[COMMAND[channel.direction]]}
    units["speed_unit"] = f"{model.units[DISPLACEMENT]}/s"
    draw_speed_map(axes, [SpeedCurve("benchmark", commands, speeds)], [], **units)


def _step_responses(
    model: "Hitch", direction: str, commands: Sequence[float] | None, duration_s: float | None, seed: int
) -> list[responses.StepResponse]:
    """Return the responses of one direction to the given or the default levels."""
    channel, characteristics = model.channels[direction], _characteristics(model, direction)
    if commands is None:
        mapped = (
            () if characteristics is None else tuple(point.command for point in characteristics.speed_map)
        )
        levels = responses.default_levels(channel, mapped)
    else:
        levels = [checks.number(level, "commands", above=0.0) for level in np.ravel(commands)]
    if not levels:
        raise InputError(
            f"commands: expected levels of the {direction} command, which the model lacks; got none"
        )
    if duration_s is None:
        duration_s = responses.default_duration_s(channel, model.step_s)
    checks.number(duration_s, "duration_s", above=0.0)
    return responses.step_responses(channel, levels, duration_s, draws_of(model, direction, seed))
