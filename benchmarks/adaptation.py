"""Adaptation on the virtual bench and on measured logs: does it follow, does it leave alone what stays?

Run: python -m benchmarks.adaptation [quick] [follow] [stable] [faults] [bands] [standstill] [delay] …
"""

import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from benchmarks.scheduling import FAST, campaign, show, without_covariates
from jax.typing import ArrayLike

import hitchid
from hitchid.adaptation import AdaptationSettings, Adapter, AdapterState, Event, Stroke, StrokeCutter
from hitchid.adaptation.events import CHANGE_DETECTED, LEARNED, PROMOTED, REFUSED, ROLLED_BACK
from hitchid.data.record import DIRECTIONS, DISPLACEMENT, Record
from hitchid.experiments.conditions import Conditions
from hitchid.experiments.work import Work, work
from hitchid.model import Hitch
from hitchid.online import OnlineAdaptation
from hitchid.rig import load_rig

DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))
RIGS = {"nominal": 40.0, "heavy-cold": 5.0, "light-warm-worn": 70.0}  # °C of the oil
TESTS = 20  # of each direction, from which a model is identified
LEVELS = (0.25, 0.9)  # of the largest effective command of the tests: levels of the operator
STROKES = 5  # of a direction, after which the model must have followed
FAULTS = ("stuck", "jump", "sign", "dropouts", "end stop", "spikes")
LARGEST_RATIO = 1.1  # of the error after a change of load to that of a model identified anew
STANDSTILL = 8_640_000  # samples: a day


def identified(rig: str, mass_kg: float, oil_degc: float) -> Hitch:
    """Return a model of a bench in one condition, which is not measured."""
    tests = campaign(rig, Conditions((mass_kg,), (oil_degc,)), TESTS, seed=1)
    return hitchid.identify(without_covariates(tests), **FAST).model


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


def follow(rigs: Sequence[str], masses_kg: Sequence[float] = (450.0, 1300.0), *, oil: bool = True) -> float:
    """Print how a model follows a change of load, and of oil temperature, beside one identified anew.

    Returns:
        The largest error after a change of load, as a multiple of that of the model identified anew.
    """
    largest = 0.0
    for rig in rigs:
        oil_degc = RIGS[rig]
        start = identified(rig, 1000.0, oil_degc)
        for mass_kg in masses_kg:
            samples = np.arange(60_000)
            changing = {"implement_kg": np.where(samples < 30_000, 1000.0, mass_kg), "oil_degc": oil_degc}
            anew = identified(rig, mass_kg, oil_degc)
            line = f"{rig}, 1000 to {mass_kg:g} kg, after {STROKES} strokes"
            at = at_work(rig, start, 11, 600.0, **changing)
            largest = max(largest, compare(line, start, anew, at, 300.0, STROKES))
        if oil:
            cold, warm = identified(rig, 1000.0, 5.0), identified(rig, 1000.0, 50.0)
            degrees = np.clip(5 + 45 * (0.01 * np.arange(90_000) - 100) / 600, 5, 50)
            changing = {"implement_kg": 1000.0, "oil_degc": degrees}
            at = at_work(rig, cold, 11, 900.0, **changing)
            compare(f"{rig}, 5 to 50 °C in 600 s, from the start of it", cold, warm, at, 100.0, 0)
            compare(f"{rig}, 5 to 50 °C in 600 s, warm", cold, warm, at, 700.0, 0)
    return largest


def compare(name: str, start: Hitch, anew: Hitch, at: Work, after_s: float, skipped: int) -> float:
    """Print errors of the adapted, the frozen and the newly identified model on strokes after a time.

    Returns:
        The largest error of the adapted model as a multiple of that of the one identified anew.
    """
    largest = 0.0
    strokes = strokes_of(start, at.record)
    adapted: dict[str, list[float]] = {direction: [] for direction in start.channels}
    frozen: dict[str, list[float]] = {direction: [] for direction in start.channels}
    for stroke, _, events in run(Adapter(start, AdaptationSettings()), strokes):
        for event in events:
            if event.kind == LEARNED and stroke.begin * at.record.step_s > after_s:
                adapted[stroke.direction].append(event.figures["error"])
                frozen[stroke.direction].append(event.figures["error_as_identified"])
    late = [stroke for stroke in strokes if stroke.begin * at.record.step_s > after_s]
    new = errors(anew, late)
    for direction in start.channels:
        first, of_frozen = adapted[direction][skipped:], frozen[direction][skipped:]
        of_new = new[direction][skipped:]
        largest = max(largest, rms(first) / rms(of_new))
        show(
            f"{name}, {direction}: adapted {rms(first):.2f} mm, identified anew {rms(of_new):.2f} "
            f"({rms(first) / rms(of_new):.2f} times), frozen {rms(of_frozen):.2f} "
            f"({100 * (1 - rms(first) / rms(of_frozen)):.0f} % below)"
        )
    return largest


def stable(runs: int) -> None:
    """Print what adaptation does where nothing changes: each run has the motion of an hour, 90 % standing."""
    model = identified("nominal", 1000.0, 40.0)
    adapter, better, promotions, wrong, alarms, strokes = Adapter(model, AdaptationSettings()), [], 0, 0, 0, 0
    for seed in range(runs):
        at = at_work("nominal", model, 1000 + seed, 400.0)
        adapted, frozen = [], []
        for _, _, events in run(adapter, strokes_of(model, at.record)):
            for event in events:
                strokes += event.kind == LEARNED
                alarms += event.kind == CHANGE_DETECTED
                wrong += event.kind == ROLLED_BACK
                promotions += event.kind == PROMOTED
                if event.kind == LEARNED:
                    adapted.append(event.figures["error"])
                    frozen.append(event.figures["error_as_identified"])
        better.append(rms(adapted) / rms(frozen))
    show(
        f"stable, {runs} hours: error {np.mean(better):.3f} times frozen, largest {np.max(better):.3f}; "
        f"{promotions} promotions, {wrong} taken back; {strokes} strokes, {alarms} alarms"
    )


def faults() -> None:
    """Print which share of the strokes with a fault of the sensor is refused, of each fault."""
    model = identified("nominal", 1000.0, 40.0)
    at = at_work("nominal", model, 11, 900.0)
    adapter, good = Adapter(model, AdaptationSettings()), strokes_of(model, at.record)
    for fault in FAULTS:
        displacement, affected = with_fault(fault, at.record.displacement, good)
        refused, learned = set(), set()
        for stroke, state, events in run(adapter, strokes_of(model, at.record, displacement)):
            if stroke.begin in affected:
                learned.add(state.strokes)
            refused |= {event.stroke for event in events if event.kind == REFUSED}
        show(f"{fault}: {len(learned & refused)} of {len(learned)} strokes refused")


def with_fault(
    fault: str, displacement: np.ndarray, strokes: Sequence[Stroke]
) -> tuple[np.ndarray, set[int]]:
    """Return a displacement of which every second pair of strokes has a fault, and where those begin."""
    rng, faulty, affected = np.random.default_rng(0), displacement.copy(), set()
    for stroke in strokes[10::4] + strokes[11::4]:
        start, stop = stroke.begin, stroke.end
        middle = start + int(rng.uniform(0.2, 0.7) * (stop - start))
        if fault == "stuck":
            faulty[middle:stop] = faulty[middle]
        elif fault == "jump":
            faulty[middle:stop] += 10.0
        elif fault == "sign":
            faulty[start:stop] = 2 * faulty[start - 1] - faulty[start:stop]
        elif fault == "dropouts":
            faulty[start:stop][rng.uniform(size=stop - start) < 0.5] = np.nan
        elif fault == "end stop":
            bound = np.minimum if faulty[stop - 1] > faulty[start] else np.maximum
            faulty[start:stop] = bound(faulty[start:stop], faulty[middle])
        else:
            spikes = start + rng.choice(stop - start, max(3, (stop - start) // 50), replace=False)
            faulty[spikes] += rng.choice([-1, 1], spikes.size) * rng.uniform(5.0, 40.0, spikes.size)
        affected.add(start)
    return faulty, affected


def bands(strokes: int) -> None:
    """Print the coverage of the 90 % bands over many strokes through changes of load."""
    model = identified("nominal", 1000.0, 40.0)
    duration_s = 9.0 * strokes
    samples = np.arange(round(100 * duration_s))
    masses = np.random.default_rng(0).uniform(450.0, 1300.0, 1 + samples[-1] // 60_000)
    at = at_work("nominal", model, 5, duration_s, implement_kg=masses[samples // 60_000])
    adapter, outside = Adapter(model, AdaptationSettings()), []
    for _, _, events in run(adapter, strokes_of(model, at.record)):
        outside += [event.figures["outside"] for event in events if event.kind == LEARNED]
    show(f"bands: {100 * (1 - np.mean(outside)):.1f} % of the samples inside over {len(outside)} strokes")


def standstill() -> None:
    """Print what a day of standstill does: nothing, and no memory."""
    model = identified("nominal", 1000.0, 40.0)
    adaptation, rng = OnlineAdaptation(model), np.random.default_rng(0)
    before = dict(adaptation.changes)
    started_s = time.perf_counter()
    for _ in range(STANDSTILL // 8640):
        noise = rng.standard_normal((8640, 3))
        adaptation.feed(0.002 * noise[:, :2], 120.0 + 0.15 * noise[:, 2])
    took_s = time.perf_counter() - started_s
    adaptation.finish()
    same = before == adaptation.changes
    show(f"standstill: {STANDSTILL} samples in {took_s:.0f} s, changes {'the same' if same else 'DIFFER'}")


def delay() -> None:
    """Print strokes until a change of the gain by 10 % is seen, and how long a sample and an update take."""
    model = identified("nominal", 1000.0, 40.0)
    at = at_work("nominal", model, 21, 600.0)
    adapter, took_s, alarms, since = (
        Adapter(model, AdaptationSettings()),
        [],
        [],
        dict.fromkeys(DIRECTIONS, 0),
    )
    adapter.prepare()
    state = adapter.initial_state()
    strokes = strokes_of(model, at.record)
    for number, stroke in enumerate(strokes):
        changed = number >= len(strokes) // 2
        start = np.nanmean(stroke.displacement[: stroke.rest])
        factor = 1.1 if changed else 1.0
        stroke = stroke._replace(displacement=start + factor * (stroke.displacement - start))
        started_s = time.perf_counter()
        state, events = adapter.learn(state, stroke)
        took_s.append(time.perf_counter() - started_s)
        since[stroke.direction] += changed
        for event in events:
            reported = event.kind == CHANGE_DETECTED or "sudden change" in event.reason
            if reported and changed and event.direction not in dict(alarms):
                alarms.append((event.direction, since[event.direction]))
    show(
        f"a gain of 1.1 times is seen after {', '.join(f'{count} strokes {name}' for name, count in alarms)}",
        f"update: median {1e3 * np.median(took_s):.0f} ms, p99 {1e3 * np.quantile(took_s, 0.99):.0f} ms",
    )


def measured() -> None:
    """Print what adaptation gains on the logs of a field excavator, one after the other."""
    if not (DATA / "field-excavator").is_dir():
        show(f"measured: {DATA / 'field-excavator'} is missing")
        return
    given = hitchid.read(DATA / "field-excavator")
    first, *others = given.records
    model = hitchid.identify(replace(given, records=(first,)), **FAST).model
    adapted = model.adapt(others)
    for direction in model.channels:
        learned = [e for e in adapted.events if e.kind == LEARNED and e.direction == direction]
        refused = sum(e.kind == REFUSED and e.direction == direction for e in adapted.events)
        late, unit = learned[len(learned) // 4 :], model.units[DISPLACEMENT]
        show(
            f"field-excavator, {direction}: {rms([e.figures['error'] for e in late]):.3g} {unit} adapted, "
            f"{rms([e.figures['error_as_identified'] for e in late]):.3g} frozen, over the last "
            f"{len(late)} of {len(learned)} strokes that were learned from, {refused} refused"
        )


def main(parts: Sequence[str]) -> None:
    """Run parts by name; all of them by default."""
    if "quick" in parts:
        ratio = follow(("nominal",), (450.0,), oil=False)
        if ratio > LARGEST_RATIO:
            sys.exit(
                f"adaptation: {ratio:.2f} times the error of a new model, expected at most {LARGEST_RATIO:g}"
            )
        return
    everything = not parts
    if everything or "follow" in parts:
        follow(tuple(RIGS))
    for name, part in (
        ("stable", lambda: stable(200)),
        ("faults", faults),
        ("bands", lambda: bands(1000)),
        ("standstill", standstill),
        ("delay", delay),
        ("measured", measured),
    ):
        if everything or name in parts:
            part()


if __name__ == "__main__":
    main(sys.argv[1:])
