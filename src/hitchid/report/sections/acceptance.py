"""Limits, and whether they hold."""

from hitchid.report.document import Finding, Findings, Rating, ReportSection
from hitchid.validation import Acceptance, Table


def limits(acceptance: Acceptance) -> ReportSection:
    """Return the section on limits: what fails first, then all of them."""
    rows = tuple(
        (check.name, check.limit, check.found, "pass" if check.passed else "fail")
        for check in acceptance.checks
    )
    failed = tuple(
        Finding(Rating.BAD, f"{check.name}: {check.found}, required {check.limit}.")
        for check in acceptance.checks
        if not check.passed
    )
    table = Table("Limits", ("figure", "required", "found", "verdict"), rows)
    return ReportSection("Acceptance", ((Findings(failed), table) if failed else (table,)))
