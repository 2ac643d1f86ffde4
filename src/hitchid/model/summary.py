"""What a model shows of itself: structure, parameters with units and errors, corrections."""

from collections.abc import Iterator

import numpy as np

from hitchid._support.tables import Summary, count, sparkline
from hitchid.logs.record import COMMAND, DISPLACEMENT
from hitchid.model.channel import Channel
from hitchid.model.hitch import Hitch
from hitchid.model.parameters import definitions


def hitch_summary(hitch: Hitch) -> Summary:
    """Return sampling time, units, and for each direction its structure and parameters."""
    units = ", ".join(f"{role} in {unit}" for role, unit in hitch.units.items())
    notes = [] if hitch.two_modes is None else [hitch.two_modes.sentence]
    if hitch.limits is not None:
        notes.append(hitch.limits.sentence(hitch.units[DISPLACEMENT]))
    maps = []
    for direction in hitch.channels:
        uncertainty = hitch.uncertainty.get(direction)
        if uncertainty is None or uncertainty.characteristics is None:
            maps.append("")
            continue
        points = uncertainty.characteristics.speed_map
        speeds = np.array([point.speed for point in points if point.load == points[0].load])
        maps.append(sparkline([speeds], f"steady speed over the {direction} command"))
    return Summary(
        f"Hitch at {hitch.step_s:g} s: {units}",
        ("direction", "structure", "parameters"),
        tuple(
            (direction, channel.benchmark.structure.name, "; ".join(_facts(hitch, channel)))
            for direction, channel in hitch.channels.items()
        ),
        tuple(notes),
        tuple(maps) if any(maps) else (),
    )


def _facts(hitch: Hitch, channel: Channel) -> Iterator[str]:
    """Yield G(s), each parameter with its unit, and the corrections of one direction."""
    benchmark = channel.benchmark
    if benchmark.structure.linear is not None:
        yield f"G(s) = {benchmark.structure.formula}"
    uncertainty = hitch.uncertainty.get(channel.direction)
    errors = {e.name: e.error for e in uncertainty.benchmark.parameters} if uncertainty else {}
    command_unit = hitch.units.get(COMMAND[channel.direction], "")
    known = benchmark.parameters
    shown = definitions(channel, uncertainty)
    units = {p.name: p.unit.format(x=hitch.units[DISPLACEMENT], u=command_unit) for p in known}
    symbols = {parameter.name: parameter.symbol for parameter in benchmark.structure.parameters}
    for name, value in benchmark.named_values().items():
        if "_by_" in name and name not in shown:
            continue
        symbol = f" {symbols[name]}" if symbols.get(name) else ""
        error = f" ± {error:.2g}" if (error := errors.get(name)) else ""
        unit = "" if units[name] == "1" else f" {units[name]}"
        yield f"{name}{symbol} = {value:.4g}{error}{unit}"
    yield f"dead zone = {channel.dead_zone:.4g} {command_unit}".rstrip()
    scatter, length = float(channel.load_filter.load_scatter), float(channel.load_filter.load_length)
    if scatter:
        unit = hitch.units[DISPLACEMENT]
        yield f"load filter: speed differs by ± {100 * scatter:.2g} %, alike over {length:.3g} {unit}"
    if uncertainty is not None and uncertainty.load_scatter is not None:
        yield f"load: {uncertainty.load_scatter.sentence}"
    corrections = []
    if channel.compensator is not None:
        corrections.append(f"up to {count(channel.compensator.max_horizon, 'sample')} ahead")
    if channel.speed_compensator is not None:
        corrections.append("free run")
    yield "network corrections: " + (" and ".join(corrections) or "none")
