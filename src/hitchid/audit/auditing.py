"""All checks on a campaign, their findings merged and put in order."""

from collections.abc import Callable

import numpy as np

from hitchid.audit.clocks import leading_current, motion_first
from hitchid.audit.commands import both_valves, idle_commands
from hitchid.audit.directions import signs
from hitchid.audit.excitation import amount, changes, little_motion, short_or_idle
from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Look, Survey, named, survey
from hitchid.audit.neutral import neutral
from hitchid.audit.ranges import units
from hitchid.audit.repeats import drift, ramp_onsets, start_positions
from hitchid.audit.resolution import noisy, quantisation, renewal
from hitchid.audit.sampling import coarse, gaps, steps
from hitchid.audit.spikes import jumps, spikes
from hitchid.audit.standing import standing
from hitchid.audit.stops import end_stops
from hitchid.data.campaign import Campaign

MERGED_FROM = 4
OF_RECORD: tuple[Callable[[Look], list[AuditFinding]], ...] = (
    steps,
    coarse,
    renewal,
    quantisation,
    noisy,
    spikes,
    jumps,
    leading_current,
    end_stops,
    both_valves,
    little_motion,
    short_or_idle,
)
OF_CAMPAIGN: tuple[Callable[[Survey], list[AuditFinding]], ...] = (
    units,
    gaps,
    standing,
    motion_first,
    signs,
    neutral,
    idle_commands,
    drift,
    start_positions,
    ramp_onsets,
    changes,
    amount,
)


def audit(campaign: Campaign) -> tuple[AuditFinding, ...]:
    """Look for what in a campaign's logs would spoil a model; changes nothing.

    Args:
        campaign: tests of one plant.

    Returns:
        Findings by level, then check, then record in the campaign's order; what four or more records share
        is one finding that names them.
    """
    if not campaign.records:
        return ()
    # Values near the largest or smallest a float can hold overflow on the way to "implausible".
    with np.errstate(all="ignore"):
        whole = survey(campaign)
        found = [finding for look in whole.looks for check in OF_RECORD for finding in check(look)]
        found += [finding for check in OF_CAMPAIGN for finding in check(whole)]
    order = {record.name: place for place, record in enumerate(campaign.records)}
    levels = {level: place for place, level in enumerate(Level)}
    merged = _merged(found, len(campaign.records))
    return tuple(sorted(merged, key=lambda f: (levels[f.level], f.check, order.get(f.record, -1))))


def _merged(found: list[AuditFinding], total: int) -> list[AuditFinding]:
    """Make one finding of each four or more that differ in their record and numbers alone."""
    alike: dict[tuple[str, Level, str, str], list[AuditFinding]] = {}
    for finding in found:
        key = (finding.check, finding.level, finding.signal, finding.advice)
        alike.setdefault(key, []).append(finding)
    merged = []
    for (check, level, signal, advice), group in alike.items():
        names = list(dict.fromkeys(finding.record for finding in group if finding.record))
        if len(names) < MERGED_FROM:
            merged += group
            continue
        what = f"in {len(names)} of {total} tests ({named(names)}); in {names[0]}: {group[0].what}"
        merged.append(AuditFinding(check, level, "", signal, (), what, advice, tuple(group)))
    return merged
