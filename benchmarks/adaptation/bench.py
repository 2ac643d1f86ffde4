"""Models of the virtual bench in one condition, and the strokes of a bench at work."""

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from benchmarks.adaptation.work import Work, work
from benchmarks.scheduling import FAST, campaign, without_covariates
from jax.typing import ArrayLike

import hitchid
from hitchid.bench import load_rig
from hitchid.bench.virtual_campaign import Conditions
from hitchid.live import AdaptationSettings, Adapter, AdapterState, Event, Stroke, StrokeCutter
from hitchid.logs.record import DIRECTIONS, Record
from hitchid.model import Hitch

RIGS = {"nominal": 40.0, "heavy-cold": 5.0, "light-warm-worn": 70.0}  # °C of the oil
TESTS = 20  # of each direction, from which a model is identified
LEVELS = (0.25, 0.9)  # of the largest effective command of the tests: levels of the operator


@lru_cache
def identified(rig: str, mass_kg: float, oil_degc: float) -> Hitch:
    """Return a model of a bench in one condition, which is not measured."""
    tests = campaign(rig, Conditions((mass_kg,), (oil_degc,)), TESTS, seed=1)
    return hitchid.identify(without_covariates(tests), **FAST).model


def nominal() -> Hitch:
    """Return the model of the nominal bench with an implement of 1000 kg."""
    return identified("nominal", 1000.0, RIGS["nominal"])


def at_work(rig: str, model: Hitch, seed: int, duration_s: float, **changing: ArrayLike) -> Work:
    """Return strokes and short pauses of a bench within the commands of a model's tests."""
    commands = {}
    for direction, channel in model.channels.items():
        highest = float(channel.operating_range.command.highest)
        lowest, largest = (channel.dead_zone + share * highest for share in LEVELS)
        commands[direction] = lowest, largest
    return work(load_rig(rig), commands, duration_s=duration_s, pause_s=(0.6, 2.0), seed=seed, **changing)


def strokes_of(model: Hitch, record: Record, displacement: np.ndarray | None = None) -> list[Stroke]:
    """Return the strokes of a record of the virtual bench, or of another displacement with its commands."""
    commands = np.column_stack([record.command(direction) for direction in DIRECTIONS])
    return StrokeCutter(model).feed(commands, record.displacement if displacement is None else displacement)


def run(
    adapter: Adapter, strokes: Sequence[Stroke]
) -> Iterator[tuple[Stroke, AdapterState, tuple[Event, ...]]]:
    """Yield each stroke, the state after it, and what happened."""
    state = adapter.initial_state()
    for stroke in strokes:
        state, events = adapter.learn(state, stroke)
        yield stroke, state, events


def errors(model: Hitch, strokes: Sequence[Stroke]) -> dict[str, np.ndarray]:
    """Return direction to the free-run error of each of its strokes, mm, judged as adaptation does."""
    adapter = Adapter(model, AdaptationSettings())
    found: dict[str, list[float]] = {direction: [] for direction in model.channels}
    for stroke in strokes:
        found[stroke.direction].append(adapter.free_run_error(stroke))
    return {direction: np.array(values) for direction, values in found.items()}


def rms(values: Sequence[float] | np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
