"""Results of an inspection of logs: one entry per record, notices and findings."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from hitchid._support.notices import Notice
from hitchid._support.short_repr import short_repr
from hitchid.audit import AuditFinding, Quality
from hitchid.data.left_out import LeftOut, left_out_notices
from hitchid.data.record import CYCLE, Record
from hitchid.data.segmentation import Segment, durations_s

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
