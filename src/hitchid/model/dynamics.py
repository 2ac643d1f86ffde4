"""The hitch one sample at a time: which channel is in charge, and what it does with the piston.

The one definition of a hitch's motion. docs/switching.md has the state machine as a table.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Float32, Int

from hitchid.data.record import DIRECTIONS
from hitchid.data.test_kinds import ACTIVE_FRACTION
from hitchid.model.channel import Channel
from hitchid.networks.error_compensator import FEATURES, Compensator, FeatureState, Sample
from hitchid.networks.lstm import SINGLE, LstmState
from hitchid.structures import DiscretePhysicalModel, ValveState

Tree = TypeVar("Tree")
STANDING = -1
MAX_COASTING_SAMPLES = 100
MAX_MAGNITUDE = 1e9


class SpeedCompensatorState(NamedTuple):
    """State of the compensator for free run.

    Attributes:
        hidden: of its networks, shape [M, 1, H].
        factor: on the benchmark's speed in this block.
        command, travel_increment: sums over this block so far, of effective command and of the benchmark's
            travel.
    """

    hidden: LstmState
    factor: Float[Array, ""]
    command: Float[Array, ""]
    travel_increment: Float[Array, ""]


class ChannelState(NamedTuple):
    """State of one channel.

    Attributes:
        valve: hears every command, in charge or not.
        plant: of the benchmark.
        samples_in_charge: samples since the channel took charge.
        correction: of the compensator for free run; None where there is none.
    """

    valve: ValveState
    plant: Float[Array, " n"]
    samples_in_charge: Int[Array, ""]
    correction: SpeedCompensatorState | None


class HitchState(NamedTuple):
    """State of a hitch at one sample; displacements in the model's unit.

    Attributes:
        displacement: what the model says it is: with measurements the benchmark's plus the predicted error,
            without any, the free run.
        error: predicted error of the benchmark.
        benchmark: the benchmark's, as if there were no end stop, but within the limits of the plant.
        free_run: free run, compensated, likewise.
        start: where the channel in charge took it.
        mode: place of the channel in charge; −1 while nothing has moved yet.
        samples_since_measurement: samples since a displacement was measured; −1 if none ever was.
        commands: lifting and lowering command last heard, shape [2].
        command_missing: whether a command was missing and the last one held.
        both_valves_active: whether both valves were on; then lowering counts.
        load: second measured input, before motion.
        feature_state: of the compensator in charge.
        channels: of each channel.
        hidden: of the network in charge: output and cell of the LSTM that answers and of the one that
            follows, shape [2, 2, H].
    """

    displacement: Float[Array, ""]
    error: Float[Array, ""]
    benchmark: Float[Array, ""]
    free_run: Float[Array, ""]
    start: Float[Array, ""]
    mode: Int[Array, ""]
    samples_since_measurement: Int[Array, ""]
    commands: Float[Array, "2"]
    command_missing: Bool[Array, ""]
    both_valves_active: Bool[Array, ""]
    load: Float[Array, ""]
    feature_state: FeatureState
    channels: tuple[ChannelState, ...]
    hidden: Float32[Array, "2 2 h"]


class NetworkInput(NamedTuple):
    """What the network of the channel in charge is asked.

    Attributes:
        channel_index: place of the channel.
        scaled_features: features, shape [10].
        index_in_window: samples read, modulo L.
        trust: factor on its answer; zero where it is not to answer.
        reset: whether it starts anew.
        error: predicted error so far.
        benchmark: displacement without error; free: without measurements.
        has_measurement: whether a displacement was ever measured.
    """

    channel_index: Int[Array, ""]
    scaled_features: Float32[Array, "10"]
    index_in_window: Int[Array, ""]
    trust: Float[Array, ""]
    reset: Bool[Array, ""]
    error: Float[Array, ""]
    benchmark: Float[Array, ""]
    free_run: Float[Array, ""]
    has_measurement: Bool[Array, ""]


class HitchDynamics(eqx.Module):
    """A hitch on its clock.

    Attributes:
        channels: in the order of the modes.
        discrete_models: their benchmarks on the clock.
        drift: speed of a piston that is held, displacement's unit/s.
        step_s: sampling time, s.
    """

    channels: tuple[Channel, ...]
    discrete_models: tuple[DiscretePhysicalModel, ...]
    drift: float = eqx.field(static=True)
    step_s: float = eqx.field(static=True)

    @classmethod
    def of(cls, channels: Sequence[Channel], step_s: float, drift: float) -> "HitchDynamics":
        """Put channels on a clock."""
        return cls(
            tuple(channels), tuple(_discrete_model(channel, step_s) for channel in channels), drift, step_s
        )

    def standing_state(self, displacement: float = 0.0, load: float = 0.0) -> HitchState:
        """Return the state of a hitch that stands, its valves shut."""
        return self.init_state(jnp.asarray(float(displacement)), jnp.asarray(float(load)))

    def init_state(self, displacement: Float[Array, ""], load: Float[Array, ""]) -> HitchState:
        """Return the state of a hitch that stands, its valves shut."""
        zero = jnp.zeros(())
        false = jnp.zeros((), jnp.bool_)
        return HitchState(
            displacement=displacement,
            benchmark=displacement,
            free_run=displacement,
            start=displacement,
            error=zero,
            mode=jnp.asarray(0 if len(self.channels) == 1 else STANDING),
            samples_since_measurement=jnp.asarray(-1),
            commands=jnp.zeros(2),
            command_missing=false,
            both_valves_active=false,
            load=load,
            feature_state=FeatureState.at_rest(Sample(zero, zero, displacement, displacement)),
            channels=tuple(
                self._init_channel(number, discrete_model.closed_valve(), displacement, zero, load)
                for number, discrete_model in enumerate(self.discrete_models)
            ),
            hidden=self.zero_lstm_state(),
        )

    def step(
        self, state: HitchState, commands: Float[Array, "2"], measured: Float[Array, ""]
    ) -> tuple[HitchState, Float[Array, ""]]:
        """Return the state one sample later, and the displacement then.

        Args:
            state: at this sample.
            commands: lifting and lowering command, held until the next sample; where one is not finite the
                last one stands.
            measured: displacement at this sample; not finite where it was not measured.
        """
        next_state, network_input = self.advance_physics(state, commands, measured)
        hidden, error, displacement = self.advance_network(next_state.hidden, network_input)
        return next_state._replace(hidden=hidden, error=error, displacement=displacement), displacement

    def advance_physics(
        self, state: HitchState, commands: Float[Array, "2"], measured: Float[Array, ""]
    ) -> tuple[HitchState, NetworkInput]:
        """Do all of a step but the network's part; see `step` and `answer`."""
        command_valid = jnp.abs(commands) < MAX_MAGNITUDE
        commands = jnp.where(command_valid, commands, state.commands)
        is_measured = jnp.abs(measured) < MAX_MAGNITUDE
        valves = tuple(
            discrete_model.step_valve(
                channel_state.valve, commands[DIRECTIONS.index(channel.direction)], state.load
            )
            for channel, discrete_model, channel_state in zip(
                self.channels, self.discrete_models, state.channels, strict=True
            )
        )
        demands = [valve.motion_demand[-1] for valve in valves]
        mode = state.mode
        for number, demand in enumerate(demands):
            # Where both call, the last of the modes counts: lowering.
            mode = jnp.where(demand, number, mode)
        next_state = state._replace(
            error=jnp.where(
                is_measured, measured - self._clip_at_end_stops(state, state.benchmark), state.error
            ),
            mode=mode,
            samples_since_measurement=jnp.where(
                is_measured,
                0,
                jnp.where(
                    state.samples_since_measurement >= 0,
                    state.samples_since_measurement + 1,
                    state.samples_since_measurement,
                ),
            ),
            commands=commands,
            command_missing=~jnp.all(
                jnp.stack([command_valid[DIRECTIONS.index(channel.direction)] for channel in self.channels])
            ),
            both_valves_active=jnp.sum(jnp.stack([valve.motion_demand[0] for valve in valves])) > 1,
            channels=tuple(
                channel_state._replace(valve=valve)
                for channel_state, valve in zip(state.channels, valves, strict=True)
            ),
        )
        displacement = jnp.where(is_measured, measured, state.displacement)
        entering = (mode != state.mode) & (state.mode != STANDING)
        speed = self._speed(state.mode, next_state)
        for number in range(len(self.channels)):
            next_state = self._enter_channel(
                number, next_state, entering & (mode == number), displacement, speed
            )
        reset = (mode != state.mode) | (is_measured & (state.samples_since_measurement < 0))
        next_state, scaled_features, trust = self._features(next_state, reset)
        for number in range(len(self.channels)):
            next_state = self._advance_channel(number, next_state)
        next_state = self._clip_at_limits(self._apply_drift(next_state, ~jnp.any(jnp.stack(demands))))
        return next_state, NetworkInput(
            channel_index=jnp.maximum(mode, 0),
            scaled_features=scaled_features,
            index_in_window=next_state.feature_state.index_in_window,
            trust=trust,
            reset=reset,
            error=next_state.error,
            benchmark=self._clip_at_end_stops(next_state, next_state.benchmark),
            free_run=self._clip_at_end_stops(next_state, next_state.free_run),
            has_measurement=next_state.samples_since_measurement >= 0,
        )

    def advance_network(
        self, hidden: Float32[Array, "2 2 h"], network_input: NetworkInput
    ) -> tuple[Float32[Array, "2 2 h"], Float[Array, ""], Float[Array, ""]]:
        """Let the network of the channel in charge predict the error.

        Returns:
            The network's state, the error, and the displacement at the next sample.
        """
        predictors = [partial(_predict_increment, channel.compensator) for channel in self.channels]
        hidden, increment = jax.lax.switch(network_input.channel_index, predictors, hidden, network_input)
        error = network_input.error + network_input.trust * increment
        return (
            hidden,
            error,
            jnp.where(network_input.has_measurement, network_input.benchmark + error, network_input.free_run),
        )

    def zero_lstm_state(self) -> Float32[Array, "2 2 h"]:
        """Return the state of a network that has read nothing, wide enough for any channel's."""
        sizes = [
            channel.compensator.network.cell.hidden_size
            for channel in self.channels
            if channel.compensator is not None
        ]
        return jnp.zeros((2, 2, max(sizes, default=0)), SINGLE)

    def _clip_at_end_stops(self, state: HitchState, displacement: Float[Array, ""]) -> Float[Array, ""]:
        """Return a displacement no farther than the end stops, or than the stroke's start beyond them."""
        for channel in self.channels:
            if channel.end_stop is not None:
                farther = jnp.maximum if channel.sign > 0 else jnp.minimum
                nearer = jnp.minimum if channel.sign > 0 else jnp.maximum
                displacement = nearer(displacement, farther(channel.end_stop, state.start))
        return displacement

    def _clip_at_limits(self, state: HitchState) -> HitchState:
        """Hold the benchmark and the free run within the limits of the plant: beyond them nothing goes on."""
        limits = self.channels[0].limits
        if limits is None:
            return state
        return state._replace(
            benchmark=limits.clip(state.benchmark, state.start),
            free_run=limits.clip(state.free_run, state.start),
        )

    def _apply_drift(self, state: HitchState, is_held: Bool[Array, ""]) -> HitchState:
        """Let a held piston creep, from the end stop if it stands there."""
        if not self.drift:
            return state
        drift_travel = self.drift * self.step_s
        benchmark, free = (
            jnp.where(is_held, self._clip_at_end_stops(state, displacement) + drift_travel, displacement)
            for displacement in (state.benchmark, state.free_run)
        )
        return state._replace(benchmark=benchmark, free_run=free)

    def _features(
        self, state: HitchState, reset: Bool[Array, ""]
    ) -> tuple[HitchState, Float32[Array, "10"], Float[Array, ""]]:
        """Return scaled features of the channel in charge, and the trust in what its network answers.

        None, if nothing was measured lately.
        """
        recent = (state.samples_since_measurement >= 0) & (
            state.samples_since_measurement < MAX_COASTING_SAMPLES
        )
        selected = state.feature_state, jnp.zeros(len(FEATURES), SINGLE), jnp.zeros(())
        for number, channel in enumerate(self.channels):
            if channel.compensator is None:
                continue
            channel_state, displacement = (
                state.channels[number],
                self._clip_at_end_stops(state, state.benchmark),
            )
            effective = channel_state.valve.effective
            time_s = self.step_s * channel_state.samples_in_charge.astype(displacement.dtype)
            sample = Sample(time_s, effective, displacement, displacement + state.error)
            trust = jnp.ones(())
            if channel.envelope is not None:
                trust = channel.envelope.trust(jnp.abs(effective), displacement, state.load)
            previous = _select(reset, FeatureState.at_rest(sample), state.feature_state)
            feature_state, scaled_features = channel.compensator.update_features(
                previous, sample, self.step_s
            )
            selected = _select(
                recent & (state.mode == number), (feature_state, scaled_features, trust), selected
            )
        return state._replace(feature_state=selected[0]), *selected[1:]

    def _init_channel(
        self,
        number: int,
        valve: ValveState,
        displacement: Float[Array, ""],
        speed: Float[Array, ""],
        load: Float[Array, ""],
    ) -> ChannelState:
        """Return a channel that takes charge at a displacement and a speed."""
        channel = self.channels[number]
        correction = None
        if channel.speed_compensator is not None:
            networks = channel.speed_compensator.networks
            lstm_state = networks.zero_state((networks.head.weight.shape[0], 1))
            correction = SpeedCompensatorState(lstm_state, jnp.ones(()), jnp.zeros(()), jnp.zeros(()))
        plant = self.discrete_models[number].init_state(displacement, speed, load)
        return ChannelState(valve, plant, jnp.asarray(0), correction)

    def _speed(self, mode: Int[Array, ""], state: HitchState) -> Float[Array, ""]:
        """Return the speed of the piston; none where it is at an end stop or a limit of the plant."""
        speed = jnp.zeros(())
        inside = self._clip_at_end_stops(state, state.benchmark) == state.benchmark
        limits = self.channels[0].limits
        if limits is not None:
            inside &= limits.is_inside(state.benchmark, state.start)
        for number, (discrete_model, channel_state) in enumerate(
            zip(self.discrete_models, state.channels, strict=True)
        ):
            channel_speed = discrete_model.speed(
                channel_state.plant, channel_state.valve, state.benchmark, state.load
            )
            speed = jnp.where(mode == number, jnp.where(inside, channel_speed, 0.0), speed)
        return speed

    def _enter_channel(
        self,
        number: int,
        state: HitchState,
        entering: Bool[Array, ""],
        displacement: Float[Array, ""],
        speed: Float[Array, ""],
    ) -> HitchState:
        """Let a channel take charge, where it does, at the plant's displacement and speed."""
        channel_state = state.channels[number]
        initial_state = self._init_channel(number, channel_state.valve, displacement, speed, state.load)
        new_state = _select(entering, initial_state, channel_state)
        return state._replace(
            benchmark=jnp.where(entering, displacement, state.benchmark),
            free_run=jnp.where(entering, displacement, state.free_run),
            start=jnp.where(entering, displacement, state.start),
            error=jnp.where(entering, 0.0, state.error),
            channels=_replace_item(state.channels, number, new_state),
        )

    def _advance_channel(self, number: int, state: HitchState) -> HitchState:
        """Move the piston by a channel where it is in charge; what corrects it hears it standing too."""
        discrete_model, channel_state = self.discrete_models[number], state.channels[number]
        in_charge = state.mode == number
        plant, increment = discrete_model.advance(
            channel_state.plant, channel_state.valve, state.benchmark, state.load
        )
        increment = jnp.where(in_charge, increment, 0.0)
        is_active = in_charge | (state.mode == STANDING)
        correction, factor = self._correct_speed(number, channel_state, is_active, increment, state)
        next_channel_state = ChannelState(
            channel_state.valve,
            jnp.where(in_charge, plant, channel_state.plant),
            channel_state.samples_in_charge + is_active,
            correction,
        )
        return state._replace(
            benchmark=state.benchmark + increment,
            free_run=state.free_run + factor * increment,
            channels=_replace_item(state.channels, number, next_channel_state),
        )

    def _correct_speed(
        self,
        number: int,
        channel_state: ChannelState,
        is_active: Bool[Array, ""],
        increment: Float[Array, ""],
        state: HitchState,
    ) -> tuple[SpeedCompensatorState | None, Float[Array, ""]]:
        """Return the factor on the benchmark's speed; at a block's start the networks hear the last."""
        channel, correction = self.channels[number], channel_state.correction
        compensator = channel.speed_compensator
        if compensator is None or correction is None:
            return None, jnp.ones(())

        def start_block(_: None) -> SpeedCompensatorState:
            hidden, factor = compensator.step(
                compensator.networks,
                correction.hidden,
                correction.command[None] / compensator.block_size,
                correction.travel_increment[None],
                state.free_run[None],
                state.load[None],
            )
            return SpeedCompensatorState(hidden, factor[0], jnp.zeros(()), jnp.zeros(()))

        block_starts = is_active & (channel_state.samples_in_charge % compensator.block_size == 0)
        current = jax.lax.cond(block_starts, start_block, lambda _: correction, None)
        accumulated = current._replace(
            command=current.command + jnp.where(is_active, channel_state.valve.effective, 0.0),
            travel_increment=current.travel_increment + channel.sign * increment,
        )
        return accumulated, current.factor


def _predict_increment(
    compensator: Compensator | None, hidden: Float32[Array, "2 2 h"], network_input: NetworkInput
) -> tuple[Float32[Array, "2 2 h"], Float[Array, ""]]:
    """Return a network's state, and the step the error takes to the next sample."""
    if compensator is None:
        return hidden, jnp.zeros(())
    size = compensator.network.cell.hidden_size
    previous = jnp.where(network_input.reset, 0.0, hidden[..., :size])
    lstm_state, increment = compensator.predict_increment(
        LstmState(*previous), network_input.index_in_window, network_input.scaled_features
    )
    return hidden.at[..., :size].set(jnp.stack(lstm_state)), increment


def _select(condition: Bool[Array, ""], new: Tree, old: Tree) -> Tree:
    """Return one of two states of one structure."""
    return jax.tree.map(lambda new_leaf, old_leaf: jnp.where(condition, new_leaf, old_leaf), new, old)


def _replace_item(items: tuple, index: int, item: object) -> tuple:
    """Return a tuple with one part in another's place."""
    return (*items[:index], item, *items[index + 1 :])


def _discrete_model(channel: Channel, step_s: float) -> DiscretePhysicalModel:
    full_scale = channel.dead_zone
    if channel.envelope is not None:
        full_scale += float(channel.envelope.command.highest)
    return DiscretePhysicalModel.of(
        channel.benchmark,
        dead_zone=channel.dead_zone,
        min_command=ACTIVE_FRACTION * full_scale,
        sign=channel.sign,
        step_s=step_s,
    )
