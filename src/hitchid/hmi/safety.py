"""States of the bench loop, and what leads from one to the next; no clock and no machine in it."""

from dataclasses import dataclass, replace
from enum import StrEnum

from hitchid.errors import InputError


class State(StrEnum):
    """State of the bench loop; only `running` moves anything."""

    DISCONNECTED = "disconnected"
    IDLE = "idle"
    ARMED = "armed"
    RUNNING = "running"
    STOPPED = "stopped"


WHAT_TO_DO = {
    State.DISCONNECTED: "connect a source first",
    State.IDLE: "arm first",
    State.ARMED: "start, or stop, first",
    State.RUNNING: "stop, or wait for the end, first",
    State.STOPPED: "look at the machine, then reset",
}


@dataclass(frozen=True)
class Safety:
    """State of the bench loop, with the last signs of life.

    Attributes:
        state: of the loop.
        reason: why it stopped, or lost its source; else empty.
        is_attended: whether the operator's page must give signs of life.
        server_s, page_s: latest sign of life of the server and of the operator's page, s.
    """

    state: State = State.DISCONNECTED
    reason: str = ""
    is_attended: bool = True
    server_s: float = 0.0
    page_s: float = 0.0

    def connect(self) -> "Safety":
        """Return the state with a source; raises `InputError` unless disconnected."""
        return replace(self._to(State.IDLE, State.DISCONNECTED), reason="")

    def disconnect(self, reason: str = "") -> "Safety":
        """Return the state without a source; one that was stopped stays so."""
        if self.state in (State.ARMED, State.RUNNING):  # it may have moved until then: that must be looked at
            return self.stop(reason or "the source was disconnected")
        if self.state is State.STOPPED:  # somebody has to look at the machine first
            return self
        return Safety(State.DISCONNECTED, reason, server_s=self.server_s)  # the server goes on

    def arm(self, *, is_attended: bool, now_s: float) -> "Safety":
        """Return the armed state; raises `InputError` unless idle."""
        # The page that asks is alive: its silence counts from now.
        return replace(self._to(State.ARMED, State.IDLE), is_attended=is_attended, page_s=now_s)

    def start(self, now_s: float) -> "Safety":
        """Return the running state; raises `InputError` unless armed."""
        return replace(self._to(State.RUNNING, State.ARMED), page_s=now_s)

    def finish(self) -> "Safety":
        """Return the state after a run that ended by itself."""
        return self._to(State.IDLE, State.RUNNING)

    def stop(self, reason: str) -> "Safety":
        """Return the latched state; the first reason stays. Without a source there is nothing to stop."""
        if self.state in (State.STOPPED, State.DISCONNECTED):
            return self
        return replace(self, state=State.STOPPED, reason=reason)

    def reset(self, *, is_connected: bool) -> "Safety":
        """Return the state after a stop was looked at; raises `InputError` unless stopped."""
        released = self._to(State.IDLE if is_connected else State.DISCONNECTED, State.STOPPED)
        return replace(released, reason="")

    def check(self, now_s: float, longest_silence_s: float) -> "Safety":
        """Return the state at a time: stopped if a sign of life is missing while armed or running."""
        if self.state not in (State.ARMED, State.RUNNING):
            return self
        if now_s - self.server_s > longest_silence_s:
            return self.stop("the server gave no sign of life")
        if self.is_attended and now_s - self.page_s > longest_silence_s:
            return self.stop("the operator's page gave no sign of life")
        return self

    def _to(self, state: State, required: State) -> "Safety":
        if self.state is not required:
            raise InputError(f"the bench is {self.state}; {WHAT_TO_DO[self.state]}")
        return replace(self, state=state)
