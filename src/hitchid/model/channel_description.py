"""Conversion between a channel and JSON and tensors."""

from dataclasses import fields
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
from hitchid.networks.operating_range import OperatingRange
from hitchid.networks.speed_compensator import INPUTS, SpeedCompensator, SpeedNetworks
from hitchid.structures import (
    NONLINEARITY_PARAMETERS,
    PhysicalModel,
    Scales,
    StaticNonlinearity,
    structure_named,
)

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
        "load": benchmark.covariate,
        "shape": None
        if curves is None
        else {
            "values": [float(value) for value in curves.values],
            "scales": {field.name: float(getattr(curves.scales, field.name)) for field in fields(Scales)},
        },
        "compensator": None
        if compensator is None
        else {
            "window": compensator.window,
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
    structure = structure_named(described["structure"])
    if len(described["values"]) != len(structure.parameters):
        raise ValueError(f"{structure.name} has {len(structure.parameters)} parameters")
    sign, limits = int(described["direction"]), described["limits"]
    return Channel(
        direction=direction,
        sign=sign,
        dead_zone=float(described["dead_zone"]),
        end_stop=described["end_stop"],
        benchmark=PhysicalModel(
            structure,
            jnp.asarray(described["values"]),
            jnp.asarray(float(described["dead_time_s"])),
            _shape(described["shape"]),
            described["load"],
        ),
        operating_range=fill(OperatingRange.unbounded(), tensors, f"{prefix}/operating_range"),
        compensator=_read_compensator(described["compensator"], tensors, f"{prefix}/compensator"),
        speed_compensator=_read_speed_compensator(
            described["speed_compensator"], sign, tensors, f"{prefix}/speed_compensator"
        ),
        limits=None if limits is None else TravelLimits(**limits),
        load_filter=fill(LoadFilter.none(), tensors, f"{prefix}/load_filter"),
    )


def _read_compensator(described: dict[str, Any] | None, tensors: Tensors, prefix: str) -> Compensator | None:
    if described is None:
        return None
    if described["features"] != list(FEATURES):
        raise ValueError("the compensator's features are not those of this version")
    check_size(tensors, described["hidden"] ** 2)
    return fill(_empty_compensator(described["hidden"], described["window"]), tensors, prefix)


def _read_speed_compensator(
    described: dict[str, Any] | None, sign: int, tensors: Tensors, prefix: str
) -> SpeedCompensator | None:
    if described is None:
        return None
    check_size(tensors, described["members"] * described["units"])
    return fill(_empty_speed_compensator(sign=sign, **described), tensors, prefix)


def _shape(described: dict | None) -> StaticNonlinearity | None:
    if described is None:
        return None
    if len(described["values"]) != len(NONLINEARITY_PARAMETERS):
        raise ValueError(f"the curves have {len(NONLINEARITY_PARAMETERS)} parameters")
    scales = Scales(**{name: jnp.asarray(float(value)) for name, value in described["scales"].items()})
    return StaticNonlinearity(jnp.asarray(described["values"]), scales)


def _empty_compensator(hidden: int, window: int) -> Compensator:
    count = len(FEATURES)
    return Compensator(
        Lstm.init(jax.random.key(0), count, hidden),
        jnp.zeros(count),
        jnp.ones(count),
        jnp.ones(()),
        window,
    )


def _empty_speed_compensator(*, members: int, units: int, sign: int) -> SpeedCompensator:
    networks = SpeedNetworks(
        jnp.zeros((members, units, INPUTS)), jnp.zeros((members, units)), jnp.zeros((members, units))
    )
    scales = (jnp.ones(()), jnp.ones(()), jnp.ones(()))
    return SpeedCompensator(networks, *scales, OperatingRange.unbounded(), sign)
