"""Figures of closed loops: displacement, its error and the currents over time; the margins' loops."""

import numpy as np
from matplotlib.figure import Figure

from hitchid.control import ClosedLoops, Scenario
from hitchid.control.prediction import Band
from hitchid.plots.style import COLOURS, FAINT, INK, PAGE_IN, legend_above, styled

HEIGHT_IN = 4.2  # of a figure, inch; chosen
SHOWN = 20  # loops that are drawn; chosen


@styled
def closed_loop(
    scenario: Scenario,
    loops: ClosedLoops,
    baseline: ClosedLoops,
    band: Band | None,
    baseline_name: str,
    units: tuple[str, str],
) -> Figure:
    """Return displacement with the target, its error, and the currents of one loop, over time."""
    figure = Figure(figsize=(PAGE_IN, HEIGHT_IN))
    displacement, error, current = figure.subplots(3, 1, sharex=True, height_ratios=[2, 1.4, 1.2])
    time_s, target = loops.time_s, scenario.target
    if band is not None:
        for axes, offset in ((displacement, 0.0), (error, target)):
            axes.fill_between(
                time_s,
                band.lower - offset,
                band.upper - offset,
                color=COLOURS["one_step"],
                alpha=0.2,
                linewidth=0,
                label="predicted 90 %" if axes is displacement else None,
            )
    for number, own in enumerate(loops.displacement[:SHOWN]):
        label = "controller" if number == 0 else None
        displacement.plot(time_s, own, color=COLOURS["greybox"], linewidth=0.6, label=label)
        error.plot(time_s, own - target, color=COLOURS["greybox"], linewidth=0.6)
    displacement.plot(
        time_s,
        baseline.displacement[0],
        color=COLOURS["benchmark"],
        dashes=(4, 1.5),
        linewidth=0.9,
        label=baseline_name,
    )
    error.plot(
        time_s,
        baseline.displacement[0] - target,
        color=COLOURS["benchmark"],
        dashes=(4, 1.5),
        linewidth=0.9,
    )
    displacement.plot(time_s, target, color=INK, linewidth=0.9, label="target")
    for number, (name, colour) in enumerate((("lifting", "one_step"), ("lowering", "transfer_function"))):
        current.plot(
            time_s,
            loops.commands[0, :, number],
            color=COLOURS[colour],
            linewidth=0.8,
            label=f"{name} current",
        )
    error.axhline(0.0, color=FAINT, linewidth=0.6)
    beyond = np.abs(loops.displacement[:SHOWN, scenario.begin :] - target[scenario.begin :])
    if scenario.amplitude:
        error.set_ylim(-1.5 * scenario.tolerance, 1.5 * scenario.tolerance)
    else:
        widest = max(1.3 * float(beyond.max()), 0.1 * scenario.tolerance)
        error.set_ylim(-widest, widest)
    displacement.set_ylabel(f"displacement / {units[0]}")
    error.set_ylabel(f"error / {units[0]}")
    current.set_ylabel(f"command / {units[1]}")
    current.set_xlabel("time / s")
    legend_above(figure, displacement, error, current, columns=6)
    figure.align_ylabels()
    return figure
