"""The speed map: steady speed over command at mid stroke, its band, and measured speeds."""

import numpy as np
from matplotlib.figure import Figure

from hitchid.model import Characteristics
from hitchid.report.figures.style import COLOURS, COLUMN_IN, INK, legend_above, styled

LINE_STYLES = (("one_step", "v", "--"), ("benchmark", "s", "-"), ("greybox", "^", "-."))
BAND_ALPHA = 0.22  # opacity of a band; chosen
HEADROOM = 1.5  # top of the axis over the fastest speed; chosen


@styled
def speed_map(characteristics: Characteristics) -> Figure:
    """Return speed over command for each load, with 95 % bands, and the mean speeds measured in tests.

    Points without a line are measured speeds; a band without an upper end extends to the edge.

    Args:
        characteristics: operating characteristics of one direction.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.6))
    axis = figure.subplots()
    loads = sorted({point.load for point in characteristics.speed_map if point.load is not None}) or [None]
    fastest = max(
        [point.speed for point in characteristics.speed_map]
        + [measurement.speed for measurement in characteristics.measured],
        default=1.0,
    )
    highest = HEADROOM * fastest
    line_styles = LINE_STYLES if len(loads) > 1 else LINE_STYLES[1:2]
    for load, (colour, marker, dashes) in zip(loads, line_styles, strict=False):
        points = [point for point in characteristics.speed_map if point.load == load]
        commands = [point.command for point in points]
        lower = [0.0 if point.interval[0] is None else point.interval[0] for point in points]
        upper = [highest if point.interval[1] is None else point.interval[1] for point in points]
        shade = COLOURS[colour]
        label = "benchmark" if load is None else f"{load:.4g}"
        if len(points) == 1:
            axis.vlines(commands, lower, upper, alpha=BAND_ALPHA, linewidth=4, color=shade)
        axis.fill_between(commands, lower, upper, alpha=BAND_ALPHA, linewidth=0, color=shade)
        axis.plot(
            commands,
            [point.speed for point in points],
            dashes,
            marker=marker,
            markersize=3,
            label=label,
            color=shade,
        )
    if characteristics.measured:
        commands, speeds = np.array(
            [(measurement.command, measurement.speed) for measurement in characteristics.measured]
        ).T
        axis.plot(commands, speeds, "o", color=INK, markersize=3, fillstyle="none", label="measured")
    axis.set_ylim(min(0.0, *(measurement.speed for measurement in characteristics.measured), 0.0), highest)
    axis.set_xlabel(f"command / {characteristics.command_unit}")
    axis.set_ylabel(f"speed / ({characteristics.speed_unit})")
    legend_above(figure, axis, columns=4)
    return figure
