"""Acceptance limits and the figures they apply to."""

from hitchid.report.document import Finding, Findings, Rating, ReportSection, Table
from hitchid.validation import Acceptance, Check


def limits(acceptance: Acceptance) -> ReportSection:
    """Return the section on limits: failed ones first, then all of them."""
    rows = tuple(
        (check.name, check.limit, check.figure, "pass" if check.passed else "fail")
        for check in acceptance.checks
    )
    failed = tuple(
        Finding(Rating.BAD, f"{check.name}: {check.figure}, required {check.limit}.")
        for check in acceptance.checks
        if not check.passed
    )
    table = Table("Limits", ("figure", "required", "found", "verdict"), rows)
    return ReportSection("Acceptance", ((Findings(failed), table) if failed else (table,)))


def check_line(check: Check) -> str:
    """Return a check as one line; unprintable characters, as in names of logs, are replaced."""
    verdict = "pass" if check.passed else "fail"
    text = f"{verdict}  {check.name} {check.figure}, required {check.limit}"
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)
