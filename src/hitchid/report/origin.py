"""Origin of a result: the information required to reproduce it."""

import json
from collections.abc import Iterator, Mapping

from hitchid.logs.audit import Severity
from hitchid.model.trace import ChannelTraceFile
from hitchid.report import figures
from hitchid.report.context import DirectionContext
from hitchid.report.document import (
    Block,
    Finding,
    Findings,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    sentence,
)
from hitchid.validation.report_data import LogData, Origin
from hitchid.validation.tables import log_table, search_table

# The logs of a validation: use of each, findings of the audit, and their hashes.

LEVELS = {Severity.FAULT: Rating.BAD, Severity.WARNING: Rating.CAUTION}
MAX_MIXED_SHOWN = 2  # mixed logs in the figure; chosen


def logs_section(data: LogData) -> ReportSection:
    """Return the section on the logs: findings of the audit, every log, figures of mixed ones."""
    inspection = data.inspection
    findings = tuple(
        Finding(
            LEVELS[finding.severity],
            f"{f'{finding.record}: ' if finding.record else ''}{finding.check}: {finding.what}; "
            f"{finding.advice}.",
        )
        for finding in inspection.findings
        if finding.severity in LEVELS
    )
    notices = (*data.notices, *inspection.notices)
    findings += tuple(Finding(Rating.CAUTION, sentence(str(notice))) for notice in notices)
    summary: Block = Findings(findings) if findings else Text("The audit of the logs found no problems.")
    blocks: list[Block] = [summary, log_table(data.logs).shown()]
    if inspection.mixed:
        shown_logs = inspection.mixed[:MAX_MIXED_SHOWN]
        segmented_logs = [(log.record, log.segments) for log in shown_logs]
        blocks.append(Pictures((figures.timeline_picture(segmented_logs, len(inspection.mixed)),)))
    return ReportSection("Logs", tuple(blocks))


# Search and training of one direction.


def search_section(context: DirectionContext) -> ReportSection:
    """Return the section on the identification; its trace is in the model's units."""
    trace, searches = context.trace, context.result.searches
    blocks: list[Block] = []
    pictures = []
    if trace is not None:
        blocks += [Text(sentence(notice)) for notice in trace.notices]
        pictures += _trace_pictures(context, trace)
    if searches:
        blocks.append(search_table(context.direction, searches, context.unit))
        pictures.append(figures.searches(context.figure_name("searches"), searches, context.unit))
    return ReportSection("Search and training", (*blocks, *([Pictures(tuple(pictures))] if pictures else [])))


def _trace_pictures(context: DirectionContext, trace: ChannelTraceFile) -> Iterator[Picture]:
    unit, search = context.data.unit, trace.phase1
    caption = "Search: best fitness so far (weighted over the tests), and the parameters of the best member."
    if len(search.searched) < len(search.uncertainty.parameters):
        caption += " The plain form was searched; dotted: the model's form, which grew from it."
    yield figures.convergence(
        context.figure_name("convergence"),
        search,
        unit,
        caption,
        "Best RMSE and the parameters that gave it, over the iterations of the search.",
    )
    if trace.phase2 is not None:
        yield figures.losses(context.figure_name("losses"), trace.phase2)
    if trace.candidates:
        yield figures.structures(
            context.figure_name("structures"), trace.candidates, unit, trace.choice_held_out_rmse
        )


def command_section(command: str) -> ReportSection:
    """Return the section on reproducing a result that its command line alone gives again."""
    return ReportSection("How to reproduce", (Table("Origin", ("what", "value"), (("command", command),)),))


def origin_section(source: Origin, command: str) -> ReportSection:
    """Return the section on reproducing the result: origin of the model, command of the report."""
    provenance, current_versions = source.provenance, source.versions
    model_versions = provenance.versions
    rows = [
        ("command", command),
        ("model", provenance.name),
        ("date of the model's files", provenance.date),
        ("model's digest", provenance.digest),
        ("seed of the identification", str(provenance.seed)),
        ("sampling time", f"{source.step_s:g} s"),
        *(
            (f"set by hand: {direction}", ", ".join(f"{name} = {value:g}" for name, value in values.items()))
            for direction, values in provenance.set_by_hand.items()
        ),
        *(
            (f"version of {name}", _versions(model_versions.get(name), current_versions.get(name)))
            for name in {**model_versions, **current_versions}
        ),
    ]
    note = Text(
        "The same logs, model and versions give the same figures; on another processor the last digits "
        "may differ. The hashes of the logs are in the table of logs."
    )
    origin_table = Table("Origin", ("what", "value"), tuple(row for row in rows if row[1]))
    settings = tuple(_toml_rows(_by_section(provenance.settings)))
    settings_table = Table("Settings of the identification", ("setting", "value"), settings)
    return ReportSection("How to reproduce", (note, origin_table, *([settings_table] if settings else [])))


def _by_section(settings: Mapping[str, object]) -> Mapping[str, object]:
    """Return settings in the sections of the settings file: those of each direction under its name."""
    sections = {name: value for name, value in settings.items() if name not in ("structure", "dead_zones")}
    forms, dead_zones = settings.get("structure"), settings.get("dead_zones")
    for direction, form in forms.items() if isinstance(forms, Mapping) else ():
        known_dead_zones = dead_zones if isinstance(dead_zones, Mapping) else {}
        automatic = {"structure": "automatic"} if form.get("automatic") else {}
        values = {name: value for name, value in form.items() if name != "automatic"}
        sections[direction] = automatic | values | {"dead_zone": known_dead_zones.get(direction)}
    return sections


def _toml_rows(settings: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield key and value of each setting in TOML; settings without a value are left out."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _toml_rows(value, f"{prefix}{name}.")
        elif value is not None:
            yield f"{prefix}{name}", json.dumps(value, ensure_ascii=False)


def _versions(model_version: str | None, current_version: str | None) -> str:
    if model_version == current_version or current_version is None:
        return model_version or ""
    if model_version is None:
        return current_version
    return f"{model_version} at identification, {current_version} now"
