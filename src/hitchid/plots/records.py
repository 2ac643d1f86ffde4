"""Signals of a test over time: displacement, its segments, commands."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from hitchid.plots.style import COLOURS, INK, curve

SEGMENT_COLOURS = {
    "lifting": COLOURS["one_step"],
    "lowering": COLOURS["narx"],
    "hold": COLOURS["hold"],
    "saturated": COLOURS["transfer_function"],
    "end stop": COLOURS["faint"],
    "both valves on": COLOURS["benchmark"],
}
"""Label of a segment, as `data.segmentation` has it, to its colour."""
DIRECTION_COLOURS = {direction: SEGMENT_COLOURS[direction] for direction in ("lifting", "lowering")}
ALPHA = 0.35  # opacity of a segment; chosen


def draw_displacement(
    axes: Axes, time_s: np.ndarray, displacement: np.ndarray, unit: str, *, thin: bool = False
) -> None:
    """Draw displacement over time.

    Args:
        axes: to draw into.
        time_s, displacement: the samples, shape [N].
        unit: of the displacement.
        thin: whether the curve is decimated.
    """
    axes.plot(*curve(time_s, displacement, thin=thin), color=INK)
    axes.set_ylabel(f"displacement / {unit}")


def draw_segments(axes: Axes, segments: Sequence[tuple[str, float, float]]) -> None:
    """Colour the background by what the hitch does.

    Args:
        axes: to draw into.
        segments: label, a key of `SEGMENT_COLOURS`, with start and end, s.
    """
    for label, start_s, stop_s in segments:
        alpha = 1.0 if label == "hold" else ALPHA
        axes.axvspan(start_s, stop_s, color=SEGMENT_COLOURS[label], alpha=alpha, linewidth=0, label=label)


def draw_commands(
    axes: Axes, time_s: np.ndarray, commands: Mapping[str, np.ndarray], unit: str, *, thin: bool = False
) -> None:
    """Draw the command of each direction over time.

    Args:
        axes: to draw into.
        time_s: time of the samples, shape [N].
        commands: direction to command, shape [N].
        unit: of the commands.
        thin: whether curves are decimated.
    """
    for direction, command in commands.items():
        axes.plot(
            *curve(time_s, command, thin=thin),
            color=DIRECTION_COLOURS[direction],
            label=f"{direction} command",
        )
    axes.set_ylabel(f"command /\n{unit}")
    axes.set_xlabel("time / s")
