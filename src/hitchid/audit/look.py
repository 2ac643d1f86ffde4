"""What the checks share: a record with its quality, and all of a campaign."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hitchid.audit.finding import AuditFinding, Level, spans_of
from hitchid.audit.quality import Quality, quality
from hitchid.data.campaign import Campaign
from hitchid.data.record import COMMAND, DISPLACEMENT, Record
from hitchid.data.test_kinds import ACTIVE_FRACTION, full_scales


@dataclass(frozen=True, eq=False)
class Look:
    """A record as its checks see it.

    Attributes:
        record: the record.
        scales: mode to the largest command of the campaign.
        reach: range of all displacements of the campaign, in their unit.
        quality: of the record's displacement.
    """

    record: Record
    scales: Mapping[str, float]
    reach: float
    quality: Quality

    def active(self, mode: str) -> np.ndarray:
        """Tell where a mode's command is above 5 % of full scale, shape [N]."""
        return np.abs(self.record.command(mode)) > ACTIVE_FRACTION * self.scales[mode]

    def any_active(self) -> np.ndarray:
        """Tell where any command is above 5 % of full scale, shape [N]."""
        first, *rest = (self.active(mode) for mode in self.record.modes)
        for other in rest:
            first |= other
        return first

    def finding(
        self,
        check: str,
        level: Level,
        what: str,
        advice: str,
        *,
        signal: str = DISPLACEMENT,
        at: list[tuple[int, int]] | None = None,
    ) -> AuditFinding:
        """Return a finding about this record, at samples `start:stop`."""
        return AuditFinding(
            check, level, self.record.name, signal, spans_of(self.record, at or []), what, advice
        )


@dataclass(frozen=True, eq=False)
class Survey:
    """A campaign as its checks see it: with one look at each record, in the campaign's order."""

    campaign: Campaign
    looks: tuple[Look, ...]
    scales: Mapping[str, float]
    reach: float

    def of_kind(self, kind: str) -> list[Look]:
        """Return the looks at the records of one kind."""
        return [look for look in self.looks if look.record.kind == kind]


def survey(campaign: Campaign) -> Survey:
    """Look at every record of a campaign that has at least one."""
    scales = full_scales(campaign.records)
    qualities = [quality(record) for record in campaign.records]
    lowest = min(each.lowest for each in qualities)
    reach = float(np.float64(max(each.highest for each in qualities)) - lowest)
    looks = tuple(
        Look(record, scales, reach, each) for record, each in zip(campaign.records, qualities, strict=True)
    )
    return Survey(campaign, looks, scales, reach)


def command_unit(record: Record, mode: str) -> str:
    """Return the unit of a mode's command as it stands behind a number; a plain ratio has none."""
    unit = record.units[COMMAND[mode]]
    return {"1": "(full = 1)", "percent": "%"}.get(unit, unit)


def travel(look: Look, mode: str) -> float:
    """Return how far the displacement goes while one mode's command alone is active, in its unit.

    Σ sign(c[k]) (y[k+1] − y[k]) over the samples at which it is; a single channel's negative command counts
    as the opposite way.
    """
    record = look.record
    alone = look.active(mode)
    for other in record.modes:
        if other != mode:
            alone &= ~look.active(other)
    signs = np.sign(record.command(mode)[:-1])
    signs *= alone[:-1]
    # Summed by parts, so that no second array of differences is needed.
    moved = np.dot(signs, record.displacement[1:]) - np.dot(signs, record.displacement[:-1])
    return float(moved) if np.isfinite(moved) else 0.0


def named(names: list[str], shown: int = 3) -> str:
    """Return names as a sentence lists them, of many the first few."""
    return ", ".join(names[:shown]) + (" …" if len(names) > shown else "")
