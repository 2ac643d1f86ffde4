"""Figure of a mixed log: displacement with its segments, and the commands."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hitchid._support.files import write_file
from hitchid.logs.kinds import LABELS, Segment
from hitchid.logs.plotting import draw_record
from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT, Record
from hitchid.plots.style import COLOURS, PAGE_IN, legend_above, style, styled
from hitchid.report.document import Picture

ROW_IN = 2.4  # height of a record, inch; chosen
MARK_COLOUR = COLOURS["benchmark"]
LEGEND_ORDER = (*LABELS, *(f"{direction} command" for direction in DIRECTIONS))


class Mark(NamedTuple):
    """A marked interval of a record.

    Attributes:
        record: name of the record.
        label: text of the mark.
        start_s, stop_s: ends of the interval, s of the log's own time.
    """

    record: str
    label: str
    start_s: float
    stop_s: float


@styled
def timeline(records: Sequence[tuple[Record, Sequence[Segment]]], marks: Sequence[Mark] = ()) -> Figure:
    """Return records, one per row: displacement with segments and marked intervals, and the commands."""
    figure = Figure(figsize=(PAGE_IN, ROW_IN * len(records) + 0.4))
    axes = figure.subplots(2 * len(records), 1, squeeze=False, height_ratios=[2, 1] * len(records))[:, 0]
    for number, (record, segments) in enumerate(records):
        displacement_axes, command_axes = axes[2 * number], axes[2 * number + 1]
        draw_record(displacement_axes, command_axes, record, segments, thin=True)
        _annotate_marks(displacement_axes, record, [mark for mark in marks if mark.record == record.name])
        displacement_axes.set_title(record.name, loc="left")
        displacement_axes.tick_params(labelbottom=False)
        for subplot in (displacement_axes, command_axes):
            subplot.set_xlim(record.time_s[0], record.time_s[-1])
    legend_above(figure, *axes, columns=len(LEGEND_ORDER), order=LEGEND_ORDER)
    figure.align_ylabels()
    return figure


def timeline_picture(records: Sequence[tuple[Record, Sequence[Segment]]], total: int) -> Picture:
    """Return `timeline` of some of the mixed logs, with the data of each sample, log below log."""
    data: dict[str, list] = {"log": [], "time_s": [], "segment": []}
    for record, segments in records:
        data["log"] += [record.name] * len(record)
        data["time_s"] += (record.start_s + record.step_s * np.arange(len(record))).tolist()
        for label, start, stop in segments:
            data["segment"] += [label] * (stop - start)
        for role in (DISPLACEMENT, *COMMAND.values()):
            if role in record.signals:
                data.setdefault(f"{role}_{record.units[role]}", []).extend(record.signals[role].tolist())
    names = ", ".join(record.name for record, _ in records)
    return Picture(
        "timeline",
        timeline(records),
        f"Segments of mixed logs: {names} ({total} in total).",
        f"Displacement and commands of {names} over time, coloured by segment.",
        wide=True,
        data=data,
    )


def _annotate_marks(axes: Axes, record: Record, marks: Sequence[Mark]) -> None:
    """Frame each mark and write its label where it does not cover the curve, each label once."""
    annotated = set()
    middle = (record.displacement.min() + record.displacement.max()) / 2
    for mark in marks:
        high = np.interp(mark.start_s, record.time_s, record.displacement) > middle
        axes.axvspan(
            mark.start_s, mark.stop_s, facecolor="none", edgecolor=MARK_COLOUR, hatch="////", linewidth=0.8
        )
        if mark.label not in annotated:
            axes.annotate(
                mark.label,
                (mark.start_s, 0.04 if high else 0.96),
                xycoords=axes.get_xaxis_transform(),
                va="bottom" if high else "top",
                color=MARK_COLOUR,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
            )
        annotated.add(mark.label)


def draw(
    records: Sequence[tuple[Record, Sequence[Segment]]],
    path: Path,
    *,
    marks: Sequence[Mark] = (),
    force: bool = False,
) -> None:
    """Write the figure of `timeline` in the format of the suffix, `.png`, `.svg` or `.pdf`.

    Raises:
        OutputError: the file exists and `force` is not given, or it cannot be written.
    """
    kind = path.suffix.lstrip(".")

    def save(target: Path) -> None:
        with style():
            timeline(records, marks).savefig(target, format=kind, dpi=150)

    write_file(path, save, force=force)
