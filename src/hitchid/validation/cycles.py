"""A model on mixed cycles it has not seen: both channels, switched by the commands."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchid._support.metrics import HORIZONS
from hitchid.data.record import Record
from hitchid.model import Band, Comparison, FreeRun, Hitch
from hitchid.validation.channels import paper_channel
from hitchid.validation.pooled import pooled
from hitchid.validation.predictions import Predictions
from hitchid.validation.uncertainty import COVERAGE, cycle_band_figures

ORIGIN_STRIDE = 5


def cycle_result(model: Hitch, cycles: Sequence[Record], factor: float) -> tuple[dict, Predictions]:
    """Return a model's figures on unseen cycles, in the form of `metrics.json`, and what is behind them.

    Args:
        model: with two channels.
        cycles: mixed logs on the model's clock and in its units, at least one.
        factor: from the model's unit of displacement to that of the figures.
    """
    actual = [factor * record.displacement for record in cycles]
    paper_model = _paper_model(model)
    free_runs = [model.free_run(record) for record in cycles]
    runs = {
        "greybox": [run.displacement for run in free_runs],
        "benchmark": [model.simulate(record, compensated=False) for record in cycles],
        **(
            {}
            if paper_model is None
            else {"transfer_function": [paper_model.simulate(record) for record in cycles]}
        ),
    }
    displacements = {name: tuple(factor * row for row in rows) for name, rows in runs.items()}
    steps = [h for h in HORIZONS if h < min(map(len, cycles))]
    multi_step = [factor * model.predictions(record, steps, stride=ORIGIN_STRIDE) for record in cycles]

    def multi_step_figures(predicted: Sequence[np.ndarray], h: int) -> dict[str, float | None]:
        """Return figures of predictions h samples ahead, at the samples that the model predicted."""
        return pooled([y[h::ORIGIN_STRIDE] for y in actual], [p[h::ORIGIN_STRIDE] for p in predicted])

    def last_measured(h: int) -> list[np.ndarray]:
        return [np.concatenate([y[:h], y[:-h]]) for y in actual]

    figures = {name: {"free_run": pooled(actual, rows)} for name, rows in displacements.items()}
    figures["greybox"]["one_step"] = multi_step_figures([rows[0] for rows in multi_step], 1)
    bands = _bands(model, cycles, factor)
    metrics = {
        "tests": [record.name for record in cycles],
        **figures,
        "persistence": {"one_step": multi_step_figures(last_measured(1), 1)},
        "horizons": {
            "steps": steps,
            "greybox": [
                multi_step_figures([rows[i] for rows in multi_step], h)["rmse"] for i, h in enumerate(steps)
            ],
            "persistence": [multi_step_figures(last_measured(h), h)["rmse"] for h in steps],
        },
        "per_test": {
            record.name: {"free_run": pooled([y], [run])}
            for record, y, run in zip(cycles, actual, displacements["greybox"], strict=True)
        },
        "max_jump": factor * max(map(_largest_jump, free_runs)),
        **({} if bands is None else {"bands": cycle_band_figures(bands, actual)}),
    }
    return metrics, Predictions(
        names=tuple(record.name for record in cycles),
        time_s=tuple(record.step_s * np.arange(len(record)) for record in cycles),
        actual=tuple(actual),
        models={"free_run" if name == "greybox" else name: rows for name, rows in displacements.items()},
        band=None if bands is None else (tuple(b.lower for b in bands), tuple(b.upper for b in bands)),
    )


def _bands(model: Hitch, cycles: Sequence[Record], factor: float) -> list[Band] | None:
    """Return bands around the free runs, in the figures' unit; None where there are none or they diverged."""
    if not model.has_bands:
        return None
    bands = [model.band(record, coverage=COVERAGE) for record in cycles]
    if not all(np.all(np.isfinite(ends)) for band in bands for ends in band):
        return None
    return [Band(factor * lower, factor * upper) for lower, upper in bands]


def _paper_model(model: Hitch) -> Hitch | None:
    """Return the transfer functions of Sun et al. 2025 as one hitch; None where they were not fitted."""
    paper_channels = {
        direction: paper_channel(channel, model.comparison.get(direction, Comparison()))
        for direction, channel in model.channels.items()
    }
    uncompensated = {
        direction: replace(channel, compensator=None, speed_compensator=None)
        for direction, channel in paper_channels.items()
        if channel is not None
    }
    return replace(model, channels=uncompensated) if len(uncompensated) == len(model.channels) else None


def _largest_jump(run: FreeRun) -> float:
    """Return the largest jump of a free run where the channel changes, in the model's unit.

    Of the step of displacement at a change, what it differs by from both the step before and the one after.
    """
    steps = np.diff(run.displacement)
    changes = np.flatnonzero(np.diff(run.active_channel)) + 1
    interior = changes[(changes > 0) & (changes < steps.size - 1)]
    mismatch = np.minimum(
        np.abs(steps[interior] - steps[interior - 1]), np.abs(steps[interior] - steps[interior + 1])
    )
    return float(np.max(mismatch, initial=0.0))
