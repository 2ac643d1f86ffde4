"""What a terminal shows: tables, notices, progress."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table as RichTable

from hitchid.segments import LABELS

if TYPE_CHECKING:
    from hitchid.design import Advice
    from hitchid.identification import Identification
    from hitchid.inspection import Inspection
    from hitchid.model import Hitch
    from hitchid.study import Study
    from hitchid.validation import Table, Validation

Report = Callable[[str, float], None]


@contextmanager
def progress() -> Iterator[Report]:
    """Give a function that shows progress on stderr: a bar on a terminal, a line a stage elsewhere."""
    if not sys.stderr.isatty():
        yield _plain_lines()
        return
    columns = (BarColumn(30), TaskProgressColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)


def _plain_lines() -> Report:
    last = ""

    def report(stage: str, fraction: float) -> None:
        nonlocal last
        name = stage.partition(", epoch")[0]
        if name != last:
            last = name
            sys.stderr.write(f"{fraction:4.0%}  {name}\n")
            sys.stderr.flush()

    return report


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
    say("notice", found.notices)
    say("fault", found.faults)


def _durations(record: Mapping[str, object]) -> Mapping[str, float]:
    spent = record.get("durations_s", {})
    assert isinstance(spent, dict)  # noqa: S101
    return spent


def show_identification(found: "Identification") -> None:
    """Print dead zones, parameters as far as they are determined, and notices."""
    from hitchid.uncertainty import interval_text, stated

    for mode, trace in found.channels.items():
        table = _table(mode, "value ± standard error", "95 %", "unit", "verdict")
        zone = trace.dead_zone
        error = zone.error.size or None
        unit = found.model.units[f"{mode}_command"]
        table.add_row("dead zone", stated(zone.value, error), "", unit, f"from {zone.count} {zone.origin}")
        for each in trace.phase1.estimates:
            value = stated(each.value, each.error) if each.determined else ""
            name = each.name.replace("_", " ")
            table.add_row(name, value, interval_text(each.interval), each.unit, each.verdict)
        for each in trace.phase1.known.derived:
            value = f"{each.value:.4g}" if each.determined else ""
            table.add_row(each.name, value, interval_text(each.interval), each.unit, "derived")
        _out().print(table)
        displacement = found.model.units["displacement"]
        if trace.candidates:
            compared = _table("form", "parameters", f"RMSE / {displacement}", "held-out levels")
            for each in trace.candidates:
                count = str(len(each.form.parameters))
                name = f"{each.name} (taken)" if each.chosen else each.name
                compared.add_row(name, count, f"{each.rmse:.4g}", f"{each.held_out_rmse:.4g}")
            _out().print(compared)
        if trace.seconds:
            spent = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in trace.seconds.items())
            _out().print(f"fitted in: {spent}")
        rmse = f"RMSE {trace.phase1.rmse:.4g} {displacement}"
        _out().print(f"benchmark, free run over the identification tests: {rmse}")
        say(f"{mode}, notice", trace.notices)


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


def show_study(study: "Study") -> None:
    """Print the tables of the study, and what a reader should not miss."""
    _show_tables(study.tables)
    say("notice", study.validation.notices)


def show_validation(result: "Validation") -> None:
    """Print every table of a validation."""
    from hitchid.validation import tables

    _show_tables(tables(result.metrics))
    say("notice", result.notices)


def _show_tables(tables: Iterable["Table"]) -> None:
    for content in tables:
        table = RichTable(title=content.title, title_justify="left", title_style="bold")
        for name, first in zip(content.header, content.rows[0], strict=True):
            table.add_column(name, justify="right" if _numeric(first) else "left")
        for row in content.rows:
            table.add_row(*row)
        _out().print(table)


def _numeric(cell: str) -> bool:
    return cell == "diverged" or not any(letter.isalpha() for letter in cell.replace("e", ""))


def _table(*header: str) -> RichTable:
    table = RichTable()
    for name in header:
        table.add_column(name)
    return table


def _out() -> Console:
    return Console(width=None if sys.stdout.isatty() else 120)


def say(kind: str, sentences: Iterable[str]) -> None:
    """Write sentences to stderr, each after what kind it is."""
    for sentence in sentences:
        sys.stderr.write(f"{kind}: {sentence}\n")
