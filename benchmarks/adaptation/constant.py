"""A machine that does not change: adaptation must leave its model alone."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from benchmarks.adaptation.bench import at_work, nominal, rms, run, strokes_of
from benchmarks.adaptation.figure import Figure
from benchmarks.scheduling import show

from hitchid.live import AdaptationSettings, Adapter, Changes, Event, OnlineAdaptation, Stroke
from hitchid.live.events import CHANGE_DETECTED, LEARNED, PROMOTED, ROLLED_BACK
from hitchid.live.stroke_errors import PIECES, StrokeErrors
from hitchid.model import Hitch

STANDSTILL, BLOCK = 8_640_000, 8640  # samples of a day, and of a block of them
# Bars: error over that of the frozen model; share of promotions that are wrong; h of strokes between false
# alarms.
OF_FROZEN, WRONG, BETWEEN_ALARMS_H = 1.02, 0.01, 10.0
# s of other work of the bench that promotions are judged on: some 35 strokes of a direction.
INDEPENDENT_S = 600.0


def stable(runs: int = 200) -> list[Figure]:
    """Return what adaptation does where nothing changes: a run has the motion of an hour, 90 % standing.

    A promotion is wrong if its parameters have a larger error in free run than those before it, over strokes
    of the same bench that no adaptation saw.
    """
    model = nominal()
    adapter, kinds, ratios, strokes_h = Adapter(model, AdaptationSettings()), Counter(), [], 0.0
    others = strokes_of(model, at_work("nominal", model, 99_999, INDEPENDENT_S).record)
    error, wrong = error_over(model, others), 0
    for seed in range(runs):
        strokes = strokes_of(model, at_work("nominal", model, 1000 + seed, 400.0).record)
        events = [event for _, _, happened in run(adapter, strokes) for event in happened]
        strokes_h += sum(stroke.end - stroke.begin for stroke in strokes) * model.step_s / 3600
        kinds.update(event.kind for event in events)
        promoted = dict.fromkeys(model.channels, Changes())
        for event in events:
            if event.kind == PROMOTED:
                wrong += error(event.direction, event.changes) > error(
                    event.direction, promoted[event.direction]
                )
            if event.kind in (PROMOTED, ROLLED_BACK):
                promoted[event.direction] = event.changes
        ratios.append(error_of_frozen(events))
    show(
        f"stable, {runs} runs, {strokes_h:.1f} h of strokes: {kinds[PROMOTED]} promotions, {wrong} of them "
        f"wrong, {kinds[ROLLED_BACK]} taken back; {kinds[CHANGE_DETECTED]} alarms; largest error "
        f"{np.max(ratios):.3f} times frozen"
    )
    between_h = strokes_h / max(kinds[CHANGE_DETECTED], 1)
    return [
        Figure("stable: error over that of the frozen model", float(np.mean(ratios)), most=OF_FROZEN),
        Figure("stable: share of the promotions that are wrong", wrong / max(kinds[PROMOTED], 1), most=WRONG),
        Figure("stable: h of strokes between false alarms", between_h, least=BETWEEN_ALARMS_H),
    ]


def error_over(model: Hitch, strokes: Sequence[Stroke]) -> Callable[[str, Changes], float]:
    """Return the function from direction and changes to the free-run error over strokes, mm."""
    judged = {}
    for direction, channel in model.channels.items():
        own = [stroke for stroke in strokes if stroke.direction == direction]
        load = np.zeros(len(channel.benchmark.covariates))
        judged[direction] = StrokeErrors(channel, model.step_s, load, len(own)), own

    @cache
    def error(direction: str, changes: Changes) -> float:
        errors, own = judged[direction]
        return float(np.sqrt(np.mean([fit.squares / PIECES for fit in errors.fits(own, changes)])))

    return error


def error_of_frozen(events: Sequence[Event]) -> float:
    """Return the error of the model in use over that of the frozen one, of the strokes learned from."""
    learned = [event.figures for event in events if event.kind == LEARNED]
    adapted, frozen = (
        rms([figures[name] for figures in learned]) for name in ("error", "error_as_identified")
    )
    return adapted / frozen


def standstill() -> list[Figure]:
    """Return what a day of standstill changes: nothing."""
    adaptation, rng = OnlineAdaptation(nominal()), np.random.default_rng(0)
    before = dict(adaptation.changes)
    started_s = time.perf_counter()
    for _ in range(STANDSTILL // BLOCK):
        noise = rng.standard_normal((BLOCK, 3))
        adaptation.feed(0.002 * noise[:, :2], 120.0 + 0.15 * noise[:, 2])
    took_s = time.perf_counter() - started_s
    adaptation.finish()
    show(f"standstill: {STANDSTILL} samples in {took_s:.0f} s")
    changed = sum(before[direction] != changes for direction, changes in adaptation.changes.items())
    return [Figure("standstill: directions whose parameters changed", changed, most=0)]
