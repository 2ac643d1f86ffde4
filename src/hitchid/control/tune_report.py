"""Report of a tuned controller: margins, open loop with bands, steps on drawn models."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hitchid._support import numbers
from hitchid._support.tables import DataTable
from hitchid.control.loops import (
    MAX_SENSITIVITY,
    MIN_DEAD_TIMES,
    MIN_GAIN_DB,
    MIN_PHASE_DEG,
    Margins,
)
from hitchid.control.tuning import OpenLoop, TrialRun, Tuning
from hitchid.plots import COLOURS, FAINT, INK, PAGE_IN, legend_above, styled
from hitchid.report import (
    Document,
    Finding,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    command_section,
)

# Figures of a tuned controller: its open loop with what the tests leave open, and steps on drawn models.

HEIGHT_IN = 4.4  # of a figure, inch; chosen
QUANTILES = (0.025, 0.975)  # of the draws: ends of a band of 95 %
COLOUR = {"lifting": COLOURS["one_step"], "lowering": COLOURS["transfer_function"]}
DASH = {"lifting": (None, None), "lowering": (4, 1.5)}


@styled
def bode(loops: Mapping[str, OpenLoop]) -> Figure:
    """Return magnitude and phase of the open loops over frequency, with the band of the draws."""
    figure = Figure(figsize=(PAGE_IN, HEIGHT_IN))
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    for direction, loop in loops.items():
        _band(magnitude, direction, loop, 20 * np.log10(np.abs(loop.response)))
        _band(phase, direction, loop, np.rad2deg(_phase(loop)))
    magnitude.axhline(0.0, color=FAINT, linewidth=0.6)
    phase.axhline(-180.0, color=FAINT, linewidth=0.6)
    magnitude.set_ylim(-60.0, 60.0)
    phase.set_ylim(-360.0, 0.0)
    magnitude.set_ylabel("open loop / dB")
    phase.set_ylabel("phase / °")
    phase.set_xlabel("frequency / Hz")
    legend_above(figure, magnitude, phase, columns=2)
    figure.align_ylabels()
    return figure


@styled
def nichols(loops: Mapping[str, OpenLoop], largest_sensitivity: float) -> Figure:
    """Return magnitude over phase of the open loops, each draw, and the limit of the sensitivity."""
    figure = Figure(figsize=(PAGE_IN, HEIGHT_IN))
    axes = figure.subplots()
    for direction, loop in loops.items():
        phase, size = np.rad2deg(_phase(loop)), 20 * np.log10(np.abs(loop.response))
        colour, dash = COLOUR[direction], DASH[direction]
        axes.plot(phase[1:].T, size[1:].T, color=colour, linewidth=0.3, alpha=0.15)
        axes.plot(phase[0], size[0], color=colour, dashes=dash, linewidth=1.2, label=direction)
    angle = np.linspace(0, 2 * np.pi, 361)
    circle = -1 + np.exp(1j * angle) / largest_sensitivity
    curve = np.rad2deg(np.angle(circle)) % 360 - 360
    axes.plot(
        curve, 20 * np.log10(np.abs(circle)), color=INK, linewidth=0.9, label=f"Ms {largest_sensitivity:g}"
    )
    axes.plot(-180, 0, "+", color=INK)
    axes.set_xlim(-300, -60)
    axes.set_ylim(-30, 30)
    axes.set_xlabel("phase / °")
    axes.set_ylabel("open loop / dB")
    legend_above(figure, axes, columns=3)
    return figure


@styled
def sensitivity(loops: Mapping[str, OpenLoop], largest: float) -> Figure:
    """Return the magnitude of the sensitivity over frequency, with the band of the draws and its limit."""
    figure = Figure(figsize=(PAGE_IN, 0.7 * HEIGHT_IN))
    axes = figure.subplots()
    for direction, loop in loops.items():
        _band(axes, direction, loop, np.abs(1 / (1 + loop.response)))
    axes.axhline(largest, color=INK, linewidth=0.9, label=f"Ms {largest:g}")
    axes.set_ylabel("sensitivity")
    axes.set_xlabel("frequency / Hz")
    legend_above(figure, axes, columns=3)
    return figure


@styled
def step_fan(steps: Sequence[TrialRun], unit: str) -> Figure:
    """Return steps of the controller on models with drawn parameters, loads and noise."""
    figure = Figure(figsize=(PAGE_IN, 0.8 * HEIGHT_IN))
    for axes, step in zip(figure.subplots(1, len(steps), squeeze=False)[0], steps, strict=True):
        axes.plot(step.time_s, step.measured.T, color=COLOURS["greybox"], linewidth=0.5)
        axes.plot(step.time_s, step.target, color=INK, linewidth=0.9, label="target")
        axes.set_xlabel("time / s")
        axes.set_ylabel(f"measured displacement / {unit}")
    return figure


def _phase(loop: OpenLoop) -> Float[np.ndarray, "s f"]:
    """Return the continuous phase, which begins between −360° and 0."""
    phase = np.unwrap(np.angle(loop.response), axis=-1)
    # Without it the draws would lie whole turns apart in one plot.
    return phase - 2 * np.pi * np.ceil(phase[:, :1] / (2 * np.pi))


def _band(axes: Axes, direction: str, loop: OpenLoop, rows: Float[np.ndarray, "s f"]) -> None:
    frequency_hz, colour, dash = loop.omega / (2 * np.pi), COLOUR[direction], DASH[direction]
    lower, upper = np.quantile(rows[1:], QUANTILES, axis=0)
    axes.fill_between(frequency_hz, lower, upper, color=colour, alpha=0.2, linewidth=0)
    axes.semilogx(frequency_hz, rows[0], color=colour, dashes=dash, linewidth=1.2, label=direction)


EXPLANATION = (
    "Worst: met by 95 % of the models with drawn parameters at every one of nine operating points, three "
    "currents by three displacements. The loop is that of the sampled controller with its predictor, open at "
    "the measurement, the dead time exact."
)


def tune_report(result: Tuning, *, command: str = "") -> Document:
    """Return the report of a tuned controller, with the command line that wrote it."""
    rows = tuple((method, f"{error:.2f}") for method, error in result.trials.items())
    title = f"IAE on drawn models, geometric mean of steps and ramps, {result.units['displacement']}·s"
    trials = Table(title, ("method", "mean"), rows)
    return Document(
        title="Position controller",
        subtitle=f"{result.method} control; {numbers.count(result.draws, 'draw')} of the parameters",
        verdict=tuple(
            Finding(
                Rating.GOOD if own.passed else Rating.BAD,
                f"{direction.capitalize()}: gain margin {own.worst.gain_db:.1f} dB, phase margin "
                f"{own.worst.phase_deg:.0f}°, Ms {own.worst.sensitivity:.2f}, delay margin "
                f"{1e3 * own.worst.delay_s:.0f} ms in 95 % of the draws.",
            )
            for direction, own in result.margins.items()
        ),
        sections=(
            ReportSection("Margins", (Text(EXPLANATION), _margin_table(result))),
            ReportSection("Gains", (_gain_table(result), trials)),
            ReportSection("Figures", (Pictures(tuple(_pictures(result))),)),
            command_section(command),
        ),
        data_tables={"open_loop": DataTable.of_columns("open_loop", _columns(result.loops))},
    )


def _margin_table(result: Tuning) -> Table:
    header = ["margin", "required"]
    for direction in result.margins:
        header += [f"{direction}: model", f"{direction}: worst"]
    margins = result.margins.values()
    delays = " and ".join(f"{1e3 * MIN_DEAD_TIMES * own.dead_time_s:.0f}" for own in margins)
    rows = (
        _row("gain margin / dB", f"≥ {MIN_GAIN_DB:g}", result, lambda m: f"{m.gain_db:.1f}"),
        _row("phase margin / °", f"≥ {MIN_PHASE_DEG:g}", result, lambda m: f"{m.phase_deg:.0f}"),
        _row("Ms", f"≤ {MAX_SENSITIVITY:g}", result, lambda m: f"{m.sensitivity:.2f}"),
        _row("delay margin / ms", f"≥ {delays}", result, lambda m: f"{1e3 * m.delay_s:.0f}"),
        _row("disk margin", "", result, lambda m: f"{m.disk:.2f}"),
    )
    return Table("Margins", tuple(header), rows)


def _row(name: str, required: str, result: Tuning, text: Callable[[Margins], str]) -> tuple[str, ...]:
    cells = [text(margins) for own in result.margins.values() for margins in (own.nominal, own.worst)]
    return name, required, *cells


def _gain_table(result: Tuning) -> Table:
    header = ("direction", "k_p / 1/s", "k_i / 1/s²", "k_v", "k_a / s", "lag τ / s")
    controller = result.controller
    rows = tuple(
        (direction, *(f"{float(gain):.3g}" for gain in gains), f"{float(lag_s):.3g}")
        for direction, gains, lag_s in zip(result.margins, controller.gains, controller.lags_s, strict=True)
    )
    return Table("Gains", header, rows)


def _pictures(result: Tuning) -> list[Picture]:
    return [
        Picture(
            "bode",
            bode(result.loops),
            "Open loop in the middle of the operating points, with the band of 95 % of the draws.",
            "Bode plot of the open loops of lifting and lowering.",
            data=_columns(result.loops),
        ),
        Picture(
            "nichols",
            nichols(result.loops, MAX_SENSITIVITY),
            "Open loop of the model and of each draw; they keep outside of the closed curve.",
            "Nichols plot of the open loops with the curve of the largest sensitivity.",
        ),
        Picture(
            "sensitivity",
            sensitivity(result.loops, MAX_SENSITIVITY),
            "Sensitivity 1/(1 + L), with the band of 95 % of the draws.",
            "Magnitude of the sensitivity over frequency.",
        ),
        Picture(
            "steps",
            step_fan(result.steps, result.units["displacement"]),
            "Steps on models with drawn parameters, loads and sensor noise.",
            "Measured displacement of steps up and down on drawn models.",
        ),
    ]


def _columns(loops: Mapping[str, OpenLoop]) -> dict[str, np.ndarray]:
    columns = {}
    for direction, loop in loops.items():
        columns["frequency_hz"] = loop.omega / (2 * np.pi)
        columns[f"{direction}_real"] = loop.response[0].real
        columns[f"{direction}_imag"] = loop.response[0].imag
    return columns
