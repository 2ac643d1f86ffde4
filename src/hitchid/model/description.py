"""Conversion between a model and JSON and tensors."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from hitchid.model.channel import Channel
from hitchid.model.hitch import Hitch
from hitchid.model.load_filter import LoadFilter
from hitchid.model.provenance import Provenance
from hitchid.model.schema import (
    SCHEMA,
    ChannelDescription,
    CompensatorSizes,
    ModelDescription,
    PhysicalDescription,
    SpeedCompensatorSizes,
)
from hitchid.networks.error_compensator import COMPENSATOR_FEATURES, Compensator
from hitchid.networks.lstm import Lstm
from hitchid.networks.operating_range import OperatingRange, SignalRange
from hitchid.networks.speed_compensator import SIGNALS, SpeedCompensator, SpeedNetworks
from hitchid.structures import (
    CovariateScales,
    PhysicalModel,
    Scales,
    Scheduling,
    StaticNonlinearity,
    structure_named,
)

# Conversion between the trained parts of a model and named tensors.

Part = TypeVar("Part")
Tensors = Mapping[str, np.ndarray]
MAX_NUMBER = 1e9  # size of a stored number, beyond which products of two are no weights; chosen


def tensors_of(tree: object) -> dict[str, np.ndarray]:
    """Return path to array, `part/field/…`, for every array of a tree."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {_name(path): np.array(leaf, order="C") for path, leaf in leaves}


def fill(skeleton: Part, tensors: Tensors, prefix: str) -> Part:
    """Return a copy of a skeleton filled with the stored arrays of a prefix.

    Raises:
        ValueError: an array is missing, has another shape or type than the skeleton's, or a number that no
            training gives. Only what is infinite in the skeleton may be.
    """

    def leaf(path: tuple, like: np.ndarray | jax.Array) -> object:
        name = f"{prefix}/{_name(path)}"
        stored = tensors.get(name)
        if stored is None or stored.shape != like.shape or stored.dtype != like.dtype:
            got = "none" if stored is None else f"shape {stored.shape}, {stored.dtype}"
            raise ValueError(f"{name}: got {got}, expected shape {like.shape}, {like.dtype}")
        # Not by np.abs: of the lowest integer it is negative.
        admissible = (stored >= -MAX_NUMBER) & (stored <= MAX_NUMBER) | (np.isinf(like) & (stored == like))
        if not np.all(admissible):
            raise ValueError(f"{name}: got {stored[~admissible].flat[0]}, expected numbers within ±1e9")
        return stored if isinstance(like, np.ndarray) else jnp.asarray(stored)

    return jax.tree_util.tree_map_with_path(leaf, skeleton)


def shapes_of(tensors: Tensors, prefix: str) -> dict[str, tuple[int, ...]]:
    """Return path without prefix to shape, for every stored array of a prefix."""
    start = f"{prefix}/"
    return {
        name.removeprefix(start): stored.shape for name, stored in tensors.items() if name.startswith(start)
    }


def check_known(tensors: Tensors, read: Tensors) -> None:
    """Check that all stored arrays were read.

    Raises:
        ValueError: there are others.
    """
    if unknown := sorted(tensors.keys() - read.keys()):
        raise ValueError(f"{unknown[0]}: is not known; expected {len(read)} arrays, got {len(tensors)}")


def check_size(tensors: Tensors, count: int) -> None:
    """Check that a described size does not exceed the stored arrays, before memory is allocated.

    Raises:
        ValueError: the stored arrays have fewer elements.
    """
    if count > sum(stored.size for stored in tensors.values()):
        raise ValueError("the description lists more weights than the tensor file contains")


def _name(path: tuple) -> str:
    return jax.tree_util.keystr(path, simple=True, separator="/")


# Conversion between a channel and JSON and tensors.

_SCALES = ("command", "centre", "span")
_TRAINED = ("compensator", "speed_compensator", "operating_range", "load_filter")


def trained_parts(channel: Channel) -> dict[str, object]:
    """Return the parts of a channel that are stored as arrays, by name."""
    return {name: getattr(channel, name) for name in _TRAINED}


def describe_channel(channel: Channel) -> dict[str, object]:
    """Return the channel without its trained arrays as content for JSON."""
    benchmark, curves = channel.benchmark, channel.benchmark.nonlinearity
    compensator, speed = channel.compensator, channel.speed_compensator
    scheduling = benchmark.scheduling
    return {
        "direction": channel.sign,
        "dead_zone": channel.dead_zone,
        "end_stop": channel.end_stop,
        "limits": None if channel.limits is None else channel.limits._asdict(),
        "structure": benchmark.structure.name,
        "values": [float(value) for value in benchmark.values],
        "dead_time_s": float(benchmark.dead_time_s),
        "shape": None
        if curves is None
        else {
            "values": [float(value) for value in curves.values],
            "scales": {name: float(getattr(curves.scales, name)) for name in _SCALES},
        },
        "scheduling": None
        if scheduling is None or curves is None
        else {
            "covariates": list(scheduling.covariates),
            "quantities": list(scheduling.quantities),
            "centre": curves.scales.covariates.centre.tolist(),
            "spread": curves.scales.covariates.spread.tolist(),
            "effects": scheduling.effects.tolist(),
        },
        "compensator": None
        if compensator is None
        else {
            "window": compensator.window,
            "max_horizon": compensator.max_horizon,
            "hidden": compensator.network.cell.hidden_size,
            # By name, so that a version with other features refuses the model.
            "features": list(COMPENSATOR_FEATURES),
        },
        "speed_compensator": None
        if speed is None
        else {
            "members": speed.members,
            "units": speed.networks.biases.shape[1],
        },
    }


def read_channel(direction: str, described: ChannelDescription, tensors: Tensors, prefix: str) -> Channel:
    """Return a channel from its description and the tensors of a prefix.

    Raises:
        ValueError: the tensors are not those of the channel.
    """
    # One zero stands for no covariate, as in every load; see `mean_load`.
    loads = len(described.covariates) or 1
    channel = Channel(
        direction=direction,
        sign=described.direction,
        dead_zone=described.dead_zone,
        end_stop=described.end_stop,
        benchmark=read_physical_model(described),
        operating_range=fill(_empty_range(loads), tensors, f"{prefix}/operating_range"),
        compensator=_read_compensator(described.compensator, tensors, f"{prefix}/compensator"),
        speed_compensator=_read_speed_compensator(
            described.speed_compensator, described.direction, loads, tensors, f"{prefix}/speed_compensator"
        ),
        limits=described.limits,
        load_filter=fill(LoadFilter.none(), tensors, f"{prefix}/load_filter"),
    )
    _check_trained(channel, prefix)
    return channel


def _check_trained(channel: Channel, prefix: str) -> None:
    """Check that ranges rise, and that scales, which are divided by, and scatters are positive.

    Raises:
        ValueError: they do not, or are not.
    """
    compensator, speed, load_filter = channel.compensator, channel.speed_compensator, channel.load_filter
    lengths, scatters = (
        ("load_length", "transient_time"),
        ("noise", "load_scatter", "transient_scatter", "drift"),
    )
    ranges = {"operating_range": channel.operating_range}
    positive = {f"load_filter/{name}": getattr(load_filter, name) for name in lengths}
    if compensator is not None:
        positive["compensator/spread"] = compensator.spread
    if speed is not None:
        scales = ("command_scale", "speed_scale", "acceleration_scale")
        positive |= {f"speed_compensator/{name}": getattr(speed, name) for name in scales}
        ranges["speed_compensator/operating_range"] = speed.operating_range
    for name, scale in positive.items():
        if np.min(scale) <= 0:
            raise ValueError(f"{prefix}/{name}: got {np.min(scale):g}, expected more than 0")
    for name in scatters:
        if (scatter := float(getattr(load_filter, name))) < 0:
            raise ValueError(f"{prefix}/load_filter/{name}: got {scatter:g}, expected at least 0")
    for name, operating_range in ranges.items():
        for signal in ("command", "displacement", "load"):
            ends: SignalRange = getattr(operating_range, signal)
            if np.any(np.asarray(ends.lowest) > np.asarray(ends.highest)):
                raise ValueError(f"{prefix}/{name}/{signal}: got the highest below the lowest")


def read_physical_model(described: PhysicalDescription) -> PhysicalModel:
    """Return the physical model of a channel from its description."""
    structure, values = structure_named(described.structure), jnp.asarray(described.values)
    dead_time_s = jnp.asarray(described.dead_time_s)
    if described.shape is None:
        return PhysicalModel(structure, values, dead_time_s)
    command, centre, span = (jnp.asarray(getattr(described.shape.scales, name)) for name in _SCALES)
    scales, curves = Scales(command, centre, span), jnp.asarray(described.shape.values)
    scheduled = described.scheduling
    if scheduled is None:
        return PhysicalModel(structure, values, dead_time_s, StaticNonlinearity(curves, scales))
    covariates = CovariateScales(jnp.asarray(scheduled.centre), jnp.asarray(scheduled.spread))
    nonlinearity = StaticNonlinearity(curves, replace(scales, covariates=covariates))
    scheduling = Scheduling(scheduled.covariates, scheduled.quantities, jnp.asarray(scheduled.effects))
    return PhysicalModel(structure, values, dead_time_s, nonlinearity, scheduling)


def _read_compensator(
    described: CompensatorSizes | None, tensors: Tensors, prefix: str
) -> Compensator | None:
    if described is None:
        return None
    check_size(tensors, described.hidden**2)
    count = len(COMPENSATOR_FEATURES)
    # Any weights of the right shapes: the stored ones replace them.
    skeleton = Compensator(
        Lstm.init(jax.random.key(0), count, described.hidden),
        jnp.zeros(count),
        jnp.ones(count),
        jnp.ones(()),
        described.window,
        described.max_horizon,
    )
    return fill(skeleton, tensors, prefix)


def _read_speed_compensator(
    described: SpeedCompensatorSizes | None, sign: int, loads: int, tensors: Tensors, prefix: str
) -> SpeedCompensator | None:
    if described is None:
        return None
    members, units = described.members, described.units
    check_size(tensors, members * units)
    networks = SpeedNetworks(
        jnp.zeros((members, units, SIGNALS + loads)), jnp.zeros((members, units)), jnp.zeros((members, units))
    )
    scales = (jnp.ones(()), jnp.ones(()), jnp.ones(()))
    skeleton = SpeedCompensator(networks, *scales, _empty_range(loads), sign)
    return fill(skeleton, tensors, prefix)


def _empty_range(loads: int) -> OperatingRange:
    """Return a range to be filled, of so many covariates."""
    unbounded = SignalRange(jnp.full(loads, -jnp.inf), jnp.full(loads, jnp.inf))
    return replace(OperatingRange.unbounded(), load=unbounded)


SUBSETS = ("identification", "validation", "held_out")


def describe(hitch: Hitch) -> dict[str, object]:
    """Return the model without its trained arrays as content for JSON."""
    provenance = hitch.provenance
    adapted = {direction: dict(changes) for direction, changes in provenance.adapted.items()}
    return {
        "schema": SCHEMA,
        "kind": ModelDescription.KIND,
        "step_s": hitch.step_s,
        "units": dict(hitch.units),
        "drift": hitch.drift,
        "two_modes": None if hitch.two_modes is None else asdict(hitch.two_modes),
        "uncertainty": {
            direction: asdict(uncertainty) for direction, uncertainty in hitch.uncertainty.items()
        },
        "channels": {direction: describe_channel(channel) for direction, channel in hitch.channels.items()},
        "split": {
            subset: {direction: list(names) for direction, names in getattr(provenance, subset).items()}
            for subset in SUBSETS
        },
        # Sorted, for a set has no order: equal models have equal bytes.
        "seen": sorted(provenance.seen),
        "cut_at": dict(provenance.segmentation_dead_zones),
        "seed": provenance.seed,
        "settings": dict(provenance.settings),
        "versions": dict(provenance.versions),
        "set_by_hand": {direction: dict(values) for direction, values in provenance.set_by_hand.items()},
        # Nothing of a model as identified, whose digest stays.
        **({"adapted": adapted} if adapted else {}),
    }


def deployed_tensors(hitch: Hitch) -> dict[str, np.ndarray]:
    """Return the arrays of the channels, `direction/part/path`."""
    return tensors_of({direction: trained_parts(channel) for direction, channel in hitch.channels.items()})


def read_hitch(described: ModelDescription, tensors: Tensors) -> Hitch:
    """Return the model of a description and its tensors.

    Raises:
        ValueError: the tensors are not those of the model.
    """
    provenance = Provenance(
        **{subset: getattr(described.split, subset) for subset in SUBSETS},
        seen=described.seen,
        segmentation_dead_zones=described.cut_at,
        seed=described.seed,
        # Only what was written: saved again, the model has the same bytes.
        settings=described.settings.model_dump(exclude_unset=True),
        versions=described.versions,
        set_by_hand=described.set_by_hand,
        adapted=described.adapted,
        digest=described.digest,
    )
    return Hitch(
        {
            direction: read_channel(direction, channel, tensors, direction)
            for direction, channel in described.channels.items()
        },
        described.step_s,
        described.units,
        provenance,
        described.drift,
        described.two_modes,
        described.uncertainty,
    )
