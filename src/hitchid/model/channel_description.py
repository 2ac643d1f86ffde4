"""Conversion between a channel and JSON and tensors."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hitchid.model.channel import Channel
from hitchid.model.limits import TravelLimits
from hitchid.model.load_filter import LoadFilter
from hitchid.model.tensors import Tensors, check_size, fill, tensors_of
from hitchid.networks.error_compensator import FEATURES, Compensator
from hitchid.networks.lstm import Lstm
from hitchid.networks.operating_range import OperatingRange, SignalRange
from hitchid.networks.speed_compensator import SIGNALS, SpeedCompensator, SpeedNetworks
from hitchid.structures import (
    NONLINEARITY_PARAMETERS,
    CovariateScales,
    PhysicalModel,
    Scales,
    Scheduling,
    StaticNonlinearity,
    Structure,
    scheduled_quantities,
    structure_named,
)
from hitchid.structures.scheduling import POWERS

_SCALES = ("command", "centre", "span")
_TRAINED = ("compensator", "speed_compensator", "operating_range", "load_filter")


def channel_tensors(channel: Channel, prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays of the trained parts, `prefix/part/path`."""
    parts = [tensors_of(getattr(channel, component), f"{prefix}/{component}") for component in _TRAINED]
    return {name: array for component in parts for name, array in component.items()}


def describe_channel(channel: Channel) -> dict[str, object]:
    """Return the channel without its trained arrays as content for JSON."""
    benchmark, curves = channel.benchmark, channel.benchmark.nonlinearity
    compensator, speed = channel.compensator, channel.speed_compensator
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
        "scheduling": _describe_scheduling(benchmark),
        "compensator": None
        if compensator is None
        else {
            "window": compensator.window,
            "max_horizon": compensator.max_horizon,
            "hidden": compensator.network.cell.hidden_size,
            "features": list(FEATURES),
        },
        "speed_compensator": None
        if speed is None
        else {
            "members": speed.members,
            "units": speed.networks.biases.shape[1],
        },
    }


def read_channel(direction: str, described: dict[str, Any], tensors: Tensors, prefix: str) -> Channel:
    """Return a channel from its description and the tensors of a prefix.

    Raises:
        ValueError, KeyError, TypeError: the description or the tensors are not those of a channel.
        InputError: its structure is not installed.
    """
    sign, limits = int(described["direction"]), described["limits"]
    loads = len((described["scheduling"] or {"covariates": [""]})["covariates"])
    return Channel(
        direction=direction,
        sign=sign,
        dead_zone=float(described["dead_zone"]),
        end_stop=described["end_stop"],
        benchmark=read_channel_benchmark(described),
        operating_range=fill(_empty_range(loads), tensors, f"{prefix}/operating_range"),
        compensator=_read_compensator(described["compensator"], tensors, f"{prefix}/compensator"),
        speed_compensator=_read_speed_compensator(
            described["speed_compensator"], sign, loads, tensors, f"{prefix}/speed_compensator"
        ),
        limits=None if limits is None else TravelLimits(**limits),
        load_filter=fill(LoadFilter.none(), tensors, f"{prefix}/load_filter"),
    )


def read_channel_benchmark(described: dict[str, Any]) -> PhysicalModel:
    """Return the physical model of a channel from its description; raises as `read_channel`."""
    structure = structure_named(described["structure"])
    if len(described["values"]) != len(structure.parameters):
        raise ValueError(f"{structure.name} has {len(structure.parameters)} parameters")
    return PhysicalModel(
        structure,
        jnp.asarray(described["values"]),
        jnp.asarray(float(described["dead_time_s"])),
        *_read_curves(described["shape"], described["scheduling"], structure),
    )


def _read_compensator(described: dict[str, Any] | None, tensors: Tensors, prefix: str) -> Compensator | None:
    if described is None:
        return None
    if described["features"] != list(FEATURES):
        raise ValueError("the compensator's features are not those of this version")
    check_size(tensors, described["hidden"] ** 2)
    sizes = (int(described[name]) for name in ("hidden", "window", "max_horizon"))
    return fill(_empty_compensator(*sizes), tensors, prefix)


def _read_speed_compensator(
    described: dict[str, Any] | None, sign: int, loads: int, tensors: Tensors, prefix: str
) -> SpeedCompensator | None:
    if described is None:
        return None
    check_size(tensors, described["members"] * described["units"])
    return fill(_empty_speed_compensator(sign=sign, loads=loads, **described), tensors, prefix)


def _describe_scheduling(benchmark: PhysicalModel) -> dict[str, object] | None:
    scheduling, nonlinearity = benchmark.scheduling, benchmark.nonlinearity
    if scheduling is None or nonlinearity is None:
        return None
    scales = nonlinearity.scales.covariates
    return {
        "covariates": list(scheduling.covariates),
        "quantities": list(scheduling.quantities),
        "centre": scales.centre.tolist(),
        "spread": scales.spread.tolist(),
        "effects": scheduling.effects.tolist(),
    }


def _read_curves(
    described: dict[str, Any] | None, scheduled: dict[str, Any] | None, structure: Structure
) -> tuple[StaticNonlinearity | None, Scheduling | None]:
    if described is None:
        return None, None
    if len(described["values"]) != len(NONLINEARITY_PARAMETERS):
        raise ValueError(f"the curves have {len(NONLINEARITY_PARAMETERS)} parameters")
    command, centre, span = (jnp.asarray(float(described["scales"][name])) for name in _SCALES)
    scales = Scales(command, centre, span)
    values = jnp.asarray(described["values"])
    if scheduled is None:
        return StaticNonlinearity(values, scales), None
    covariates, quantities = tuple(scheduled["covariates"]), tuple(scheduled["quantities"])
    rows = {name: jnp.asarray(scheduled[name], dtype=float) for name in ("centre", "spread", "effects")}
    count = len(covariates)
    if quantities != scheduled_quantities(structure.require_linear()):
        raise ValueError("the parameters that covariates change are not those of the structure")
    if [row.shape for row in rows.values()] != [(count,), (count,), (len(quantities), count, len(POWERS))]:
        raise ValueError("the effects are not those of the covariates")
    scales = replace(scales, covariates=CovariateScales(rows["centre"], rows["spread"]))
    return StaticNonlinearity(values, scales), Scheduling(covariates, quantities, rows["effects"])


def _empty_compensator(hidden: int, window: int, max_horizon: int) -> Compensator:
    count = len(FEATURES)
    return Compensator(
        Lstm.init(jax.random.key(0), count, hidden),
        jnp.zeros(count),
        jnp.ones(count),
        jnp.ones(()),
        window,
        max_horizon,
    )


def _empty_range(loads: int) -> OperatingRange:
    """Return a range to be filled, of so many covariates."""
    empty = SignalRange(jnp.zeros(loads), jnp.zeros(loads))
    return replace(OperatingRange.unbounded(), load=empty)


def _empty_speed_compensator(*, members: int, units: int, sign: int, loads: int) -> SpeedCompensator:
    networks = SpeedNetworks(
        jnp.zeros((members, units, SIGNALS + loads)), jnp.zeros((members, units)), jnp.zeros((members, units))
    )
    scales = (jnp.ones(()), jnp.ones(()), jnp.ones(()))
    return SpeedCompensator(networks, *scales, _empty_range(loads), sign)
