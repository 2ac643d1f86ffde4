"""The hitch one sample at a time: which channel is in charge, and what it does with the piston.

The one definition of a hitch's motion. docs/switching.md has the state machine as a table.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from hitchid.benchmark import Sampled, Valve
from hitchid.compensator import Listening, Memory, Sample
from hitchid.lstm import Hidden
from hitchid.model.channel import Channel
from hitchid.modes import ACTIVE_FRACTION
from hitchid.record import MODES

STANDING = -1
COASTING = 100
LARGEST = 1e9


class Correction(NamedTuple):
    """State of the compensator for free run.

    Attributes:
        hidden: of its networks, shape [M, 1, H].
        factor: on the benchmark's speed in this block.
        command, moved: sums over this block so far, of effective command and of the benchmark's travel.
    """

    hidden: Hidden
    factor: Float[Array, ""]
    command: Float[Array, ""]
    moved: Float[Array, ""]


class ChannelState(NamedTuple):
    """State of one channel.

    Attributes:
        valve: hears every command, in charge or not.
        plant: of the benchmark.
        since: samples since the channel took charge.
        listening: of the compensator for predictions; None where there is none.
        correction: of the compensator for free run; None where there is none.
    """

    valve: Valve
    plant: Float[Array, " n"]
    since: Int[Array, ""]
    listening: Listening | None
    correction: Correction | None


class State(NamedTuple):
    """State of a hitch at one sample; displacements in the model's unit.

    Attributes:
        displacement: what the model says it is: with measurements the benchmark's plus the predicted error,
            without any, the free run.
        benchmark: the benchmark's.
        free: free run, compensated.
        error: predicted error of the benchmark.
        mode: place of the channel in charge; −1 while nothing has moved yet.
        unmeasured: samples since a displacement was measured; −1 if none ever was.
        commands: lifting and lowering command last heard, shape [2].
        missing: whether a command was missing and the last one held.
        both: whether both valves were on; then lowering counts.
        load: second measured input, before motion.
        channels: of each channel.
    """

    displacement: Float[Array, ""]
    benchmark: Float[Array, ""]
    free: Float[Array, ""]
    error: Float[Array, ""]
    mode: Int[Array, ""]
    unmeasured: Int[Array, ""]
    commands: Float[Array, "2"]
    missing: Bool[Array, ""]
    both: Bool[Array, ""]
    load: Float[Array, ""]
    channels: tuple[ChannelState, ...]


class Motion(eqx.Module):
    """A hitch on its clock.

    Attributes:
        channels: in the order of the modes.
        sampled: their benchmarks on the clock.
        drift: speed of a piston that is held, displacement's unit/s.
        step_s: sampling time, s.
    """

    channels: tuple[Channel, ...]
    sampled: tuple[Sampled, ...]
    drift: float = eqx.field(static=True)
    step_s: float = eqx.field(static=True)

    @classmethod
    def of(cls, channels: Sequence[Channel], step_s: float, drift: float) -> "Motion":
        """Put channels on a clock."""
        return cls(tuple(channels), tuple(_sampled(channel, step_s) for channel in channels), drift, step_s)

    def initial(self, displacement: Float[Array, ""], load: Float[Array, ""]) -> State:
        """Return the state of a hitch that stands, its valves shut."""
        nothing = jnp.zeros(())
        no = jnp.zeros((), jnp.bool_)
        return State(
            displacement=displacement,
            benchmark=displacement,
            free=displacement,
            error=nothing,
            mode=jnp.asarray(0 if len(self.channels) == 1 else STANDING),
            unmeasured=jnp.asarray(-1),
            commands=jnp.zeros(2),
            missing=no,
            both=no,
            load=load,
            channels=tuple(
                self._started(number, sampled.shut(), displacement, nothing, load)
                for number, sampled in enumerate(self.sampled)
            ),
        )

    def step(
        self, state: State, commands: Float[Array, "2"], measured: Float[Array, ""]
    ) -> tuple[State, Float[Array, ""]]:
        """Return the state one sample later, and the displacement then.

        Args:
            state: at this sample.
            commands: lifting and lowering command, held until the next sample; where one is not finite the
                last one stands.
            measured: displacement at this sample; not finite where it was not measured.
        """
        told = jnp.abs(commands) < LARGEST
        commands = jnp.where(told, commands, state.commands)
        known = jnp.abs(measured) < LARGEST
        valves = tuple(
            sampled.hear(own.valve, commands[MODES.index(channel.mode)], state.load)
            for channel, sampled, own in zip(self.channels, self.sampled, state.channels, strict=True)
        )
        calls = [valve.calls[-1] for valve in valves]
        mode = state.mode
        for number, called in enumerate(calls):
            # Where both call, the last of the modes counts: lowering.
            mode = jnp.where(called, number, mode)
        heard = state._replace(
            error=jnp.where(known, measured - state.benchmark, state.error),
            mode=mode,
            unmeasured=jnp.where(
                known, 0, jnp.where(state.unmeasured >= 0, state.unmeasured + 1, state.unmeasured)
            ),
            commands=commands,
            missing=~jnp.all(jnp.stack([told[MODES.index(channel.mode)] for channel in self.channels])),
            both=jnp.sum(jnp.stack([valve.calls[0] for valve in valves])) > 1,
            channels=tuple(
                own._replace(valve=valve) for own, valve in zip(state.channels, valves, strict=True)
            ),
        )
        place = jnp.where(known, measured, state.displacement)
        entering = (mode != state.mode) & (state.mode != STANDING)
        speed = self._speed(state.mode, heard)
        newly = known & (state.unmeasured < 0)
        now = heard
        for number in range(len(self.channels)):
            now = self._entered(number, now, entering & (mode == number), place, speed)
        listenings = tuple(own.listening for own in now.channels)
        listening = [partial(self._listened, number, now, newly) for number in range(len(self.channels))]
        listenings, error = jax.lax.switch(
            mode + 1, [lambda given: (given, now.error), *listening], listenings
        )
        after = now._replace(error=error)
        for number in range(len(self.channels)):
            after = self._moved(number, after, listenings[number])
        crept = jnp.where(jnp.any(jnp.stack(calls)), 0.0, self.drift * self.step_s)
        after = after._replace(benchmark=after.benchmark + crept, free=after.free + crept)
        displacement = jnp.where(after.unmeasured >= 0, after.benchmark + after.error, after.free)
        return after._replace(displacement=displacement), displacement

    def _started(
        self,
        number: int,
        valve: Valve,
        displacement: Float[Array, ""],
        speed: Float[Array, ""],
        load: Float[Array, ""],
    ) -> ChannelState:
        """Return a channel that takes charge at a displacement and a speed."""
        channel = self.channels[number]
        listening = correction = None
        if channel.compensator is not None:
            first = Sample(jnp.zeros(()), valve.effective, displacement, displacement)
            listening = channel.compensator.begin(first)
        if channel.speed_compensator is not None:
            networks = channel.speed_compensator.networks
            blank = networks.blank((networks.head.weight.shape[0], 1))
            correction = Correction(blank, jnp.ones(()), jnp.zeros(()), jnp.zeros(()))
        plant = self.sampled[number].entered(displacement, speed, load)
        return ChannelState(valve, plant, jnp.asarray(0), listening, correction)

    def _speed(self, mode: Int[Array, ""], state: State) -> Float[Array, ""]:
        """Return the speed of the piston; none where it is at an end stop."""
        speed = jnp.zeros(())
        for number, (channel, sampled, own) in enumerate(
            zip(self.channels, self.sampled, state.channels, strict=True)
        ):
            moving = sampled.speed(own.plant, own.valve, state.benchmark, state.load)
            moving = jnp.where(_room(channel, state.benchmark) > 0, moving, 0.0)
            speed = jnp.where(mode == number, moving, speed)
        return speed

    def _entered(
        self,
        number: int,
        state: State,
        entering: Bool[Array, ""],
        place: Float[Array, ""],
        speed: Float[Array, ""],
    ) -> State:
        """Let a channel take charge, where it does, at the plant's displacement and speed."""
        own = state.channels[number]
        fresh = self._started(number, own.valve, place, speed, state.load)
        begun = jax.tree.map(lambda new, old: jnp.where(entering, new, old), fresh, own)
        return state._replace(
            benchmark=jnp.where(entering, place, state.benchmark),
            free=jnp.where(entering, place, state.free),
            error=jnp.where(entering, 0.0, state.error),
            channels=_with(state.channels, number, begun),
        )

    def _moved(self, number: int, state: State, listening: Listening | None) -> State:
        """Move the piston by a channel where it is in charge; what corrects it hears it standing too."""
        channel, sampled, own = self.channels[number], self.sampled[number], state.channels[number]
        charged = state.mode == number
        plant, change = sampled.advance(own.plant, own.valve, state.benchmark, state.load)
        change = jnp.where(charged, change, 0.0)
        heard = charged | (state.mode == STANDING)
        correction, factor = self._corrected(number, own, heard, change, state)
        after = ChannelState(
            own.valve,
            jnp.where(charged, plant, own.plant),
            own.since + heard,
            listening,
            correction,
        )
        return state._replace(
            benchmark=state.benchmark + _stopped(channel, state.benchmark, change),
            free=state.free + _stopped(channel, state.free, factor * change),
            channels=_with(state.channels, number, after),
        )

    def _corrected(
        self,
        number: int,
        own: ChannelState,
        heard: Bool[Array, ""],
        change: Float[Array, ""],
        state: State,
    ) -> tuple[Correction | None, Float[Array, ""]]:
        """Return the factor on the benchmark's speed; at a block's start the networks hear the last."""
        channel, correction = self.channels[number], own.correction
        compensator = channel.speed_compensator
        if compensator is None or correction is None:
            return None, jnp.ones(())

        def hear(_: None) -> Correction:
            hidden, factor = compensator.hear(
                compensator.networks,
                correction.hidden,
                correction.command[None] / compensator.every,
                correction.moved[None],
                state.free[None],
                state.load[None],
            )
            return Correction(hidden, factor[0], jnp.zeros(()), jnp.zeros(()))

        begins = heard & (own.since % compensator.every == 0)
        now = jax.lax.cond(begins, hear, lambda _: correction, None)
        summed = now._replace(
            command=now.command + jnp.where(heard, own.valve.effective, 0.0),
            moved=now.moved + channel.direction * change,
        )
        return summed, now.factor

    def _listened(
        self,
        number: int,
        state: State,
        newly: Bool[Array, ""],
        listenings: tuple[Listening | None, ...],
    ) -> tuple[tuple[Listening | None, ...], Float[Array, ""]]:
        """Return what is carried on, and the error predicted for the next sample.

        The last error stands where nothing was measured lately.
        """
        channel, own, listening = self.channels[number], state.channels[number], listenings[number]
        compensator = channel.compensator
        if compensator is None or listening is None:
            return listenings, state.error
        at, effective = state.benchmark, own.valve.effective
        time_s = self.step_s * own.since.astype(at.dtype)
        sample = Sample(time_s, effective, at, at + state.error)
        trust = jnp.ones(())
        if channel.envelope is not None:
            trust = channel.envelope.trust(jnp.abs(effective), at, state.load)

        def listen(before: Listening) -> tuple[Listening, Float[Array, ""]]:
            memory = jax.tree.map(
                lambda new, old: jnp.where(newly, new, old), Memory.at_rest(sample), before.memory
            )
            return compensator.listen(before._replace(memory=memory), sample, self.step_s)

        recent = (state.unmeasured >= 0) & (state.unmeasured < COASTING)
        listening, step = jax.lax.cond(recent, listen, lambda before: (before, jnp.zeros(())), listening)
        return _with(listenings, number, listening), state.error + trust * step


def _with(parts: tuple, number: int, part: object) -> tuple:
    """Return a tuple with one part in another's place."""
    return (*parts[:number], part, *parts[number + 1 :])


def _sampled(channel: Channel, step_s: float) -> Sampled:
    full_scale = channel.dead_zone
    if channel.envelope is not None:
        full_scale += float(channel.envelope.command.highest)
    return Sampled.of(
        channel.benchmark,
        dead_zone=channel.dead_zone,
        least=ACTIVE_FRACTION * full_scale,
        direction=channel.direction,
        step_s=step_s,
    )


def _room(channel: Channel, displacement: Float[Array, ""]) -> Float[Array, ""]:
    """Return how far the piston may travel until it meets the end stop."""
    if channel.end_stop is None:
        return jnp.asarray(jnp.inf)
    return jnp.maximum(channel.direction * (channel.end_stop - displacement), 0.0)


def _stopped(channel: Channel, displacement: Float[Array, ""], change: Float[Array, ""]) -> Float[Array, ""]:
    """Return a change of displacement that does not pass the end stop."""
    return channel.direction * jnp.minimum(channel.direction * change, _room(channel, displacement))
