"""The speed map: steady speed over command at mid stroke, its band, measured speeds, and the dead zone."""

from matplotlib.figure import Figure

from hitchid.model import Characteristics
from hitchid.model.plotting import draw_characteristics
from hitchid.plots.style import COLUMN_IN, legend_above, styled


@styled
def speed_map(characteristics: Characteristics) -> Figure:
    """Return speed over command for each load, with 95 % bands, and the mean speeds measured in tests.

    Points without a line are measured speeds; a band without an upper end extends to the edge.

    Args:
        characteristics: operating characteristics of one direction.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.6))
    axes = figure.subplots()
    draw_characteristics(axes, characteristics)
    legend_above(figure, axes, columns=3)
    return figure
