"""A look at logs before any fit: what each one is, how it was sampled, what is wrong with it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hitchid.audit import AuditFinding, audit, quality
from hitchid.data.campaign import Campaign
from hitchid.data.left_out import LeftOut, sentences
from hitchid.data.record import CYCLE, DIRECTIONS, Record
from hitchid.data.segmentation import CommandThreshold, Segment, durations_s, segments
from hitchid.data.test_kinds import full_scales
from hitchid.errors import HitchError
from hitchid.readers import assemble, find_logs, read_logs, settings_of

ThresholdLookup = Callable[[Mapping[str, str]], Mapping[str, CommandThreshold]]


@dataclass(frozen=True)
class Inspection:
    """What was found in a folder of logs.

    Attributes:
        records: one entry a record: name, kind, held out or not, samples, step, duration, each signal's unit
            and range, how good its displacement is, and of a mixed one its stretches of lift, hold, lower and
            so on.
        notices: what was done to logs on the way in, each naming its record.
        faults: why logs cannot be used at all, each naming file, line, column.
        findings: what in the logs would spoil a model, where, and what to do about it.
        mixed: the mixed records with their stretches.
        inspected: every record.
        left_out: logs that cannot be used beside those that can.
    """

    records: tuple[Mapping[str, object], ...]
    notices: tuple[str, ...]
    faults: tuple[str, ...]
    findings: tuple[AuditFinding, ...] = ()
    mixed: tuple[tuple[Record, tuple[Segment, ...]], ...] = ()
    inspected: tuple[Record, ...] = ()
    left_out: tuple[LeftOut, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is left out and why, and how much of all."""
        return sentences(self.left_out, len(self.left_out) + len(self.records), "logs")

    def describe(self) -> dict[str, list]:
        """Return everything as JSON can hold it."""
        return {
            "records": list(self.records),
            "notices": list(self.notices),
            "faults": list(self.faults),
            "left_out": [item.describe() for item in self.left_out],
            "findings": [finding.describe() for finding in self.findings],
        }


def inspect(
    logs: str | Path | Iterable[str | Path],
    *,
    signals: str | Path | None = None,
    command_thresholds: ThresholdLookup | None = None,
    strict: bool = False,
) -> Inspection:
    """Look at logs one by one, going on past those that cannot be used; changes nothing.

    Args:
        logs: files and folders.
        signals: a file like `campaign.toml`; without it each folder's own counts.
        command_thresholds: from the logs' units to how each mode hears its command, where a model tells.
        strict: whether a log that cannot be used is a fault.

    Raises:
        InputError: there are no logs.
        SettingsError: a settings file cannot be used.
    """
    paths = find_logs(logs)
    settings = settings_of(paths, signals)
    records, unread = read_logs(paths, settings)
    faults = tuple(str(item.error) for item in unread)
    if not records:
        return Inspection((), (), faults)
    try:
        campaign = assemble(records, settings, unread, strict=strict)
    except HitchError as error:
        entries = tuple({**_entry(record, False), "kind": "not told"} for record in records)
        return Inspection(entries, (), (*faults, str(error)))
    inspection = inspect_campaign(campaign, command_thresholds)
    return replace(inspection, faults=faults, left_out=()) if strict else inspection


def inspect_campaign(campaign: Campaign, command_thresholds: ThresholdLookup | None = None) -> Inspection:
    """Look at logs that have been read.

    Args:
        campaign: the tests.
        command_thresholds: as for `inspect`.

    Raises:
        SettingsError: the model's commands are of another dimension than the logs'.
    """
    held_out = {record.name for direction in DIRECTIONS for record in campaign.held_out(direction)}
    scales = full_scales(campaign.records)
    thresholds = None if command_thresholds is None else command_thresholds(campaign.units)
    mixed = {
        record.name: (record, tuple(segments(record, scales, thresholds)))
        for record in campaign.of_kind(CYCLE)
    }
    return Inspection(
        records=tuple(
            _entry(record, record.name in held_out) | _segment_entries(*mixed.get(record.name, (record, ())))
            for record in campaign.records
        ),
        notices=tuple(f"{record.name}: {notice}" for record in campaign.records for notice in record.notices),
        faults=(),
        findings=audit(campaign),
        mixed=tuple(mixed.values()),
        inspected=campaign.records,
        left_out=campaign.left_out,
    )


def _segment_entries(record: Record, found_segments: Sequence[Segment]) -> dict[str, object]:
    if not found_segments:
        return {}
    start, step = record.start_s, record.step_s
    return {
        "durations_s": durations_s(found_segments, step),
        "segments": [
            {
                "label": segment.label,
                "start_s": round(start + segment.start * step, 6),
                "stop_s": round(start + segment.stop * step, 6),
            }
            for segment in found_segments
        ],
    }


def _entry(record: Record, held_out: bool) -> dict[str, object]:
    return {
        "name": record.name,
        "kind": record.kind,
        "held_out": held_out,
        "samples": len(record),
        "step_s": record.step_s,
        "duration_s": round((len(record) - 1) * record.step_s, 6),
        "signals": {
            role: {
                "unit": record.units[role],
                "lowest": float(np.min(samples)),
                "highest": float(np.max(samples)),
            }
            for role, samples in record.signals.items()
        },
        "quality": quality(record).describe(),
    }
