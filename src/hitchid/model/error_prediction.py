"""Error compensator in a hitch: features, and the predicted innovation of the filter."""

from collections.abc import Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Float32

from hitchid.model.channel import Channel
from hitchid.model.inputs import channel_load
from hitchid.model.state import HitchState, NetworkInput
from hitchid.networks.error_compensator import COMPENSATOR_FEATURES, Compensator, FeatureState, Sample
from hitchid.networks.lstm import SINGLE, LstmState

Tree = TypeVar("Tree")


def compute_features(
    channels: Sequence[Channel], state: HitchState, reset: Bool[Array, ""], step_s: float
) -> tuple[HitchState, Float32[Array, "10"], Float[Array, ""]]:
    """Return the state with new features of the active channel, the scaled features, and their trust.

    The trust is zero without a measured displacement within the compensator's largest horizon.
    """
    since = state.samples_since_measurement
    selected = state.feature_state, jnp.zeros(len(COMPENSATOR_FEATURES), SINGLE), jnp.zeros(())
    for number, channel in enumerate(channels):
        if channel.compensator is None:
            continue
        channel_state, displacement = (
            state.channels[number],
            clip_at_end_stops(channels, state, state.benchmark),
        )
        effective = channel_state.valve.effective
        time_s = step_s * channel_state.samples_in_charge.astype(displacement.dtype)
        sample = Sample(time_s, effective, displacement, displacement + state.error)
        load = channel_load(channels, number, state.load)
        trust = channel.operating_range.trust(jnp.abs(effective), displacement, load)
        previous = select(reset, FeatureState.at_rest(sample), state.feature_state)
        feature_state, scaled_features = channel.compensator.update_features(previous, sample, step_s)
        recent = (since >= 0) & (since < channel.compensator.max_horizon)
        selected = select(recent & (state.mode == number), (feature_state, scaled_features, trust), selected)
    return state._replace(feature_state=selected[0]), *selected[1:]


def predict_innovation(
    compensator: Compensator | None, hidden: Float32[Array, "2 2 h"], network_input: NetworkInput
) -> tuple[Float32[Array, "2 2 h"], Float[Array, ""]]:
    """Return the next state of a network, and the innovation of the filter at the next sample."""
    if compensator is None:
        return hidden, jnp.zeros(())
    size = compensator.network.cell.hidden_size
    previous = jnp.where(network_input.reset, 0.0, hidden[..., :size])
    lstm_state, increment = compensator.predict_increment(
        LstmState(*previous), network_input.index_in_window, network_input.scaled_features
    )
    return hidden.at[..., :size].set(jnp.stack(lstm_state)), increment


def clip_at_end_stops(
    channels: Sequence[Channel], state: HitchState, displacement: Float[Array, ""]
) -> Float[Array, ""]:
    """Return a displacement clipped to the end stops, or to the start of a stroke that begins beyond them."""
    for channel in channels:
        if channel.end_stop is not None:
            farther = jnp.maximum if channel.sign > 0 else jnp.minimum
            nearer = jnp.minimum if channel.sign > 0 else jnp.maximum
            displacement = nearer(displacement, farther(channel.end_stop, state.start))
    return displacement


def select(condition: Bool[Array, ""], new: Tree, old: Tree) -> Tree:
    """Return the new state where the condition holds, otherwise the old one; both of one structure."""
    return jax.tree.map(lambda new_leaf, old_leaf: jnp.where(condition, new_leaf, old_leaf), new, old)
