"""Report of closed loops on the virtual bench: limits, figures of each scenario, rivals, margins."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from hitchid._support.tables import DataTable
from hitchid.control.closed_loop import ClosedLoops
from hitchid.control.drive import BASELINE, TESTED, Drive
from hitchid.control.prediction import Band
from hitchid.control.scenarios import COMPENSATED, Kind, Scenario
from hitchid.plots.style import COLOURS, FAINT, INK, PAGE_IN, legend_above, styled
from hitchid.report import numbers
from hitchid.report.document import (
    Document,
    Finding,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    sentence,
)
from hitchid.report.verdict import limits_section
from hitchid.validation import Acceptance

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
    """Return the report of closed loops.

    Args:
        result: of `drive`.
        rig: name of the bench or plant.
        margins: direction to the margins of the controller file.
        acceptance: result of the acceptance limits; None without limits.
        notices: warnings.
        command: the command line that wrote the report.
    """
    metrics = result.metrics
    loops = numbers.count(result.draws, "loop")
    return Document(
        title="Closed loops",
        subtitle=f"{rig}; {loops} of each scenario, with drawn load and noise",
        verdict=drive_verdict(result, acceptance),
        notices=tuple(map(sentence, notices)),
        sections=(
            *([] if acceptance is None else [limits_section(acceptance)]),
            ReportSection("Figures", (Text(EXPLANATION), _figure_table(result, TESTED))),
            ReportSection("Beside the baselines", (_comparison(result), _ratios(result))),
            ReportSection("Margins", (Text(MARGINS), _margin_table(margins))),
            ReportSection("Scenarios", (Pictures(tuple(_pictures(result))),)),
            ReportSection("How to reproduce", (Table("Origin", ("what", "value"), (("command", command),)),)),
        ),
        summary=(_summary(result),),
        checks=() if acceptance is None else acceptance.checks,
        data=metrics,
        data_tables={name: _data_table(result, name) for name in result.figures},
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
    findings = []
    if acceptance is not None:
        failed = [check.name for check in acceptance.checks if not check.passed]
        text = f"{len(failed)} of {len(acceptance.checks)} limits failed: {', '.join(failed)}."
        passed = f"All {len(acceptance.checks)} limits are met."
        findings.append(Finding(Rating.BAD, text) if failed else Finding(Rating.GOOD, passed))
    diverged = sum(each.diverged for each in own.values())
    both = sum(each.both_valves_samples for each in own.values())
    findings += [
        Finding(Rating.BAD if diverged else Rating.GOOD, f"{diverged} loops diverged."),
        Finding(Rating.BAD if both else Rating.GOOD, f"Both valves were on in {both} samples."),
    ]
    steps = {name: scenario for name, scenario in result.scenarios.items() if scenario.amplitude}
    restless = [name for name in steps if own[name].settling_s == np.inf]
    off = {
        name: own[name].final_error
        for name, scenario in steps.items()
        if not own[name].final_error <= scenario.tolerance
    }
    if restless:
        findings.append(Finding(Rating.BAD, f"Never settled: {'; '.join(restless)}."))
    if off:
        worst = max(off, key=lambda name: off[name])
        text = f"{numbers.count(len(off), 'step')} of {len(steps)} end outside the tolerance, the farthest"
        findings.append(Finding(Rating.BAD, f"{text} {off[worst]:.1f} {result.unit} off: {worst}."))
    if not restless and not off:
        findings.append(Finding(Rating.GOOD, f"All {len(steps)} steps settle and end within the tolerance."))
    ratios = {
        name: own[name].iae / rival[name].iae
        for name, scenario in result.scenarios.items()
        if scenario.kind is not Kind.HOLD
    }
    slower = {name: ratio for name, ratio in ratios.items() if not ratio <= 1}
    if slower:
        worst = max(slower, key=lambda name: slower[name])
        text = (
            f"The IAE of {len(slower)} of {len(ratios)} runs is larger than that of {COMPENSATED}, the most"
        )
        findings.append(Finding(Rating.CAUTION, f"{text} in {worst}: {slower[worst]:.2f} times."))
    elif ratios:
        text = f"The IAE of each run is at most {max(ratios.values()):.2f} times that of {COMPENSATED}."
        findings.append(Finding(Rating.GOOD, text))
    for name, scenario in result.scenarios.items():
        if scenario.kind is Kind.HOLD:
            actions = own[name].valve_actions_per_10_s
            rating = Rating.GOOD if actions <= HELD_ACTIONS else Rating.CAUTION
            findings.append(Finding(rating, f"A held hitch costs {actions:.1f} valve actions in 10 s."))
    ratio = result.iae_ratios["all"]
    findings.append(
        Finding(
            Rating.GOOD if ratio < 1 else Rating.CAUTION,
            f"The IAE is {ratio:.2f} times that of {BASELINE}, mean of steps, ramps and sine.",
        )
    )
    inside = result.inside_band
    if inside:
        share = sum(inside.values()) / len(inside)
        text = f"{100 * share:.0f} % of the loops are inside the band that the identified model predicts."
        findings.append(Finding(Rating.GOOD if share >= 0.85 else Rating.CAUTION, text))
    order = (Rating.BAD, Rating.CAUTION, Rating.GOOD)
    return tuple(sorted(findings, key=lambda finding: order.index(finding.level)))


def _figure_table(result: Drive, controller: str) -> Table:
    return Table(
        f"Figures of the {controller}" if controller == TESTED else controller,
        _header(result.unit),
        _rows(result, controller),
    )


def _header(unit: str) -> tuple[str, ...]:
    return (
        "scenario",
        f"IAE / {unit}·s",
        f"RMSE / {unit}",
        f"overshoot / {unit}",
        "settling / s",
        f"final error / {unit}",
        "valve actions in 10 s",
    )


def _rows(result: Drive, controller: str) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            _name(result, name),
            f"{each.iae:.2f}",
            f"{each.rmse:.2f}",
            _cell(each.overshoot),
            _cell(each.settling_s),
            f"{each.final_error:.2f}",
            f"{each.valve_actions_per_10_s:.1f}",
        )
        for name, each in result.figures[controller].items()
    )


def _name(result: Drive, name: str) -> str:
    least_s = result.least_times_s.get(name)
    return name if least_s is None else f"{name} (least {least_s:.2f} s)"


def _cell(value: float | None) -> str:
    return "" if value is None else "never" if value == float("inf") else f"{value:.2f}"


def _comparison(result: Drive) -> Table:
    names = list(result.figures)
    rows = tuple(
        (scenario, *(f"{result.figures[name][scenario].iae:.2f}" for name in names))
        for scenario in result.scenarios
    )
    return Table(f"IAE in {result.unit}·s, mean of the loops", ("scenario", *names), rows)


def _ratios(result: Drive) -> Table:
    rows = tuple((kind, f"{ratio:.2f}") for kind, ratio in result.iae_ratios.items())
    return Table(f"IAE over that of {BASELINE}, geometric means", ("scenarios", "ratio"), rows)


def _margin_table(margins: Mapping[str, Mapping[str, float]]) -> Table:
    rows = tuple(
        (
            f"{title} / {unit}" if unit else title,
            *(f"{own[key]:.3g}" for own in margins.values()),
        )
        for key, (title, unit) in MARGIN_ROWS.items()
    )
    return Table("Margins", ("margin", *margins), rows)


def _pictures(result: Drive) -> list[Picture]:
    return [_picture(result, name, scenario) for name, scenario in result.scenarios.items()]


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


def _summary(result: Drive) -> Table:
    rows = tuple((row[0], row[2], row[3], row[4], row[5]) for row in _rows(result, TESTED))
    header = _header(result.unit)
    return Table("closed loops", (header[0], *header[2:6]), rows)


def _data_table(result: Drive, controller: str) -> DataTable:
    unit = result.unit
    lengths = {"iae": f"iae_{unit}_s"} | {n: f"{n}_{unit}" for n in ("rmse", "overshoot", "final_error")}
    rows = (
        {"scenario": name, **{lengths.get(key, key): value for key, value in each._asdict().items()}}
        for name, each in result.figures[controller].items()
    )
    return DataTable.of_rows(controller, rows)
