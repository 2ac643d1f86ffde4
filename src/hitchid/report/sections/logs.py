"""The logs of a validation: use of each, findings of the audit, and their hashes."""

from collections.abc import Sequence

from hitchid.audit import AuditFinding, Severity
from hitchid.report import figure_data, numbers
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
from hitchid.report.figures import timeline
from hitchid.validation.report_data import HASH_DIGITS, LogData, LogUse

LEVELS = {Severity.FAULT: Rating.BAD, Severity.WARNING: Rating.CAUTION}
MAX_MIXED_SHOWN = 2  # mixed logs in the figure; chosen


def logs(data: LogData) -> ReportSection:
    """Return the section on the logs: findings of the audit, every log, figures of mixed ones."""
    inspection = data.inspection
    findings = tuple(
        _report_finding(finding) for finding in inspection.findings if finding.severity in LEVELS
    )
    notices = (*data.notices, *inspection.notices)
    findings += tuple(Finding(Rating.CAUTION, sentence(str(notice))) for notice in notices)
    summary: Block = Findings(findings) if findings else Text("The audit of the logs found no problems.")
    blocks: list[Block] = [summary, _table(data.logs)]
    if inspection.mixed:
        shown_logs = inspection.mixed[:MAX_MIXED_SHOWN]
        segmented_logs = [(log.record, log.segments) for log in shown_logs]
        names = ", ".join(log.name for log in shown_logs)
        picture = Picture(
            "timeline",
            timeline(segmented_logs),
            f"Segments of mixed logs: {names} ({len(inspection.mixed)} in total).",
            f"Displacement and commands of {names} over time, coloured by segment.",
            wide=True,
            data=figure_data.timeline(segmented_logs),
        )
        blocks.append(Pictures((picture,)))
    return ReportSection("Logs", tuple(blocks))


def _report_finding(finding: AuditFinding) -> Finding:
    prefix = f"{finding.record}: " if finding.record else ""
    return Finding(LEVELS[finding.severity], f"{prefix}{finding.check}: {finding.what}; {finding.advice}.")


def _table(logs: Sequence[LogUse]) -> Table:
    rows = tuple(
        (
            log.name,
            log.kind,
            log.used_as,
            str(log.samples),
            numbers.digits(log.step_s),
            numbers.digits(log.duration_s),
            log.digest,
        )
        for log in logs
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
