"""Adaptation on logs."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchid._support import checks
from hitchid._support.short_repr import short_repr
from hitchid.adaptation.adapter import Adapter, AdapterState
from hitchid.adaptation.events import Event, last_sample
from hitchid.adaptation.settings import AdaptationSettings
from hitchid.adaptation.strokes import Stroke, StrokeCutter
from hitchid.data.record import COMMAND, DIRECTIONS, Record
from hitchid.model import Hitch
from hitchid.model.loads import Load


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
    for strokes in _strokes_of_logs(model, records, last_sample(earlier, model.step_s)):
        state = replace(state, rested_at=math.nan)  # what happened between logs is not known
        for stroke in strokes:
            state, happened = adapter.learn(state, stroke)
            events += happened
    return Adaptation(adapter.adapted(state), tuple(events), state)


def _strokes_of_logs(model: Hitch, records: Iterable[Record], before: int) -> Iterator[list[Stroke]]:
    """Yield the strokes of each log in the model's units, the samples counted from log to log.

    Args:
        model: identified hitch.
        records: logs.
        before: samples before the first of them.
    """
    for record in records:
        converted = model.to_model_units(checks.instance(record, Record, "records", "records of logs"))
        commands = np.column_stack(
            [converted.signals.get(COMMAND[direction], np.zeros(len(converted))) for direction in DIRECTIONS]
        )
        cutter = StrokeCutter(model)
        found = cutter.feed(commands, converted.displacement) + cutter.finish()
        yield [stroke._replace(begin=before + stroke.begin) for stroke in found]
        before += len(converted)
