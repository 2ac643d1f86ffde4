"""Faults of the sensor, and a pump that cannot deliver: strokes with one must not be learned from."""

from collections.abc import Sequence

import numpy as np
from benchmarks.adaptation.bench import at_work, nominal, run, strokes_of
from benchmarks.adaptation.figure import Figure
from benchmarks.scheduling import show

from hitchid.bench import Rig, load_rig, simulate
from hitchid.bench.virtual_campaign import LITRES_PER_MIN
from hitchid.live import AdaptationSettings, Adapter, Stroke
from hitchid.live.events import REFUSED

FAULTS = ("stuck", "jump", "sign", "dropouts", "end stop", "spikes")
LEAST_REFUSED = 0.99  # share of the affected strokes
# Flow that is left to a starved pump, over its own, and length of the log, s: some 100 strokes are affected.
STARVED = {0.06: 6000.0, 0.1: 7000.0}
SOUND_FIRST_S = 120.0  # s before the first episode
EPISODE_S, BETWEEN_S = (30.0, 90.0), (40.0, 100.0)  # s of an episode, and from one to the next
LEAST_EFFECT = 0.06  # share of the travel under a sound pump by which that of an affected stroke differs


def faults() -> list[Figure]:
    """Return which share of the affected strokes is refused, of each fault of sensor and pump."""
    model = nominal()
    at = at_work("nominal", model, 11, 900.0)
    adapter, good, figures = Adapter(model, AdaptationSettings()), strokes_of(model, at.record), []
    for fault in FAULTS:
        displacement, affected = with_fault(fault, at.record.displacement, good)
        strokes = strokes_of(model, at.record, displacement)
        figures.append(share_refused(fault, adapter, strokes, affected))
    return figures + [starved(share, duration_s) for share, duration_s in STARVED.items()]


def starved(share: float, duration_s: float) -> Figure:
    """Return which share of the strokes is refused that a pump is too small for at times.

    Args:
        share: of the flow of the pump that is left.
        duration_s: length, s.
    """
    model, rig = nominal(), load_rig("nominal")
    flow = float(rig.supply.pump_flow) / LITRES_PER_MIN * starved_at_times(share, duration_s)
    strokes = strokes_of(model, at_work("nominal", model, 12, duration_s, pump_l_min=flow).record)
    sound = sound_travels(rig, strokes)
    affected = {
        stroke.begin
        for stroke, expected in zip(strokes, sound, strict=True)
        if abs(travel(stroke) - expected) > LEAST_EFFECT * abs(expected)
    }
    adapter = Adapter(model, AdaptationSettings())
    return share_refused(f"pump at {100 * share:g} %", adapter, strokes, affected)


def starved_at_times(share: float, duration_s: float) -> np.ndarray:
    """Return the flow of a pump over its own at each sample: at times only a share is left."""
    rng, flow = np.random.default_rng(0), np.ones(round(100 * duration_s))
    at_s = SOUND_FIRST_S
    while at_s < duration_s:
        until_s = at_s + rng.uniform(*EPISODE_S)
        flow[round(100 * at_s) : round(100 * until_s)] = share
        at_s = until_s + rng.uniform(*BETWEEN_S)
    return flow


def travel(stroke: Stroke) -> float:
    """Return the measured travel of a stroke, mm."""
    return float(stroke.displacement[-1] - start_of(stroke))


def start_of(stroke: Stroke) -> float:
    """Return where a stroke begins, mm."""
    return float(np.mean(stroke.displacement[: stroke.rest + 1]))


def sound_travels(rig: Rig, strokes: Sequence[Stroke]) -> list[float]:
    """Return the travel of each stroke, mm, that the bench would have with its own pump."""
    longest = max(len(stroke.displacement) for stroke in strokes)
    currents = np.zeros((len(strokes), longest, 2))
    for row, stroke in zip(currents, strokes, strict=True):
        row[: len(stroke.commands)] = np.maximum(stroke.commands, 0.0)
    starts_m = 1e-3 * np.array([start_of(stroke) for stroke in strokes])
    moved = 1e3 * np.asarray(simulate(rig, currents, initial_displacement_m=starts_m).displacement_m)
    return [
        float(row[len(stroke.displacement) - 1] - row[0]) for row, stroke in zip(moved, strokes, strict=True)
    ]


def share_refused(name: str, adapter: Adapter, strokes: Sequence[Stroke], affected: set[int]) -> Figure:
    """Return which share of the affected strokes was refused.

    Args:
        name: of the fault.
        adapter: of the model.
        strokes: of the machine.
        affected: where those with the fault begin.
    """
    refused, numbers = set(), set()
    for stroke, state, events in run(adapter, strokes):
        if stroke.begin in affected:
            numbers.add(state.strokes)
        refused |= {event.stroke for event in events if event.kind == REFUSED}
    show(f"{name}: {len(numbers & refused)} of {len(numbers)} strokes refused")
    share = len(numbers & refused) / len(numbers) if numbers else float("nan")
    return Figure(f"{name}: share of the affected strokes that is refused", share, least=LEAST_REFUSED)


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
