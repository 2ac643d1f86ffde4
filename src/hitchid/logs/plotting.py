"""Plots of records and campaigns: which arrays are drawn, with which texts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from hitchid._support.inert import printable
from hitchid.errors import InputError
from hitchid.logs.kinds import LABELS, Segment, segments
from hitchid.logs.record import COMMAND, CYCLE, DIRECTIONS, Record
from hitchid.plots import draw_commands, draw_displacement, draw_segments
from hitchid.plots.style import canvas, checked_axes

if TYPE_CHECKING:
    from hitchid.logs.campaign import Campaign

RECORD_IN, CELL_IN, LEGEND_IN = 3.4, 1.5, 0.4  # height of a record, of a row of tests, of the legend; chosen
MAX_TESTS, COLUMNS = 12, 3  # tests of a campaign in a new figure, and in one of its rows; chosen
MAX_TITLE = 36  # characters that fit over the axes of a test; chosen


def plot_record(record: Record, axes: Axes | Sequence[Axes] | np.ndarray | None) -> np.ndarray:
    """Draw displacement above and commands below; see `Record.plot`."""
    with canvas(axes, 2, height_in=RECORD_IN, sharex=True, height_ratios=[2, 1]) as drawn:
        displacement_axes, command_axes = drawn
        draw_record(displacement_axes, command_axes, record)
        if axes is None:
            drawn[0].set_title(record.name, loc="left")
    return drawn


def draw_record(
    displacement_axes: Axes,
    command_axes: Axes,
    record: Record,
    segments: Sequence[Segment] = (),
    *,
    thin: bool = False,
) -> None:
    """Draw a record: displacement, on coloured segments if there are any, and commands."""
    draw_segments(displacement_axes, _spans(record, segments))
    draw_displacement(displacement_axes, record.time_s, record.displacement, record.unit, thin=thin)
    commands = {direction: record.command(direction) for direction in record.directions}
    units = dict.fromkeys(record.units[COMMAND[direction]] for direction in commands)
    draw_commands(command_axes, record.time_s, commands, ", ".join(units), thin=thin)


def plot_campaign(
    campaign: "Campaign", axes: Axes | Sequence[Axes] | np.ndarray | None, direction: str | None
) -> np.ndarray:
    """Draw the tests of a campaign side by side; see `Campaign.plot`."""
    records = campaign.records if direction is None else campaign.of_kind(direction)
    if not records:
        raise InputError(f"the campaign has no {direction or ''} tests to plot; expected at least one")
    given = None if axes is None else checked_axes(axes)
    shown = records[: MAX_TESTS if given is None else given.size]
    # Axes of the user are one column: how they stand in their figure is not known.
    columns = min(COLUMNS, len(shown)) if given is None else 1
    rows = -(-len(shown) // columns)
    with canvas(
        None if given is None else given[: len(shown)],
        rows,
        columns,
        height_in=CELL_IN * rows + LEGEND_IN,
        legend_order=LABELS,
        sharey=True,
    ) as drawn:
        held_out = {test.name for kind in (*DIRECTIONS, CYCLE) for test in campaign.held_out(kind)}
        for number, (cell, record) in enumerate(zip(drawn, shown, strict=False), start=1):
            draw_segments(cell, _spans(record, segments(record)))
            draw_displacement(cell, record.time_s, record.displacement, record.unit)
            cell.set_xlabel("time / s")
            remark = " (held out)" if record.name in held_out else ""
            if number == len(shown) < len(records):
                remark += f" + {len(records) - number} more tests"
            # A file may be called anything: a title must neither be parsed as mathematics nor leave its axes.
            name, room = printable(record.name), MAX_TITLE - len(remark)
            short = name if len(name) <= room else f"{name[: room - 1]}…"
            cell.set_title(f"{short}{remark}", loc="left", parse_math=False)
        # Of a new figure unused axes are hidden, and labels that the axes to the left or below repeat.
        for number, cell in enumerate(drawn if axes is None else ()):
            cell.set_visible(number < len(shown))
            if number % columns:
                cell.set_ylabel("")
            if number + columns < len(shown):
                cell.set_xlabel("")
    return drawn[: len(shown)]


def _spans(record: Record, parts: Sequence[Segment]) -> list[tuple[str, float, float]]:
    """Return label, start and end of segments, s."""
    return [
        (label, record.start_s + record.step_s * start, record.start_s + record.step_s * stop)
        for label, start, stop in parts
    ]
