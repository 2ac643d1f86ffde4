"""The process of the model beside the machine: blocks of samples in, predictions out."""

import json
import signal
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.data.units import conversion_factor
from hitchid.errors import HitchError, InputError
from hitchid.hmi.history import packed_rows
from hitchid.hmi.source import is_same_sampling_time
from hitchid.model import Hitch, load
from hitchid.online import Monitor

FREE_RUN, AHEAD = 1, 2  # kinds of messages to the page
HORIZON_S = 1.0  # s of the prediction ahead
BLOCK_S = 0.04  # s of samples that are predicted at once
LONGEST_GAP = 1.5  # sampling times between two samples, above which one is missing


class MonitorLoop:
    """A model beside a source, in the units of the source.

    Args:
        model: identified hitch.
        units: of the commands and of the displacement of the source.
        step_s: sampling time of the source, s.

    Raises:
        InputError: sampling time or units do not fit the model.
    """

    def __init__(self, model: Hitch, units: tuple[str, str], step_s: float) -> None:
        if not is_same_sampling_time(step_s, model.step_s):
            raise InputError(
                f"the model has a sampling time of {model.step_s:g} s, the source of {step_s:g} s; "
                "identify a model at that of the source"
            )
        command_units = {model.units[COMMAND[direction]] for direction in model.channels}
        self._command_factor = np.array([1.0, 1.0])
        for number, direction in enumerate(DIRECTIONS):
            unit = model.units.get(COMMAND[direction], next(iter(command_units)))
            self._command_factor[number] = conversion_factor(units[0], unit, COMMAND[direction])
        self._factor = conversion_factor(units[1], model.units[DISPLACEMENT], DISPLACEMENT)
        self._model, self._step_s = model, step_s
        self._block = max(1, round(BLOCK_S / step_s))
        self._monitor: Monitor | None = None
        self._waiting, self._latest_s = np.empty((0, 4)), np.inf

    def restart(self) -> None:
        """Start the free run anew at the next measured displacement."""
        self._monitor = None

    def advance(self, rows: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """Return kind and rows of the predictions that samples complete; time, displacement, band.

        Args:
            rows: time, s; lifting command, lowering command, displacement; shape [N, 4].
        """
        gaps = np.diff(rows[:, 0], prepend=self._latest_s) > LONGEST_GAP * self._step_s
        messages = []
        for number, piece in enumerate(np.split(rows, np.flatnonzero(gaps))):
            if number:
                self.restart()  # samples were lost on the way here, so that the free run would lack commands
                self._waiting = rows[:0]
            self._waiting = np.concatenate([self._waiting, piece])
            while len(self._waiting) >= self._block:
                block, self._waiting = self._waiting[: self._block], self._waiting[self._block :]
                messages += self._predict(block)
        self._latest_s = rows[-1, 0] if len(rows) else self._latest_s
        return messages

    def _predict(self, block: np.ndarray) -> list[tuple[int, np.ndarray]]:
        commands, measured = self._command_factor * block[:, 1:3], self._factor * block[:, 3]
        if self._monitor is None:
            if not np.isfinite(measured[0]):
                return []
            self._monitor = Monitor(self._model, measured[0], block=self._block, horizon_s=HORIZON_S)
        found = self._monitor.advance(commands, measured)
        free_run = np.column_stack([found.free_run, found.free_run_half_width]) / self._factor
        ahead = np.array([[found.ahead, found.ahead_half_width]]) / self._factor
        ahead_s = block[-1:, 0] + self._monitor.horizon * self._step_s
        return [(FREE_RUN, _with_band(block[:, 0], free_run)), (AHEAD, _with_band(ahead_s, ahead))]


def _with_band(time_s: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return time, displacement, lower and upper limit from displacement and half width."""
    centre, half_width = rows.T
    return np.column_stack([time_s, centre, centre - half_width, centre + half_width])


def main(arguments: Sequence[str]) -> None:
    """Predict until the server is gone.

    Args:
        arguments: file descriptor of the connection; model, units and step_s as JSON.
    """
    from hitchid._support.compilation_cache import prepare_jax

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection, settings = Connection(int(arguments[0])), json.loads(arguments[1])
    try:
        prepare_jax()
        loop = MonitorLoop(load(Path(settings["model"])), tuple(settings["units"]), settings["step_s"])
        while True:
            message = connection.recv_bytes()
            if not message:
                loop.restart()
                continue
            rows = np.frombuffer(message, dtype=float).reshape(-1, 5)
            for kind, predicted in loop.advance(rows[:, 1:]):
                connection.send_bytes(packed_rows(kind, predicted, rows[-1, 0]))
    except HitchError as error:
        connection.send_bytes(json.dumps({"error": str(error)}).encode())
    except (EOFError, OSError):
        return


if __name__ == "__main__":
    main(sys.argv[1:])
