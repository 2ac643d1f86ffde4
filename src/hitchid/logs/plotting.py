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
        held_out = _held_out(campaign)
        for number, (each, record) in enumerate(zip(drawn, shown, strict=False), start=1):
            draw_segments(each, _spans(record, segments(record)))
            draw_displacement(each, record.time_s, record.displacement, record.unit)
            each.set_xlabel("time / s")
            remark = " (held out)" if record.name in held_out else ""
            if number == len(shown) < len(records):
                remark += f" + {len(records) - number} more tests"
            each.set_title(_title(printable(record.name), remark), loc="left", parse_math=False)
        if axes is None:
            _tidy_grid(drawn, len(shown), columns)
    return drawn[: len(shown)]


def _tidy_grid(drawn: np.ndarray, shown: int, columns: int) -> None:
    """Hide unused axes, and labels that the axes to the left or below repeat."""
    for number, each in enumerate(drawn):
        each.set_visible(number < shown)
        if number % columns:
            each.set_ylabel("")
        if number + columns < shown:
            each.set_xlabel("")


def _held_out(campaign: "Campaign") -> set[str]:
    return {record.name for kind in (*DIRECTIONS, CYCLE) for record in campaign.held_out(kind)}


def _title(name: str, remark: str) -> str:
    """Return a name, shortened where there is no room for it, and a remark."""
    room = MAX_TITLE - len(remark)
    short = name if len(name) <= room else f"{name[: room - 1]}…"
    return f"{short}{remark}"


def _spans(record: Record, found: Sequence[Segment]) -> list[tuple[str, float, float]]:
    """Return label, start and end of segments, s."""
    return [
        (label, record.start_s + record.step_s * start, record.start_s + record.step_s * stop)
        for label, start, stop in found
    ]
