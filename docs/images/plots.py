"""Write the pictures of docs/howto/plots.md from the logs and the model of the tutorial.

python docs/images/plots.py LOGS MODEL
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

import hitchid
from hitchid.plots.style import decimate
from hitchid.report.svg import svg

BAND_CORNERS = 300  # of the polygon of a band


def main(logs: str, folder: str) -> None:
    """Write one SVG file for each plot, with fewer points."""
    campaign, model = hitchid.read(logs), hitchid.load(folder)
    plots = {
        "record": campaign.records[0].plot,
        "fit": hitchid.validate(model, campaign).plot,
        "speed-map": model.plot,
        "bode": model.plot_bode,
    }
    for name, plot in plots.items():
        axes = plot()
        for each in axes:
            thin(each)
        path = Path(__file__).with_name(f"plot-{name}.svg")
        path.write_text(svg(axes[0].figure), encoding="utf-8")
        pyplot.close()


def thin(axes: Axes) -> None:
    """Leave out points of lines and bands that are not seen."""
    for line in axes.get_lines():
        line.set_data(*decimate(*map(np.asarray, line.get_data())))
    for band in axes.collections:
        polygons = [path.vertices for path in band.get_paths()]
        band.set_verts([polygon[:: 1 + len(polygon) // BAND_CORNERS] for polygon in polygons])


main(*sys.argv[1:])
