"""Write the pictures of docs/howto/plots.md from the logs and the model of the tutorial.

python docs/images/plots.py LOGS MODEL
"""

import sys
from pathlib import Path

from matplotlib import pyplot

import hitchid
from hitchid.plots.style import decimate
from hitchid.report.svg import svg


def main(logs: str, folder: str) -> None:
    """Write one SVG file for each plot, its curves decimated."""
    campaign, model = hitchid.read(logs), hitchid.load(folder)
    plots = {
        "record": campaign.records[0].plot,
        "fit": hitchid.validate(model, campaign).plot,
        "speed-map": model.plot,
        "bode": model.plot_bode,
    }
    for name, plot in plots.items():
        axes = plot()
        for line in (line for each in axes for line in each.get_lines()):
            line.set_data(*decimate(*line.get_data()))
        path = Path(__file__).with_name(f"plot-{name}.svg")
        path.write_text(svg(axes[0].figure), encoding="utf-8")
        pyplot.close()


main(*sys.argv[1:])
