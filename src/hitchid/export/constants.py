"""Numbers of a model that generated code computes with, as plain Python numbers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from hitchid._support.precision import double_precision
from hitchid.errors import InputError
from hitchid.export.error_constants import (
    Range,
    Rows,
    bands_of,
    compensator_of,
    filter_of,
    rows,
    speed_compensator_of,
)
from hitchid.logs import DIRECTIONS
from hitchid.model import (
    LOAD_JUMP,
    LOAD_TINY,
    MAX_MAGNITUDE,
    Bands,
    Channel,
    Hitch,
    HitchDynamics,
    TravelLimits,
    covariates_of,
    mean_load,
)
from hitchid.networks import SPEED_AUTHORITY
from hitchid.structures import (
    STROKE_NODES,
    STROKE_RANGE,
    CascadedTanks,
    DiscretePhysicalModel,
    FirstOrderLag,
    InertiaWithFriction,
    Integrator,
    IntegratorFirstOrder,
    IntegratorSecondOrder,
    NonlinearStructure,
    StaticNonlinearity,
    StrokeModel,
)

# Numbers of a direction's physical model, as plain Python numbers.

# Structures whose equations the templates hold: state space from parameters, or the vector field.
STATE_SPACES = {
    Integrator: "integrator",
    IntegratorFirstOrder: "integrator_first_order",
    FirstOrderLag: "first_order_lag",
    IntegratorSecondOrder: "integrator_second_order",
}
VECTOR_FIELDS = {InertiaWithFriction: "inertia_with_friction", CascadedTanks: "cascaded_tanks"}


@dataclass(frozen=True)
class Plant:
    """Physical model of a direction at the sampling time.

    Attributes:
        form: name of the equations in the templates.
        states: n.
        values: the structure's parameters.
        substeps: of a sample, in the integration of a nonlinear structure; 0 of a linear one.
        nodes: places on the stroke at which it is discretised.
        transition, gamma0, gamma1, friction: Φ, Γ₀, Γ₁ and the gains of dry friction, at each node; empty
            of a nonlinear structure.
        speed_row, speed_gain: speed = row · state + gain · flow.
        friction_at_rest: φ₀; None without dry friction.
        friction_travel, natural_frequency, frequency_slope: of a load with dry friction.
        delay_samples: m, whole samples of dead time.
        dead_time_parts_s: parts of a sample with the flow of the sample before and with the present one, s.
    """

    form: str
    states: int
    values: Rows
    dead_time_parts_s: tuple[float, float]
    substeps: int = 0
    nodes: int = 1
    transition: Rows = ()
    gamma0: Rows = ()
    gamma1: Rows = ()
    friction: Rows = ()
    speed_row: Rows = ()
    speed_gain: float = 0.0
    friction_at_rest: float | None = None
    friction_travel: float = 0.0
    natural_frequency: float = 0.0
    frequency_slope: float = 0.0
    delay_samples: int = 0


def plant_of(channel: Channel, discrete: DiscretePhysicalModel) -> Plant:
    """Return the numbers of a channel's benchmark, which is given discretised, too.

    Raises:
        InputError: its equations are not known here.
    """
    benchmark, step_s = channel.benchmark, discrete.step_s
    structure = benchmark.structure
    if isinstance(structure, NonlinearStructure):
        form = _form(structure, VECTOR_FIELDS)
        if form is None:
            raise _unknown(structure.name)
        return Plant(
            form=form,
            states=int(np.asarray(structure.init_state(benchmark.values, jnp.zeros(1))).shape[0]),
            values=rows(benchmark.values),
            dead_time_parts_s=(0.0, step_s),
            substeps=structure.substeps,
        )
    linear = structure.require_linear()
    form = _form(linear, STATE_SPACES)
    # A discretised model needs no equations, unless a covariate or dry friction changes it at run time.
    if form is None and (benchmark.scheduling is not None or linear.has_dry_friction):
        raise _unknown(linear.name)
    names = [parameter.name for parameter in linear.parameters]
    values = dict(zip(names, np.asarray(benchmark.values).tolist(), strict=True))
    a, b = (np.asarray(part) for part in linear.state_space(benchmark.values))
    along = benchmark.discretised_along_stroke(step_s)
    nodes = STROKE_NODES if benchmark.varies_along_stroke else 1
    models = along.models if isinstance(along, StrokeModel) else along
    friction = models.friction
    samples = float(benchmark.dead_time_s) / step_s
    # Rounding must not turn whole samples into one less and a fraction of nearly one.
    fraction = min(max(samples - math.floor(samples + 1e-9), 0.0), 1.0)
    return Plant(
        form=form or "linear",
        states=b.size,
        values=rows(benchmark.values),
        dead_time_parts_s=(fraction * step_s, (1 - fraction) * step_s),
        nodes=nodes,
        transition=_per_node(models.transition, nodes, (b.size, b.size)),
        gamma0=_per_node(models.gamma0, nodes, (b.size,)),
        gamma1=_per_node(models.gamma1, nodes, (b.size,)),
        friction=() if friction is None else _per_node(friction.gains, nodes, (b.size,)),
        speed_row=rows(a[0]),
        speed_gain=float(b[0]),
        friction_at_rest=values.get("friction_at_rest") if linear.has_dry_friction else None,
        friction_travel=values.get("friction_travel", 0.0),
        natural_frequency=values.get("natural_frequency", 0.0),
        frequency_slope=values.get("frequency_slope", 0.0) if benchmark.varies_along_stroke else 0.0,
        delay_samples=discrete.delay_samples,
    )


def _form(structure: object, forms: dict[type, str]) -> str | None:
    """Return the name of a structure's equations; None of a structure of another package."""
    # A class of another package that extends one of ours may have other equations.
    if type(structure).__module__.partition(".")[0] != "hitchid":
        return None
    return next((name for kind, name in reversed(forms.items()) if isinstance(structure, kind)), None)


def _unknown(name: str) -> InputError:
    forms = ", ".join([*STATE_SPACES.values(), *VECTOR_FIELDS.values()]).replace("_", "-")
    return InputError(
        f"structure {name}: expected one whose equations the export knows ({forms}), or a linear one without "
        "covariates and dry friction"
    )


def _per_node(array: object, nodes: int, shape: tuple[int, ...]) -> Rows:
    return rows(np.asarray(array).reshape(nodes, *shape))


@double_precision
def curves_of(nonlinearity: StaticNonlinearity, step_s: float) -> dict[str, float]:
    """Return the numbers of the nonlinearities of valve and stroke at the sampling time."""
    names = ("opening", "exponent", "saturation", "hysteresis", "spool_lag")
    names += ("position_slope", "position_curve")
    curves = {name: float(value) for name, value in zip(names, nonlinearity.named(*names), strict=True)}
    # Computed here in double precision, also for code in single.
    decay = float(np.exp(-step_s / curves["spool_lag"]))
    scales = nonlinearity.scales
    return curves | {
        "command_scale": float(scales.command),
        "largest_share": float(nonlinearity.largest_share),
        "centre": float(scales.centre),
        "span": float(scales.span),
        "decay": decay,
        "mean_share": curves["spool_lag"] / step_s * (1 - decay),
    }


def scheduling_of(channel: Channel) -> dict[str, Any] | None:
    """Return what covariates change, and by how much; None where they change nothing."""
    scheduling, nonlinearity = channel.benchmark.scheduling, channel.benchmark.nonlinearity
    if scheduling is None or nonlinearity is None:
        return None
    scales = nonlinearity.scales.covariates
    names = [parameter.name for parameter in channel.benchmark.structure.parameters]
    return {
        "centre": rows(scales.centre),
        "spread": rows(scales.spread),
        # Index of the structure's parameter; −1: the opening of the valve.
        "targets": tuple(names.index(name) if name in names else -1 for name in scheduling.quantities),
        "effects": rows(scheduling.effects),
    }


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
    jump: float = LOAD_JUMP
    tiny: float = float(LOAD_TINY)
    authority: float = SPEED_AUTHORITY
    stroke_range: float = STROKE_RANGE

    @property
    def error_steps(self) -> tuple[float, ...] | None:
        """Spread of the innovations of each network; None where no channel has a compensator."""
        if not any(channel.compensator or channel.speed_compensator for channel in self.channels):
            return None
        return tuple(own.compensator["error_step"] for own in self.channels if own.compensator)


@double_precision
def constants_of(model: Hitch) -> ModelConstants:
    """Return the numbers of a model.

    Raises:
        InputError: it has a structure of another package whose equations are not known here.
    """
    dynamics = HitchDynamics.of(tuple(model.channels.values()), model.step_s, model.drift)
    names = covariates_of(model.channels.values())
    bands = {direction: own.bands for direction, own in model.uncertainty.items() if own.bands is not None}
    # A half width of one direction alone would be none for a hitch that goes both ways.
    has_bands = all(direction in bands for direction in model.channels)
    pairs = zip(dynamics.channels, dynamics.discrete_models, strict=True)
    channels = tuple(
        channel_constants(
            index, channel, discrete, names, bands=bands[channel.direction] if has_bands else None
        )
        for index, (channel, discrete) in enumerate(pairs)
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
    """Return the numbers of a channel, of its benchmark at the sampling time, and of its bands.

    Raises:
        InputError: as `constants_of`.
    """
    benchmark = channel.benchmark
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
        ranges=Range.all_of(channel.operating_range),
        compensator=compensator_of(channel.compensator) if channel.compensator is not None else None,
        speed_compensator=None
        if channel.speed_compensator is None
        else speed_compensator_of(channel.speed_compensator),
        bands=None if bands is None else bands_of(bands),
    )
