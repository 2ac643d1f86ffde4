"""A model on mixed cycles it has not seen: both channels, switched by the commands."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchid.metrics import HORIZONS
from hitchid.model import Hitch
from hitchid.record import Record
from hitchid.units import conversion_factor
from hitchid.validation.pooled import pooled
from hitchid.validation.predictions import Predictions
from hitchid.validation.uncertainty import COVERAGE, cycle_band_figures

ORIGINS = 5


def cycle_result(model: Hitch, cycles: Sequence[Record]) -> tuple[dict, Predictions]:
    """Return a model's figures on unseen cycles, in the form of `metrics.json`, and what is behind them.

    Args:
        model: with two channels.
        cycles: mixed logs, at least one.
    """
    actual = [record.displacement for record in cycles]
    paper = _papers(model)
    grey = [model.simulate(record) for record in cycles]
    free = {
        "greybox": grey,
        "benchmark": [model.simulate(record, compensated=False) for record in cycles],
        **({} if paper is None else {"transfer_function": [paper.simulate(record) for record in cycles]}),
    }
    steps = [h for h in HORIZONS if h < min(map(len, cycles))]
    ahead = [model.predictions(record, steps, every=ORIGINS) for record in cycles]
    held = {h: [np.concatenate([y[:h], y[:-h]]) for y in actual] for h in steps}

    def figures(predicted: Sequence[np.ndarray], skip: int) -> dict[str, float | None]:
        told = [np.isfinite(p) & (np.arange(p.size) >= skip) for p in predicted]
        return pooled(
            [y[here] for y, here in zip(actual, told, strict=True)],
            [p[here] for p, here in zip(predicted, told, strict=True)],
        )

    found = {name: {"free_run": pooled(actual, rows)} for name, rows in free.items()}
    found["greybox"]["one_step"] = figures([rows[0] for rows in ahead], 1)
    bands = [model.band(record, coverage=COVERAGE) for record in cycles] if model.has_bands else []
    if not all(np.all(np.isfinite(ends)) for band in bands for ends in band):
        bands = []
    metrics = {
        "tests": [record.name for record in cycles],
        **found,
        "persistence": {"one_step": figures(held[1], 1)},
        "horizons": {
            "steps": steps,
            "greybox": [figures([rows[i] for rows in ahead], h)["rmse"] for i, h in enumerate(steps)],
            "persistence": [figures(held[h], h)["rmse"] for h in steps],
        },
        "per_test": {
            record.name: {"free_run": pooled([y], [g])}
            for record, y, g in zip(cycles, actual, grey, strict=True)
        },
        "max_jump": max(_largest_jump(model, record) for record in cycles),
        **({"bands": cycle_band_figures(bands, actual)} if bands else {}),
    }
    return metrics, Predictions(
        names=tuple(record.name for record in cycles),
        time_s=tuple(record.step_s * np.arange(len(record)) for record in cycles),
        actual=tuple(actual),
        models={"benchmark": tuple(free["benchmark"]), "free_run": tuple(grey)},
        band=(tuple(b.lower for b in bands), tuple(b.upper for b in bands)) if bands else None,
    )


def _papers(model: Hitch) -> Hitch | None:
    """Return the transfer functions of Sun et al. 2025 as one hitch; None where they were not fitted."""
    papers = {
        mode: channel.paper or channel for mode, channel in model.channels.items() if channel.arx is not None
    }
    alone = {
        mode: replace(channel, compensator=None, speed_compensator=None) for mode, channel in papers.items()
    }
    return replace(model, channels=alone) if len(alone) == len(model.channels) else None


def _largest_jump(model: Hitch, record: Record) -> float:
    """Return the largest jump where the channel changes, in the unit of the record's displacement.

    Of the step of displacement at a change, what it differs by from both the step before and the one after.
    """
    own = model.adopt(record)
    run = model.free_run(own)
    steps = np.diff(run.displacement)
    changes = np.flatnonzero(np.diff(run.charge)) + 1
    inside = changes[(changes > 0) & (changes < steps.size - 1)]
    unlike = np.minimum(np.abs(steps[inside] - steps[inside - 1]), np.abs(steps[inside] - steps[inside + 1]))
    return conversion_factor(own.unit, record.unit, record.name) * float(np.max(unlike, initial=0.0))
