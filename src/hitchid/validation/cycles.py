"""A model on unseen mixed cycles: both channels, switched by the commands."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchid._support.metrics import HORIZONS
from hitchid.logs.record import Record
from hitchid.model import Band, FreeRun, Hitch, Rivals, Simulation
from hitchid.validation.channels import COVERAGE, cycle_band_figures, paper_channel
from hitchid.validation.results import (
    BENCHMARK,
    FREE_RUN,
    GREYBOX,
    PERSISTENCE,
    Accuracy,
    CycleResult,
    Horizons,
    ModelFigures,
    Predictions,
    RunFigures,
    commands_of,
    figures_by_test,
)

ORIGIN_STRIDE = 5  # samples between prediction origins; chosen for speed


def cycle_result(model: Hitch, cycles: Sequence[Record], factor: float) -> CycleResult:
    """Return a model's results on unseen cycles.

    Cycles are on the model's clock and in its units; the factor leads to the unit of the figures.
    """
    simulations = [model.simulate(record) for record in cycles]
    predictions = _predictions(model, cycles, simulations, factor)
    actual = predictions.actual
    steps = [h for h in HORIZONS if h < min(map(len, cycles))]
    multi_step = [factor * model.predictions(record, steps, stride=ORIGIN_STRIDE) for record in cycles]

    def figures(predicted: Sequence[np.ndarray], h: int) -> RunFigures:
        """Return figures of predictions h samples ahead, at the samples of the prediction origins."""
        return RunFigures.of([y[h::ORIGIN_STRIDE] for y in actual], [p[h::ORIGIN_STRIDE] for p in predicted])

    multi_step = {
        GREYBOX: {h: figures([rows[i] for rows in multi_step], h) for i, h in enumerate(steps)},
        PERSISTENCE: {h: figures([np.concatenate([y[:h], y[:-h]]) for y in actual], h) for h in steps},
    }
    free = {name: RunFigures.of(actual, rows) for name, rows in predictions.models.items()}
    models = {name: ModelFigures(free_run=run) for name, run in free.items() if name != FREE_RUN}
    models[PERSISTENCE] = ModelFigures(one_step=multi_step[PERSISTENCE][steps[0]])
    models[GREYBOX] = ModelFigures(multi_step[GREYBOX][steps[0]], free[FREE_RUN])
    bands = _bands(simulations, factor) if model.has_bands else None
    if bands is not None:
        ends = (tuple(band.lower for band in bands), tuple(band.upper for band in bands))
        predictions = replace(predictions, band=ends)
    max_jump = factor * max(_largest_jump(simulation.run) for simulation in simulations)
    accuracy = Accuracy(
        models=models,
        horizons=Horizons.of(multi_step),
        per_test=figures_by_test(predictions),
        predictions=predictions,
        bands=None if bands is None else cycle_band_figures(bands, actual),
    )
    return CycleResult(accuracy, max_jump if np.isfinite(max_jump) else None)


def _predictions(
    model: Hitch, cycles: Sequence[Record], simulations: Sequence[Simulation], factor: float
) -> Predictions:
    runs = {
        BENCHMARK: [model.simulate(record, compensated=False).displacement for record in cycles],
        FREE_RUN: [simulation.displacement for simulation in simulations],
    }
    # The transfer functions of Sun et al. 2025 make one hitch, too, where both directions have theirs.
    paper = {
        direction: replace(channel, compensator=None, speed_compensator=None)
        for direction, own in model.channels.items()
        if (channel := paper_channel(own, model.rivals.get(direction, Rivals()))) is not None
    }
    if len(paper) == len(model.channels):
        paper_model = replace(model, channels=paper)
        runs["transfer_function"] = [paper_model.simulate(record).displacement for record in cycles]
    return Predictions(
        names=tuple(record.name for record in cycles),
        time_s=tuple(record.step_s * np.arange(len(record)) for record in cycles),
        actual=tuple(factor * record.displacement for record in cycles),
        models={name: tuple(factor * row for row in rows) for name, rows in runs.items()},
        commands=commands_of(cycles),
    )


def _bands(simulations: Sequence[Simulation], factor: float) -> list[Band] | None:
    """Return bands around the free runs, in the figures' unit; None where they diverged."""
    bands = [simulation.band(COVERAGE) for simulation in simulations]
    if not all(np.all(np.isfinite(ends)) for band in bands for ends in band):
        return None
    return [Band(factor * lower, factor * upper) for lower, upper in bands]


def _largest_jump(run: FreeRun) -> float:
    """Return the largest jump of a free run where the channel changes, in the model's unit.

    A jump is the smaller difference of the displacement step at a change from its two neighbours.
    """
    steps = np.diff(run.displacement)
    changes = np.flatnonzero(np.diff(run.active_channel)) + 1
    interior = changes[(changes > 0) & (changes < steps.size - 1)]
    mismatch = np.minimum(
        np.abs(steps[interior] - steps[interior - 1]), np.abs(steps[interior] - steps[interior + 1])
    )
    return float(np.max(mismatch, initial=0.0))
