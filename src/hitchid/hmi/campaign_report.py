"""Report of a campaign that chose its own tests: its errors over bench minutes, beside other programmes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from hitchid.bench.excitation import binary_command, precompensated
from hitchid.control.sequential_design import PRIOR, Duties, Posterior, free_run_slopes, information, within
from hitchid.hmi import project
from hitchid.hmi.plans import Limits
from hitchid.hmi.programs import MOVE_STROKES_PER_S, SETTLE_S, START, TEST_TRAVEL
from hitchid.logs import DIRECTIONS
from hitchid.plots import COLOURS, INK, PAGE_IN, legend_above, logarithmic, styled
from hitchid.report import (
    Document,
    Finding,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    write_report,
)

# The paper's programme as the same bench loop runs it, for what it would have known; lengths in s.
FIXED_RAMPS, FIXED_RAMP_S, FIXED_TESTS, FIXED_TEST_S = 3, 10.0, 20, 10.0
MOVE_S = 0.7 / MOVE_STROKES_PER_S + SETTLE_S  # s, back over most of the travel before the next test
HEIGHT_IN = 3.6  # of the figure, inch; chosen
EXPLANATION = (
    "Points are measured: errors in free run on tests that were never fitted. Lines are computed with the "
    "last model: what the parameters leave open in free runs, as the campaign went, had the fixed programme "
    "of ramps and binary tests been run, and had commands been drawn at random up to their limits. They hold "
    "what tests say of the parameters, not what the form of the model misses."
)
Curve = tuple[np.ndarray, np.ndarray]


def expected_curve(
    posterior: Posterior,
    duties: Duties,
    tests: Sequence[Float[np.ndarray, " n"]],
    start: float,
    ahead: float,
    begin_s: float,
    between_s: float,
    directions: int,
) -> Curve:
    """Return bench minutes and the expected error of free runs after each of a programme's tests.

    Args:
        posterior, duties: of the direction.
        tests: commands as logged.
        start, ahead: where each begins, and the travel ahead of it.
        begin_s, between_s: time before the first test, and between two, s.
        directions: that share the time, in turn.
    """  # fmt: skip
    precision, clock_s = np.eye(len(posterior.position)) / PRIOR**2, begin_s
    minutes, errors = [], []
    travel, slopes = free_run_slopes(posterior, np.stack(tests), start)
    for row, jacobian in zip(travel, slopes, strict=True):
        samples = within(row, ahead)
        clock_s += directions * (samples * posterior.tests.step_s + between_s)
        precision = precision + information(posterior, jacobian[:samples])
        minutes.append(clock_s / 60)
        errors.append(duties.variance(precision) ** 0.5)
    return np.array(minutes), np.array(errors)


def _programmes(
    posterior: Posterior, duties: Duties, start: float, limits: Limits, highest: float, directions: int
) -> dict[str, Curve]:
    """Return what the fixed programme and random tests would have known, over bench minutes."""
    step_s, zone, rng = posterior.tests.step_s, posterior.dead_zone, np.random.default_rng(0)
    ahead = (1 - 2 * START) * limits.travel
    # The level at which a test that holds it uses its share of the travel: as the fixed programme has it.
    levels = np.linspace(zone, highest, 9)[1:]
    held = np.repeat(levels[:, None], round(FIXED_TEST_S / step_s), axis=1)
    travelled = free_run_slopes(posterior, held, start)[0][:, -1]
    largest = float(np.interp(TEST_TRAVEL * limits.travel, np.maximum.accumulate(travelled), levels)) - zone
    fixed = [
        precompensated(binary_command(largest, 0.0, FIXED_TEST_S, rng, step_s), zone)
        for _ in range(FIXED_TESTS)
    ]
    drawn = []
    for _ in range(2 * FIXED_TESTS):
        low, high = np.sort(rng.uniform(0.0, highest, 2))
        hold = max(1, round(rng.uniform(0.15, 0.4) / step_s))
        is_high = np.repeat(rng.integers(0, 2, len(fixed[0]) // hold + 1), hold)[: len(fixed[0])]
        drawn.append(np.where(is_high, high, low))
    ramps_s = directions * FIXED_RAMPS * (FIXED_RAMP_S + MOVE_S)
    return {
        "fixed programme": expected_curve(
            posterior, duties, fixed, start, ahead, ramps_s, MOVE_S, directions
        ),
        "random commands": expected_curve(posterior, duties, drawn, start, ahead, 0.0, MOVE_S, directions),
    }


@styled
def campaign_figure(
    curves: Mapping[str, Mapping[str, Curve]], points: Mapping[str, Curve], unit: str
) -> Figure:
    """Return errors over bench minutes: a panel for each direction, a line for each programme."""
    figure = Figure(figsize=(PAGE_IN, HEIGHT_IN))
    panels = figure.subplots(1, len(curves), squeeze=False, sharey=True)[0]
    styles = {
        "this campaign": (COLOURS["greybox"], (None, None)),
        "fixed programme": (INK, (4, 1.5)),
        "random commands": (COLOURS["narx"], (1, 1.5)),
    }
    for axes, (direction, by_programme) in zip(panels, curves.items(), strict=True):
        for name, (minutes, errors) in by_programme.items():
            colour, dashes = styles[name]
            axes.plot(minutes, errors, color=colour, dashes=dashes, linewidth=1.4, label=name)
        axes.plot(*points[direction], "o", color=COLOURS["transfer_function"], markersize=4, label="measured")
        logarithmic(axes.yaxis)
        axes.set_title(direction)
        axes.set_xlabel("bench time / min")
    panels[0].set_ylabel(f"error in free run / {unit}")
    legend_above(figure, *panels, columns=4)
    return figure


def write_campaign_report(
    root: Path,
    name: str,
    reason: str,
    rounds: Sequence[Mapping[str, Any]],
    posterior: Mapping[str, Posterior],
    duties: Mapping[str, Duties],
    ends: Mapping[str, float],
    limits: Limits,
) -> str:
    """Write the report of a campaign into the project; return where it lies, relative to it."""
    unit, curves, points = limits.displacement_unit, {}, {}
    highest: dict[str, float] = dict(zip(DIRECTIONS, limits.commands, strict=True))
    for direction, own in posterior.items():
        entries = [(entry["minutes"], entry["directions"].get(direction, {})) for entry in rounds]
        left_open = [(m, e["open"]) for m, e in entries if e.get("open") is not None]
        validated = [(m, e["validation"]) for m, e in entries if e.get("validation") is not None]
        points[direction] = tuple(np.array(validated, float).reshape(-1, 2).T)
        curves[direction] = {
            "this campaign": tuple(np.array(left_open, float).reshape(-1, 2).T)
        } | _programmes(own, duties[direction], ends[direction], limits, highest[direction], len(posterior))
    out = _free(root, name)
    document = Document(
        title="Campaign that chose its own tests",
        subtitle=name,
        verdict=tuple(_findings(reason, rounds, unit)),
        sections=(
            ReportSection("Errors over bench time", (Text(EXPLANATION), *_pictures(curves, points, unit))),
            ReportSection("Rounds", (_table(rounds, unit),)),
        ),
    )
    write_report(root / out, document, {}, mark=project.REPORT_FILE)
    return f"{out}/{project.REPORT_FILE}"


def _findings(reason: str, rounds: Sequence[Mapping[str, Any]], unit: str) -> list[Finding]:
    """Return why the campaign ended, and what each direction has reached; open ends first."""
    has_reached = reason.startswith(("the goal is reached", "all that ships is determined"))
    findings = [Finding(Rating.GOOD if has_reached else Rating.CAUTION, f"It ended: {reason}.")]
    for direction, own in (rounds[-1]["directions"] if rounds else {}).items():
        if own.get("validation") is None:
            text = f"{direction}: no test was run that is not fitted; how good the model is, is not known."
            findings.append(Finding(Rating.CAUTION, text.capitalize()))
        else:
            text = f"{direction}: {own['validation']:.3g} {unit} in free run on tests that were never fitted."
            findings.append(Finding(Rating.GOOD, text.capitalize()))
    return sorted(findings, key=lambda finding: finding.level is Rating.GOOD)


def _free(root: Path, name: str) -> str:
    """Return a folder that is free: a campaign that went on has a report each time it ended."""
    number, out = 1, f"{project.REPORTS}/{name}"
    while (root / out).exists():
        number += 1
        out = f"{project.REPORTS}/{name}-{number}"
    return out


def _pictures(
    curves: Mapping[str, Mapping[str, Curve]], points: Mapping[str, Curve], unit: str
) -> tuple[Pictures, ...]:
    if not curves:
        return ()
    data = {}
    for direction, by_programme in curves.items():
        for programme, (minutes, errors) in by_programme.items():
            data[f"{direction}_{programme.replace(' ', '_')}_min"] = minutes
            data[f"{direction}_{programme.replace(' ', '_')}_{unit}"] = errors
    longest = max(map(len, data.values()))
    padded = {
        key: np.pad(values, (0, longest - len(values)), constant_values=np.nan)
        for key, values in data.items()
    }
    picture = Picture(
        "campaign",
        campaign_figure(curves, points, unit),
        "Error in free run over bench time; the lower and the farther left, the better the use of the bench.",
        "Errors of this campaign, of the fixed programme and of random commands over bench minutes.",
        wide=True,
        data=padded,
    )
    return (Pictures((picture,)),)


def _table(rounds: Sequence[Mapping[str, Any]], unit: str) -> Table:
    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.3g}"

    rows = []
    for entry in rounds:
        for direction, own in entry["directions"].items():
            ships = "" if own.get("parameters") is None else f"{own['determined']} of {own['parameters']}"
            errors = (own.get("rmse"), own.get("open"), own.get("validation"))
            rows.append((f"{entry['minutes']:.1f}", direction, *map(number, errors), ships))
    header = (
        "bench time / min", "direction", f"fitted / {unit}", f"left open / {unit}", f"never fitted / {unit}",
        "determined",
    )  # fmt: skip
    return Table("Rounds", header, tuple(rows))
