"""A machine that changes: does the model follow, how soon is it seen, do the bands stay?"""

import time
from collections.abc import Sequence

import numpy as np
from benchmarks.adaptation.bench import RIGS, at_work, errors, identified, nominal, rms, run, strokes_of
from benchmarks.adaptation.figure import Figure
from benchmarks.adaptation.work import Work
from benchmarks.scheduling import show

from hitchid.live import AdaptationSettings, Adapter
from hitchid.live.events import CHANGE_DETECTED, LEARNED
from hitchid.logs.record import DIRECTIONS
from hitchid.model import Hitch

STROKES = 5  # of a direction, after which the model must have followed
# Bars: errors as multiples of those of a model identified anew, after a change of load and of the oil, and of
# those of the frozen model; strokes until a change is seen; s of an update; % of samples inside the bands.
AFTER_LOAD, AFTER_OIL, OF_FROZEN, DELAY, UPDATE_S, INSIDE = 1.1, 1.2, 0.5, 4, 0.2, (87.0, 93.0)


def follow(
    rigs: Sequence[str] = tuple(RIGS), masses_kg: Sequence[float] = (450.0, 1300.0), *, oil: bool = True
) -> list[Figure]:
    """Return how a model follows a change of load, and of oil temperature, beside one identified anew."""
    figures = []
    for rig in rigs:
        figures += [figure for mass_kg in masses_kg for figure in follow_load(rig, mass_kg)]
        figures += follow_oil(rig) if oil else []
    return figures


def follow_load(rig: str, mass_kg: float) -> list[Figure]:
    """Return the errors after an implement of 1000 kg is exchanged, over those of a model identified anew."""
    start, anew = (identified(rig, mass, RIGS[rig]) for mass in (1000.0, mass_kg))
    masses = np.where(np.arange(60_000) < 30_000, 1000.0, mass_kg)
    at = at_work(rig, start, 11, 600.0, implement_kg=masses, oil_degc=RIGS[rig])
    name = f"{rig}, 1000 to {mass_kg:g} kg, after {STROKES} strokes"
    ratios = compare(name, start, anew, at, 300.0, STROKES)
    return [
        Figure(f"{name}, {direction}: error over that of a model identified anew", of_new, most=AFTER_LOAD)
        for direction, (of_new, _) in ratios.items()
    ]


def follow_oil(rig: str) -> list[Figure]:
    """Return the errors while and after the oil becomes warm, over those of other models.

    While it becomes warm no model identified anew exists: then only the frozen one is compared.
    """
    cold, warm = identified(rig, 1000.0, 5.0), identified(rig, 1000.0, 50.0)
    degrees = np.clip(5 + 45 * (0.01 * np.arange(90_000) - 100) / 600, 5, 50)
    at = at_work(rig, cold, 11, 900.0, implement_kg=1000.0, oil_degc=degrees)
    figures = []
    for moment, after_s in (("from the start of it", 100.0), ("warm", 700.0)):
        name = f"{rig}, 5 to 50 °C in 600 s, {moment}"
        for direction, (of_new, of_frozen) in compare(name, cold, warm, at, after_s, 0).items():
            line = f"{name}, {direction}: error over that of"
            figures.append(Figure(f"{line} the frozen model", of_frozen, most=OF_FROZEN))
            if moment == "warm":
                figures.append(Figure(f"{line} a model identified anew", of_new, most=AFTER_OIL))
    return figures


def compare(
    name: str, start: Hitch, anew: Hitch, at: Work, after_s: float, skipped: int
) -> dict[str, tuple[float, float]]:
    """Print errors of the adapted, the frozen and the newly identified model on strokes after a time.

    Returns:
        Direction to the error of the adapted model as a multiple of that of the one identified anew, and of
        that of the frozen one.
    """
    strokes = strokes_of(start, at.record)
    adapted: dict[str, list[float]] = {direction: [] for direction in start.channels}
    frozen: dict[str, list[float]] = {direction: [] for direction in start.channels}
    for stroke, _, events in run(Adapter(start, AdaptationSettings()), strokes):
        for event in events:
            if event.kind == LEARNED and stroke.begin * at.record.step_s > after_s:
                adapted[stroke.direction].append(event.figures["error"])
                frozen[stroke.direction].append(event.figures["error_as_identified"])
    new = errors(anew, [stroke for stroke in strokes if stroke.begin * at.record.step_s > after_s])
    ratios = {}
    for direction in start.channels:
        of_adapted, of_frozen, of_new = (
            rms(values[direction][skipped:]) for values in (adapted, frozen, new)
        )
        ratios[direction] = of_adapted / of_new, of_adapted / of_frozen
        show(
            f"{name}, {direction}: adapted {of_adapted:.2f} mm, identified anew {of_new:.2f}, "
            f"frozen {of_frozen:.2f}"
        )
    return ratios


def bands(strokes: int = 1000) -> list[Figure]:
    """Return the coverage of the 90 % bands over many strokes through changes of load."""
    model = nominal()
    duration_s = 9.0 * strokes
    samples = np.arange(round(100 * duration_s))
    masses = np.random.default_rng(0).uniform(450.0, 1300.0, 1 + samples[-1] // 60_000)
    at = at_work("nominal", model, 5, duration_s, implement_kg=masses[samples // 60_000])
    adapter, outside = Adapter(model, AdaptationSettings()), []
    for _, _, events in run(adapter, strokes_of(model, at.record)):
        outside += [event.figures["outside"] for event in events if event.kind == LEARNED]
    name = f"samples inside the 90 % bands over {len(outside)} strokes, %"
    return [Figure(name, 100 * (1 - float(np.mean(outside))), *INSIDE)]


def delay() -> list[Figure]:
    """Return strokes until a change of the gain by 10 % is seen, and how long an update takes."""
    model = nominal()
    strokes = strokes_of(model, at_work("nominal", model, 21, 600.0).record)
    adapter, took_s = Adapter(model, AdaptationSettings()), []
    seen: dict[str, int] = {}
    since = dict.fromkeys(DIRECTIONS, 0)
    adapter.prepare()
    state = adapter.initial_state()
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
            if reported and changed:
                seen.setdefault(event.direction, since[event.direction])
    show(f"update: median {1e3 * np.median(took_s):.0f} ms")
    name = "strokes until a gain of 1.1 times is seen"
    return [
        *(Figure(f"{name}, {each}", seen.get(each, float("nan")), most=DELAY) for each in model.channels),
        Figure("update, p99, s", float(np.quantile(took_s, 0.99)), most=UPDATE_S),
    ]
