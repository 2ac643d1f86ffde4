"""The logs of a validation: what each was used for, what was found in them, and their hashes."""

import hashlib
from pathlib import Path

from hitchid import audit
from hitchid.audit import AuditFinding
from hitchid.data.campaign import Campaign
from hitchid.data.record import CYCLE, IDLE, RAMP, Record
from hitchid.inspection.inspect_logs import inspect_campaign
from hitchid.model import Hitch
from hitchid.report.document import (
    Block,
    Finding,
    Findings,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Text,
    sentence,
)
from hitchid.report.figures import timeline
from hitchid.validation import Table

LEVELS = {audit.Severity.FAULT: Rating.BAD, audit.Severity.WARNING: Rating.CAUTION}
MAX_MIXED_SHOWN = 2
HASH_DIGITS = 16


def logs(campaign: Campaign, model: Hitch) -> ReportSection:
    """Return the section on the logs: the audit's findings, every log, mixed ones as a picture."""
    inspection = inspect_campaign(campaign, model.command_thresholds)
    findings = tuple(
        _report_finding(finding) for finding in inspection.findings if finding.severity in LEVELS
    )
    notices = (*campaign.notices, *inspection.notices)
    findings += tuple(Finding(Rating.CAUTION, sentence(str(notice))) for notice in notices)
    summary: Block = Findings(findings) if findings else Text("The audit of the logs found nothing to mend.")
    blocks: list[Block] = [summary, _table(campaign, model)]
    if inspection.mixed:
        shown_logs = inspection.mixed[:MAX_MIXED_SHOWN]
        names = ", ".join(log.name for log in shown_logs)
        picture = Picture(
            "timeline",
            timeline([(log.record, log.segments) for log in shown_logs]),
            f"What mixed logs do, stretch by stretch: {names} ({len(inspection.mixed)} in all).",
            f"Displacement and commands of {names} over time, coloured by what the hitch does.",
            wide=True,
        )
        blocks.append(Pictures((picture,)))
    return ReportSection("Logs", tuple(blocks))


def _report_finding(finding: AuditFinding) -> Finding:
    prefix = f"{finding.record}: " if finding.record else ""
    return Finding(LEVELS[finding.severity], f"{prefix}{finding.check}: {finding.what}; {finding.advice}.")


def _table(campaign: Campaign, model: Hitch) -> Table:
    hashes: dict[Path, str] = {}
    rows = tuple(
        (
            record.name,
            record.kind,
            _usage(record, model),
            str(len(record)),
            f"{record.step_s:.4g}",
            f"{(len(record) - 1) * record.step_s:.4g}",
            _digest(record.source, hashes),
        )
        for record in campaign.records
    )
    header = (
        "log",
        "kind",
        "used as",
        "samples",
        "step / s",
        "duration / s",
        f"SHA-256, first {HASH_DIGITS}",
    )
    return Table(f"{len(rows)} logs", header, rows)


def _usage(record: Record, model: Hitch) -> str:
    """Return what a log was to the model; of a cycle cut into strokes all strokes are known by its name."""
    provenance = model.provenance
    if record.kind == RAMP:
        return "dead zone's ramp"
    if record.kind == IDLE or (record.kind == CYCLE and len(model.channels) < 2):
        return "not used"
    if record.fingerprint in provenance.seen:
        stopping = any(record.name in names for names in provenance.validation.values())
        strokes = ", by strokes" if record.kind == CYCLE else ""
        return "validation while training" if stopping else f"identification{strokes}"
    if record.kind == CYCLE:
        return "unseen cycle"
    return "unseen test" if record.kind in model.channels else "not used"


def _digest(path: Path | None, cache: dict[Path, str]) -> str:
    if path is None or not path.is_file():
        return ""
    if path not in cache:
        with path.open("rb") as file:
            cache[path] = hashlib.file_digest(file, "sha256").hexdigest()[:HASH_DIGITS]
    return cache[path]
