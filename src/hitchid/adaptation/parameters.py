"""The parameters that adaptation moves, and a channel and a model with other values of them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid._support.precision import double_precision
from hitchid._support.short_repr import short_repr
from hitchid.errors import InputError
from hitchid.model import Channel, Hitch
from hitchid.model.bands import Bands, EnsembleMember
from hitchid.model.uncertainty import Uncertainty
from hitchid.structures import NONLINEARITY_PARAMETERS, PhysicalModel

GAIN, DEAD_ZONE, LAG = range(3)
NAMES = ("gain", "dead_zone", "lag")
SPOOL_LAG = [parameter.name for parameter in NONLINEARITY_PARAMETERS].index("spool_lag")
LEAST_LAG_S = 1e-4  # s; a spool without lag has a value far below, and nothing to move; chosen


@short_repr
class Changes(NamedTuple):
    """Changes of a channel's parameters since its identification.

    Attributes:
        gain: natural logarithm of the factor on the gain.
        dead_zone: what is added to the dead zone, in the command's unit.
        lag: natural logarithm of the factor on the lag; see `lag_index`.
    """

    gain: float = 0.0
    dead_zone: float = 0.0
    lag: float = 0.0


def check_adaptable(channel: Channel) -> None:
    """Raise InputError where a channel has no gain, or takes commands without a dead zone."""
    structure = channel.benchmark.structure
    if not structure.gain or structure.uses_raw_command:
        raise InputError(
            f"{channel.direction}: structure '{structure.name}' has no gain behind a dead zone; adaptation "
            "requires one that has"
        )


def lag_index(benchmark: PhysicalModel) -> int | None:
    """Return the number of the structure's parameter that is a lag; None where it is that of the spool.

    The time constant, or the damping ratio ξ: a second order follows the flow with a lag of 2 ξ/ωh, which
    oil makes longer the colder it is, while the frequency ωh, of mass and oil column, stays.
    """
    structure = benchmark.structure
    dynamics = () if structure.linear is None else structure.linear.load_dynamics
    names = [parameter.name for parameter in structure.parameters]
    return names.index(dynamics[-1]) if dynamics else None


def changed_benchmark(benchmark: PhysicalModel, changes: Float[Array, "3"]) -> PhysicalModel:
    """Return a benchmark with gain and lag multiplied; `changes` may be traced."""
    gain, lag = benchmark.structure.gain_index, lag_index(benchmark)
    values = benchmark.values.at[gain].multiply(jnp.exp(changes[GAIN]))
    if lag is not None:
        values = values.at[lag].multiply(jnp.exp(changes[LAG]))
    changed = eqx.tree_at(lambda tree: tree.values, benchmark, values)
    if lag is not None or benchmark.nonlinearity is None:
        return changed
    curves = benchmark.nonlinearity.values.at[SPOOL_LAG].multiply(jnp.exp(changes[LAG]))
    return eqx.tree_at(lambda tree: tree.nonlinearity.values, changed, curves)


def has_lag(channel: Channel) -> bool:
    """Return whether structure or spool of a channel have a lag."""
    nonlinearity = channel.benchmark.nonlinearity
    if lag_index(channel.benchmark) is not None:
        return True
    return nonlinearity is not None and float(nonlinearity.named("spool_lag")[0]) > LEAST_LAG_S


@double_precision
def changed_model(
    model: Hitch, changes: Mapping[str, Changes], band_factors: Mapping[str, float] | None = None
) -> Hitch:
    """Return a model with changed parameters of some directions; networks and curves stay.

    The ensembles of the bands change as their channel does. Speed maps, Fisher information and rivals
    are of the identified values, and are left out of a direction that changed.

    Args:
        model: identified hitch.
        changes: direction to the changes of its parameters.
        band_factors: direction to a factor on the half width of its bands.
    """
    factors = band_factors or {}
    channels, uncertainty, rivals = dict(model.channels), dict(model.uncertainty), dict(model.rivals)
    adapted = {direction: dict(values) for direction, values in model.provenance.adapted.items()}
    for direction, change in changes.items():
        factor = factors.get(direction, 1.0)
        if change == Changes() and factor == 1.0:
            continue
        channels[direction] = _changed_channel(channels[direction], change)
        if direction in uncertainty:
            uncertainty[direction] = _changed_uncertainty(
                uncertainty[direction], model.channels[direction], change, factor
            )
        rivals.pop(direction, None)
        adapted[direction] = {**change._asdict(), "band_factor": factor}
    return replace(
        model,
        channels=channels,
        uncertainty=uncertainty,
        rivals=rivals,
        provenance=replace(model.provenance, adapted=adapted, digest=""),
    )


def _changed_channel(channel: Channel, changes: Changes) -> Channel:
    return replace(
        channel,
        dead_zone=channel.dead_zone + changes.dead_zone,
        benchmark=changed_benchmark(channel.benchmark, jnp.asarray(changes, float)),
    )


def _changed_uncertainty(
    uncertainty: Uncertainty, channel: Channel, changes: Changes, band_factor: float
) -> Uncertainty:
    """Return estimates and bands of the changed parameters."""
    benchmark, estimates = channel.benchmark, uncertainty.benchmark
    lag = lag_index(benchmark)
    lag_name = "spool_lag" if lag is None else benchmark.structure.parameters[lag].name
    for number, name in ((GAIN, benchmark.structure.gain), (LAG, lag_name)):
        estimates = estimates.scaled(name, float(np.exp(changes[number])))
    bands = uncertainty.bands
    changed = None if bands is None else _changed_bands(bands, channel, changes, band_factor)
    return Uncertainty(estimates, changed, load_scatter=uncertainty.load_scatter)


def _changed_bands(bands: Bands, channel: Channel, changes: Changes, factor: float) -> Bands:
    predictions = bands.predictions
    return replace(
        bands,
        ensemble=tuple(_changed_member(member, channel, changes) for member in bands.ensemble),
        free_run=tuple(factor * multiplier for multiplier in bands.free_run),
        predictions=replace(
            predictions,
            multipliers=tuple(tuple(factor * each for each in row) for row in predictions.multipliers),
        ),
    )


def _changed_member(member: EnsembleMember, channel: Channel, changes: Changes) -> EnsembleMember:
    perturbed = channel.benchmark.with_parameter_vector(jnp.asarray(member.benchmark))
    row = changed_benchmark(perturbed, jnp.asarray(changes, float)).parameter_vector
    return replace(member, benchmark=tuple(map(float, row)))
