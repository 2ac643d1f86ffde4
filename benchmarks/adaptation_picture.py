"""Picture of an adaptation: errors of each stroke and the gain in use while the load changes.

Run: python -m benchmarks.adaptation_picture FILE.svg
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from benchmarks.adaptation.bench import RIGS, at_work, identified
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hitchid.live import Event
from hitchid.live.events import CHANGE_DETECTED, LEARNED, MOVED, PROMOTED, REFUSED, ROLLED_BACK
from hitchid.model import Hitch
from hitchid.plots.style import COLOURS, FAINT, INK, PAGE_IN, legend_above, styled
from hitchid.report.svg import svg

RIG, BEFORE_KG, AFTER_KG = "nominal", 1000.0, 1300.0
DURATION_S, CHANGE_S = 600.0, 300.0
HEIGHT_IN = 3.6
# Kind of an event to its colour and dashes.
MARKED = {
    PROMOTED: (COLOURS["greybox"], (None, None)),
    ROLLED_BACK: (COLOURS["crimson"], (1.2, 1.2)),
    CHANGE_DETECTED: (COLOURS["one_step"], (4, 1.5)),
}

REFUSAL = {
    "marker": "|",
    "linestyle": "",
    "markersize": 9,
    "markeredgewidth": 1.4,
    "color": COLOURS["crimson"],
}


def adapted(model: Hitch) -> tuple[Event, ...]:
    """Return the change log of a bench at work whose implement is exchanged in the middle."""
    samples = np.arange(round(100 * DURATION_S))
    masses = np.where(samples < 100 * CHANGE_S, BEFORE_KG, AFTER_KG)
    at = at_work(RIG, model, 11, DURATION_S, implement_kg=masses, oil_degc=RIGS[RIG])
    return model.adapt([at.record]).events


@styled
def picture(events: Sequence[Event]) -> Figure:
    """Draw errors above and gain below, one column for each direction."""
    directions = list(dict.fromkeys(event.direction for event in events if event.direction))
    figure = Figure(figsize=(PAGE_IN, HEIGHT_IN))
    axes = figure.subplots(2, len(directions), sharex=True, sharey="row", squeeze=False)
    for direction, (above, below) in zip(directions, axes.T, strict=True):
        of_direction = [event for event in events if event.direction == direction]
        draw_errors(above, of_direction)
        draw_gain(below, of_direction)
        for each in (above, below):
            draw_events(each, of_direction)
        above.set_title(direction)
        below.set_xlabel("time / s")
    axes[0, 0].set_ylim(bottom=0)
    axes[0, 0].set_ylabel("error of a stroke / mm")
    axes[1, 0].set_ylabel("change of gain / %")
    legend_above(figure, *axes.ravel(), columns=4)
    return figure


def draw_errors(axes: Axes, events: Sequence[Event]) -> None:
    """Draw the free-run error of each stroke, and which strokes were refused."""
    learned = [event for event in events if event.kind == LEARNED]
    times = [event.time_s for event in learned]
    for name, label, colour, marker in (
        ("error_as_identified", "model as identified", FAINT, "x"),
        ("error", "adapted model", COLOURS["greybox"], "o"),
    ):
        values = [event.figures[name] for event in learned]
        axes.plot(times, values, color=colour, marker=marker, markersize=2.5, linewidth=0.7, label=label)
    refused = [event.time_s for event in events if event.kind == REFUSED]
    axes.plot(refused, [0.0] * len(refused), label="stroke refused", **REFUSAL)


def draw_gain(axes: Axes, events: Sequence[Event]) -> None:
    """Draw the gain in use, and the estimate with twice its standard deviation."""
    learned = [event for event in events if event.kind == LEARNED]
    times = [event.time_s for event in learned]
    estimate, deviation = np.array(
        [(event.figures["gain"], event.figures["gain_deviation"]) for event in learned]
    ).T
    lower, upper = (100 * np.expm1(estimate + sign * 2 * deviation) for sign in (-1, 1))
    axes.fill_between(times, lower, upper, color=COLOURS["hold"], label="estimate ± 2 standard deviations")
    used = [event for event in events if event.kind in (MOVED, ROLLED_BACK)]
    moments = [0.0, *(event.time_s for event in used), DURATION_S]
    gains = [0.0, *(100 * np.expm1(event.changes.gain) for event in used)]
    axes.step(moments, [*gains, gains[-1]], where="post", color=COLOURS["benchmark"], label="gain in use")


def draw_events(axes: Axes, events: Sequence[Event]) -> None:
    """Mark the change of the load, and the events."""
    axes.axvline(CHANGE_S, color=INK, linewidth=1.6, label="the load changes")
    for kind, (colour, dashes) in MARKED.items():
        for event in events:
            if event.kind == kind:
                axes.axvline(event.time_s, color=colour, dashes=dashes, linewidth=0.8, label=kind)


def main(path: str) -> None:
    """Identify a model, adapt it, and write the picture."""
    events = adapted(identified(RIG, BEFORE_KG, RIGS[RIG]))
    Path(path).write_text(svg(picture(events)), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
