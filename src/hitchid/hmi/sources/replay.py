"""A log as a source: its samples as they were recorded."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hitchid.data.record import COMMAND, DIRECTIONS
from hitchid.errors import InputError
from hitchid.hmi.source import DISPLACEMENT, LIFTING_COMMAND, LOWERING_COMMAND, Reading, Signal
from hitchid.readers import read

GROUPS = {"bar": "pressure", "Pa": "pressure", "kPa": "pressure", "MPa": "pressure"}


class Replay:
    """A log, sample by sample on its own clock; it moves nothing and ends with the log.

    Args:
        log: file; a `campaign.toml` beside it assigns its signals.
    """

    virtual = True
    can_move = False

    def __init__(self, log: str) -> None:
        records = read(log).records
        if not records:
            raise InputError(f"{log}: holds no record that can be replayed")
        record = records[0]
        columns = {}
        for name, direction in zip((LIFTING_COMMAND, LOWERING_COMMAND), DIRECTIONS, strict=True):
            given = direction in record.directions
            unit = record.units[COMMAND[direction]] if given else "A"
            signal = Signal(name, f"{direction.capitalize()} command", unit, "command")
            columns[signal] = record.command(direction) if given else np.zeros(len(record))
        columns[Signal(DISPLACEMENT, "Displacement", record.unit, "displacement")] = record.displacement
        for name, values in record.signals.items():
            if name != "displacement" and name not in COMMAND.values():
                unit = record.units[name]
                label = name.replace("_", " ").capitalize()
                columns[Signal(name, label, unit, GROUPS.get(unit, "other"))] = values
        self.label = f"replay of {Path(log).name}"
        self.signals = tuple(columns)
        self.step_s = record.step_s
        self._rows = np.column_stack(list(columns.values()))

    def open(self) -> None:
        """Start at the first sample."""
        self._sample = 0

    def read(self) -> Sequence[Reading]:
        """Return the next sample.

        Raises:
            InputError: the log has ended.
        """
        if self._sample == len(self._rows):
            raise InputError("the log has ended; connect again to replay it once more")
        row = self._rows[self._sample]
        self._sample += 1
        return (Reading(self.step_s * (self._sample - 1), tuple(map(float, row))),)

    def write(self, commands: np.ndarray) -> None:
        """Do nothing: a log takes no commands."""

    def close(self) -> None:
        """Do nothing: the log is in memory."""
