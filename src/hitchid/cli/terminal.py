"""What a terminal shows: tables, verdicts, notices."""

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table as RichTable

from hitchid.cli.terminal_progress import progress as progress
from hitchid.data.segmentation import LABELS

if TYPE_CHECKING:
    from hitchid.audit import AuditFinding
    from hitchid.data.campaign import Campaign
    from hitchid.design.next_test import Advice
    from hitchid.identification import ChannelTrace, Identification
    from hitchid.inspection.inspect_logs import Inspection
    from hitchid.model import Hitch
    from hitchid.report import Document
    from hitchid.studies.sun2025 import Study
    from hitchid.validation import Acceptance, ModelComparison, Table, Validation

COLUMNS = 80
PLACES = 3


def show_inspection(found: "Inspection") -> None:
    """Print what was found in logs."""
    if found.records:
        table = _table("record", "kind", "samples", "step / s", "duration / s", "signals")
        for record in found.records:
            signals = record["signals"]
            assert isinstance(signals, dict)  # noqa: S101
            ranges = [
                f"{role} {signal['lowest']:.4g} … {signal['highest']:.4g} {signal['unit']}"
                for role, signal in signals.items()
            ]
            kind = f"{record['kind']}, held out" if record["held_out"] else str(record["kind"])
            table.add_row(
                str(record["name"]),
                kind,
                str(record["samples"]),
                f"{record['step_s']:.4g}",
                f"{record['duration_s']:.4g}",
                "\n".join(ranges),
            )
        _out().print(table)
    if found.mixed:
        labels = [label for label in LABELS if any(label in _durations(each) for each in found.records)]
        table = _table("mixed record", *(f"{label} / s" for label in labels), "stretches")
        for record in found.records:
            spent = _durations(record)
            if spent:
                cells = [f"{spent[label]:.4g}" if label in spent else "" for label in labels]
                stretches = record["segments"]
                assert isinstance(stretches, list)  # noqa: S101
                table.add_row(str(record["name"]), *cells, str(len(stretches)))
        _out().print(table)
    if found.findings:
        _out().print(_findings(found.findings))
    elif found.records:
        _say_in("The audit found nothing to mend.")
    say("notice", found.notices)
    say("warning", found.warnings)
    say("fault", found.faults)


def show_left_out(campaign: "Campaign", *, quiet: bool = False) -> None:
    """Write to stderr which logs are left out and why, and how many; quietly, nothing."""
    say("warning", () if quiet else campaign.warnings)


def show_audit(findings: Iterable["AuditFinding"], *, quiet: bool = False) -> None:
    """Write to stderr what an audit of the logs found that would spoil a model; quietly, faults alone."""
    for each in findings:
        if each.level.value in (("fault",) if quiet else ("fault", "warning")):
            whose = f"{each.record}: " if each.record else ""
            say(each.level.value, [f"{whose}{each.check}: {each.what}; {each.advice}"])


def _findings(findings: Iterable["AuditFinding"]) -> RichTable:
    """Return what an audit found: how grave, where, what, and what to do."""
    table = _table("finding", "where", "what, and what to do")
    for each in findings:
        signal = each.signal.replace("_", " ")
        whose = each.record or (f"{len(each.records)} logs" if each.records else "the campaign")
        where = "\n".join([whose, signal, *_places(each)] if signal else [whose, *_places(each)])
        table.add_row(f"{each.level.value}:\n{each.check}", where, f"{each.what}\n→ {each.advice}")
        table.add_section()
    return table


def _places(finding: "AuditFinding") -> list[str]:
    if not finding.record:
        return []
    more = len(finding.spans) - PLACES
    told = [f"{start:.6g} … {stop:.6g} s" for start, stop in finding.spans[:PLACES]]
    return [*told, f"and {more} more"] if more > 0 else told


def _durations(record: Mapping[str, object]) -> Mapping[str, float]:
    spent = record.get("durations_s", {})
    assert isinstance(spent, dict)  # noqa: S101
    return spent


def show_identification(found: "Identification", out: Path) -> None:
    """Print what was found of each direction, in 80 columns, and where the model lies."""
    from hitchid.uncertainty import characteristic_sentences

    for mode, trace in found.channels.items():
        _summary().print(_parameters(mode, found.model.units[f"{mode}_command"], trace))
        displacement = found.model.units["displacement"]
        chosen = [each.name for each in trace.candidates if each.chosen]
        form = f"form taken of {len(trace.candidates)}: {chosen[0]}; " if chosen else ""
        _say_in(f"{form}RMSE {trace.phase1.rmse:.4g} {displacement} over the identification tests, free run")
        for each in characteristic_sentences(trace.characteristics, mode) if trace.characteristics else ():
            _say_in(each, indent=2)
        if trace.seconds:
            spent = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in trace.seconds.items())
            _say_in(f"time: {spent}")
        say(f"{mode}, notice", trace.notices)
    _say_in(f"model: {out}")


def _parameters(mode: str, unit: str, trace: "ChannelTrace") -> RichTable:
    """Return the dead zone and every parameter; what is not determined is told by its verdict alone."""
    from hitchid.uncertainty import stated

    table = _table(mode, "value ± std error", "unit", "verdict", kind=box.SIMPLE_HEAD)
    zone = trace.dead_zone
    value = stated(zone.value, zone.error.size or None)
    origin = f"from {zone.count} {zone.origin}" if zone.count else zone.origin
    table.add_row("dead zone", value, unit, origin)
    for each in trace.phase1.estimates:
        value = stated(each.value, each.error) if each.determined else ""
        table.add_row(each.symbol or each.name.replace("_", " "), value, each.unit, each.verdict)
    return table


def show_advice(advice: "Advice", model: "Hitch") -> None:
    """Print the tests proposed, and what each is expected to leave of the standard error."""
    command, displacement = model.units[f"{advice.mode}_command"], model.units["displacement"]
    zone = model.channels[advice.mode].dead_zone
    name = advice.parameter.replace("_", " ")
    table = _table(
        f"{advice.mode}: next test",
        f"low / {command}",
        f"high / {command}",
        "clock / s",
        "duration / s",
        f"travel / {displacement}",
        f"error of {name} / %",
    )
    table.add_row("another like those", "", "", "", "", "", f"{100 * advice.usual[advice.parameter]:.0f}")
    for number, each in enumerate(advice.proposals, start=1):
        table.add_row(
            f"binary, {number}",
            f"{each.low + zone * (each.low > 0):.4g}",
            f"{each.high + zone:.4g}",
            f"{each.clock_s:.3g}",
            f"{each.duration_s:.4g}",
            f"{each.travel:.4g}",
            f"{100 * each.left[advice.parameter]:.0f}",
        )
    _out().print(table)
    if advice.ramps:
        say(
            "notice", [f"{name} waits for the dead zone: three more ramps would narrow it more than any test"]
        )


def show_study(study: "Study", out: Path) -> None:
    """Print the tables of the study, and what a reader should not miss."""
    _show_tables(study.tables)
    say("notice", study.validation.notices)
    _say_in(f"report: {out / 'report.html'}")


def show_validation(result: "Validation", document: "Document", out: Path) -> None:
    """Print the verdict and how every model errs, in 80 columns, and where the report lies."""
    from hitchid.validation import NAMES

    _show_verdict(document)
    unit = result.metrics["unit"]
    for mode, channel in result.metrics["channels"].items():
        table = _errors_table(f"{mode}, RMSE / {unit}")
        everything = {
            **channel["baselines"],
            "benchmark": channel["benchmark"],
            "greybox": channel["greybox"],
        }
        for name, figures in everything.items():
            table.add_row(NAMES[name], *_errors(figures))
        _summary().print(table)
    cycles = result.metrics["cycles"]
    if cycles["tests"]:
        table = _errors_table(f"cycles, RMSE / {unit}")
        for name in (name for name in NAMES if name in cycles):
            table.add_row(NAMES[name], *_errors(cycles[name]))
        _summary().print(table)
    say("notice", result.notices)
    _say_in(f"report: {out / 'report.html'}")


def show_comparison(compared: "ModelComparison", document: "Document", out: Path) -> None:
    """Print which model errs less, and both side by side, in 80 columns."""
    _show_verdict(document)
    for part in compared.parts:
        table = _errors_table(f"{part}, RMSE / {compared.unit}")
        for name, figures in zip("AB", compared.figures(part), strict=True):
            table.add_row(f"model {name}", *_errors(figures["greybox"]))
        _summary().print(table)
    say("notice", compared.notices)
    _say_in(f"report: {out / 'report.html'}")


def show_acceptance(acceptance: "Acceptance", *, quiet: bool = False) -> None:
    """Print whether each limit holds, a line for each; quietly, those alone that do not."""
    from hitchid.validation import line

    for check in acceptance.checks:
        if not (quiet and check.passed):
            sys.stdout.write(f"{line(check)}\n")


def _show_verdict(document: "Document") -> None:
    for finding in document.verdict:
        _say_in(f"{finding.level.value:8}{finding.sentence}", indent=8)


def _errors_table(title: str) -> RichTable:
    table = _table(title, kind=box.SIMPLE_HEAD)
    for name in ("one step", "free run", "fit / %", "largest"):
        table.add_column(name, justify="right")
    return table


def _errors(figures: Mapping[str, Any]) -> tuple[str, ...]:
    """Return RMSE one step ahead and in free run, fit and largest error in free run where there is one."""
    from hitchid.validation import error_cells

    ahead, free = (figures.get(run) for run in ("one_step", "free_run"))
    step = error_cells(ahead)[0] if ahead else ""
    if not free:
        return step, "", "", ""
    rmse, _, _, fit, largest, _ = error_cells(free)
    return step, rmse, fit, largest


def _show_tables(tables: Iterable["Table"]) -> None:
    from hitchid.validation import numeric

    for content in tables:
        table = RichTable(title=content.title, title_justify="left", title_style="bold")
        for name, right in zip(content.header, numeric(content), strict=True):
            table.add_column(name, justify="right" if right else "left")
        for row in content.rows:
            table.add_row(*row)
        _out().print(table)


def _table(*header: str, kind: box.Box = box.HEAVY_HEAD) -> RichTable:
    table = RichTable(box=kind, pad_edge=False)
    for name in header:
        table.add_column(name)
    return table


def _out() -> Console:
    return Console(width=None if sys.stdout.isatty() else 120, markup=False, highlight=False)


def _summary() -> Console:
    return Console(width=COLUMNS, markup=False, highlight=False)


def _say_in(text: str, indent: int = 0) -> None:
    """Print a sentence on lines of 80 columns at most, all but the first indented."""
    sys.stdout.write(fill(text, COLUMNS, subsequent_indent=" " * indent, break_on_hyphens=False) + "\n")


def say(kind: str, sentences: Iterable[str]) -> None:
    """Write sentences to stderr, each after what kind it is."""
    for sentence in sentences:
        sys.stderr.write(f"{kind}: {sentence}\n")
