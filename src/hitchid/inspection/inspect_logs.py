"""Inspection of logs before an identification: kind, sampling, signals and faults of each log."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hitchid._support.summary import count
from hitchid.audit import audit, quality
from hitchid.data.campaign import Campaign
from hitchid.data.left_out import LeftOut
from hitchid.data.not_measured import NOT_MEASURED
from hitchid.data.record import CYCLE, DIRECTIONS
from hitchid.data.segmentation import CommandThreshold, segments
from hitchid.data.test_kinds import full_scales
from hitchid.errors import HitchError
from hitchid.inspection.results import UNCLASSIFIED, InspectedRecord, Inspection
from hitchid.readers import assemble, find_logs, read_logs, settings_of

ThresholdLookup = Callable[[Mapping[str, str]], Mapping[str, CommandThreshold]]
"""Returns direction to command threshold for the units of the logs, role to unit."""


def inspect(
    logs: str | Path | Iterable[str | Path],
    *,
    signals: str | Path | None = None,
    command_thresholds: ThresholdLookup | None = None,
    strict: bool = False,
) -> Inspection:
    """Inspect logs; a log that cannot be read does not prevent the inspection of others. Changes nothing.

    Args:
        logs: files and folders.
        signals: settings file like `campaign.toml`; by default that of each folder.
        command_thresholds: returns the thresholds of a model; by default 5 % of full scale.
        strict: whether a log that cannot be used is a fault.

    Raises:
        InputError: there are no logs.
        SettingsError: a settings file cannot be used.
    """
    paths = find_logs(logs)
    settings = settings_of(paths, signals)
    records, unread = read_logs(paths, settings)
    faults = _faults(unread)
    if not records:
        return Inspection(faults=faults)
    try:
        campaign = assemble(records, settings, unread, strict=strict)
    except HitchError as error:
        entries = tuple(InspectedRecord(r, UNCLASSIFIED, False, quality(r)) for r in records)
        return Inspection(entries, faults=(*faults, str(error)))
    inspection = inspect_campaign(campaign, command_thresholds)
    return replace(inspection, faults=faults, left_out=()) if strict else inspection


def _faults(unread: Sequence[LeftOut]) -> tuple[str, ...]:
    """Return one sentence for each reason: a missing column is missing in every log of a campaign."""
    by_reason: dict[str, list[LeftOut]] = {}
    for item in unread:
        by_reason.setdefault(item.reason, []).append(item)
    others = {reason: count(len(items) - 1, "more log") for reason, items in by_reason.items() if items[1:]}
    return tuple(
        f"{items[0].error}" + (f"; the same in {others[reason]}" if reason in others else "")
        for reason, items in by_reason.items()
    )


def inspect_campaign(campaign: Campaign, command_thresholds: ThresholdLookup | None = None) -> Inspection:
    """Inspect the logs of a campaign.

    Args:
        campaign: the tests.
        command_thresholds: as for `inspect`.

    Raises:
        InputError: the commands of model and logs differ in dimension.
    """
    held_out = {record.name for direction in DIRECTIONS for record in campaign.held_out(direction)}
    scales = full_scales(campaign.records)
    thresholds = None if command_thresholds is None else command_thresholds(campaign.units)
    return Inspection(
        records=tuple(
            InspectedRecord(
                record,
                record.kind,
                record.name in held_out,
                quality(record),
                tuple(segments(record, scales, thresholds)) if record.kind == CYCLE else (),
            )
            for record in campaign.records
        ),
        notices=tuple(
            notice.at(record.name)
            for record in campaign.records
            for notice in record.notices
            if notice.code != NOT_MEASURED  # the audit finds it
        ),
        findings=audit(campaign),
        left_out=campaign.left_out,
    )
