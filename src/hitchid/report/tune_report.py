"""Report of a tuned controller: margins, open loop with bands, steps on drawn models."""

from collections.abc import Callable, Mapping

import numpy as np

from hitchid._support.data_table import DataTable
from hitchid.control import DirectionMargins, Margins, OpenLoop, Tuning
from hitchid.control.direction_loops import MAX_SENSITIVITY, MIN_DEAD_TIMES, MIN_GAIN_DB, MIN_PHASE_DEG
from hitchid.report import numbers
from hitchid.report.document import Document, Finding, Picture, Pictures, Rating, ReportSection, Table, Text
from hitchid.report.figures import open_loop

EXPLANATION = (
    "Worst: met by 95 % of the models with drawn parameters at every one of nine operating points, three "
    "currents by three displacements. The loop is that of the sampled controller with its predictor, open at "
    "the measurement, the dead time exact."
)


def tune_report(result: Tuning, *, command: str = "") -> Document:
    """Return the report of a tuned controller.

    Args:
        result: of `tune`.
        command: the command line that wrote the report.
    """
    return Document(
        title="Position controller",
        subtitle=f"{result.method} control; {numbers.count(result.draws, 'draw')} of the parameters",
        verdict=tuple(_finding(direction, own) for direction, own in result.margins.items()),
        sections=(
            ReportSection("Margins", (Text(EXPLANATION), _margin_table(result))),
            ReportSection("Gains", (_gain_table(result), _trial_table(result))),
            ReportSection("Figures", (Pictures(tuple(_pictures(result))),)),
            ReportSection("How to reproduce", (Table("Origin", ("what", "value"), (("command", command),)),)),
        ),
        data_tables={"open_loop": _loop_table(result)},
    )


def _finding(direction: str, own: DirectionMargins) -> Finding:
    worst = own.worst
    text = (
        f"{direction}: gain margin {worst.gain_db:.1f} dB, phase margin {worst.phase_deg:.0f}°, "
        f"Ms {worst.sensitivity:.2f}, delay margin {1e3 * worst.delay_s:.0f} ms in 95 % of the draws."
    )
    return Finding(Rating.GOOD if own.passed else Rating.BAD, text[0].upper() + text[1:])


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


def _trial_table(result: Tuning) -> Table:
    rows = tuple((method, f"{error:.2f}") for method, error in result.trials.items())
    title = f"IAE on drawn models, geometric mean of steps and ramps, {result.units['displacement']}·s"
    return Table(title, ("method", "mean"), rows)


def _pictures(result: Tuning) -> list[Picture]:
    return [
        Picture(
            "bode",
            open_loop.bode(result.loops),
            "Open loop in the middle of the operating points, with the band of 95 % of the draws.",
            "Bode plot of the open loops of lifting and lowering.",
            data=_columns(result.loops),
        ),
        Picture(
            "nichols",
            open_loop.nichols(result.loops, MAX_SENSITIVITY),
            "Open loop of the model and of each draw; they keep outside of the closed curve.",
            "Nichols plot of the open loops with the curve of the largest sensitivity.",
        ),
        Picture(
            "sensitivity",
            open_loop.sensitivity(result.loops, MAX_SENSITIVITY),
            "Sensitivity 1/(1 + L), with the band of 95 % of the draws.",
            "Magnitude of the sensitivity over frequency.",
        ),
        Picture(
            "steps",
            open_loop.step_fan(result.steps, result.units["displacement"]),
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


def _loop_table(result: Tuning) -> DataTable:
    return DataTable.of_columns("open_loop", _columns(result.loops))
