"""Inspection of logs before an identification: kind, sampling, signals and faults of each log."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from hitchid._support.numbers import count
from hitchid._support.records import Notice, short_repr
from hitchid.errors import HitchError
from hitchid.logs.audit import AuditFinding, Quality, audit
from hitchid.logs.audit.context import quality
from hitchid.logs.campaign import Campaign
from hitchid.logs.kinds import CommandThreshold, Segment, durations_s, full_scales, segments
from hitchid.logs.not_measured import NOT_MEASURED
from hitchid.logs.reading import assemble, find_logs, read_logs, settings_of
from hitchid.logs.record import CYCLE, DIRECTIONS, Record
from hitchid.logs.unification import LeftOut, left_out_notices

# Results of an inspection of logs: one entry per record, notices and findings.

UNCLASSIFIED = "not told"  # kind of a record whose campaign cannot be assembled; a value in JSON


@dataclass(frozen=True)
class SignalRange:
    """Unit of a signal with its smallest and largest sample."""

    unit: str
    lowest: float
    highest: float


@short_repr
@dataclass(frozen=True)
class InspectedRecord:
    """Result of the inspection of one record, a log or part of one.

    Attributes:
        record: its samples.
        kind: kind of test.
        held_out: whether the test is held out from identification.
        quality: clock, resolution and noise of the displacement.
        segments: intervals of lifting, hold, lowering, …; empty for a record that is not mixed.
    """

    record: Record
    kind: str
    held_out: bool
    quality: Quality
    segments: tuple[Segment, ...] = ()

    @property
    def name(self) -> str:
        """Name of the record."""
        return self.record.name

    @property
    def signals(self) -> Mapping[str, SignalRange]:
        """Role to unit and range."""
        return {
            role: SignalRange(self.record.units[role], float(np.min(samples)), float(np.max(samples)))
            for role, samples in self.record.signals.items()
        }

    @property
    def durations_s(self) -> Mapping[str, float]:
        """Label of a segment to its total duration, s."""
        return durations_s(self.segments, self.record.step_s)

    def describe(self) -> dict[str, object]:
        """Return the content of JSON output."""
        start_s, step_s = self.record.start_s, self.record.step_s
        entry: dict[str, object] = {
            "name": self.name,
            "kind": self.kind,
            "held_out": self.held_out,
            "samples": len(self.record),
            "step_s": step_s,
            "duration_s": round(self.quality.duration_s, 6),
            "signals": {role: asdict(signal) for role, signal in self.signals.items()},
            "quality": self.quality.describe(),
        }
        if self.segments:
            entry["durations_s"] = self.durations_s
            entry["segments"] = [
                {
                    "label": segment.label,
                    "start_s": round(start_s + segment.start * step_s, 6),
                    "stop_s": round(start_s + segment.stop * step_s, 6),
                }
                for segment in self.segments
            ]
        return entry


@short_repr
@dataclass(frozen=True)
class Inspection:
    """Result of an inspection of logs.

    Attributes:
        records: one entry per record.
        notices: changes made to logs in reading, each with its record as place.
        faults: reasons why logs cannot be used, each once, with file, line and column.
        findings: audit findings.
        left_out: logs that cannot be used, if others can.
    """

    records: tuple[InspectedRecord, ...] = ()
    notices: tuple[Notice, ...] = ()
    faults: tuple[str, ...] = ()
    findings: tuple[AuditFinding, ...] = ()
    left_out: tuple[LeftOut, ...] = ()

    @property
    def usable(self) -> tuple[InspectedRecord, ...]:
        """Records that form a campaign."""
        return tuple(record for record in self.records if record.kind != UNCLASSIFIED)

    @property
    def mixed(self) -> tuple[InspectedRecord, ...]:
        """Records with both directions."""
        return tuple(record for record in self.records if record.kind == CYCLE)

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Logs left out with the reason, and their number."""
        return left_out_notices(self.left_out, len(self.left_out) + len(self.records), "logs")

    def describe(self) -> dict[str, list]:
        """Return the content of JSON output."""
        return {
            "records": [record.describe() for record in self.records],
            "notices": list(map(str, self.notices)),
            "faults": list(self.faults),
            "left_out": [item.describe() for item in self.left_out],
            "findings": [finding.describe() for finding in self.findings],
        }


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
    # One sentence for each reason: a missing column is missing in every log of a campaign.
    by_reason: dict[str, list[LeftOut]] = {}
    for item in unread:
        by_reason.setdefault(item.reason, []).append(item)
    faults = tuple(
        f"{first.error}; the same in {count(len(others), 'more log')}" if others else f"{first.error}"
        for first, *others in by_reason.values()
    )
    if not records:
        return Inspection(faults=faults)
    # Each log may be fine and no two of them fit together: then they are listed all the same.
    try:
        campaign = assemble(records, settings, unread, strict=strict)
    except HitchError as error:
        entries = tuple(InspectedRecord(r, UNCLASSIFIED, False, quality(r)) for r in records)
        return Inspection(entries, faults=(*faults, str(error)))
    inspection = inspect_campaign(campaign, command_thresholds)
    return replace(inspection, faults=faults, left_out=()) if strict else inspection


def inspect_campaign(campaign: Campaign, command_thresholds: ThresholdLookup | None = None) -> Inspection:
    """Inspect the logs of a campaign; `command_thresholds` as for `inspect`.

    Raises:
        InputError: the commands of model and logs differ in dimension.
    """
    held_out = {record.name for direction in DIRECTIONS for record in campaign.held_out(direction)}
    # Of all logs: 5 % of the largest command of one idle log would be noise.
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
