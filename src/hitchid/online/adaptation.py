"""Adaptation beside a running model: strokes are learned from in another thread."""

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from hitchid._support.short_repr import short_repr
from hitchid.adaptation import AdaptationSettings, Adapter, AdapterState, Event, Stroke, StrokeCutter
from hitchid.model import Hitch
from hitchid.model.adjustable import numbers_of_models
from hitchid.model.loads import Load


@short_repr
class Adapted(NamedTuple):
    """What was learned from one stroke.

    Attributes:
        state: of the adaptation after it.
        events: what happened.
        numbers: of the physical models in use from now on; None where they stay.
    """

    state: AdapterState
    events: tuple[Event, ...]
    numbers: Float[Array, " p"] | None


class OnlineAdaptation:
    """Cuts strokes from samples and learns from them in the background, one after the other.

    A sample never waits: what was learned takes effect with the first sample after it is there at which no
    stroke is under way. What is learned depends on the samples alone, not on when.

    Args:
        model: identified hitch, not one that was adapted.
        settings: of the adaptation; the defaults where None.
        load: covariates, as for `Hitch.simulate`.
        log: called with each event, in the order in which they take effect.
        earlier: events of a change log to go on from.

    Attributes:
        numbers: of the physical models in use, see `numbers_of_models`.

    Raises:
        InputError: the model was adapted, or as `Adapter`.
    """

    def __init__(
        self,
        model: Hitch,
        settings: AdaptationSettings | None = None,
        *,
        load: Load | None = None,
        log: Callable[[Event], None] | None = None,
        earlier: Sequence[Event] = (),
    ) -> None:
        self._adapter = Adapter(model, settings or AdaptationSettings(), load)
        self._state = self._latest = self._adapter.resumed(earlier)
        self._cutter = StrokeCutter(model)
        self._log = log
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="adaptation")
        self._pending: deque[Future[Adapted]] = deque()
        self._adapter.prepare()
        self.numbers = numbers_of_models(self._adapter.adapted(self._state))

    @property
    def state(self) -> AdapterState:
        """State of the adaptation whose parameters are in use."""
        return self._state

    @property
    def model(self) -> Hitch:
        """The model with the parameters in use."""
        return self._adapter.adapted(self._state)

    def feed(
        self, commands: Float[np.ndarray, "b 2"], displacement: Float[np.ndarray, " b"]
    ) -> tuple[Event, ...]:
        """Take a block of samples; return the events that take effect with it.

        Args:
            commands: lifting and lowering, in the model's units.
            displacement: measured; NaN where there is none.
        """
        for stroke in self._cutter.feed(commands, displacement):
            self._pending.append(self._thread.submit(self._learn, stroke))
        return self._taken(wait=False)

    def rollback(self, direction: str) -> None:
        """Return to the parameters of one direction before its last promotion, with the next sample."""
        self._pending.append(self._thread.submit(self._rolled_back, direction))

    def finish(self) -> tuple[Event, ...]:
        """Wait for what is being learned; return the events that then take effect."""
        events = self._taken(wait=True)
        self._thread.shutdown()
        return events

    def _taken(self, *, wait: bool) -> tuple[Event, ...]:
        events: list[Event] = []
        while self._pending and (wait or (self._pending[0].done() and not self._cutter.moves)):
            adapted = self._pending.popleft().result()
            self._state = adapted.state
            events += adapted.events
            if adapted.numbers is not None:
                self.numbers = adapted.numbers
        if self._log is not None:
            for event in events:
                self._log(event)
        return tuple(events)

    def _learn(self, stroke: Stroke) -> Adapted:
        return self._outcome(*self._adapter.learn(self._latest, stroke))

    def _rolled_back(self, direction: str) -> Adapted:
        state, event = self._adapter.rollback(self._latest, direction)
        return self._outcome(state, (event,))

    def _outcome(self, state: AdapterState, events: tuple[Event, ...]) -> Adapted:
        """Return the outcome of a stroke; `_latest` is of the thread alone."""
        changed = state.changes != self._latest.changes
        self._latest = state
        models = numbers_of_models(self._adapter.adapted(state)) if changed else None
        return Adapted(state, events, models)
