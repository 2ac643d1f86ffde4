"""Faults of the sensor: strokes with one must not be learned from."""

from collections.abc import Sequence

import numpy as np
from benchmarks.adaptation.bench import at_work, nominal, run, strokes_of
from benchmarks.adaptation.figure import Figure
from benchmarks.scheduling import show

from hitchid.adaptation import AdaptationSettings, Adapter, Stroke
from hitchid.adaptation.events import REFUSED

FAULTS = ("stuck", "jump", "sign", "dropouts", "end stop", "spikes")
LEAST_REFUSED = 0.99  # share of the affected strokes


def faults() -> list[Figure]:
    """Return which share of the strokes with a fault of the sensor is refused, of each fault."""
    model = nominal()
    at = at_work("nominal", model, 11, 900.0)
    adapter, good, figures = Adapter(model, AdaptationSettings()), strokes_of(model, at.record), []
    for fault in FAULTS:
        displacement, affected = with_fault(fault, at.record.displacement, good)
        strokes = strokes_of(model, at.record, displacement)
        figures.append(share_refused(fault, adapter, strokes, affected))
    return figures


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
