"""A mixed log as a picture: displacement over what the hitch does, and the commands below."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hitchid._support.storage import write_file
from hitchid.data.record import COMMAND, LIFTING, LOWERING, Record
from hitchid.data.segmentation import BOTH, END_STOP, HOLD, SATURATED, Segment
from hitchid.report.figures.style import COLOURS, INK, PAGE_IN, style, styled, thinned

FILLS = {
    LIFTING: COLOURS["one_step"],
    LOWERING: COLOURS["narx"],
    HOLD: COLOURS["hold"],
    SATURATED: COLOURS["transfer_function"],
    END_STOP: COLOURS["faint"],
    BOTH: COLOURS["benchmark"],
}
LINES = {LIFTING: COLOURS["one_step"], LOWERING: COLOURS["narx"]}
ALPHA, ROW_IN = 0.35, 2.4
POINTED = COLOURS["benchmark"]


class Mark(NamedTuple):
    """A stretch of a record that is to be pointed at.

    Attributes:
        record: name of the record.
        label: what is there.
        start_s, stop_s: where, s of the log's own time.
    """

    record: str
    label: str
    start_s: float
    stop_s: float


@styled
def timeline(records: Sequence[tuple[Record, Sequence[Segment]]], marks: Sequence[Mark] = ()) -> Figure:
    """Return records, one below the other, with what happens in them behind the displacement.

    Args:
        records: logs, each with its stretches, as `segments` gives them for a mixed one.
        marks: what is to be pointed at in them.
    """
    figure = Figure(figsize=(PAGE_IN, ROW_IN * len(records) + 0.4))
    axes = figure.subplots(2 * len(records), 1, squeeze=False, height_ratios=[2, 1] * len(records))[:, 0]
    used: dict[str, None] = {}
    for number, (record, found) in enumerate(records):
        above, below = axes[2 * number], axes[2 * number + 1]
        for label, start, stop in found:
            used[label] = None
            ends = record.start_s + record.step_s * start, record.start_s + record.step_s * stop
            above.axvspan(*ends, color=FILLS[label], alpha=1.0 if label == HOLD else ALPHA, linewidth=0)
        above.plot(*thinned(record.time_s, record.displacement), color=INK)
        _point_at(above, record, [mark for mark in marks if mark.record == record.name])
        above.set_ylabel(f"displacement / {record.unit}")
        above.set_title(record.name.encode(errors="replace").decode(), loc="left", parse_math=False)
        above.tick_params(labelbottom=False)
        for mode in record.modes:
            below.plot(*thinned(record.time_s, record.command(mode)), color=LINES[mode], label=mode)
        below.set_ylabel(f"command /\n{record.units[COMMAND[record.modes[0]]]}")
        below.set_xlabel("time / s")
        for each in (above, below):
            each.set_xlim(record.time_s[0], record.time_s[-1])
    used_commands = [mode for mode in LINES if any(mode in record.modes for record, _ in records)]
    handles: list[Artist] = [
        Patch(color=FILLS[label], alpha=1.0 if label == HOLD else ALPHA, label=label)
        for label in FILLS
        if label in used
    ]
    handles += [Line2D([], [], color=LINES[mode], label=f"{mode} command") for mode in used_commands]
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))
    figure.align_ylabels()
    return figure


def _point_at(axes: Axes, record: Record, marks: Sequence[Mark]) -> None:
    """Frame what is to be pointed at and name it off the curve, each label once."""
    named = set()
    middle = (record.displacement.min() + record.displacement.max()) / 2
    for mark in marks:
        high = np.interp(mark.start_s, record.time_s, record.displacement) > middle
        axes.axvspan(
            mark.start_s, mark.stop_s, facecolor="none", edgecolor=POINTED, hatch="////", linewidth=0.8
        )
        if mark.label not in named:
            axes.annotate(
                mark.label,
                (mark.start_s, 0.04 if high else 0.96),
                xycoords=axes.get_xaxis_transform(),
                va="bottom" if high else "top",
                color=POINTED,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
            )
        named.add(mark.label)


def draw(
    records: Sequence[tuple[Record, Sequence[Segment]]],
    path: Path,
    *,
    marks: Sequence[Mark] = (),
    force: bool = False,
) -> None:
    """Write the picture; its ending says the format, `.png`, `.svg` or `.pdf`.

    Raises:
        OutputError: the file exists and `force` is not given, or it cannot be written.
    """
    kind = path.suffix.lstrip(".")

    def save(place: Path) -> None:
        with style():
            timeline(records, marks).savefig(place, format=kind, dpi=150)

    write_file(path, save, force=force)
