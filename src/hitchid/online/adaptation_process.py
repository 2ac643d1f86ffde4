"""The process that learns from strokes; see `OnlineAdaptation`."""

import json
import signal
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any

from hitchid.adaptation import AdaptationSettings, Adapter, Event
from hitchid.errors import HitchError
from hitchid.model import load
from hitchid.model.adjustable import numbers_of_models
from hitchid.online.adaptation_messages import outcome_message, stroke_of


def main(arguments: Sequence[str]) -> None:
    """Learn from strokes until the other side is gone.

    Args:
        arguments: file descriptor of the connection. Its first message are folder of the model, settings,
            load and earlier events as JSON.
    """
    from hitchid._support.compilation import prepare_jax

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection = Connection(int(arguments[0]))
    try:
        prepare_jax()
        _learn(connection, json.loads(connection.recv_bytes()))
    except HitchError as error:
        connection.send_bytes(json.dumps({"error": str(error)}).encode() + b"\n")
    except (EOFError, OSError):
        return


def _learn(connection: Connection, given: dict[str, Any]) -> None:
    settings = {**given["settings"], "parameters": tuple(given["settings"]["parameters"])}
    adapter = Adapter(load(given["model"]), AdaptationSettings(**settings), given["load"])
    state = adapter.resumed([Event.from_json(line) for line in given["earlier"]])
    adapter.prepare()
    events: tuple[Event, ...] = ()
    while True:
        numbers = numbers_of_models(adapter.adapted(state))
        connection.send_bytes(outcome_message(state, events, numbers))
        message = connection.recv_bytes()
        if message.startswith(b"rollback "):
            state, event = adapter.rollback(state, message.removeprefix(b"rollback ").decode())
            events = (event,)
        else:
            state, events = adapter.learn(state, stroke_of(message))


if __name__ == "__main__":
    main(sys.argv[1:])
