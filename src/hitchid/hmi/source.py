"""What a source of signals is: the virtual bench, a log, a bus, or an operator's own device."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from hitchid.logs import DEFAULT_SIGNALS, SignalColumn

LIFTING_COMMAND, LOWERING_COMMAND, DISPLACEMENT = "lifting_command", "lowering_command", "displacement"
REQUIRED = (LIFTING_COMMAND, LOWERING_COMMAND, DISPLACEMENT)  # signals that every source has
CLOSED = np.zeros(2)  # commands of closed valves
SAME_STEP = 0.01  # relative difference of sampling times that still counts as none


@dataclass(frozen=True)
class Signal:
    """A signal of a source.

    Attributes:
        name: in logs and messages.
        label: for the operator.
        unit: of its values.
        group: the plot it is drawn in: command, displacement, speed, pressure or other.
    """

    name: str
    label: str
    unit: str
    group: str = "other"

    @property
    def column(self) -> str:
        """Column of a log: the default of its role where it has that unit, else name and unit."""
        default = getattr(DEFAULT_SIGNALS, self.name, None)
        if isinstance(default, SignalColumn) and default.unit == self.unit:
            return default.column
        return f"{self.name}_{self.unit}"


def signal_named(name: str, unit: str, group: str = "other") -> Signal:
    """Return a signal whose label is its name."""
    return Signal(name, name.replace("_", " ").capitalize(), unit, group)


# Of a source in A and mm.
REQUIRED_SIGNALS = (
    signal_named(LIFTING_COMMAND, "A", "command"),
    signal_named(LOWERING_COMMAND, "A", "command"),
    signal_named(DISPLACEMENT, "mm", "displacement"),
)


class Reading(NamedTuple):
    """One sample of a source.

    Attributes:
        time_s: on the clock of the source, s; rises from sample to sample.
        values: of its signals in their order, NaN where there is none.
    """

    time_s: float
    values: tuple[float, ...]


@runtime_checkable
class Source(Protocol):
    """A source of signals: in each tick the bench loop reads it, decides, and writes to it.

    Attributes:
        label: for the operator.
        signals: lifting command, lowering command and displacement, by these names, then any others.
        step_s: sampling time, s.
        virtual: whether it is no real machine.
        can_move: whether it takes commands.
    """

    label: str
    signals: tuple[Signal, ...]
    step_s: float
    virtual: bool
    can_move: bool

    def open(self) -> None:
        """Connect; raises `InputError` with what to do where that fails."""
        ...

    def read(self) -> Sequence[Reading]:
        """Return the samples that have arrived since the last call; must not block.

        A command that is NaN is filled in by the bench loop with what it commands.

        Raises:
            InputError: the source is lost.
        """
        ...

    def write(self, commands: np.ndarray) -> None:
        """Send the commands until the next sample; must not block.

        Args:
            commands: lifting and lowering, shape [2]; zero where nothing may move.

        Raises:
            InputError: the source is lost.
        """
        ...

    def close(self) -> None:
        """Disconnect; where commands are allowed, zero was written before."""
        ...


def is_same_sampling_time(one_s: float, other_s: float) -> bool:
    """Return whether two sampling times, s, differ by no more than a hundredth."""
    return abs(one_s / other_s - 1) <= SAME_STEP


def describe(source: Source, name: str, speed: int) -> dict[str, object]:
    """Return what the page needs to know of a source, as content for JSON."""
    return {
        "name": name,
        "label": source.label,
        "step_s": source.step_s,
        "speed": speed,
        "can_move": source.can_move,
        "virtual": source.virtual,
        "signals": [asdict(signal) for signal in source.signals],
    }
