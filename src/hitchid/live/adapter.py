"""Adaptation of a model: strokes in, changes of its parameters and events out."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.live.channel_adaptation import ChannelAdaptation
from hitchid.live.channel_state import ChannelState
from hitchid.live.events import FAULT, LEARNED, REFUSED, Event, last_sample
from hitchid.live.gates import Gate, rested_at, standstill_before
from hitchid.live.parameters import Changes, changed_model, check_adaptable
from hitchid.live.settings import AdaptationSettings
from hitchid.live.stroke_errors import StrokeErrors
from hitchid.live.strokes import Stroke, StrokeCutter
from hitchid.logs import COMMAND, DIRECTIONS, Record
from hitchid.model import Hitch, Load, channel_load, load_row

UNKNOWN = (0.05, 0.02)  # relative gain, dead zone as share of the command, without estimates; chosen


@short_repr
@dataclass(frozen=True)
class AdapterState:
    """State of the adaptation of a model.

    Attributes:
        channels: direction to the state of its channel.
        strokes: of the machine so far.
        ended_at: number of the sample at which the last stroke ended; 0 before any.
        rested_at: displacement there; NaN before any.
    """

    channels: Mapping[str, ChannelState]
    strokes: int = 0
    ended_at: int = 0
    rested_at: float = math.nan

    @property
    def changes(self) -> dict[str, Changes]:
        """Direction to the changes in use."""
        return {direction: state.deployed for direction, state in self.channels.items()}

    @property
    def band_factors(self) -> dict[str, float]:
        """Direction to the factor on the half width of its bands."""
        return {direction: state.band.factor for direction, state in self.channels.items()}


class Adapter:
    """Adaptation of one model.

    Args:
        model: identified hitch.
        settings: of the adaptation.
        load: covariates, as for `Hitch.simulate`; by default the means of the tests.

    Raises:
        InputError: the model was adapted, a channel has no gain behind a dead zone, or there is no such
            covariate.
    """

    @double_precision
    def __init__(self, model: Hitch, settings: AdaptationSettings, load: Load | None = None) -> None:
        if model.provenance.adapted:
            raise InputError(
                "model: expected one as identified, got one that was adapted; adapt the identified model and "
                "go on from its change log"
            )
        self.model, self.settings = model, settings
        channels = tuple(model.channels.values())
        row = jnp.asarray(load_row(load, channels, "model"))
        self._channels = {}
        for number, channel in enumerate(channels):
            check_adaptable(channel)
            uncertainty = model.uncertainty.get(channel.direction)
            loads = np.asarray(channel_load(channels, number, row))
            bands = None if uncertainty is None else uncertainty.bands
            self._channels[channel.direction] = ChannelAdaptation(
                StrokeErrors(channel, model.step_s, loads, settings.window, bands),
                Gate(channel, model.step_s, settings),
                settings,
                _identified(model, channel.direction),
                model.units[COMMAND[channel.direction]],
            )

    def prepare(self) -> None:
        """Compile all that a stroke needs."""
        for learner in self._channels.values():
            learner.prepare()

    def initial_state(self) -> AdapterState:
        """Return the state of the model as identified."""
        return self.resumed(())

    def resumed(self, events: Sequence[Event]) -> AdapterState:
        """Return the state after the events of a change log; its model is that of the log, bit for bit.

        Raises:
            InputError: an entry changes a channel that the model lacks, or beyond its bounds.
        """
        for event in events:
            # Faults and strokes of both valves have no channel, but change nothing.
            if event.direction not in self._channels and event.changes != Changes():
                raise InputError(
                    f"change log: expected changes of {' or '.join(self._channels)}, got {event.direction!r}"
                )
        channels = {
            direction: learner.resumed([event for event in events if event.direction == direction])
            for direction, learner in self._channels.items()
        }
        strokes = max((event.stroke for event in events), default=0)
        return AdapterState(channels, strokes, last_sample(events, self.model.step_s))

    @double_precision
    def learn(self, state: AdapterState, stroke: Stroke) -> tuple[AdapterState, tuple[Event, ...]]:
        """Return the state after a stroke of the machine, and what happened.

        Args:
            state: before it.
            stroke: of any direction.
        """
        number, channels, events = state.strokes + 1, dict(state.channels), []
        # Before the stroke itself is judged, as it is seen also where that is refused.
        standstill = standstill_before(self.model, stroke, state.ended_at, state.rested_at)
        fault = "" if standstill is None else standstill.fault(self.model)
        if fault:
            events.append(self._event(FAULT, stroke, number, fault))
        learner = self._channels.get(stroke.direction)
        if learner is None:
            reason = "the model has no such channel" if stroke.direction else "both commands are active"
            events.append(self._event(REFUSED, stroke, number, reason))
        else:
            channels[stroke.direction], happened = learner.learn(channels[stroke.direction], stroke, number)
            events += happened
        # After each stroke of the machine, of whichever direction, all move on towards what was promoted.
        for direction, other in self._channels.items():
            channels[direction], moved = other.moved(channels[direction], stroke, number)
            events += moved
        if standstill is not None and not fault:
            # The leak before a stroke that was learned from or refused.
            events = [
                replace(event, figures={**event.figures, **standstill.leak})
                if event.kind in (LEARNED, REFUSED) and event.stroke == number
                else event
                for event in events
            ]
        rested = rested_at(stroke, self.model.step_s)  # whatever was learned: the next standstill begins here
        return AdapterState(channels, number, stroke.end, rested), tuple(events)

    def _event(self, kind: str, stroke: Stroke, number: int, reason: str) -> Event:
        return Event(kind, stroke.end * self.model.step_s, number, stroke.direction, reason, Changes())

    @double_precision
    def free_run_error(self, stroke: Stroke) -> float:
        """Return the root mean square error of the model as identified over a stroke, in its unit."""
        return self._channels[stroke.direction].free_run_error(stroke)

    def rollback(
        self, state: AdapterState, direction: str, reason: str = "requested"
    ) -> tuple[AdapterState, Event]:
        """Return the state with the changes of one direction before its last promotion, bit for bit."""
        channel, events = self._channels[direction].rolled_back(
            state.channels[direction], None, state.strokes, reason, state.ended_at * self.model.step_s
        )
        return replace(state, channels={**state.channels, direction: channel}), events[0]

    def adapted(self, state: AdapterState) -> Hitch:
        """Return the model with the changes in use, and with its bands as wide as they had to be."""
        return changed_model(self.model, state.changes, state.band_factors)


def _identified(model: Hitch, direction: str) -> list[float]:
    """Return standard deviations of log gain, dead zone and log lag as identified."""
    channel = model.channels[direction]
    command = float(channel.operating_range.command.highest)
    deviations = [UNKNOWN[0], UNKNOWN[1] * command, UNKNOWN[0]]
    uncertainty = model.uncertainty.get(direction)
    if uncertainty is None:
        return deviations
    for estimate in uncertainty.benchmark.parameters:
        if estimate.name == channel.benchmark.structure.gain and estimate.error:
            deviations[0] = estimate.error / estimate.value
    return deviations


# Adaptation on logs.


@short_repr
@dataclass(frozen=True)
class Adaptation:
    """What was learned from logs.

    Attributes:
        model: with the parameters in use after the last log.
        events: the change log.
        state: of the adaptation after the last log.
    """

    model: Hitch
    events: tuple[Event, ...]
    state: AdapterState


def adapt(
    model: Hitch,
    records: Iterable[Record],
    *,
    settings: AdaptationSettings | None = None,
    load: Load | None = None,
    earlier: Sequence[Event] = (),
) -> Adaptation:
    """Return what a model learns from logs, one after the other; see `Hitch.adapt`."""
    adapter = Adapter(model, settings or AdaptationSettings(), load)
    state, events = adapter.resumed(earlier), list(earlier)
    before = last_sample(earlier, model.step_s)  # the samples are counted from log to log
    for record in records:
        converted = model.to_model_units(checks.instance(record, Record, "records", "records of logs"))
        commands = np.column_stack(
            [converted.signals.get(COMMAND[direction], np.zeros(len(converted))) for direction in DIRECTIONS]
        )
        cutter = StrokeCutter(model)  # a stroke that a log cuts off does not go on in the next one
        state = replace(state, rested_at=math.nan)  # what happened between logs is not known
        for stroke in cutter.feed(commands, converted.displacement) + cutter.finish():
            state, happened = adapter.learn(state, stroke._replace(begin=before + stroke.begin))
            events += happened
        before += len(converted)
    return Adaptation(adapter.adapted(state), tuple(events), state)
