"""Dynamics of a hitch, one sample at a time: the active channel, and the motion of the piston.

Simulation, prediction and online use of a hitch run this step. The state machine is documented in
:doc:`/switching`.
"""

from collections.abc import Sequence
from functools import partial
from math import isfinite

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Float32, Int

from hitchid._support.bounded import MAX_MAGNITUDE
from hitchid.logs.kinds import ACTIVE_FRACTION
from hitchid.logs.record import DIRECTIONS
from hitchid.model.channel import Channel
from hitchid.model.inputs import channel_load, mean_load
from hitchid.model.load_filter import OFFSET, LoadFilter
from hitchid.model.state import ChannelState, HitchState, SpeedCompensatorState, select
from hitchid.networks.error_compensator import COMPENSATOR_FEATURES, Compensator, FeatureState, Sample
from hitchid.networks.lstm import SINGLE, LstmState
from hitchid.structures import DiscretePhysicalModel, ValveState

STANDING = -1  # `HitchState.mode` before the first effective command: no channel is active


class HitchDynamics(eqx.Module):
    """Discrete-time dynamics of a hitch.

    Attributes:
        channels: channels in the order of `DIRECTIONS`.
        discrete_models: their benchmarks, discretised.
        drift: speed of a piston that is held, displacement's unit/s; None where it stays.
        step_s: sampling time, s.
    """

    channels: tuple[Channel, ...]
    discrete_models: tuple[DiscretePhysicalModel, ...]
    drift: float | None
    step_s: float = eqx.field(static=True)

    @classmethod
    def of(cls, channels: Sequence[Channel], step_s: float, drift: float | None) -> "HitchDynamics":
        """Return the dynamics of channels, their benchmarks discretised at a sampling time."""
        models = []
        for channel in channels:
            highest = float(channel.operating_range.command.highest)
            full_scale = channel.dead_zone + (highest if isfinite(highest) else 0.0)
            models.append(
                DiscretePhysicalModel.of(
                    channel.benchmark,
                    dead_zone=channel.dead_zone,
                    min_command=ACTIVE_FRACTION * full_scale,
                    sign=channel.sign,
                    step_s=step_s,
                )
            )
        # No drift is None, not zero: nothing of it is then compiled.
        return cls(tuple(channels), tuple(models), drift or None, step_s)

    def standing_state(self) -> HitchState:
        """Return the state at rest with closed valves at zero and the tests' mean load: the form of any."""
        return self.init_state(jnp.zeros(()), jnp.asarray(mean_load(self.channels), dtype=float))

    def init_state(self, displacement: Float[Array, ""], load: Float[Array, " l"]) -> HitchState:
        """Return the state of a hitch at rest with closed valves.

        Args:
            displacement: where the piston is.
            load: the covariates, in the order of `covariates_of`; one zero where there is none.
        """
        zero = jnp.zeros(())
        false = jnp.zeros((), jnp.bool_)
        return HitchState(
            displacement=displacement,
            benchmark=displacement,
            free_run=displacement,
            start=displacement,
            error=zero,
            innovation=zero,
            mode=jnp.asarray(0 if len(self.channels) == 1 else STANDING),
            samples_since_measurement=jnp.asarray(-1),
            commands=jnp.zeros(2),
            command_missing=false,
            both_valves_active=false,
            load=load,
            estimates=self._load_filters.init_estimate(jnp.zeros(len(self.channels)), self.step_s),
            feature_state=FeatureState.at_rest(Sample(zero, zero, displacement, displacement)),
            channels=tuple(
                self._init_channel(
                    number,
                    discrete_model.closed_valve(),
                    displacement,
                    zero,
                    discrete_model.at_load(channel_load(self.channels, number, load))
                    if discrete_model.is_scheduled
                    else None,
                )
                for number, discrete_model in enumerate(self.discrete_models)
            ),
            hidden=self.zero_lstm_state(),
        )

    def step(
        self, state: HitchState, commands: Float[Array, "2"], measured: Float[Array, ""]
    ) -> tuple[HitchState, Float[Array, ""]]:
        """Return the state and the displacement at the next sample.

        Args:
            state: state at this sample.
            commands: lifting and lowering command, constant until the next sample; one that is not finite
                keeps its last value.
            measured: displacement at this sample; not finite where it was not measured.
        """
        next_state, reset, demands = self._take_charge(state, commands, measured)
        # The features are of this sample, so they are read before the physics move on.
        next_state, scaled_features, trust = self._compute_features(next_state, reset)
        next_state = self._advance_physics(next_state, demands)
        hidden, predicted = self._predict_innovation(next_state, scaled_features, reset)
        innovation = trust * predicted
        error = next_state.estimates.error[jnp.maximum(next_state.mode, 0)] + innovation
        # Before the first measurement nothing is known of the error: the model is in free run, whose
        # compensator corrects the speed. After it the filter knows more, and corrects the benchmark instead.
        displacement = jnp.where(
            next_state.samples_since_measurement >= 0,
            self.within_end_stops(next_state, next_state.benchmark) + error,
            self.within_end_stops(next_state, next_state.free_run),
        )
        next_state = next_state._replace(
            displacement=displacement, error=error, innovation=innovation, hidden=hidden
        )
        return next_state, displacement

    def _take_charge(
        self, state: HitchState, commands: Float[Array, "2"], measured: Float[Array, ""]
    ) -> tuple[HitchState, Bool[Array, ""], list[Bool[Array, ""]]]:
        """Return the state after measurement and commands of a sample, before the piston moves.

        Beside it: whether the features of the compensator begin anew, and which valves demand motion.
        """
        # A command that is lost or absurd keeps its last value, as the valve does; not finite ones compare as
        # false, so that no NaN gets into the state, where it would stay.
        command_valid = jnp.abs(commands) < MAX_MAGNITUDE
        commands = jnp.where(command_valid, commands, state.commands)
        is_measured = jnp.abs(measured) < MAX_MAGNITUDE
        # Every valve follows its command, also while another channel moves the piston: lags and dead times
        # run on, and after a reversal what was commanded before it still plays out.
        valves = tuple(
            self._discrete_model(number, state.channels[number]).step_valve(
                state.channels[number].valve, commands[DIRECTIONS.index(channel.direction)]
            )
            for number, channel in enumerate(self.channels)
        )
        demands = [valve.motion_demand[-1] for valve in valves]
        mode = state.mode
        for number, demand in enumerate(demands):
            # If both valves demand motion, the last direction takes precedence: lowering.
            mode = jnp.where(demand, number, mode)
        # The measurement belongs to this sample, at which the last channel was still in charge: its filter is
        # corrected before another channel takes over, which would move the benchmark to where the piston is.
        next_state = self._with_measurement(state, measured, is_measured)._replace(
            mode=mode,
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
        # A channel takes over where the piston is now: at the displacement that the corrected filter
        # estimates, which is smoother than the measured one, and at the speed of the last channel, so that
        # nothing jumps at a reversal. The first one starts from rest, as `init_state` left it.
        estimated = next_state.estimates.error[jnp.maximum(state.mode, 0)]
        displacement = jnp.where(
            is_measured,
            self.within_end_stops(state, state.benchmark) + estimated,
            state.displacement,
        )
        entering = (mode != state.mode) & (state.mode != STANDING)
        speed = self._speed(state.mode, next_state)
        for number in range(len(self.channels)):
            next_state = self._enter_channel(
                number, next_state, entering & (mode == number), displacement, speed
            )
        # After the takeover: the variance of the last filter goes over into the new one.
        next_state = self._start_filter(next_state, state.mode)
        # Features begin anew with a channel, and with the first measurement: before it there is no error.
        reset = (mode != state.mode) | (is_measured & (state.samples_since_measurement < 0))
        return next_state, reset, demands

    def _advance_physics(self, state: HitchState, demands: list[Bool[Array, ""]]) -> HitchState:
        """Return the state with the piston, in benchmark and free run, and the load filters moved on."""
        modelled = self.within_end_stops(state, state.benchmark)
        for number in range(len(self.channels)):
            state = self._advance_channel(number, state)
        is_held = ~jnp.any(jnp.stack(demands))
        limits, moved = self.channels[0].limits, []
        for displacement in (state.benchmark, state.free_run):
            if self.drift is not None:
                # From the stop where the model is beyond it: there the real piston stands and creeps.
                crept = self.within_end_stops(state, displacement) + self.drift * self.step_s
                displacement = jnp.where(is_held, crept, displacement)
            # Last, as drift is held at the limits of the plant like any other motion.
            moved.append(displacement if limits is None else limits.clip(displacement, state.start))
        state = state._replace(benchmark=moved[0], free_run=moved[1])
        # The filter's input is what the benchmark really moved, between the stops: beyond them no load shows.
        # All filters advance alike, though only the active one counts: which, is known at run time.
        increment = self.within_end_stops(state, state.benchmark) - modelled
        return state._replace(
            estimates=self._load_filters.advance(
                state.estimates, jnp.broadcast_to(increment, len(self.channels)), self.step_s
            )
        )

    @property
    def _load_filters(self) -> LoadFilter:
        """The load filters of all channels, parameters of shape [C]."""
        return jax.tree.map(
            lambda *values: jnp.stack(values), *(channel.load_filter for channel in self.channels)
        )

    def _with_measurement(
        self, state: HitchState, measured: Float[Array, ""], is_measured: Bool[Array, ""]
    ) -> HitchState:
        """Return the state with corrected filters; unmeasured, they take the predicted innovation."""
        count = state.samples_since_measurement
        error = measured - self.within_end_stops(state, state.benchmark)
        corrected = self._load_filters.correct(
            state.estimates, jnp.broadcast_to(jnp.where(is_measured, error, 0.0), len(self.channels))
        )
        return state._replace(
            error=jnp.where(is_measured, error, state.error),
            estimates=select(is_measured, corrected, state.estimates.with_innovation(state.innovation)),
            samples_since_measurement=jnp.where(is_measured, 0, jnp.where(count >= 0, count + 1, count)),
        )

    def _start_filter(self, state: HitchState, last_mode: Int[Array, ""]) -> HitchState:
        """Start the filter of a channel that takes charge: its load is unknown."""
        estimates, from_rest = state.estimates, last_mode == STANDING
        # A channel that takes over starts at the estimated displacement, which leaves no offset, with the
        # variance of that estimate; the first one keeps what was measured at rest.
        offset = jnp.where(from_rest, estimates.mean[OFFSET], 0.0)
        variance = jnp.where(from_rest, estimates.variance, estimates.variance[last_mode])
        fresh = self._load_filters.init_estimate(offset, self.step_s)
        started = fresh._replace(
            mean=fresh.mean.at[OFFSET].set(offset),
            covariance=fresh.covariance.at[OFFSET, OFFSET].set(variance),
        )
        return state._replace(estimates=select(state.mode != last_mode, started, estimates))

    def _compute_features(
        self, state: HitchState, reset: Bool[Array, ""]
    ) -> tuple[HitchState, Float32[Array, "10"], Float[Array, ""]]:
        """Return the state with new features of the active channel, the scaled features, and their trust.

        The trust is zero without a measured displacement within the compensator's largest horizon.
        """
        since, displacement = state.samples_since_measurement, self.within_end_stops(state, state.benchmark)
        selected = state.feature_state, jnp.zeros(len(COMPENSATOR_FEATURES), SINGLE), jnp.zeros(())
        for number, channel in enumerate(self.channels):
            if channel.compensator is None:
                continue
            channel_state = state.channels[number]
            effective = channel_state.valve.effective
            time_s = self.step_s * channel_state.samples_in_charge.astype(displacement.dtype)
            sample = Sample(time_s, effective, displacement, displacement + state.error)
            load = channel_load(self.channels, number, state.load)
            trust = channel.operating_range.trust(jnp.abs(effective), displacement, load)
            previous = select(reset, FeatureState.at_rest(sample), state.feature_state)
            feature_state, scaled_features = channel.compensator.update_features(
                previous, sample, self.step_s
            )
            # Longer without a measurement the network is not asked: it may diverge on its own output.
            recent = (since >= 0) & (since < channel.compensator.max_horizon)
            own = feature_state, scaled_features, trust
            selected = select(recent & (state.mode == number), own, selected)
        return state._replace(feature_state=selected[0]), *selected[1:]

    def _predict_innovation(
        self, state: HitchState, scaled_features: Float32[Array, "10"], reset: Bool[Array, ""]
    ) -> tuple[Float32[Array, "2 2 h"], Float[Array, ""]]:
        """Return the next state of the active network, and the innovation at the next sample."""
        # A switch, not a choice between the outputs of all: only the active channel's network is computed.
        networks = [partial(_advance_network, channel.compensator) for channel in self.channels]
        return jax.lax.switch(
            jnp.maximum(state.mode, 0),
            networks,
            state.hidden,
            state.feature_state.index_in_window,
            scaled_features,
            reset,
        )

    def zero_lstm_state(self) -> Float32[Array, "2 2 h"]:
        """Return the zero state of a network, of the largest size of all channels."""
        # One state serves the networks of all channels, of which one at a time is active.
        sizes = [
            channel.compensator.network.cell.hidden_size
            for channel in self.channels
            if channel.compensator is not None
        ]
        return jnp.zeros((2, 2, max(sizes, default=0)), SINGLE)

    def within_end_stops(self, state: HitchState, displacement: Float[Array, ""]) -> Float[Array, ""]:
        """Return a displacement clipped to the end stops, or to the start of a stroke beyond them."""
        for channel in self.channels:
            if channel.end_stop is not None:
                farther = jnp.maximum if channel.sign > 0 else jnp.minimum
                nearer = jnp.minimum if channel.sign > 0 else jnp.maximum
                displacement = nearer(displacement, farther(channel.end_stop, state.start))
        return displacement

    def _init_channel(
        self,
        number: int,
        valve: ValveState,
        displacement: Float[Array, ""],
        speed: Float[Array, ""],
        at_load: DiscretePhysicalModel | None,
    ) -> ChannelState:
        """Return the state of a channel that takes charge; `at_load` is None where no load matters."""
        channel = self.channels[number]
        correction = None
        if channel.speed_compensator is not None:
            correction = SpeedCompensatorState(jnp.zeros(()), jnp.zeros(()))
        model = self.discrete_models[number] if at_load is None else at_load
        plant = model.init_state(displacement, speed)
        return ChannelState(valve, plant, jnp.asarray(0), correction, at_load)

    def _discrete_model(self, number: int, channel_state: ChannelState) -> DiscretePhysicalModel:
        """Return the benchmark of a channel, at the load of the run where it varies with it."""
        return self.discrete_models[number] if channel_state.at_load is None else channel_state.at_load

    def _speed(self, mode: Int[Array, ""], state: HitchState) -> Float[Array, ""]:
        """Return the speed of the piston; zero at an end stop or a limit of the plant."""
        speed = jnp.zeros(())
        # At a stop the piston stands, though the benchmark, which is not clipped there, goes on beyond it.
        inside = self.within_end_stops(state, state.benchmark) == state.benchmark
        limits = self.channels[0].limits
        if limits is not None:
            inside &= limits.is_inside(state.benchmark, state.start)
        for number, channel_state in enumerate(state.channels):
            channel_speed = self._discrete_model(number, channel_state).speed(
                channel_state.plant, channel_state.valve, state.benchmark
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
        """Initialise a channel that takes charge at the plant's displacement and speed."""
        channel_state = state.channels[number]
        initial_state = self._init_channel(
            number, channel_state.valve, displacement, speed, channel_state.at_load
        )
        new_state = select(entering, initial_state, channel_state)
        return state._replace(
            benchmark=jnp.where(entering, displacement, state.benchmark),
            free_run=jnp.where(entering, displacement, state.free_run),
            start=jnp.where(entering, displacement, state.start),
            error=jnp.where(entering, 0.0, state.error),
            channels=_replace_item(state.channels, number, new_state),
        )

    def _advance_channel(self, number: int, state: HitchState) -> HitchState:
        """Advance a channel. Only the active channel moves the piston; before the first motion all run."""
        channel_state = state.channels[number]
        discrete_model = self._discrete_model(number, channel_state)
        in_charge = state.mode == number
        plant, increment = discrete_model.advance(channel_state.plant, channel_state.valve, state.benchmark)
        increment = jnp.where(in_charge, increment, 0.0)
        # Before the first motion time runs for all, as from the first sample of a test in the fast form.
        is_active = in_charge | (state.mode == STANDING)
        correction, factor = self._correct_speed(number, channel_state, is_active, increment, state)
        next_channel_state = ChannelState(
            channel_state.valve,
            # The linear dynamics of the others are at rest; only their valves follow the command.
            jnp.where(in_charge, plant, channel_state.plant),
            channel_state.samples_in_charge + is_active,
            correction,
            channel_state.at_load,
        )
        return state._replace(
            benchmark=state.benchmark + increment,
            # A factor on the movement, so that no network moves a piston that stands.
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
        """Return the compensator's next state and the speed factor until the next sample."""
        channel, correction = self.channels[number], channel_state.correction
        compensator = channel.speed_compensator
        if compensator is None or correction is None:
            return None, jnp.ones(())
        factor = compensator.factor(
            channel_state.valve.effective,
            correction.speed,
            correction.acceleration,
            state.free_run,
            channel_load(self.channels, number, state.load),
        )
        speed = channel.sign * increment / self.step_s
        advanced = SpeedCompensatorState(speed, (speed - correction.speed) / self.step_s)
        return select(is_active, advanced, correction), factor


def _advance_network(
    compensator: Compensator | None,
    hidden: Float32[Array, "2 2 h"],
    index_in_window: Int[Array, ""],
    scaled_features: Float32[Array, "10"],
    reset: Bool[Array, ""],
) -> tuple[Float32[Array, "2 2 h"], Float[Array, ""]]:
    if compensator is None:
        return hidden, jnp.zeros(())
    size = compensator.network.cell.hidden_size
    previous = jnp.where(reset, 0.0, hidden[..., :size])
    lstm_state, increment = compensator.predict_increment(
        LstmState(*previous), index_in_window, scaled_features
    )
    return hidden.at[..., :size].set(jnp.stack(lstm_state)), increment


def _replace_item(items: tuple, index: int, item: object) -> tuple:
    """Return a tuple with the item at an index replaced."""
    return (*items[:index], item, *items[index + 1 :])
