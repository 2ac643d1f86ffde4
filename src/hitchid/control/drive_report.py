"""Acceptance limits and report of closed loops on the virtual bench."""

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hitchid._support import checks, numbers
from hitchid._support.tables import Column, RecordTable
from hitchid.control.closed_loop import ClosedLoops
from hitchid.control.drive import BASELINE, TESTED, Drive, Figures
from hitchid.control.prediction import Band
from hitchid.control.scenarios import COMPENSATED, Kind, Scenario
from hitchid.errors import SettingsError
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
    limits_section,
    sentence,
    worst_first,
)
from hitchid.validation import Acceptance, Check

# Acceptance limits of a drive, from a file: at most what its metrics may be.

AT_LEAST = ("band.inside",)  # figures with a lower limit


def read_drive_limits(path: str | Path) -> dict[str, float]:
    """Return the limits of a file by name, such as `steps.100.overshoot`.

    The tables of the file are those of `metrics.json`; every number is the largest that is accepted, of
    `band.inside` the smallest.

    Raises:
        SettingsError: the file is missing, no TOML, empty, or holds something that is not a number.
    """
    file = checks.path(path, "path")
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read: {error.strerror}; expected a TOML file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{file}: is not TOML: {error}") from error
    limits = {}
    for name, value in _flat(content):
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise SettingsError(f"{file}: {name}: got {value!r}, expected a finite number")
        limits[name] = float(value)
    if not limits:
        raise SettingsError(f"{file}: has no limit; expected one such as iae_ratio = 0.6")
    return limits


def check_drive(metrics: Mapping[str, object], limits: Mapping[str, float]) -> Acceptance:
    """Compare the metrics of a drive with limits; a figure that is missing fails its limit.

    Raises:
        SettingsError: a limit has the name of no figure.
    """
    figures = {name: value for name, value in _flat(metrics) if not isinstance(value, str)}  # but units
    made = []
    for name, limit in limits.items():
        if name not in figures:  # misspelt: it must not pass as a limit that is met
            listed = ", ".join(sorted(figures))
            raise SettingsError(f"limits: there is no figure '{name}'; expected one of {listed}")
        value = figures[name]
        bound = "at least" if name in AT_LEAST else "at most"
        passed = value is not None and (value >= limit if name in AT_LEAST else value <= limit)
        figure = "missing: never settled, or not predicted" if value is None else f"{float(value):.4g}"
        made.append(Check("closed loop", name, f"{bound} {limit:g}", figure, bool(passed)))
    return Acceptance(tuple(made))


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables with their path, such as `steps.100.overshoot`."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


# Figures of closed loops: displacement, its error and the currents over time; the margins' loops.

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
        # One line of the legend for all loops.
        label = "controller" if number == 0 else None
        displacement.plot(time_s, own, color=COLOURS["greybox"], linewidth=0.6, label=label)
        error.plot(time_s, own - target, color=COLOURS["greybox"], linewidth=0.6)
    for axes, offset, label in ((displacement, 0.0, baseline_name), (error, target, None)):
        axes.plot(
            time_s,
            baseline.displacement[0] - offset,
            color=COLOURS["benchmark"],
            dashes=(4, 1.5),
            linewidth=0.9,
            label=label,
        )
    displacement.plot(time_s, target, color=INK, linewidth=0.9, label="target")
    for number, (name, colour) in enumerate((("lifting", "one_step"), ("lowering", "transfer_function"))):
        commands, label = loops.commands[0, :, number], f"{name} current"
        current.plot(time_s, commands, color=COLOURS[colour], linewidth=0.8, label=label)
    error.axhline(0.0, color=FAINT, linewidth=0.6)
    # The approach is in the panel above; here the tolerance is to be seen.
    widest = 1.5 * scenario.tolerance
    if not scenario.amplitude:
        beyond = np.abs(loops.displacement[:SHOWN, scenario.begin :] - target[scenario.begin :])
        widest = max(1.3 * float(beyond.max()), 0.1 * scenario.tolerance)
    error.set_ylim(-widest, widest)
    displacement.set_ylabel(f"displacement / {units[0]}")
    error.set_ylabel(f"error / {units[0]}")
    current.set_ylabel(f"command / {units[1]}")
    current.set_xlabel("time / s")
    legend_above(figure, displacement, error, current, columns=6)
    figure.align_ylabels()
    return figure


MARGIN_ROWS = {
    "gain_dB": ("gain margin", "dB"),
    "phase_deg": ("phase margin", "°"),
    "delay_s": ("delay margin", "s"),
    "sensitivity": ("Ms", ""),
    "disk": ("disk margin", ""),
}
HELD_ACTIONS = 1.0  # valve actions in 10 s that a held hitch may cost


def drive_report(
    result: Drive,
    *,
    rig: str,
    margins: Mapping[str, Mapping[str, float]],
    acceptance: Acceptance | None = None,
    notices: tuple[str, ...] = (),
    command: str = "",
) -> Document:
    """Return the report of closed loops on a bench or plant, `margins` being those of the controller file."""
    unit, names = result.unit, tuple(result.figures)
    figures = _figure_table(result, TESTED)
    margin_rows = tuple(
        (f"{title} / {limit_unit}" if limit_unit else title, *(f"{own[key]:.3g}" for own in margins.values()))
        for key, (title, limit_unit) in MARGIN_ROWS.items()
    )
    areas = tuple(
        (scenario, *(f"{result.figures[name][scenario].iae:.2f}" for name in names))
        for scenario in result.scenarios
    )
    ratios = tuple((kind, f"{ratio:.2f}") for kind, ratio in result.iae_ratios.items())
    beside = (
        Table(f"IAE in {unit}·s, mean of the loops", ("scenario", *names), areas),
        Table(f"IAE over that of {BASELINE}, geometric means", ("scenarios", "ratio"), ratios),
    )
    pictures = tuple(_picture(result, name, scenario) for name, scenario in result.scenarios.items())
    loops = numbers.count(result.draws, "loop")
    return Document(
        title="Closed loops",
        subtitle=f"{rig}; {loops} of each scenario, with drawn load and noise",
        verdict=drive_verdict(result, acceptance),
        notices=tuple(map(sentence, notices)),
        sections=(
            *([] if acceptance is None else [limits_section(acceptance)]),
            ReportSection("Figures", (Text(EXPLANATION), figures.shown())),
            ReportSection("Beside the baselines", beside),
            ReportSection("Margins", (Text(MARGINS), Table("Margins", ("margin", *margins), margin_rows))),
            ReportSection("Scenarios", (Pictures(pictures),)),
            command_section(command),
        ),
        summary=(_summary(figures),),
        checks=() if acceptance is None else acceptance.checks,
        data=result.metrics,
        data_tables={name: _figure_table(result, name).data() for name in result.figures},
    )


EXPLANATION = (
    "Every figure is the worst of 95 % of the loops, the IAE their mean. A step has settled when the "
    "displacement stays within 0.8 % of the stroke (smallest step: 0.4 %) of its end; the least "
    "time is that of the bench at the largest current of the identification tests. The final error is the "
    "distance of the mean measured displacement of the last second to the target."
)
MARGINS = (
    "Margins that 95 % of the models with drawn parameters keep at nine operating points, as written by "
    "`hitchid tune`. They hold for errors of the parameters, not for dynamics that the model does not have."
)


def drive_verdict(result: Drive, acceptance: Acceptance | None = None) -> tuple[Finding, ...]:
    """Return what the tables of the report mean, the worst first.

    Bad is a limit that failed, a loop that diverged, both valves on, and a step that does not settle or ends
    outside its tolerance. A caution is a run with a larger IAE than SIMC PI with its dead zone compensated,
    a held hitch with more than one valve action in ten seconds, and a bench outside the predicted band.
    """
    own, rival = result.figures[TESTED], result.figures[COMPENSATED]
    findings: list[Finding] = []

    def judge(is_good: bool, text: str, otherwise: Rating = Rating.CAUTION) -> None:
        findings.append(Finding(Rating.GOOD if is_good else otherwise, text))

    if acceptance is not None:
        failed, count = (
            [check.name for check in acceptance.checks if not check.passed],
            len(acceptance.checks),
        )
        text = f"{len(failed)} of {count} limits failed: {', '.join(failed)}."
        judge(not failed, text if failed else f"All {count} limits are met.", Rating.BAD)
    diverged = sum(figures.diverged for figures in own.values())
    both = sum(figures.both_valves_samples for figures in own.values())
    judge(not diverged, f"{diverged} loops diverged.", Rating.BAD)
    judge(not both, f"Both valves were on in {both} samples.", Rating.BAD)
    steps = {name: scenario for name, scenario in result.scenarios.items() if scenario.amplitude}
    restless = [name for name in steps if own[name].settling_s == np.inf]
    final = {name: own[name].final_error for name in steps}
    off = [name for name, scenario in steps.items() if not final[name] <= scenario.tolerance]
    if restless:
        judge(False, f"Never settled: {'; '.join(restless)}.", Rating.BAD)
    if off:
        worst = max(off, key=lambda name: final[name])
        text = f"{numbers.count(len(off), 'step')} of {len(steps)} end outside the tolerance, the farthest"
        judge(False, f"{text} {final[worst]:.1f} {result.unit} off: {worst}.", Rating.BAD)
    if not restless and not off:
        judge(True, f"All {len(steps)} steps settle and end within the tolerance.")
    ratios = {
        name: own[name].iae / rival[name].iae
        for name, scenario in result.scenarios.items()
        if scenario.kind is not Kind.HOLD
    }
    slower = [name for name, ratio in ratios.items() if not ratio <= 1]
    if slower:
        worst = max(slower, key=lambda name: ratios[name])
        text = f"The IAE of {len(slower)} of {len(ratios)} runs is larger than that of {COMPENSATED}"
        judge(False, f"{text}, the most in {worst}: {ratios[worst]:.2f} times.")
    elif ratios:
        judge(True, f"The IAE of each run is at most {max(ratios.values()):.2f} times that of {COMPENSATED}.")
    for name, scenario in result.scenarios.items():
        if scenario.kind is Kind.HOLD:
            actions = own[name].valve_actions_per_10_s
            judge(actions <= HELD_ACTIONS, f"A held hitch costs {actions:.1f} valve actions in 10 s.")
    ratio = result.iae_ratios["all"]
    judge(ratio < 1, f"The IAE is {ratio:.2f} times that of {BASELINE}, mean of steps, ramps and sine.")
    inside = result.inside_band
    if inside:
        share = sum(inside.values()) / len(inside)
        text = f"{100 * share:.0f} % of the loops are inside the band that the identified model predicts."
        judge(share >= 0.85, text)
    return worst_first(findings)


def _figure_table(result: Drive, controller: str) -> RecordTable:
    """Return the figures of a controller in each scenario."""
    unit, least_times_s = result.unit, result.least_times_s

    def named(record: tuple[str, Figures]) -> str:
        name, _ = record
        return f"{name} (least {least_times_s[name]:.2f} s)" if name in least_times_s else name

    def figure(name: str, key: str, label: str = "", text: Callable[[Any], str] = _cell) -> Column:
        def value(record: tuple[str, Figures]) -> float | int | None:
            return getattr(record[1], name)

        return Column(key, label, value, lambda record: text(value(record)))

    columns = (
        Column("scenario", "scenario", itemgetter(0), named),
        figure("iae", f"iae_{unit}_s", f"IAE / {unit}·s", "{:.2f}".format),
        figure("rmse", f"rmse_{unit}", f"RMSE / {unit}", "{:.2f}".format),
        figure("overshoot", f"overshoot_{unit}", f"overshoot / {unit}"),
        figure("settling_s", "settling_s", "settling / s"),
        figure("final_error", f"final_error_{unit}", f"final error / {unit}", "{:.2f}".format),
        figure("valve_actions_per_10_s", "valve_actions_per_10_s", "valve actions in 10 s", "{:.1f}".format),
        *(figure(name, name) for name in ("both_valves_samples", "samples_until_closed", "diverged")),
    )
    title = f"Figures of the {controller}"
    return RecordTable(controller, title, columns, tuple(result.figures[controller].items()))


def _cell(value: float | None) -> str:
    return "" if value is None else "never" if value == float("inf") else f"{value:.2f}"


def _picture(result: Drive, name: str, scenario: Scenario) -> Picture:
    loops, baseline = result.loops[TESTED][name], result.loops[BASELINE][name]
    band = result.bands.get(name)
    beneath = "" if scenario.kind is not Kind.STEP else " The error axis ends at 1.5 tolerances."
    return Picture(
        name.replace(" ", "-")
        .replace(",", "")
        .replace("/", "-per-")
        .replace("°", "")
        .replace("+", "plus-")
        .replace("--", "-minus-"),
        closed_loop(scenario, loops, baseline, band, BASELINE, (result.unit, result.command_unit)),
        f"{name}: displacement, error and currents of the first loop.{beneath}",
        f"Displacement, its error and the currents over time, {name}.",
        data={
            "time_s": loops.time_s,
            f"target_{result.unit}": loops.target,
            f"displacement_{result.unit}": loops.displacement[0],
            f"measured_{result.unit}": loops.measured[0],
            f"lifting_command_{result.command_unit}": loops.commands[0, :, 0],
            f"lowering_command_{result.command_unit}": loops.commands[0, :, 1],
        },
    )


def _summary(figures: RecordTable) -> Table:
    scenario, _, *errors = figures.columns
    return replace(figures, title="closed loops", columns=(scenario, *errors[:4])).shown()
