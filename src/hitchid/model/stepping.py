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

from hitchid.data.record import MODES
from hitchid.data.test_kinds import ACTIVE_FRACTION
from hitchid.model.channel import Channel
from hitchid.networks.error_compensator import FEATURES, Attention, Compensator, Sample
from hitchid.networks.lstm import SINGLE, Hidden
from hitchid.structures import Sampled, Valve

Tree = TypeVar("Tree")
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
        correction: of the compensator for free run; None where there is none.
    """

    valve: Valve
    plant: Float[Array, " n"]
    since: Int[Array, ""]
    correction: Correction | None


class State(NamedTuple):
    """State of a hitch at one sample; displacements in the model's unit.

    Attributes:
        displacement: what the model says it is: with measurements the benchmark's plus the predicted error,
            without any, the free run.
        error: predicted error of the benchmark.
        benchmark: the benchmark's, as if there were no end stop, but within the limits of the plant.
        free: free run, compensated, likewise.
        start: where the channel in charge took it.
        mode: place of the channel in charge; −1 while nothing has moved yet.
        unmeasured: samples since a displacement was measured; −1 if none ever was.
        commands: lifting and lowering command last heard, shape [2].
        missing: whether a command was missing and the last one held.
        both: whether both valves were on; then lowering counts.
        load: second measured input, before motion.
        attention: of the compensator in charge.
        channels: of each channel.
        hidden: of the network in charge: output and cell of the LSTM that answers and of the one that
            follows, shape [2, 2, H].
    """

    displacement: Float[Array, ""]
    error: Float[Array, ""]
    benchmark: Float[Array, ""]
    free: Float[Array, ""]
    start: Float[Array, ""]
    mode: Int[Array, ""]
    unmeasured: Int[Array, ""]
    commands: Float[Array, "2"]
    missing: Bool[Array, ""]
    both: Bool[Array, ""]
    load: Float[Array, ""]
    attention: Attention
    channels: tuple[ChannelState, ...]
    hidden: Float32[Array, "2 2 h"]


class Question(NamedTuple):
    """What the network of the channel in charge is asked.

    Attributes:
        number: place of the channel.
        scaled: features, shape [10].
        place: samples read, modulo L.
        trust: factor on its answer; zero where it is not to answer.
        fresh: whether it starts anew.
        error: predicted error so far.
        benchmark: displacement without error; free: without measurements.
        heard: whether a displacement was ever measured.
    """

    number: Int[Array, ""]
    scaled: Float32[Array, "10"]
    place: Int[Array, ""]
    trust: Float[Array, ""]
    fresh: Bool[Array, ""]
    error: Float[Array, ""]
    benchmark: Float[Array, ""]
    free: Float[Array, ""]
    heard: Bool[Array, ""]


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

    def standing(self, displacement: float = 0.0, load: float = 0.0) -> State:
        """Return the state of a hitch that stands, its valves shut."""
        return self.initial(jnp.asarray(float(displacement)), jnp.asarray(float(load)))

    def initial(self, displacement: Float[Array, ""], load: Float[Array, ""]) -> State:
        """Return the state of a hitch that stands, its valves shut."""
        nothing = jnp.zeros(())
        no = jnp.zeros((), jnp.bool_)
        return State(
            displacement=displacement,
            benchmark=displacement,
            free=displacement,
            start=displacement,
            error=nothing,
            mode=jnp.asarray(0 if len(self.channels) == 1 else STANDING),
            unmeasured=jnp.asarray(-1),
            commands=jnp.zeros(2),
            missing=no,
            both=no,
            load=load,
            attention=Attention.at_rest(Sample(nothing, nothing, displacement, displacement)),
            channels=tuple(
                self._started(number, sampled.shut(), displacement, nothing, load)
                for number, sampled in enumerate(self.sampled)
            ),
            hidden=self.blank(),
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
        after, question = self.move(state, commands, measured)
        hidden, error, displacement = self.answer(after.hidden, question)
        return after._replace(hidden=hidden, error=error, displacement=displacement), displacement

    def move(
        self, state: State, commands: Float[Array, "2"], measured: Float[Array, ""]
    ) -> tuple[State, Question]:
        """Do all of a step but the network's part; see `step` and `answer`."""
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
        now = state._replace(
            error=jnp.where(known, measured - self._stopped(state, state.benchmark), state.error),
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
        speed = self._speed(state.mode, now)
        for number in range(len(self.channels)):
            now = self._entered(number, now, entering & (mode == number), place, speed)
        fresh = (mode != state.mode) | (known & (state.unmeasured < 0))
        now, scaled, trust = self._asked(now, fresh)
        for number in range(len(self.channels)):
            now = self._moved(number, now)
        now = self._limited(self._crept(now, ~jnp.any(jnp.stack(calls))))
        return now, Question(
            number=jnp.maximum(mode, 0),
            scaled=scaled,
            place=now.attention.place,
            trust=trust,
            fresh=fresh,
            error=now.error,
            benchmark=self._stopped(now, now.benchmark),
            free=self._stopped(now, now.free),
            heard=now.unmeasured >= 0,
        )

    def answer(
        self, hidden: Float32[Array, "2 2 h"], question: Question
    ) -> tuple[Float32[Array, "2 2 h"], Float[Array, ""], Float[Array, ""]]:
        """Let the network of the channel in charge predict the error.

        Returns:
            The network's state, the error, and the displacement at the next sample.
        """
        asked = [partial(_answered, channel.compensator) for channel in self.channels]
        hidden, step = jax.lax.switch(question.number, asked, hidden, question)
        error = question.error + question.trust * step
        return hidden, error, jnp.where(question.heard, question.benchmark + error, question.free)

    def blank(self) -> Float32[Array, "2 2 h"]:
        """Return the state of a network that has read nothing, wide enough for any channel's."""
        sizes = [c.compensator.network.cell.hidden_size for c in self.channels if c.compensator is not None]
        return jnp.zeros((2, 2, max(sizes, default=0)), SINGLE)

    def _stopped(self, state: State, displacement: Float[Array, ""]) -> Float[Array, ""]:
        """Return a displacement no farther than the end stops, or than the stroke's start beyond them."""
        for channel in self.channels:
            if channel.end_stop is not None:
                beyond = jnp.maximum if channel.direction > 0 else jnp.minimum
                within = jnp.minimum if channel.direction > 0 else jnp.maximum
                displacement = within(displacement, beyond(channel.end_stop, state.start))
        return displacement

    def _limited(self, state: State) -> State:
        """Hold the benchmark and the free run within the limits of the plant: beyond them nothing goes on."""
        limits = self.channels[0].limits
        if limits is None:
            return state
        return state._replace(
            benchmark=limits.hold(state.benchmark, state.start), free=limits.hold(state.free, state.start)
        )

    def _crept(self, state: State, held: Bool[Array, ""]) -> State:
        """Let a held piston creep, from the end stop if it stands there."""
        if not self.drift:
            return state
        crept = self.drift * self.step_s
        benchmark, free = (
            jnp.where(held, self._stopped(state, each) + crept, each)
            for each in (state.benchmark, state.free)
        )
        return state._replace(benchmark=benchmark, free=free)

    def _asked(
        self, state: State, fresh: Bool[Array, ""]
    ) -> tuple[State, Float32[Array, "10"], Float[Array, ""]]:
        """Return scaled features of the channel in charge, and the trust in what its network answers.

        None, if nothing was measured lately.
        """
        recent = (state.unmeasured >= 0) & (state.unmeasured < COASTING)
        answer = state.attention, jnp.zeros(len(FEATURES), SINGLE), jnp.zeros(())
        for number, channel in enumerate(self.channels):
            if channel.compensator is None:
                continue
            own, at = state.channels[number], self._stopped(state, state.benchmark)
            effective = own.valve.effective
            time_s = self.step_s * own.since.astype(at.dtype)
            sample = Sample(time_s, effective, at, at + state.error)
            trust = jnp.ones(())
            if channel.envelope is not None:
                trust = channel.envelope.trust(jnp.abs(effective), at, state.load)
            before = _where(fresh, Attention.at_rest(sample), state.attention)
            attention, scaled = channel.compensator.hear(before, sample, self.step_s)
            answer = _where(recent & (state.mode == number), (attention, scaled, trust), answer)
        return state._replace(attention=answer[0]), *answer[1:]

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
        correction = None
        if channel.speed_compensator is not None:
            networks = channel.speed_compensator.networks
            blank = networks.blank((networks.head.weight.shape[0], 1))
            correction = Correction(blank, jnp.ones(()), jnp.zeros(()), jnp.zeros(()))
        plant = self.sampled[number].entered(displacement, speed, load)
        return ChannelState(valve, plant, jnp.asarray(0), correction)

    def _speed(self, mode: Int[Array, ""], state: State) -> Float[Array, ""]:
        """Return the speed of the piston; none where it is at an end stop or a limit of the plant."""
        speed = jnp.zeros(())
        inside = self._stopped(state, state.benchmark) == state.benchmark
        limits = self.channels[0].limits
        if limits is not None:
            inside &= limits.inside(state.benchmark, state.start)
        for number, (sampled, own) in enumerate(zip(self.sampled, state.channels, strict=True)):
            moving = sampled.speed(own.plant, own.valve, state.benchmark, state.load)
            speed = jnp.where(mode == number, jnp.where(inside, moving, 0.0), speed)
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
        begun = _where(entering, fresh, own)
        return state._replace(
            benchmark=jnp.where(entering, place, state.benchmark),
            free=jnp.where(entering, place, state.free),
            start=jnp.where(entering, place, state.start),
            error=jnp.where(entering, 0.0, state.error),
            channels=_with(state.channels, number, begun),
        )

    def _moved(self, number: int, state: State) -> State:
        """Move the piston by a channel where it is in charge; what corrects it hears it standing too."""
        sampled, own = self.sampled[number], state.channels[number]
        charged = state.mode == number
        plant, change = sampled.advance(own.plant, own.valve, state.benchmark, state.load)
        change = jnp.where(charged, change, 0.0)
        heard = charged | (state.mode == STANDING)
        correction, factor = self._corrected(number, own, heard, change, state)
        after = ChannelState(
            own.valve,
            jnp.where(charged, plant, own.plant),
            own.since + heard,
            correction,
        )
        return state._replace(
            benchmark=state.benchmark + change,
            free=state.free + factor * change,
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


def _answered(
    compensator: Compensator | None, hidden: Float32[Array, "2 2 h"], question: Question
) -> tuple[Float32[Array, "2 2 h"], Float[Array, ""]]:
    """Return a network's state, and the step the error takes to the next sample."""
    if compensator is None:
        return hidden, jnp.zeros(())
    size = compensator.network.cell.hidden_size
    before = jnp.where(question.fresh, 0.0, hidden[..., :size])
    read, step = compensator.answer(Hidden(*before), question.place, question.scaled)
    return hidden.at[..., :size].set(jnp.stack(read)), step


def _where(chosen: Bool[Array, ""], new: Tree, old: Tree) -> Tree:
    """Return one of two states of one structure."""
    return jax.tree.map(lambda one, other: jnp.where(chosen, one, other), new, old)


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
