"""Report of closed loops on the virtual bench: limits, figures of each scenario, rivals, margins."""

from collections.abc import Mapping

from hitchid._support.data_table import DataTable
from hitchid.control import Drive, Kind, Scenario
from hitchid.control.drive import BASELINE, TESTED
from hitchid.report import numbers, sections
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
from hitchid.report.figures import closed_loop
from hitchid.validation import Acceptance

MARGIN_ROWS = {
    "gain_dB": ("gain margin", "dB"),
    "phase_deg": ("phase margin", "°"),
    "delay_s": ("delay margin", "s"),
    "sensitivity": ("Ms", ""),
    "disk": ("disk margin", ""),
}
HEADER = (
    "scenario",
    "IAE / mm·s",
    "RMSE / mm",
    "overshoot / mm",
    "settling / s",
    "final error / mm",
    "valve actions in 10 s",
)


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
        rig: name of the bench.
        margins: direction to the margins of the controller file.
        acceptance: result of the acceptance limits; None without limits.
        notices: warnings.
        command: the command line that wrote the report.
    """
    metrics = result.metrics
    loops = numbers.count(result.draws, "loop")
    return Document(
        title="Closed loops on the virtual bench",
        subtitle=f"bench {rig}; {loops} of each scenario, with drawn load and noise",
        verdict=_verdict(result, acceptance),
        notices=tuple(map(sentence, notices)),
        sections=(
            *([] if acceptance is None else [sections.limits(acceptance)]),
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
    "displacement stays within 2 mm (5 mm step: 1 mm) of its end; the least time is that of the bench at the "
    "largest current of the identification tests. The final error is the distance of the mean "
    "measured displacement of the last second to the target."
)
MARGINS = (
    "Margins that 95 % of the models with drawn parameters keep at nine operating points, as written by "
    "`hitchid tune`. They hold for errors of the parameters, not for dynamics that the model does not have."
)


def _verdict(result: Drive, acceptance: Acceptance | None) -> tuple[Finding, ...]:
    found = []
    if acceptance is not None:
        failed = [check.name for check in acceptance.checks if not check.passed]
        text = f"{len(failed)} of {len(acceptance.checks)} limits failed: {', '.join(failed)}."
        passed = f"All {len(acceptance.checks)} limits are met."
        found.append(Finding(Rating.BAD, text) if failed else Finding(Rating.GOOD, passed))
    own = result.figures[TESTED]
    diverged = sum(each.diverged for each in own.values())
    both = sum(each.both_valves_samples for each in own.values())
    ratio = result.iae_ratios["all"]
    found += [
        Finding(Rating.BAD if diverged else Rating.GOOD, f"{diverged} loops diverged."),
        Finding(Rating.BAD if both else Rating.GOOD, f"Both valves were on in {both} samples."),
        Finding(
            Rating.GOOD if ratio < 1 else Rating.CAUTION,
            f"The IAE is {ratio:.2f} times that of {BASELINE}, mean of steps, ramps and sine.",
        ),
    ]
    inside = result.inside_band
    if inside:
        share = sum(inside.values()) / len(inside)
        text = f"{100 * share:.0f} % of the loops are inside the band that the identified model predicts."
        found.append(Finding(Rating.GOOD if share >= 0.85 else Rating.CAUTION, text))
    return tuple(found)


def _figure_table(result: Drive, controller: str) -> Table:
    return Table(
        f"Figures of the {controller}" if controller == TESTED else controller,
        HEADER,
        _rows(result, controller),
    )


def _rows(result: Drive, controller: str) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            _name(result, name),
            f"{each.iae_mm_s:.2f}",
            f"{each.rmse_mm:.2f}",
            _cell(each.overshoot_mm),
            _cell(each.settling_s),
            f"{each.final_error_mm:.2f}",
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
        (scenario, *(f"{result.figures[name][scenario].iae_mm_s:.2f}" for name in names))
        for scenario in result.scenarios
    )
    return Table("IAE in mm·s, mean of the loops", ("scenario", *names), rows)


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
    beneath = "" if scenario.kind is not Kind.STEP else " The error axis ends at ±3 mm."
    return Picture(
        name.replace(" ", "-")
        .replace(",", "")
        .replace("/", "-per-")
        .replace("°", "")
        .replace("+", "plus-")
        .replace("--", "-minus-"),
        closed_loop.closed_loop(scenario, loops, baseline, band, BASELINE),
        f"{name}: displacement, error and currents of the first loop.{beneath}",
        f"Displacement, its error and the currents over time, {name}.",
        data={
            "time_s": loops.time_s,
            "target_mm": loops.target_mm,
            "displacement_mm": loops.displacement_mm[0],
            "measured_mm": loops.measured_mm[0],
            "lifting_current_A": loops.currents_a[0, :, 0],
            "lowering_current_A": loops.currents_a[0, :, 1],
        },
    )


def _summary(result: Drive) -> Table:
    rows = tuple((row[0], row[2], row[3], row[4], row[5]) for row in _rows(result, TESTED))
    return Table("closed loops", (HEADER[0], *HEADER[2:6]), rows)


def _data_table(result: Drive, controller: str) -> DataTable:
    rows = ({"scenario": name, **each._asdict()} for name, each in result.figures[controller].items())
    return DataTable.of_rows(controller, rows)
