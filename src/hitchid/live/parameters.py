"""The parameters that adaptation moves, and a channel and a model with other values of them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from hitchid._support.bounded import LogFactor, Number
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.model import (
    Channel,
    Hitch,
    HitchDynamics,
    HitchState,
    Packed,
    Packing,
    Uncertainty,
    channel_load,
    join_inputs,
    with_numbers,
)
from hitchid.structures import NONLINEARITY_PARAMETERS, PhysicalModel

# A hitch in a loop whose gains and dead zones change while it runs, without a new compilation.


@double_precision
def numbers_of_models(model: Hitch) -> Float[Array, " p"]:
    """Return the numbers of the physical models of a hitch at its sampling time, for `AdjustableHitch`."""
    channels = tuple(model.channels.values())
    return ravel_pytree(HitchDynamics.of(channels, model.step_s, model.drift).discrete_models)[0]


def adjusted_state(dynamics: HitchDynamics, state: HitchState) -> HitchState:
    """Return a state with the physical models of dynamics at its load."""
    channels = tuple(
        channel._replace(at_load=model.at_load(channel_load(dynamics.channels, number, state.load)))
        if channel.at_load is not None
        else channel
        for number, (channel, model) in enumerate(zip(state.channels, dynamics.discrete_models, strict=True))
    )
    return state._replace(channels=channels)


class AdjustableHitch:
    """`Hitch.step` with physical models that may get other numbers of their structure; networks stay."""

    @double_precision
    def __init__(self, model: Hitch) -> None:
        self._dynamics = model.dynamics
        self._directions = tuple(model.channels)
        # Shapes alone: the state itself is made by the model.
        self._packing = Packing(jax.eval_shape(self._dynamics.standing_state))
        self._step = self._packing.adjustable_step(self._dynamics)
        self._adjusted_state = jax.jit(self._at_load)
        self._numbers = numbers_of_models(model)

    def step(
        self, state: Packed, commands: ArrayLike | Sequence[ArrayLike], measured: ArrayLike | None = None
    ) -> tuple[Packed, Array]:
        """Return state and displacement one sampling time later; see `Hitch.step`."""
        with jax.enable_x64(True):
            inputs = join_inputs(commands, np.nan if measured is None else measured, self._directions)
            return self._step(self._numbers, state, inputs)

    def adjust(self, numbers: ArrayLike, state: Packed) -> Packed:
        """Go on with other numbers, see `numbers_of_models`; return the state with them at its load."""
        with jax.enable_x64(True):
            self._numbers = jnp.asarray(numbers)
            return Packed(self._adjusted_state(self._numbers, state.numbers), state.hidden)

    def _at_load(self, numbers_of_models: Array, numbers: Array) -> Array:
        dynamics = with_numbers(self._dynamics, numbers_of_models)
        state = self._packing.unpack(Packed(numbers, dynamics.zero_lstm_state()))
        return self._packing.pack(adjusted_state(dynamics, state)).numbers


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

    gain: LogFactor = 0.0
    dead_zone: Number = 0.0
    lag: LogFactor = 0.0


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
    # A structure without a lag of its own has that of its spool, where there is one.
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
            continue  # that direction stays the same object, with all that is known of it
        channel = model.channels[direction]
        benchmark = changed_benchmark(channel.benchmark, jnp.asarray(change, float))
        dead_zone = channel.dead_zone + change.dead_zone
        channels[direction] = replace(channel, dead_zone=dead_zone, benchmark=benchmark)
        if direction in uncertainty:
            uncertainty[direction] = _changed_uncertainty(uncertainty[direction], channel, change, factor)
        rivals.pop(direction, None)
        adapted[direction] = {**change._asdict(), "band_factor": factor}
    return replace(
        model,
        channels=channels,
        uncertainty=uncertainty,
        rivals=rivals,
        # Without a digest: it is not the model of the file any more.
        provenance=replace(model.provenance, adapted=adapted, digest=""),
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
    bands, ensemble = uncertainty.bands, []
    if bands is not None:
        for member in bands.ensemble:
            perturbed = benchmark.with_parameter_vector(jnp.asarray(member.benchmark))
            row = changed_benchmark(perturbed, jnp.asarray(changes, float)).parameter_vector
            ensemble.append(replace(member, benchmark=tuple(map(float, row))))
        multipliers = tuple(tuple(band_factor * own for own in row) for row in bands.predictions.multipliers)
        bands = replace(
            bands,
            ensemble=tuple(ensemble),
            free_run=tuple(band_factor * multiplier for multiplier in bands.free_run),
            predictions=replace(bands.predictions, multipliers=multipliers),
        )
    return Uncertainty(estimates, bands, load_scatter=uncertainty.load_scatter)
