"""Numbers of a model that generated code computes with, as plain Python numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchid._support.precision import double_precision
from hitchid.data.record import DIRECTIONS
from hitchid.export.error_constants import (
    Range,
    bands_of,
    compensator_of,
    filter_of,
    speed_compensator_of,
)
from hitchid.export.plant_constants import Plant, curves_of, plant_of, scheduling_of
from hitchid.model import Bands, Channel, Hitch, TravelLimits
from hitchid.model.dynamics import MAX_MAGNITUDE, HitchDynamics
from hitchid.model.load_filter import JUMP, TINY
from hitchid.model.loads import covariates_of, mean_load
from hitchid.networks.speed_compensator import AUTHORITY
from hitchid.structures import DiscretePhysicalModel
from hitchid.structures.discretisation import STROKE_RANGE


@dataclass(frozen=True)
class ChannelConstants:
    """Numbers of one channel; see `Channel` for what they mean."""

    name: str
    index: int
    command: int
    sign: int
    dead_zone: float
    min_command: float
    end_stop: float | None
    uses_raw_command: bool
    plant: Plant
    curves: dict[str, float] | None
    scheduling: dict[str, Any] | None
    covariates: tuple[int, ...]
    filter: dict[str, float]
    ranges: dict[str, Any]
    compensator: dict[str, Any] | None
    speed_compensator: dict[str, Any] | None
    bands: dict[str, Any] | None

    @property
    def may_scale_gain(self) -> bool:
        """Whether a factor on the flow is a factor on the gain: in all linear structures."""
        return not self.plant.substeps


@dataclass(frozen=True)
class ModelConstants:
    """Numbers of a model.

    Attributes:
        channels: in the order of `DIRECTIONS`.
        step_s: sampling time, s.
        drift: speed of a held piston, in the displacement's unit/s.
        limits: of the displacement in free run.
        units: role to unit.
        covariates, mean_load: names of the covariates, and their means in the tests.
        has_bands: whether every channel has a band.
        digest: of the model folder; empty for one that was not saved.
    """

    channels: tuple[ChannelConstants, ...]
    step_s: float
    drift: float
    limits: TravelLimits | None
    units: dict[str, str]
    covariates: tuple[str, ...]
    mean_load: tuple[float, ...]
    has_bands: bool
    digest: str

    max_magnitude: float = MAX_MAGNITUDE
    jump: float = JUMP
    tiny: float = float(TINY)
    authority: float = AUTHORITY
    stroke_range: float = STROKE_RANGE

    @property
    def error_steps(self) -> tuple[float, ...] | None:
        """Spread of the innovations of each network; None where no channel has a compensator."""
        if not any(channel.compensator or channel.speed_compensator for channel in self.channels):
            return None
        return tuple(each.compensator["error_step"] for each in self.channels if each.compensator)


@double_precision
def constants_of(model: Hitch) -> ModelConstants:
    """Return the numbers of a model.

    Raises:
        InputError: it has a structure of another package whose equations are not known here.
    """
    dynamics = HitchDynamics.of(tuple(model.channels.values()), model.step_s, model.drift)
    names = covariates_of(model.channels.values())
    bands = {name: known.bands for name, known in model.uncertainty.items() if known.bands is not None}
    has_bands = all(direction in bands for direction in model.channels)
    channels = tuple(
        channel_constants(
            index,
            channel,
            discrete,
            names,
            bands=bands[channel.direction] if has_bands else None,
        )
        for index, (channel, discrete) in enumerate(
            zip(dynamics.channels, dynamics.discrete_models, strict=True)
        )
    )
    return ModelConstants(
        channels,
        model.step_s,
        float(model.drift),
        model.limits,
        dict(model.units),
        names,
        tuple(mean_load(model.channels.values()).tolist()) if names else (),
        has_bands,
        model.provenance.digest,
    )


def channel_constants(
    index: int,
    channel: Channel,
    discrete: DiscretePhysicalModel,
    covariates: Sequence[str] = (),
    *,
    bands: Bands | None = None,
) -> ChannelConstants:
    """Return the numbers of a channel, and of its benchmark at the sampling time.

    Args:
        index: of the channel in its model.
        channel: the channel.
        discrete: its benchmark, discretised.
        covariates: names of those of the model.
        bands: around its predictions.

    Raises:
        InputError: as `constants_of`.
    """
    benchmark = channel.benchmark
    load = channel.operating_range.load
    return ChannelConstants(
        name=channel.direction,
        index=index,
        command=DIRECTIONS.index(channel.direction),
        sign=channel.sign,
        dead_zone=float(channel.dead_zone),
        min_command=float(discrete.min_command),
        end_stop=None if channel.end_stop is None else float(channel.end_stop),
        uses_raw_command=bool(benchmark.structure.uses_raw_command),
        plant=plant_of(channel, discrete),
        curves=None if benchmark.nonlinearity is None else curves_of(benchmark.nonlinearity, discrete.step_s),
        scheduling=scheduling_of(channel),
        covariates=tuple(covariates.index(name) for name in benchmark.covariates),
        filter=filter_of(channel.load_filter, discrete.step_s),
        ranges={
            "command": Range.of(channel.operating_range.command),
            "displacement": Range.of(channel.operating_range.displacement),
            "load": [Range.of(load, number) for number in range(np.asarray(load.lowest).size)],
        },
        compensator=compensator_of(channel.compensator) if channel.compensator is not None else None,
        speed_compensator=None
        if channel.speed_compensator is None
        else speed_compensator_of(channel.speed_compensator),
        bands=None if bands is None else bands_of(bands),
    )
