"""Figures of what was identified: parameters, loads of the tests, speed over command, dead zone."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, NullLocator, StrMethodFormatter

from hitchid._support.inert import printable
from hitchid.logs.record import Record
from hitchid.model import Characteristics, Estimate, LoadScatter
from hitchid.model.plotting import draw_characteristics
from hitchid.model.trace import TracedDeadZone
from hitchid.plots.style import COLOURS, COLUMN_IN, FAINT, INK, decimate, legend_above, styled
from hitchid.report.document import Picture, sentence
from hitchid.validation.valve_map import ValveMap

MARGIN = 0.6  # margin of an interval, share of its width; all values chosen
ROW_IN, NAMED_ROWS = 0.16, 48  # height of a test, in; tests whose names fit on a page; chosen
WIDE_RATIO = 5  # ratio of the ends of a logarithmic axis above which its ticks are logarithmic
ONSET_FACTOR = 1.6  # end of a ramp's command axis over the dead zone; chosen


@styled
def intervals(name: str, title: str, estimates: Sequence[Estimate]) -> Picture:
    """Return each parameter with its 95 % interval, one row with its own scale per parameter.

    Open ends are arrows to the edge; the thin line is the bootstrap interval.

    Args:
        name: of the picture.
        title: the parameters' own, in its caption.
        estimates: of the parameters of one direction.
    """
    figure = Figure(figsize=(COLUMN_IN, 0.25 + 0.62 * len(estimates)))
    for axis, estimate in zip(np.atleast_1d(figure.subplots(len(estimates), 1)), estimates, strict=True):
        _interval(axis, estimate)
    return Picture(
        name,
        figure,
        f"{title.capitalize()}: estimate and 95 % interval, each on its own scale; thin "
        "line: bootstrap interval. Grey: not determined by the tests.",
        "; ".join(f"{estimate.symbol}: {estimate.verdict}" for estimate in estimates),
        data={
            "name": [estimate.name for estimate in estimates],
            "unit": [estimate.unit for estimate in estimates],
            "value": [estimate.value for estimate in estimates],
            "interval_95_lower": [estimate.interval[0] for estimate in estimates],
            "interval_95_upper": [estimate.interval[1] for estimate in estimates],
            "bootstrap_95_lower": [estimate.bootstrap and estimate.bootstrap[0] for estimate in estimates],
            "bootstrap_95_upper": [estimate.bootstrap and estimate.bootstrap[1] for estimate in estimates],
        },
    )


def _interval(axis: Axes, estimate: Estimate) -> None:
    interval, value = estimate.interval, estimate.value
    positive = estimate.lower > 0 and min([value, *(end for end in interval if end is not None)]) > 0
    finite_values = [np.log(x) if positive else x for x in (value, *interval) if x is not None]
    spread = (max(finite_values) - min(finite_values)) or (1.0 if positive else abs(value) or 1.0)
    low, high = min(finite_values) - MARGIN * spread, max(finite_values) + MARGIN * spread
    edge = np.exp([low, high]) if positive else np.array([low, high])
    axis.set_xscale("log" if positive else "linear")
    axis.set_xlim(*edge)
    line_ends = [edge[side] if end is None else end for side, end in enumerate(interval)]
    colour = COLOURS["benchmark"] if estimate.determined else FAINT
    axis.plot(line_ends, [0, 0], color=colour, linewidth=4, solid_capstyle="butt")
    for side, marker in enumerate("<>"):
        if interval[side] is None:
            axis.plot([edge[side]], [0], marker, color=colour, markersize=6, clip_on=False)
    if estimate.bootstrap and estimate.determined:
        axis.plot(np.array(estimate.bootstrap, dtype=float), [-0.45, -0.45], color=FAINT, linewidth=1.2)
    axis.plot([value], [0], "|", color=INK, markersize=11, markeredgewidth=1.4)
    axis.set_ylim(-1, 1)
    axis.set_yticks([])
    axis.spines["left"].set_visible(False)
    # Ticks that do not overlap on a logarithmic axis; linear ones on a short one.
    axis.xaxis.set_major_locator(
        FixedLocator(sorted({float(f"{x:.1g}") for x in np.geomspace(edge[0], edge[1], 5)[1:-1]}))
        if positive and edge[1] >= WIDE_RATIO * edge[0]
        else MaxNLocator(4)
    )
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:.4g}"))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_formatter(NullFormatter())
    unit = "" if estimate.unit == "1" else f" / {estimate.unit}"
    axis.set_ylabel(f"{estimate.symbol}{unit}", rotation=0, ha="right", va="center")


@styled
def loads(name: str, load_scatter: LoadScatter) -> Picture:
    """Return each test's speed above the model's with its 95 % interval, slowest below, in percent.

    The band is ± the scatter between tests. Of very many tests the names are left out.

    Args:
        name: of the picture.
        load_scatter: of one direction.
    """
    tests = sorted(load_scatter.tests, key=lambda test: test.speed)
    figure = Figure(figsize=(COLUMN_IN, 0.6 + ROW_IN * min(len(tests), NAMED_ROWS)))
    axes = figure.subplots()
    speed, lower, upper = 100 * np.array([(test.speed, *test.interval) for test in tests]).T
    rows = np.arange(len(tests))
    axes.axvspan(-100 * load_scatter.scatter, 100 * load_scatter.scatter, color=FAINT, alpha=0.3, linewidth=0)
    axes.axvline(0, color=FAINT, linewidth=0.8)
    colours = [COLOURS["benchmark"] if test.determined else FAINT for test in tests]
    axes.hlines(rows, lower, upper, color=colours, linewidth=1.2)
    axes.plot(speed, rows, "o", color=INK, markersize=3)
    named = len(tests) <= NAMED_ROWS
    axes.set_yticks(rows if named else [], [printable(test.test) for test in tests] if named else [])
    axes.set_ylim(-0.7, len(tests) - 0.3)
    axes.set_xlabel("speed above the model's / %")
    return Picture(
        name,
        figure,
        "Speed of each identification test above the model's, as a load that nobody measures would make "
        "it, with its 95 % interval, the slowest test below; grey: not determined; grey band: "
        "± the scatter between tests.",
        sentence(load_scatter.sentence),
        data={
            "test": [test.test for test in load_scatter.tests],
            "speed_percent": [100 * test.speed for test in load_scatter.tests],
            "interval_95_lower_percent": [100 * test.interval[0] for test in load_scatter.tests],
            "interval_95_upper_percent": [100 * test.interval[1] for test in load_scatter.tests],
            "scatter_percent": (100 * load_scatter.scatter,),
        },
    )


@styled
def speed_map(name: str, characteristics: Characteristics, alt: str) -> Picture:
    """Return speed over command for each load, with 95 % bands, and the mean speeds measured in tests.

    Points without a line are measured speeds; a band without an upper end extends to the edge.

    Args:
        name, alt: of the picture.
        characteristics: operating characteristics of one direction.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.6))
    axes = figure.subplots()
    draw_characteristics(axes, characteristics)
    legend_above(figure, axes, columns=3)
    points, measured = characteristics.speed_map, characteristics.measured
    command, speed = characteristics.command_unit, characteristics.speed_unit
    load = characteristics.load
    lines = f" One line for each load ({load})." if load else ""
    return Picture(
        name,
        figure,
        "Speed map: steady speed at mid stroke over the command, as identified, with its 95 % band; open "
        f"circles are mean speeds of identification tests during constant command.{lines}",
        alt,
        data={
            f"command_{command}": [point.command for point in points],
            **({load: [point.load for point in points]} if load else {}),
            f"speed_{speed}": [point.speed for point in points],
            f"speed_lower_{speed}": [point.interval[0] for point in points],
            f"speed_upper_{speed}": [point.interval[1] for point in points],
            f"measured_command_{command}": [point.command for point in measured],
            **({f"measured_{load}": [point.load for point in measured]} if load else {}),
            f"measured_speed_{speed}": [point.speed for point in measured],
        },
    )


@styled
def valve_map(name: str, valve: ValveMap, unit: str, command_unit: str) -> Picture:
    """Return the steady speed of the benchmark over the command, and the speeds measured in the logs.

    Points are medians of equal numbers of samples, lines their 10 % to 90 % quantiles.

    Args:
        name: of the picture.
        valve: speeds of one direction.
        unit, command_unit: of displacement and command.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.7))
    axis = figure.subplots()
    data = {
        f"benchmark_command_{command_unit}": valve.commands,
        f"benchmark_speed_{unit}/s": valve.speeds,
        f"tests_command_{command_unit}": [speeds.command for speeds in valve.bins],
        f"tests_speed_10_percent_{unit}/s": [speeds.low for speeds in valve.bins],
        f"tests_speed_median_{unit}/s": [speeds.middle for speeds in valve.bins],
        f"tests_speed_90_percent_{unit}/s": [speeds.high for speeds in valve.bins],
        f"dead_zone_{command_unit}": valve.dead_zones,
    }
    for number, (command, speed) in enumerate(valve.ramps, start=1):
        label = "ramps" if number == 1 else None
        axis.plot(*decimate(command, speed), color=FAINT, linewidth=0.7, label=label)
        data |= {f"ramp_{number}_command_{command_unit}": command, f"ramp_{number}_speed_{unit}/s": speed}
    for speeds in valve.bins:
        axis.plot([speeds.command] * 2, [speeds.low, speeds.high], color=INK, linewidth=0.8)
        axis.plot([speeds.command], [speeds.middle], "o", color=INK, markersize=3.5)
    if valve.bins:
        axis.plot([], [], "o-", color=INK, markersize=3.5, linewidth=0.8, label="tests")
    axis.plot(valve.commands, valve.speeds, color=COLOURS["benchmark"], label="benchmark")
    for zone in valve.dead_zones:
        axis.axvline(zone, color=COLOURS["benchmark"], linestyle=":", label="dead zone")
    axis.set_xlim(1.03 * valve.lowest if valve.signed else 0.5 * valve.dead_zones[0], 1.03 * valve.highest)
    axis.set_xlabel(f"{valve.direction} command / {command_unit}")
    axis.set_ylabel(f"speed / ({unit}/s)")
    legend_above(figure, axis, columns=4)
    return Picture(
        name,
        figure,
        "Valve map: speed over command, of tests once it has settled: four lags after a change of the "
        "command. Points below the dead zone are decaying motion.",
        f"Speed in {unit}/s over command in {command_unit}: benchmark, tests and ramps.",
        data=data,
    )


@styled
def dead_zone(
    name: str, ramps: Sequence[Record], direction: str, zone: TracedDeadZone, unit: str, command_unit: str
) -> Picture:
    """Return displacement over the command of slow ramps, around the command at which motion begins.

    Args:
        name: of the picture.
        ramps: slow ramps of one direction.
        direction: lifting or lowering.
        zone: dead zone, and its standard deviation over ramps.
        unit, command_unit: of displacement and command.
    """
    value, spread = zone.value, zone.spread
    figure = Figure(figsize=(COLUMN_IN, 2.3))
    axis = figure.subplots()
    highest = 0.0
    data: dict[str, Sequence | np.ndarray] = {
        f"dead_zone_{command_unit}": (value,),
        f"dead_zone_standard_deviation_{command_unit}": (spread,),
    }
    for number, ramp in enumerate(ramps, start=1):
        command = ramp.command(direction)
        rising = slice(0, int(np.argmax(command)) + 1)
        near = command[rising] <= ONSET_FACTOR * value
        travel = np.abs(ramp.displacement[rising] - ramp.displacement[0])
        axis.plot(*decimate(command[rising][near], travel[near]), color=INK, linewidth=0.8)
        highest = max(highest, float(travel[near].max(initial=0.0)))
        data |= {
            f"ramp_{number}_command_{command_unit}": command,
            f"ramp_{number}_displacement_{unit}": ramp.displacement,
        }
    axis.axvline(value, color=COLOURS["benchmark"], label="dead zone")
    if spread:
        axis.axvspan(value - spread, value + spread, color=COLOURS["benchmark"], alpha=0.25, linewidth=0)
    axis.set_xlim(0.4 * value, ONSET_FACTOR * value)
    axis.set_ylim(-0.02 * highest, 1.05 * highest or 1.0)
    axis.set_xlabel(f"{direction} command / {command_unit}")
    axis.set_ylabel(f"travel / {unit}")
    legend_above(figure, axis)
    caption = "Dead zone as given; the ramps were not used."
    if zone.origin == "ramps":
        caption = f"Dead zone from {zone.count} slow ramps, ± its spread: the command at which motion starts."
    elif zone.origin == "tests":
        caption = f"Dead zone from {zone.count} dynamic tests, ± its standard error; the ramps were not used."
    alt = f"Travel of the piston over command on {len(ramps)} ramps; dead zone {value:.4g} {command_unit}."
    return Picture(name, figure, caption, alt, data=data)
