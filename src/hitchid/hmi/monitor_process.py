"""The process of the model beside the machine: samples and requests in, predictions and replies out."""

import json
import signal
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.errors import HitchError, InputError
from hitchid.hmi.history import packed_rows
from hitchid.hmi.model_beside import BLOCK
from hitchid.hmi.monitor_loop import MonitorLoop
from hitchid.model import load

MOST_WAITING = 100  # messages with samples before the oldest is dropped: four seconds of them; chosen
COLUMNS = 5  # of a sample: wall clock, ms; time, s; both commands, displacement


def main(arguments: Sequence[str]) -> None:
    """Predict until the server is gone.

    Args:
        arguments: file descriptor of the connection; model, units and step_s as JSON.
    """
    from hitchid._support.compilation import prepare_jax

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection, settings = Connection(int(arguments[0])), json.loads(arguments[1])
    loop = None
    try:
        prepare_jax()
        loop = MonitorLoop(load(Path(settings["model"])), tuple(settings["units"]), settings["step_s"])
        waiting: deque[bytes] = deque(maxlen=MOST_WAITING)
        while True:
            _proceed(loop, connection, waiting)
            _tell_adaptation(loop, connection)
    except HitchError as error:
        connection.send_bytes(json.dumps({"type": "error", "error": str(error)}).encode())
    except (EOFError, OSError):
        pass
    finally:
        if loop is not None:
            loop.adapt(None)


def _proceed(loop: MonitorLoop, connection: Connection, waiting: deque[bytes]) -> None:
    """Take a message: a request is answered at once, samples are predicted when no message is left."""
    if waiting and not connection.poll():
        rows = np.frombuffer(waiting.popleft()[len(BLOCK) :]).reshape(-1, COLUMNS)
        for kind, predicted in loop.advance(rows[:, 1:]):
            connection.send_bytes(packed_rows(kind, predicted, rows[-1, 0]))
        return
    message = connection.recv_bytes()
    if message.startswith(BLOCK):
        waiting.append(message)
        return
    request = json.loads(message)
    error = _error_of(loop, request)
    is_written = error is None and request["type"] == "save_adapted"
    reply = {"type": "reply", "id": request["id"], "error": error, "written": is_written}
    connection.send_bytes(json.dumps(reply).encode())


def _tell_adaptation(loop: MonitorLoop, connection: Connection) -> None:
    news = loop.news_of_adaptation()
    if news is not None:
        connection.send_bytes(json.dumps({"type": "adaptation", **news}).encode())


def _error_of(loop: MonitorLoop, request: Mapping[str, Any]) -> str | None:
    """Carry out a request; return why that is not possible, or None."""
    try:
        match request["type"]:
            case "monitor_restart":
                loop.restart()
            case "adapt":
                loop.adapt(Path(request["log"]) if request["on"] else None)
            case "roll_back":
                loop.adaptation.roll_back(request["direction"])
            case "save_adapted":
                loop.adaptation.save(Path(request["folder"]))
            case kind:
                raise InputError(f"{kind!r:.40} is no request to the model beside the machine")
    except HitchError as error:
        return str(error)
    return None


if __name__ == "__main__":
    main(sys.argv[1:])
