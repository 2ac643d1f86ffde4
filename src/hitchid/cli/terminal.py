"""Terminal output: tables, verdicts, notices."""

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO
from math import expm1
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import typer
from rich import box
from rich.table import Table as RichTable

from hitchid._support.console import PlainConsole, line, rich_table
from hitchid._support.progress_display import progress as progress
from hitchid._support.tables import Table
from hitchid.logs.kinds import LABELS
from hitchid.logs.record import COMMAND, DISPLACEMENT

if TYPE_CHECKING:
    from hitchid.bench.sun2025 import Study
    from hitchid.control import Limitation, Tuning
    from hitchid.control.next_test import Advice
    from hitchid.export import Export
    from hitchid.fleet import ValidationRow
    from hitchid.identification import ChannelTrace, Identification
    from hitchid.live import Changes
    from hitchid.logs import Inspection
    from hitchid.logs.audit import AuditFinding
    from hitchid.logs.campaign import Campaign
    from hitchid.model import Hitch
    from hitchid.report import Document
    from hitchid.validation import Acceptance

COLUMNS = 80  # characters, width of narrow output (chosen)
WIDEST = 1000  # characters of a line with the longest name of a log (chosen)
MAX_SPANS = 3  # intervals listed for one finding (chosen)
MAX_MACHINES = 20  # of a fleet that are shown (chosen)
SHOWN_PARAMETERS = 3  # that a controller depends on most (chosen)


def show_inspection(inspection: "Inspection") -> None:
    """Print the result of an inspection."""
    if inspection.records:
        _print_whole(_records(inspection))
        _print_whole(_signals(inspection))
        for sentence in _split(inspection):
            _print_wrapped(sentence, 2)
    if inspection.mixed:
        labels = [label for label in LABELS if any(label in r.durations_s for r in inspection.mixed)]
        rows = []
        for record in inspection.mixed:
            durations = record.durations_s
            cells = [f"{durations[label]:.4g}" if label in durations else "" for label in labels]
            rows.append((record.name, *cells, str(len(record.segments))))
        _console().print(_table(("mixed record", *(f"{label} / s" for label in labels), "stretches"), rows))
    if inspection.findings:
        rows = []
        for finding in inspection.findings:
            logs = f"{len(finding.records)} logs" if finding.records else "the campaign"
            signal = [finding.signal.replace("_", " ")] if finding.signal else []
            spans = [f"{start:.6g} … {stop:.6g} s" for start, stop in finding.spans if finding.record]
            if len(spans) > MAX_SPANS:
                spans[MAX_SPANS:] = [f"and {len(spans) - MAX_SPANS} more"]
            location = "\n".join([finding.record or logs, *signal, *spans])
            severity = f"{finding.severity.value}:\n{finding.check}"
            rows.append((severity, location, f"{finding.what}\n→ {finding.advice}"))
        table = _table(("finding", "where", "problem and remedy"), rows)
        table.show_lines = True
        _console().print(table)
    elif inspection.records:
        _print_wrapped("No problems found.")
    write_messages("notice", inspection.notices)
    write_messages("warning", inspection.warnings)
    write_messages("fault", inspection.faults)


def _records(inspection: "Inspection") -> RichTable:
    """Return a line for each log, its name last, so that a long one makes no other column narrow."""
    rows = []
    for record in inspection.records:
        quality, travel = record.quality, record.signals[DISPLACEMENT]
        rows.append(
            (
                f"{record.kind}, held out" if record.held_out else record.kind,
                str(quality.samples),
                f"{quality.step_s:.4g}",
                f"{quality.duration_s:.4g}",
                f"{travel.lowest:.4g} … {travel.highest:.4g} {travel.unit}",
                record.name,
            )
        )
    header = ("kind", "samples", "step / s", "duration / s", "displacement", "log")
    table = _table(header, rows, kind=box.SIMPLE_HEAD)
    for column in table.columns[1:-1]:
        column.justify = "right"
    return table


def _signals(inspection: "Inspection") -> RichTable:
    """Return a line for each signal: its smallest and largest value over all logs."""
    ranges: dict[tuple[str, str], tuple[float, float]] = {}
    for record in inspection.records:
        for role, signal in record.signals.items():
            low, high = ranges.get((role, signal.unit), (signal.lowest, signal.highest))
            ranges[role, signal.unit] = min(low, signal.lowest), max(high, signal.highest)
    rows = [(f"{low:.4g}", f"{high:.4g}", unit, role) for (role, unit), (low, high) in ranges.items()]
    return _table(("smallest", "largest", "unit", "signal"), rows, kind=box.SIMPLE_HEAD)


def _split(inspection: "Inspection") -> Iterator[str]:
    """Yield for each kind with held-out tests how many there are, and their names."""
    kinds = dict.fromkeys(record.kind for record in inspection.records if record.held_out)
    for kind in kinds:
        records = [record for record in inspection.records if record.kind == kind]
        held_out = [record.name for record in records if record.held_out]
        yield (
            f"{kind}: identified from {len(records) - len(held_out)} of {len(records)} tests; held out for "
            f"validation: {', '.join(held_out)}"
        )


def show_drift(rows: "Sequence[ValidationRow]") -> None:
    """Print the machines of a fleet with the change of each direction, in their order."""
    cells = [
        (
            row.machine,
            direction,
            _change(drift.gain_change, drift.gain_change_error, 100.0, 1),
            _change(drift.dead_zone_change, drift.dead_zone_change_error, 1.0, 3),
            "" if drift.p_value is None else f"{drift.p_value:.2g}",
            f"{drift.rmse:.3g}",
            f"{drift.reference_rmse:.3g}",
            str(len(row.faults)),
        )
        for row in rows[:MAX_MACHINES]
        for direction, drift in row.directions.items()
    ]
    header = ("machine", "direction", "gain / %", "dead zone", "p", "RMSE: now", "before", "faults")
    _console().print(_table(header, cells))
    if len(rows) > MAX_MACHINES:
        _print_wrapped(f"and {len(rows) - MAX_MACHINES} more machines, with smaller drift, in fleet.csv")


def _change(value: float | None, error: float | None, scale: float, digits: int) -> str:
    """Return a change with its standard error; a dash where there is none."""
    if value is None or error is None:
        return "-"
    return f"{scale * value:+.{digits}f} ± {scale * error:.{digits}f}"


def read_campaign(logs: Sequence[Path], *, signals: Path | None, strict: bool, quiet: bool) -> "Campaign":
    """Read logs; write those left out, with their reasons and number, to stderr, but not if `quiet`."""
    from hitchid.logs import read

    campaign = read(logs, signals=signals, strict=strict)
    write_messages("warning", () if quiet else campaign.notices)
    return campaign


def show_audit(findings: Iterable["AuditFinding"], *, quiet: bool = False) -> None:
    """Write faults and warnings of an audit to stderr; only faults if `quiet`."""
    for finding in findings:
        if finding.severity.value in (("fault",) if quiet else ("fault", "warning")):
            where = f"{finding.record}: " if finding.record else ""
            message = f"{where}{finding.check}: {finding.what}; {finding.advice}"
            write_messages(finding.severity.value, [message])


def show_identification(identification: "Identification", out: Path) -> None:
    """Print the identified parameters of each direction, in 80 columns, and the path of the model."""
    from hitchid.report.parameters_section import characteristic_sentences

    for direction, trace in identification.channels.items():
        _narrow_console().print(
            _parameters(direction, identification.model.units[f"{direction}_command"], trace)
        )
        displacement = identification.model.units["displacement"]
        if trace.candidates:
            _show_candidates(trace, displacement)
        _print_wrapped(f"RMSE {trace.phase1.rmse:.4g} {displacement} in free run on the identification tests")
        if trace.characteristics:
            for text in characteristic_sentences(trace.characteristics, direction):
                _print_wrapped(text, indent=2)
        if trace.seconds:
            times = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in trace.seconds.items())
            _print_wrapped(f"time: {times}")
        write_messages(f"{direction}, notice", trace.notices)
    _print_wrapped(f"model: {out}")


def _show_candidates(trace: "ChannelTrace", unit: str) -> None:
    """Print the compared structures with their errors, and the error of the choice itself."""
    rows = []
    for candidate in trace.candidates:
        errors = candidate.rmse, candidate.held_out_rmse, candidate.held_out_rmse_per_test_gain
        name = f"{candidate.name} (chosen)" if candidate.chosen else candidate.name
        rows.append((name, *(f"{error:.4g}" for error in errors)))
    header = ("structure", f"RMSE / {unit}", "held out", "held out, gain per test")
    _narrow_console().print(_table(header, rows, kind=box.SIMPLE_HEAD))
    _print_wrapped(
        "A larger structure is taken where it is significantly better on levels held out, as it is or with a "
        "gain for each test, and not significantly worse in the other. Then what no test misses goes."
    )
    _print_wrapped(
        f"RMSE {trace.choice_held_out_rmse:.4g} {unit} in free run on levels that neither fitted nor chose "
        "the structure"
    )


def _parameters(direction: str, unit: str, trace: "ChannelTrace") -> RichTable:
    """Return the table of dead zone and parameters; the value of one that is not determined is dim."""
    from hitchid._support import numbers
    from hitchid.validation.estimate_tables import estimate_text

    zone = trace.dead_zone
    value = numbers.with_error(zone.value, zone.error.standard_error or None)
    rows = [("dead zone", value, unit, f"from {zone.count} {zone.origin}" if zone.count else zone.origin)]
    rows += [
        (
            estimate.symbol or estimate.name.replace("_", " "),
            estimate_text(estimate),
            estimate.unit,
            estimate.verdict,
        )
        for estimate in trace.phase1.parameter_estimates
    ]
    return _table((direction, "value ± std error", "unit", "verdict"), rows, kind=box.SIMPLE_HEAD)


def show_adaptation(
    model: "Hitch", changes: "Mapping[str, Changes]", counts: "Mapping[tuple[str, str], int]"
) -> None:
    """Write to stderr what an adaptation has come to: changes in use, and events by direction and kind."""
    from hitchid.live import REPORTED, Changes
    from hitchid.live.events import LEARNED, REFUSED

    strokes = [sum(n for (_, kind), n in counts.items() if kind == kept) for kept in (LEARNED, REFUSED)]
    sys.stderr.write(f"adaptation: {strokes[0]} strokes learned from, {strokes[1]} refused\n")
    for direction, change in changes.items():
        gain, lag = (f"{100 * expm1(value):+.3g} %" for value in (change.gain, change.lag))
        dead_zone = f"{change.dead_zone:+.3g} {model.units[COMMAND[direction]]}"
        parameters = f"gain {gain}, dead zone {dead_zone}, lag {lag}"
        events = [f"{counts[direction, kind]} {kind}" for kind in REPORTED if (direction, kind) in counts]
        state = "as identified" if change == Changes() else parameters
        sys.stderr.write(f"{direction}: {'; '.join([state, *events])}\n")


def show_advice(advice: "Advice", model: "Hitch") -> None:
    """Print the proposed tests and the predicted standard error after each, in percent of the present one."""
    command, displacement = model.units[f"{advice.direction}_command"], model.units["displacement"]
    zone = model.channels[advice.direction].dead_zone
    name = advice.parameter.replace("_", " ")
    header = (
        f"{advice.direction}: next test",
        f"low / {command}",
        f"high / {command}",
        "clock / s",
        "duration / s",
        f"travel / {displacement}",
        f"error of {name} / %",
    )
    unchanged = f"{100 * advice.baseline_reduction[advice.parameter]:.0f}"
    rows = [("one more such test", "", "", "", "", "", unchanged)]
    rows += [
        (
            f"binary, {number}",
            f"{proposal.low + zone * (proposal.low > 0):.4g}",
            f"{proposal.high + zone:.4g}",
            f"{proposal.clock_s:.3g}",
            f"{proposal.duration_s:.4g}",
            f"{proposal.travel:.4g}",
            f"{100 * proposal.remaining_error[advice.parameter]:.0f}",
        )
        for number, proposal in enumerate(advice.proposals, start=1)
    ]
    _console().print(_table(header, rows))
    if advice.ramps:
        sentence = f"the error of {name} is mostly due to the dead zone: measure three more ramps"
        write_messages("notice", [sentence])


def show_tuning(tuning: "Tuning", out: Path) -> None:
    """Print method, gains and margins of a controller, and the path of its file."""
    rows = []
    for (direction, margins), gains in zip(tuning.margins.items(), tuning.controller.gains, strict=True):
        worst = margins.worst
        rows.append(
            (
                direction,
                f"{float(gains.proportional):.2f} 1/s",
                f"{worst.gain_db:.1f} dB",
                f"{worst.phase_deg:.0f}°",
                f"{1e3 * worst.delay_s:.0f} ms",
                f"{worst.sensitivity:.2f}",
            )
        )
    header = ("direction", "bandwidth", "gain margin", "phase margin", "delay margin", "Ms")
    _narrow_console().print(_table(header, rows))
    _print_wrapped(f"margins: met by 95 % of {tuning.draws} draws of the parameters at nine operating points")
    _print_wrapped(f"method: {tuning.method}")
    _print_wrapped(f"controller: {out}")


def show_limitation(found: "Limitation") -> None:
    """Print what limits a controller and which parameters it depends on."""
    shares = [f"{name.replace('_', ' ')} {share:.0%}" for name, share in found.shares.items()]
    most = shares[:SHOWN_PARAMETERS]
    _print_wrapped(
        f"{found.direction}: at {found.bandwidth_rad_s:.3g} rad/s Ms is {found.nominal:.3f} with the "
        f"identified parameters and {found.worst:.3f} for 95 % of the draws; of its variance is due to "
        f"{', '.join(most)}"
    )
    if found.limit == "noise":
        _print_wrapped(
            f"the noise of the displacement, as identified, limits the controller to "
            f"{found.bandwidth_rad_s:.3g} rad/s, not its margins: a sensor with less noise makes it faster, "
            "or a model that fits better where the noise contains what it misses"
        )


def show_export(done: "Export") -> None:
    """Print how far the exported code differs from the model, notices, and its place."""
    if done.parity is not None:
        _print_wrapped(
            f"replayed {done.parity.samples} samples with {done.compiler}: the displacement differs by at "
            f"most {done.parity.measured:.1e} of its range with measured displacements and "
            f"{done.parity.free_run:.1e} in free run, mode and flags in {done.parity.modes} samples"
        )
    write_messages("notice", done.notices)
    _print_wrapped(f"export: {done.place}")


def show_study(study: "Study", out: Path) -> None:
    """Print the tables of the study, notices, and the path of the report."""
    for table in study.tables:
        _console().print(rich_table(table))
    write_messages("notice", study.validation.notices)
    _print_wrapped(f"report: {out / 'report.html'}")


def show_report(document: "Document", notices: Iterable[str], out: Path) -> None:
    """Print verdict and summary of a report, in 80 columns, notices, and the path of the report."""
    from hitchid.report import render

    sys.stdout.write(render(document, "terminal").decode())
    write_messages("notice", notices)
    _print_wrapped(f"report: {out / 'report.html'}")


def end_with_verdict(
    document: "Document",
    metrics: Mapping[str, object],
    notices: Iterable[str],
    acceptance: "Acceptance | None",
    out: Path,
    *,
    quiet: bool,
    as_json: bool,
) -> None:
    """Print metrics as JSON, or a report and each limit, only failed ones if `quiet`; then end.

    Raises:
        typer.Exit: with code 1, where a limit is violated.
    """
    from hitchid.report.verdict import check_line

    if as_json:
        accepted = {} if acceptance is None else {"acceptance": acceptance.describe()}
        typer.echo(json.dumps({**metrics, **accepted}, indent=1))
    elif not quiet:
        show_report(document, notices, out)
    for check in () if acceptance is None or as_json else acceptance.checks:
        if not (quiet and check.passed):
            sys.stdout.write(line(check_line(check)))
    if acceptance is not None and not acceptance.passed:
        raise typer.Exit(1)


def _table(
    header: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, kind: box.Box = box.HEAVY_HEAD
) -> RichTable:
    return rich_table(Table("", header, tuple(rows)), kind=kind, align=False)


def _console() -> PlainConsole:
    # What goes to a file or a pipe has one width, whatever terminal it is started from.
    return PlainConsole(width=None if sys.stdout.isatty() else 120)


def _print_whole(table: RichTable) -> None:
    """Print a table whose last column may be wider than the terminal: nothing is cut, no line is padded."""
    text = StringIO()
    PlainConsole(file=text, width=WIDEST).print(table)
    for row in text.getvalue().splitlines():
        rule = row.strip(" ─") == ""
        sys.stdout.write((row[:COLUMNS] if rule else row).rstrip() + "\n")


def _narrow_console() -> PlainConsole:
    return PlainConsole(width=COLUMNS)


def _print_wrapped(text: str, indent: int = 0) -> None:
    """Print a sentence on lines of 80 columns at most, all but the first indented."""
    sys.stdout.write(line(fill(text, COLUMNS, subsequent_indent=" " * indent, break_on_hyphens=False)))


def write_result(out: Path, sentence: str) -> None:
    """Write what a command wrote to a file or folder, to stderr."""
    sys.stderr.write(line(f"{out}: {sentence}"))


def write_messages(kind: str, sentences: Iterable[object]) -> None:
    """Write sentences to stderr, each with its kind as prefix."""
    for sentence in sentences:
        sys.stderr.write(line(f"{kind}: {sentence}"))
