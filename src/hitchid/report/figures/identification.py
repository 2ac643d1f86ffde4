"""Figures of an identification: search, training, structures; parameters, loads, speed map, dead zone."""

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, NullLocator, StrMethodFormatter

from hitchid._support.inert import printable
from hitchid.logs.record import Record
from hitchid.model import Characteristics, Estimate, LoadScatter, SearchSummary
from hitchid.model.plotting import draw_characteristics
from hitchid.model.trace import TracedCandidate, TracedDeadZone, TracedSearch, TracedTraining
from hitchid.plots.style import (
    COLOURS,
    COLUMN_IN,
    FAINT,
    INK,
    decimate,
    finite_or_nan,
    legend_above,
    logarithmic,
    styled,
)
from hitchid.report.document import Picture, sentence
from hitchid.validation.estimate_tables import ESTIMATE_COLUMNS
from hitchid.validation.valve_map import ValveMap

SEARCH_COLOURS = {"whale": "one_step", "differential-evolution": "benchmark", "multi-start": "greybox"}
WRAP = 24  # characters per line of the name of a structure; chosen


@styled
def convergence(name: str, search: TracedSearch, unit: str, caption: str, alt: str) -> Picture:
    """Return best fitness and each parameter over the iterations of the search (paper, Fig. 5 and 6)."""
    parameters = search.parameters
    fitness = finite_or_nan(search.fitness)
    iteration = np.arange(1, fitness.size + 1)
    figure = Figure(figsize=(COLUMN_IN, 0.5 + 0.78 * (1 + len(parameters))))
    axes = np.atleast_1d(figure.subplots(1 + len(parameters), 1, sharex=True))
    axes[0].plot(iteration, fitness, color=COLOURS["benchmark"])
    axes[0].set_ylabel(f"RMSE\n/ {unit}")
    logarithmic(axes[0].yaxis)
    data = {"iteration": iteration, f"rmse_{unit}": search.fitness}
    for axis, parameter, values in zip(axes[1:], parameters, np.array(search.values).T, strict=True):
        data[parameter.name] = values
        axis.plot(iteration, values, color=COLOURS["one_step"], label="best so far")
        axis.axhline(parameter.value, color=INK, linewidth=0.7, linestyle=":", label="after least squares")
        unit_suffix = "" if parameter.unit == "1" else f"\n/ {parameter.unit}"
        axis.set_ylabel(f"{parameter.symbol or parameter.name.replace('_', ' ')}{unit_suffix}")
        if not parameter.linear:
            logarithmic(axis.yaxis)
    legend_above(figure, *axes[1:])
    axes[-1].set_xlabel("iteration")
    figure.align_ylabels()
    return Picture(name, figure, caption, alt, data=data)


@styled
def searches(name: str, results: Sequence[SearchSummary], unit: str) -> Picture:
    """Return the final error of searches from several seeds, and the convergence of the median run."""
    figure = Figure(figsize=(COLUMN_IN, 2.6))
    history_axis, final_axis = figure.subplots(1, 2, sharey=True, width_ratios=[2, 1])
    data = {}
    for index, result in enumerate(results):
        colour = COLOURS[SEARCH_COLOURS.get(result.name, "faint")]
        budget = np.linspace(0, 100, len(result.median_rmse))
        history_axis.plot(budget, finite_or_nan(result.median_rmse), color=colour, label=result.name)
        final_errors = [value for value in result.rmse if value is not None]
        final_axis.plot([index] * len(final_errors), final_errors, "o", color=colour, markersize=3, alpha=0.7)
        data |= {
            f"{result.name}_budget_percent": budget,
            f"{result.name}_median_run_rmse_{unit}": result.median_rmse,
            f"{result.name}_final_rmse_{unit}": result.rmse,
        }
    logarithmic(history_axis.yaxis)
    history_axis.set_xlabel("evaluations used / %")
    history_axis.set_ylabel(f"best RMSE / {unit}")
    final_axis.set_xticks(range(len(results)), [""] * len(results))
    final_axis.set_xlim(-0.6, len(results) - 0.4)
    final_axis.set_xlabel("ends")
    legend_above(figure, history_axis)
    return Picture(
        name,
        figure,
        "Searches with equal evaluations: the median run, and the final error of each seed.",
        f"Best RMSE over the evaluations for {', '.join(result.name for result in results)}.",
        data=data,
    )


@styled
def losses(name: str, training: TracedTraining) -> Picture:
    """Return the loss of the compensator's training on training and validation tests over the epochs."""
    figure = Figure(figsize=(COLUMN_IN, 2.2))
    axis = figure.subplots()
    curves = (
        ("training", training.training_loss, "one_step"),
        ("validation", training.validation_loss, "transfer_function"),
    )
    for subset, loss, colour in curves:
        epochs = np.arange(1, len(loss) + 1)
        axis.plot(epochs, finite_or_nan(loss), color=COLOURS[colour], label=subset)
    axis.axvline(training.best_epoch, color=FAINT, linewidth=0.8, linestyle="--", label="kept")
    logarithmic(axis.yaxis)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel("epoch")
    axis.set_ylabel("loss, errors scaled to 1")
    legend_above(figure, axis, columns=3)
    return Picture(
        name,
        figure,
        "Training of the LSTM correction; the epoch with the smallest validation loss is used.",
        f"Losses over epochs; epoch {training.best_epoch} is used.",
        data={
            "epoch": np.arange(1, max(len(training.training_loss), len(training.validation_loss)) + 1),
            "training_loss": training.training_loss,
            "validation_loss": training.validation_loss,
        },
    )


@styled
def structures(
    name: str, candidates: Sequence[TracedCandidate], unit: str, choice_held_out_rmse: float | None
) -> Picture:
    """Return the compared model specifications: RMSE on all tests, and cross-validated by operating point.

    `choice_held_out_rmse` is on levels that neither fitted nor chose the structure; None where none were.
    """
    labels = [f"{candidate.name}{' (chosen)' if candidate.chosen else ''}" for candidate in candidates]
    labels = [fill(printable(label), WRAP) for label in labels]
    # In rows of two lines, the first on top.
    heights = np.array([max(1.0, (1 + label.count("\n")) / 2) for label in labels])
    row_positions = np.sum(heights) - np.cumsum(heights) + 0.5 * heights
    figure = Figure(figsize=(COLUMN_IN, 0.8 + 0.33 * float(np.sum(heights))))
    axis = figure.subplots()
    rmse = [candidate.rmse for candidate in candidates]
    held_out = [candidate.held_out_rmse for candidate in candidates]
    for values, sign, colour, inside, label in (
        (rmse, "o", INK, "none", "all tests"),
        (held_out, "D", COLOURS["benchmark"], "full", "cross-validation over levels"),
    ):
        axis.plot(
            finite_or_nan(values),
            row_positions,
            sign,
            color=colour,
            fillstyle=inside,
            markersize=4,
            label=label,
        )
    axis.set_yticks(row_positions, labels)
    axis.set_ylim(-0.1, float(np.sum(heights)) + 0.1)
    logarithmic(axis.xaxis)
    axis.set_xlabel(f"RMSE in free run / {unit}")
    legend_above(figure, axis)
    caption = (
        "Free-run RMSE of each structure, on all tests and in cross-validation over levels. A larger "
        "structure is taken where it is significantly better in cross-validation, as shown or with a gain "
        "fitted to each test, which this figure does not include; in the other of the two it must not be "
        "significantly worse. Then parameters go, one after the other, as long as none is missed."
    )
    if choice_held_out_rmse is not None:
        error = f"{choice_held_out_rmse:.4g} {unit}"
        caption += f" On levels that neither fitted nor chose the structure: {error}."
    chosen = next(candidate.name for candidate in candidates if candidate.chosen)
    data = {
        "structure": [candidate.name for candidate in candidates],
        f"rmse_{unit}": rmse,
        f"held_out_rmse_{unit}": held_out,
        f"held_out_rmse_per_test_gain_{unit}": [
            candidate.held_out_rmse_per_test_gain for candidate in candidates
        ],
        "chosen": [candidate.chosen for candidate in candidates],
    }
    alt = f"RMSE of {len(candidates)} structures; chosen: {chosen}."
    return Picture(name, figure, caption, alt, data=data)


# What was identified.

MARGIN = 0.6  # margin of an interval, share of its width; all values chosen
ROW_IN, NAMED_ROWS = 0.16, 48  # height of a test, in; tests whose names fit on a page; chosen
WIDE_RATIO = 5  # ratio of the ends of a logarithmic axis above which its ticks are logarithmic
ONSET_FACTOR = 1.6  # end of a ramp's command axis over the dead zone; chosen


@styled
def intervals(name: str, title: str, estimates: Sequence[Estimate]) -> Picture:
    """Return each parameter with its 95 % interval, one row with its own scale per parameter.

    Open ends are arrows to the edge; the thin line is the bootstrap interval.
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
            column.key: [column.value(estimate) for estimate in estimates]
            for column in ESTIMATE_COLUMNS
            if column.key in ("name", "unit", "value") or "_95_" in column.key
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
    """Return displacement over the command of slow ramps, around the command at which motion begins."""
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
