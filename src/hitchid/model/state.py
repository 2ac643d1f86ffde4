"""State of a hitch at one sample."""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Float32, Int

from hitchid._support.records import short_repr
from hitchid.model.load_filter import ErrorEstimate
from hitchid.networks.error_compensator import FeatureState
from hitchid.structures import DiscretePhysicalModel, ValveState

Tree = TypeVar("Tree")


@short_repr
class SpeedCompensatorState(NamedTuple):
    """Inputs of the compensator for free run from the past.

    Attributes:
        speed, acceleration: of the benchmark's travel up to now, in the displacement's unit, 1/s, 1/s².
    """

    speed: Float[Array, ""]
    acceleration: Float[Array, ""]


@short_repr
class ChannelState(NamedTuple):
    """State of one channel.

    Attributes:
        valve: state of the valve; it follows the command also while another channel is active.
        plant: state of the benchmark, shape [n].
        samples_in_charge: samples since the channel took charge.
        correction: state of the compensator for free run; None where there is none.
        at_load: its benchmark at the load of the run; None where its parameters do not vary with covariates.
    """

    valve: ValveState
    plant: Float[Array, " n"]
    samples_in_charge: Int[Array, ""]
    correction: SpeedCompensatorState | None
    at_load: DiscretePhysicalModel | None = None


@short_repr
class HitchState(NamedTuple):
    """State of a hitch at one sample; displacements in the model's unit.

    Attributes:
        displacement: output of the model: benchmark plus predicted error once a displacement was measured,
            the free run before.
        error: predicted error of the benchmark.
        innovation: that of the load filter at this sample, as the active compensator predicts it.
        benchmark: output of the benchmark, clipped to the limits of the plant but not to end stops.
        free_run: output of the compensated free run, clipped likewise.
        start: displacement at which the active channel took over.
        mode: index of the active channel; −1 before the first effective command.
        samples_since_measurement: samples since the last measured displacement; −1 before the first.
        commands: last valid lifting and lowering command, shape [2].
        command_missing: whether a command was missing and its last value was used.
        both_valves_active: whether both valves were open; then lowering takes precedence.
        load: covariates before motion, in the order of the model, shape [L]; one zero where there is none.
        estimates: of the load filter of each channel, before the measurement at this sample, shape [C, ...];
            that of the active channel counts.
        feature_state: features of the active compensator.
        channels: state of each channel.
        hidden: h and c of the active network, for the current and the next window, shape [2, 2, H].
    """

    displacement: Float[Array, ""]
    error: Float[Array, ""]
    innovation: Float[Array, ""]
    benchmark: Float[Array, ""]
    free_run: Float[Array, ""]
    start: Float[Array, ""]
    mode: Int[Array, ""]
    samples_since_measurement: Int[Array, ""]
    commands: Float[Array, "2"]
    command_missing: Bool[Array, ""]
    both_valves_active: Bool[Array, ""]
    load: Float[Array, " l"]
    estimates: ErrorEstimate
    feature_state: FeatureState
    channels: tuple[ChannelState, ...]
    hidden: Float32[Array, "2 2 h"]


class Switching(NamedTuple):
    """Which valves are in charge; see `HitchState`.

    Attributes:
        mode: index of the active channel; −1 before the first effective command.
        both_valves_active: whether both valves were open; then lowering takes precedence.
    """

    mode: int
    both_valves_active: bool


def select(condition: Bool[Array, ""], new: Tree, old: Tree) -> Tree:
    """Return the new state where the condition holds, otherwise the old one; both of one structure."""
    return jax.tree.map(lambda new_leaf, old_leaf: jnp.where(condition, new_leaf, old_leaf), new, old)
