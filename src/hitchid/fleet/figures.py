"""Figures of a fleet: machines with intervals, their scatter, the map of verdicts, speed over command."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hitchid._support.inert import printable
from hitchid.fleet.comparison import FleetComparison
from hitchid.fleet.parameters import DEAD_ZONE, GAIN, FleetParameter
from hitchid.plots import COLOURS, COMPARED, FAINT, GRID, INK, PAGE_IN, legend_above, logarithmic, styled

# Machines of a fleet beside each other: intervals, ellipses of errors, verdicts, speed over command.

LOWER, ALIKE, HIGHER, ABSENT, FAILED = -1, 0, 1, 2, 3
"""Verdicts on one parameter of one machine: beside the others, not compared, not identified."""
VERDICTS = {
    HIGHER: ("higher than the others", "^", COLOURS["benchmark"], 28.0),
    LOWER: ("lower than the others", "v", COLOURS["one_step"], 28.0),
    ALIKE: ("like the others", "o", FAINT, 5.0),
    ABSENT: ("not compared", "_", FAINT, 12.0),
    FAILED: ("not identified", "x", INK, 14.0),
}
"""Verdict to its label, marker, colour and area in points²: distinguished without colours, too."""
INTERVAL_WIDTH, POINT_SIZE = 0.9, 3.0  # of a machine's interval and its value, points; chosen
OUTER, INNER = (0.025, 0.975), (0.25, 0.75)  # quantiles of the machines that are drawn as one row
CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 73)), np.sin(np.linspace(0, 2 * np.pi, 73))])
RADIUS = float(np.sqrt(-2 * np.log(0.05)))  # of the ellipse that contains 95 % of a normal distribution
LINE_WIDTH = 0.6  # of the speed of one of many machines, points; chosen
OPAQUE_LINES, LEAST_ALPHA = 10, 0.2  # lines that are drawn opaque, and the opacity of one of many; chosen
STYLES = tuple(COMPARED.values())  # of machines that are pointed out; further ones are drawn alike
FURTHER = ("ink", (1.0, 1.0), "")
NAME_SHARE = (0.35, 0.06)  # width and height of a name, shares of the axes; chosen: no name covers another


def draw_machine_intervals(
    axes: Axes,
    values: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    verdicts: Int[np.ndarray, " n"],
) -> None:
    """Draw the value of each machine with its interval, the first one at the top; NaN where missing."""
    rows = np.arange(len(values))
    # Those that stand out last, on top of the others.
    for verdict in (ALIKE, LOWER, HIGHER):
        _, marker, colour, _ = VERDICTS[verdict]
        outlying = verdict in (LOWER, HIGHER)
        of_it = verdicts == verdict if outlying else ~np.isin(verdicts, (LOWER, HIGHER))
        shade = colour if outlying else INK
        axes.hlines(rows[of_it], lower[of_it], upper[of_it], color=shade, linewidth=INTERVAL_WIDTH)
        size = POINT_SIZE * (1.6 if outlying else 1.0)
        axes.plot(values[of_it], rows[of_it], marker, color=shade, markersize=size, linestyle="none")


def draw_quantiles(axes: Axes, values: Float[np.ndarray, " n"], row: int) -> None:
    """Draw 95 % and half of some values as a thin and a thick line, and their median, in one row."""
    present = values[~np.isnan(values)]
    if not present.size:
        return
    (low, high), (first, third) = np.quantile(present, OUTER), np.quantile(present, INNER)
    axes.hlines([row], low, high, color=INK, linewidth=INTERVAL_WIDTH)
    axes.hlines([row], first, third, color=INK, linewidth=4 * INTERVAL_WIDTH)
    axes.plot([np.median(present)], [row], "|", color=INK, markersize=9)


def ellipse(
    centre: Float[np.ndarray, " 2"], covariance: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "2 k"]:
    """Return the curve that contains 95 % of a normal distribution, which may have no spread in an axis."""
    spread, axes = np.linalg.eigh(covariance)
    return centre[:, None] + axes @ (RADIUS * np.sqrt(np.maximum(spread, 0.0))[:, None] * CIRCLE)


def draw_machine_points(
    axes: Axes,
    x: Float[np.ndarray, " n"],
    y: Float[np.ndarray, " n"],
    outlying: Bool[np.ndarray, " n"],
    names: Sequence[str],
) -> None:
    """Draw a point for each machine; those that stand out are diamonds with their name.

    Of names that would cover each other the first one is written.
    """
    for of_it, marker, colour, size, label in (
        (~outlying, "o", FAINT, 2.5, "machine"),
        (outlying, "D", COLOURS["benchmark"], 3.5, "stands out"),
    ):
        if of_it.any():
            axes.plot(x[of_it], y[of_it], marker, color=colour, markersize=size, label=label)
    scaled = np.stack([x / (np.ptp(x) or 1.0), y / (np.ptp(y) or 1.0)])
    written: list[int] = []
    for index in [index for index, name in enumerate(names) if name]:
        distances = np.abs(scaled[:, written] - scaled[:, [index]])
        if not np.any(np.all(distances < np.array(NAME_SHARE)[:, None], axis=0)):
            written.append(index)
            at = (x[index], y[index])
            axes.annotate(names[index], at, xytext=(4, 3), textcoords="offset points", fontsize=6.5)


MOST_ROWS = 60  # machines that are drawn one by one; of more, those that stand out; chosen
MOST_POINTS = 1000  # machines like the others in a scatter, and lines of speeds; chosen: size of the page
ROW_IN, MARGIN_IN, LEAST_IN = 0.15, 0.75, 1.5  # height of a machine, of labels, of the whole, inch; chosen
PANEL_IN = 3.4  # height of scatter and speeds, inch; chosen
NAME_LENGTH = 26  # characters of a name; longer ones lose their middle; chosen
COMMAND_FACTOR = 3.0  # end of the command's axis over the median dead zone; chosen
HALF_WIDTH = 1.96  # of a 95 % interval, in standard errors


def short_name(name: str) -> str:
    """Return a name of at most 26 characters, without its middle if it is longer."""
    half, shown = NAME_LENGTH // 2, printable(name)
    return shown if len(shown) <= NAME_LENGTH else f"{shown[: half - 1]}…{shown[-half:]}"


def shown_machines(comparison: FleetComparison) -> tuple[list[int], list[int]]:
    """Return the machines that are drawn one by one, those that stand out first, and the others."""
    first = list(dict.fromkeys(machine for machine, _ in comparison.outliers.ranking))
    others = [machine for machine in range(len(comparison.machines)) if machine not in set(first)]
    if len(comparison.machines) <= MOST_ROWS:
        return first + others, []
    # More rows cannot be read on a page; the others are drawn as quantiles.
    return first[:MOST_ROWS], first[MOST_ROWS:] + others


def verdict_codes(comparison: FleetComparison) -> Int[np.ndarray, "n p"]:
    """Return the verdict on each parameter of each machine."""
    outliers = comparison.outliers
    signed = np.where(outliers.deviation > 0, HIGHER, LOWER)
    codes = np.where(outliers.named, signed, ALIKE)
    return np.where(np.isnan(outliers.p_value), ABSENT, codes)


def axis_label(parameter: FleetParameter) -> str:
    """Return name and unit of a parameter."""
    unit = parameter.unit
    return f"{parameter.name} / {f'({unit})' if '/' in unit else unit}"


@styled
def forest(comparison: FleetComparison, direction: str) -> Figure:
    """Return each parameter of each machine with its 95 % interval, beside the distribution over machines.

    Line and bands are mean, its 95 % interval and the 95 % prediction interval. Of more than sixty machines
    those that stand out are drawn, and the quantiles of the others.
    """
    shown, others = shown_machines(comparison)
    parameters, codes = comparison.parameters, verdict_codes(comparison)
    columns = [index for index, parameter in enumerate(parameters) if parameter.direction == direction]
    rows = len(shown) + bool(others)
    figure = Figure(figsize=(PAGE_IN, max(LEAST_IN, MARGIN_IN + ROW_IN * rows)))
    panels = np.atleast_1d(figure.subplots(1, len(columns), sharey=True))
    for axes, column in zip(panels, columns, strict=True):
        parameter, population = parameters[column], comparison.populations[column]
        estimates = comparison.estimates[shown, column]
        half_width = HALF_WIDTH * np.sqrt(comparison.covariances[shown, column, column])
        limits = (estimates, estimates - half_width, estimates + half_width)
        values, lower, upper = map(parameter.value, limits)
        if not np.isnan(population.mean):
            of_mean, of_another = (
                parameter.value(np.array(ends))
                for ends in (population.mean_interval, population.prediction_interval)
            )
            axes.axvspan(*of_another, color=GRID, alpha=0.6, linewidth=0, zorder=0)
            axes.axvspan(*of_mean, color=FAINT, alpha=0.45, linewidth=0, zorder=0.1)
            axes.axvline(float(parameter.value(population.mean)), color=INK, linewidth=0.7, zorder=0.2)
        draw_machine_intervals(axes, values, lower, upper, codes[shown, column])
        if others:
            draw_quantiles(axes, parameter.value(comparison.estimates[others, column]), len(shown))
        axes.set_xlabel(axis_label(parameter))
        axes.xaxis.set_major_locator(MaxNLocator(3))
        axes.grid(visible=False, axis="y")
        axes.tick_params(axis="y", length=0)
    labels = [short_name(comparison.machines[machine]) for machine in shown]
    labels += [f"the other {len(others)}"] if others else []
    panels[0].set_yticks(range(rows), labels, fontsize=6.5)
    panels[0].set_ylim(rows - 0.4, -0.6)
    return figure


@styled
def scatter(comparison: FleetComparison) -> Figure:
    """Return gain over dead zone of the machines of each direction in which one has both, with ellipses.

    Thin ellipses are of the errors, of more than sixty machines only of those that stand out; the wide one
    is of the distribution over machines; 95 % of both.
    """
    directions = directions_with_both(comparison)
    figure = Figure(figsize=(PAGE_IN, PANEL_IN))
    panels = np.atleast_1d(figure.subplots(1, len(directions)))
    for axes, direction in zip(panels, directions, strict=True):
        columns, machines = np.array(_columns(comparison, direction)), _with_both(comparison, direction)
        outlying = np.any(comparison.outliers.named[machines][:, columns], axis=1)
        points = comparison.estimates[machines][:, columns]
        with_ellipse = outlying if machines.size > MOST_ROWS else np.ones(machines.size, bool)
        errors = comparison.covariances[machines][:, columns[:, None], columns]
        curves = [
            _in_units(ellipse(point, error)).T
            for point, error in zip(points[with_ellipse], errors[with_ellipse], strict=True)
        ]
        axes.add_collection(LineCollection(curves, colors=COLOURS["one_step"], linewidths=0.4))
        axes.autoscale_view()
        names = [
            short_name(comparison.machines[machine]) if stands_out else ""
            for machine, stands_out in zip(machines, outlying, strict=True)
        ]
        dead_zones, gains = _in_units(points.T)
        draw_machine_points(axes, dead_zones, gains, outlying, names)
        of_model, fit = comparison.hierarchies.get(direction, ((), None))
        if fit is not None and set(columns.tolist()) <= set(of_model):
            places = np.array([of_model.index(column) for column in columns])
            covariance = (fit.between + fit.mean_covariance)[places[:, None], places]
            curve = _in_units(ellipse(fit.mean[places], covariance))
            axes.plot(*curve, color=INK, linewidth=1.2, label="95 % of the machines")
        logarithmic(axes.yaxis)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        for set_label, column in zip((axes.set_xlabel, axes.set_ylabel), columns, strict=True):
            set_label(axis_label(comparison.parameters[column]))
        axes.set_title(direction, loc="left")
    legend_above(figure, *panels, columns=3)
    return figure


def directions_with_both(comparison: FleetComparison) -> list[str]:
    """Return the directions in which a machine has both gain and dead zone."""
    return [direction for direction in comparison.kinds if _with_both(comparison, direction).size]


def _columns(comparison: FleetComparison, direction: str) -> list[int]:
    """Return the indices of dead zone and gain."""
    columns = (comparison.column(direction, name) for name in (DEAD_ZONE, GAIN))
    return [column for column in columns if column is not None]


def _with_both(comparison: FleetComparison, direction: str) -> np.ndarray:
    """Return the machines with gain and dead zone in a direction; of very many like the others, some."""
    columns = _columns(comparison, direction)
    if len(columns) < 2:
        return np.zeros(0, int)
    has_both = ~np.isnan(comparison.estimates[:, columns]).any(axis=1)
    outlying = np.any(comparison.outliers.named[:, columns], axis=1)
    alike = np.flatnonzero(has_both & ~outlying)
    # Each k-th, not a random choice: equal comparisons give equal pictures.
    every = max(1, -(-alike.size // MOST_POINTS))
    return np.sort(np.concatenate([np.flatnonzero(has_both & outlying), alike[::every]]))


def _in_units(curve: np.ndarray) -> np.ndarray:
    """Return dead zones and gains of dead zones and logarithms of gains, shape [2, K]."""
    return np.stack([curve[0], np.exp(curve[1])])


@styled
def verdicts(comparison: FleetComparison) -> Figure:
    """Return the verdict on each parameter of each machine.

    Machines that could not be identified are the last rows; of more than sixty, those that stand out alone.
    At least one has to be shown.
    """
    names, codes = verdict_rows(comparison)
    figure = Figure(figsize=(PAGE_IN, max(LEAST_IN, 1.2 * MARGIN_IN + ROW_IN * len(names))))
    axes = figure.subplots()
    for verdict, (label, marker, colour, area) in VERDICTS.items():
        rows, columns = np.nonzero(codes == verdict)
        if rows.size:
            axes.scatter(columns, rows, s=area, marker=marker, color=colour, label=label, linewidths=1.0)
    axes.set_xlim(-0.5, codes.shape[1] - 0.5)
    axes.set_ylim(codes.shape[0] - 0.5, -0.5)  # the first machine at the top
    labels = [f"{parameter.direction}\n{parameter.name}" for parameter in comparison.parameters]
    axes.set_xticks(range(len(labels)), labels, fontsize=6.5)
    axes.set_yticks(range(len(names)), [short_name(name) for name in names], fontsize=6.5)
    axes.tick_params(length=0)
    legend_above(figure, axes, columns=5)
    return figure


def verdict_rows(comparison: FleetComparison) -> tuple[list[str], Int[np.ndarray, "n p"]]:
    """Return the machines on the map of verdicts and their verdicts."""
    failed = [row.machine for row in comparison.failed]
    if len(comparison.machines) + len(failed) > MOST_ROWS:
        failed = []  # the report lists them by cause
    shown = shown_machines(comparison)[0]
    identified = verdict_codes(comparison)[shown]
    absent = np.full((len(failed), len(comparison.parameters)), FAILED)
    names = [*(comparison.machines[machine] for machine in shown), *failed]
    return names, np.concatenate([identified, absent])


@styled
def speed_fan(comparison: FleetComparison) -> Figure:
    """Return steady speed over command of all machines, with those that stand out in gain or dead zone.

    speed = gain · (command − dead zone): what nonlinearities of the structure add is left out. A machine has
    both in a direction at least.
    """
    directions = directions_with_both(comparison)
    figure = Figure(figsize=(PAGE_IN, PANEL_IN))
    panels = np.atleast_1d(figure.subplots(1, len(directions)))
    for axes, direction in zip(panels, directions, strict=True):
        _fan_panel(axes, comparison, direction)
    ranked = [short_name(comparison.machines[machine]) for machine in _ranked_by_speed(comparison)]
    legend_above(figure, *panels, columns=3, order=["all machines", *ranked])
    return figure


def _fan_panel(axes: Axes, comparison: FleetComparison, direction: str) -> None:
    columns, machines = _columns(comparison, direction), _with_both(comparison, direction)
    dead_zones, gains = _in_units(comparison.estimates[machines][:, columns].T)
    median = float(np.median(dead_zones))
    highest = COMMAND_FACTOR * median if median > 0 else 1.0

    def line(gain: float, dead_zone: float) -> list[tuple[float, float]]:
        # A dead zone beyond the axis must not give a line that runs back.
        end = max(highest, dead_zone)
        return [(0.0, 0.0), (dead_zone, 0.0), (end, gain * (end - dead_zone))]

    many = [line(*pair) for pair in zip(gains.tolist(), dead_zones.tolist(), strict=True)]
    # Fainter where there are more, so that a thousand lines are no area.
    opacity = float(np.clip(OPAQUE_LINES / max(1, len(many)), LEAST_ALPHA, 1.0))
    axes.add_collection(
        LineCollection(many, colors=FAINT, linewidths=LINE_WIDTH, alpha=opacity, label="all machines")
    )
    named = np.any(comparison.outliers.named[:, columns], axis=1)
    for style, machine in enumerate(_ranked_by_speed(comparison)):
        dead_zone, gain = _in_units(comparison.estimates[machine, columns][:, None])[:, 0]
        if named[machine] and np.isfinite(dead_zone + gain):
            is_further = style >= len(STYLES)  # more than one can tell apart
            colour, dashes, _ = FURTHER if is_further else STYLES[style]
            name = short_name(comparison.machines[machine])
            label = "further ones that stand out" if is_further else name
            x, y = zip(*line(gain, dead_zone), strict=True)
            axes.plot(x, y, color=COLOURS[colour], dashes=dashes, label=label)
    axes.autoscale_view()
    axes.set_xlim(0.0, highest)
    axes.set_ylim(bottom=0.0)
    kind = comparison.kinds[direction]
    axes.set_xlabel(f"{direction} command / {kind.command_unit}")
    axes.set_ylabel(f"speed / ({kind.speed_unit})")


def _ranked_by_speed(comparison: FleetComparison) -> list[int]:
    """Return the machines that stand out in gain or dead zone of a direction, smallest p-value first."""
    ranking = comparison.outliers.ranking
    of_speed = (row for row, column in ranking if comparison.parameters[column].name in (GAIN, DEAD_ZONE))
    return list(dict.fromkeys(of_speed))
