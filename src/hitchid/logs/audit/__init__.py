"""Audit of logs before an identification: faults that would bias a model, their place and remedy.

Every check yields findings of one kind; here they are merged and sorted.
"""

from collections.abc import Callable

import numpy as np

from hitchid._support.records import Severity as Severity
from hitchid.logs.audit.campaign_checks import (
    changes,
    drift,
    little_motion,
    one_sided_split,
    ramp_onsets,
    short_or_idle,
    start_positions,
    too_few_tests,
    weak_commands,
)
from hitchid.logs.audit.clock_checks import (
    coarse,
    current_lag,
    gaps,
    motion_before_command,
    not_measured,
    steps,
    time_unit,
)
from hitchid.logs.audit.command_checks import CommandResponse as CommandResponse
from hitchid.logs.audit.command_checks import both_valves, idle_commands, neutral, signs
from hitchid.logs.audit.command_checks import rest_level as rest_level
from hitchid.logs.audit.context import AuditFinding as AuditFinding
from hitchid.logs.audit.context import CampaignContext, Findings, RecordContext, join_names
from hitchid.logs.audit.context import Quality as Quality
from hitchid.logs.audit.context import campaign_context as campaign_context
from hitchid.logs.audit.context import quality as quality
from hitchid.logs.audit.end_stops import end_stops
from hitchid.logs.audit.end_stops import find_end_stop as find_end_stop
from hitchid.logs.audit.end_stops import find_end_stops as find_end_stops
from hitchid.logs.audit.feedback import Feedback as Feedback
from hitchid.logs.audit.feedback import feedback
from hitchid.logs.audit.feedback import feedback_of as feedback_of
from hitchid.logs.audit.resolution import jumps, noisy, quantisation, spikes, update_rate
from hitchid.logs.audit.resolution import update_interval as update_interval
from hitchid.logs.audit.signal_checks import stuck_sensors, units, units_of_logs
from hitchid.logs.campaign import Campaign

MIN_MERGED = 4  # records with the same finding, from which on they are merged (chosen)
RECORD_CHECKS: tuple[Callable[[RecordContext], Findings], ...] = (
    not_measured,
    steps,
    coarse,
    update_rate,
    quantisation,
    noisy,
    spikes,
    jumps,
    current_lag,
    both_valves,
    little_motion,
    short_or_idle,
)
CAMPAIGN_CHECKS: tuple[Callable[[CampaignContext], Findings], ...] = (
    units,
    time_unit,
    gaps,
    stuck_sensors,
    end_stops,
    motion_before_command,
    signs,
    neutral,
    feedback,
)
DIRECTION_CHECKS: tuple[Callable[[CampaignContext, str], Findings], ...] = (
    units_of_logs,
    idle_commands,
    drift,
    start_positions,
    ramp_onsets,
    changes,
    one_sided_split,
    too_few_tests,
    weak_commands,
)


def audit(campaign: Campaign) -> tuple[AuditFinding, ...]:
    """Check a campaign's logs for faults that would bias a model; changes nothing.

    Args:
        campaign: tests of one plant.

    Returns:
        Findings by severity, then check, then record in the campaign's order; a finding shared by four or
        more records is merged into one.
    """
    if not campaign.records:
        return ()
    # Values near the limits of a float overflow in the checks; such results count as implausible.
    with np.errstate(all="ignore"):
        context = campaign_context(campaign)
        findings = [finding for test in context.tests for check in RECORD_CHECKS for finding in check(test)]
        for check in CAMPAIGN_CHECKS:
            findings += check(context)
        for check in DIRECTION_CHECKS:
            for direction in context.directions:
                findings += check(context, direction)
    # A finding on the whole campaign comes before those on its records.
    order = {record.name: rank for rank, record in enumerate(campaign.records)}
    severities = {severity: rank for rank, severity in enumerate(Severity)}
    # Four or more findings that differ only in record and numbers become one.
    alike: dict[tuple[str, Severity, str, str], list[AuditFinding]] = {}
    for finding in findings:
        key = (finding.check, finding.severity, finding.signal, finding.advice)
        alike.setdefault(key, []).append(finding)
    merged = []
    for (check, severity, signal, advice), group in alike.items():
        names = list(dict.fromkeys(finding.record for finding in group if finding.record))
        # By the number of records: one log may have many findings of a kind.
        if len(names) < MIN_MERGED:
            merged += group
            continue
        count = f"in {len(names)} of {len(campaign.records)} tests ({join_names(names)})"
        what = f"{count}; in {names[0]}: {group[0].what}"
        merged.append(AuditFinding(check, severity, "", signal, (), what, advice, tuple(group)))
    return tuple(sorted(merged, key=lambda f: (severities[f.severity], f.check, order.get(f.record, -1))))
