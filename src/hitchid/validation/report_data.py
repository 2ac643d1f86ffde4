"""Further content of a report: logs and their audit, speed over command, origin of the model."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hitchid._support.jax_setup import installed_versions
from hitchid._support.records import Notice, short_repr
from hitchid.logs.campaign import Campaign
from hitchid.logs.inspect import Inspection, inspect_campaign
from hitchid.logs.record import COMMAND, CYCLE, DISPLACEMENT, IDLE, RAMP, Record
from hitchid.model import Channel, Hitch, Provenance
from hitchid.validation.valve_map import ValveMap, valve_map

HASH_DIGITS = 16  # of the 64 hexadecimal digits of a SHA-256


@short_repr
@dataclass(frozen=True)
class LogUse:
    """One log of the campaign.

    Attributes:
        name, kind: of the record.
        used_as: part of the log in identification and validation.
        samples: number of samples.
        step_s, duration_s: sampling time and duration, s.
        digest: first digits of the SHA-256 of its file; empty where it was not read from one.
    """

    name: str
    kind: str
    used_as: str
    samples: int
    step_s: float
    duration_s: float
    digest: str


@short_repr
@dataclass(frozen=True)
class LogData:
    """The logs of a campaign and the findings of their audit.

    Attributes:
        inspection: audit and segments of mixed logs.
        notices: logs that are left out, and why.
        logs: every log.
    """

    inspection: Inspection
    notices: tuple[Notice, ...]
    logs: tuple[LogUse, ...]


@short_repr
@dataclass(frozen=True)
class DirectionData:
    """Channel, speed over command and slow ramps of one direction, in the model's units.

    Attributes:
        unit, command_unit: of displacement and command.
        channel: of the model.
        valve_map: speed over command.
        ramps: slow ramps.
    """

    unit: str
    command_unit: str
    channel: Channel
    valve_map: ValveMap
    ramps: tuple[Record, ...]


@short_repr
@dataclass(frozen=True)
class Origin:
    """Origin of a model: provenance, sampling time in s, and the versions installed now."""

    provenance: Provenance
    step_s: float
    versions: Mapping[str, str]


@short_repr
@dataclass(frozen=True)
class ReportData:
    """Content of a report other than the figures of the validation.

    Attributes:
        directions: data of each direction in both model and logs.
        logs: of the campaign.
        origin: of the model.
    """

    directions: Mapping[str, DirectionData]
    logs: LogData
    origin: Origin


def report_data(model: Hitch, campaign: Campaign) -> ReportData:
    """Return the report data of a model and the logs it was validated on."""
    segmented = (
        campaign if campaign.directions else campaign.segmented(model.segmentation_dead_zones(campaign.units))
    )
    directions = {}
    for direction in segmented.directions:
        if direction not in model.channels:
            continue
        channel = model.channels[direction]
        tests, ramps = (
            [model.to_model_units(record) for record in records]
            for records in (segmented.of_kind(direction), segmented.ramps(direction))
        )
        directions[direction] = DirectionData(
            unit=model.units[DISPLACEMENT],
            command_unit=model.units[COMMAND[direction]],
            channel=channel,
            valve_map=valve_map(channel, tests, ramps),
            ramps=tuple(ramps),
        )
    return ReportData(
        directions=directions,
        logs=log_data(model, campaign),
        origin=Origin(model.provenance, model.step_s, installed_versions()),
    )


def log_data(model: Hitch, campaign: Campaign) -> LogData:
    """Return the logs of a campaign, their use by a model, and the findings of their audit."""
    return LogData(
        inspect_campaign(campaign, model.command_thresholds), campaign.notices, log_uses(model, campaign)
    )


def log_uses(model: Hitch, campaign: Campaign) -> tuple[LogUse, ...]:
    """Return the logs of a campaign and their use by a model."""
    digests: dict[Path, str] = {}
    return tuple(
        LogUse(
            name=record.name,
            kind=record.kind,
            used_as=_use(record, model),
            samples=len(record),
            step_s=record.step_s,
            duration_s=(len(record) - 1) * record.step_s,
            digest=_digest(record.source, digests),
        )
        for record in campaign.records
    )


def _use(record: Record, model: Hitch) -> str:
    """Return the use of a log by the model; the strokes of a segmented cycle have the cycle's name."""
    provenance = model.provenance
    if record.kind == RAMP:
        return "ramp for the dead zone"
    if record.kind == IDLE or (record.kind == CYCLE and len(model.channels) < 2):
        return "not used"
    if record.fingerprint in provenance.seen:
        stopping = any(record.name in names for names in provenance.validation.values())
        strokes = ", split into strokes" if record.kind == CYCLE else ""
        return "early stopping" if stopping else f"identification{strokes}"
    if record.kind == CYCLE:
        return "unseen cycle"
    return "unseen test" if record.kind in model.channels else "not used"


def _digest(path: Path | None, cache: dict[Path, str]) -> str:
    if path is None or not path.is_file():
        return ""
    if path not in cache:
        with path.open("rb") as file:
            cache[path] = hashlib.file_digest(file, "sha256").hexdigest()[:HASH_DIGITS]
    return cache[path]
