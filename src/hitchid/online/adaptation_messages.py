"""Messages to and from the process that learns from strokes: a line of JSON, and numbers as float64."""

import json
from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike

from hitchid.adaptation import AdapterState, Event, Stroke


def stroke_message(stroke: Stroke) -> bytes:
    """Return a stroke as a line of JSON and its samples, float64 in the machine's byte order."""
    header = {"direction": stroke.direction, "begin": stroke.begin, "rest": stroke.rest}
    rows = np.column_stack([stroke.commands, stroke.displacement])
    return json.dumps(header).encode() + b"\n" + rows.tobytes()


def stroke_of(message: bytes) -> Stroke:
    """Return the stroke of a message."""
    header, samples = message.split(b"\n", 1)
    rows = np.frombuffer(samples).reshape(-1, 3)
    return Stroke(**json.loads(header), commands=rows[:, :2], displacement=rows[:, 2])


def outcome_message(state: AdapterState, events: Sequence[Event], numbers: ArrayLike) -> bytes:
    """Return what was learned as a line of JSON, and the numbers of the physical models in use."""
    header = {
        "changes": {direction: list(changes) for direction, changes in state.changes.items()},
        "bands": state.band_factors,
        "events": [event.to_json() for event in events],
    }
    return json.dumps(header).encode() + b"\n" + np.asarray(numbers).tobytes()
