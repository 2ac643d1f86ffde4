"""Input of the checks: a record with its quality, and the campaign."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hitchid._support.notices import Severity
from hitchid.audit.finding import AuditFinding, spans_of
from hitchid.audit.quality import Quality, quality
from hitchid.data.campaign import Campaign
from hitchid.data.record import COMMAND, DISPLACEMENT, Record
from hitchid.data.test_kinds import ACTIVE_FRACTION, full_scales


@dataclass(frozen=True, eq=False)
class RecordContext:
    """A record, its quality, and the scales of its campaign.

    Attributes:
        record: the record.
        scales: direction to full scale, the largest command of the campaign.
        campaign_range: range of all displacements of the campaign, in their unit.
        quality: of the record's displacement.
    """

    record: Record
    scales: Mapping[str, float]
    campaign_range: float
    quality: Quality

    def active(self, direction: str) -> np.ndarray:
        """Return where a direction's command is above 5 % of full scale, shape [N]."""
        return np.abs(self.record.command(direction)) > ACTIVE_FRACTION * self.scales[direction]

    def any_active(self) -> np.ndarray:
        """Return where any command is above 5 % of full scale, shape [N]."""
        first, *rest = (self.active(direction) for direction in self.record.directions)
        for other in rest:
            first |= other
        return first

    def finding(
        self,
        check: str,
        severity: Severity,
        what: str,
        advice: str,
        *,
        signal: str = DISPLACEMENT,
        intervals: list[tuple[int, int]] | None = None,
    ) -> AuditFinding:
        """Return a finding about this record, at samples `start:stop`."""
        return AuditFinding(
            check, severity, self.record.name, signal, spans_of(self.record, intervals or []), what, advice
        )


@dataclass(frozen=True, eq=False)
class CampaignContext:
    """A campaign with the context of each record, in the campaign's order."""

    campaign: Campaign
    tests: tuple[RecordContext, ...]
    scales: Mapping[str, float]
    campaign_range: float

    def of_kind(self, kind: str) -> list[RecordContext]:
        """Return the contexts of the records of one kind."""
        return [test for test in self.tests if test.record.kind == kind]


def campaign_context(campaign: Campaign) -> CampaignContext:
    """Return the context of a campaign with at least one record."""
    scales = full_scales(campaign.records)
    qualities = [quality(record) for record in campaign.records]
    lowest = min(test_quality.lowest for test_quality in qualities)
    campaign_range = float(np.float64(max(test_quality.highest for test_quality in qualities)) - lowest)
    tests = tuple(
        RecordContext(record, scales, campaign_range, test_quality)
        for record, test_quality in zip(campaign.records, qualities, strict=True)
    )
    return CampaignContext(campaign, tests, scales, campaign_range)


def command_unit(record: Record, direction: str) -> str:
    """Return the unit of a direction's command as printed after a number."""
    unit = record.units[COMMAND[direction]]
    return {"1": "(full = 1)", "percent": "%"}.get(unit, unit)


def travel(context: RecordContext, direction: str) -> float:
    """Return the travel while only one direction's command is active, in the displacement's unit.

    Σ sign(c[k]) (y[k+1] − y[k]) over those samples; a negative command of a single channel is the
    opposite direction.
    """
    record = context.record
    only_active = context.active(direction)
    for other in record.directions:
        if other != direction:
            only_active &= ~context.active(other)
    signs = np.sign(record.command(direction)[:-1])
    signs *= only_active[:-1]
    # Two scalar products need no array of differences.
    signed_travel = np.dot(signs, record.displacement[1:]) - np.dot(signs, record.displacement[:-1])
    return float(signed_travel) if np.isfinite(signed_travel) else 0.0


def join_names(names: list[str], shown: int = 3) -> str:
    """Return the first names, joined by commas."""
    return ", ".join(names[:shown]) + (" …" if len(names) > shown else "")
