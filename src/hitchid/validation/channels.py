"""One channel on tests it has not seen: every figure beside its baselines."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from hitchid._support.metrics import HORIZONS
from hitchid.baselines.autoregression import predict_ahead
from hitchid.baselines.black_box import BlackBox
from hitchid.data.record import Record
from hitchid.model import Channel, remove_padding
from hitchid.structures import Batch
from hitchid.uncertainty import Uncertainty
from hitchid.validation.pooled import pooled
from hitchid.validation.predictions import Predictions
from hitchid.validation.uncertainty import band_figures, free_run_band, residual_figures, trust_figures


class _ModelRuns(NamedTuple):
    """What a channel and its baselines say of tests, in the model's unit, rows of shape [T, N].

    Attributes:
        batch: the tests.
        steps: horizons, in samples.
        benchmark, free_run: free runs of the benchmark and of the grey box.
        multi_step: model to its predictions, an entry a horizon; what only runs freely starts from the last
            measured displacement.
        baselines: the baselines, by name.
    """

    batch: Batch
    steps: list[int]
    benchmark: np.ndarray
    free_run: np.ndarray
    multi_step: dict[str, list[np.ndarray]]
    baselines: dict[str, "_BaselineRun"]


def channel_result(
    channel: Channel, tests: Sequence[Record], factor: float, uncertainty: Uncertainty | None
) -> tuple[dict, Predictions]:
    """Return a channel's figures on unseen tests, in the form of `metrics.json`, and what is behind them.

    Args:
        channel: of the model.
        tests: on the model's clock and in its units.
        factor: from the model's unit of displacement to that of the figures.
        uncertainty: how far the channel can be trusted; None where that was not asked for.
    """
    runs = _run(channel, tests)
    half_width = _half_width(channel, runs, uncertainty)
    trust = {} if uncertainty is None else trust_figures(uncertainty, factor)
    if uncertainty is not None and uncertainty.bands is not None and half_width is not None:
        multi_step = np.stack(runs.multi_step["greybox"])
        trust["bands"] = band_figures(
            uncertainty.bands, runs.batch, runs.free_run, half_width, multi_step, runs.steps, factor
        )
    residuals = {
        run: residual_figures(channel, runs.batch, rows, factor)
        for run, rows in (("one_step", runs.multi_step["greybox"][0]), ("free_run", runs.free_run))
    }
    metrics = {**_figures(runs, tests, factor), "residuals": residuals, **trust}
    return metrics, _predictions(runs, half_width, tests, factor)


def _run(channel: Channel, tests: Sequence[Record]) -> _ModelRuns:
    batch = channel.batch(tests)
    steps = [h for h in HORIZONS if h < min(map(len, tests))]
    benchmark = np.asarray(channel.simulate_benchmark(batch))
    measured = np.asarray(batch.displacement)

    def delayed(rows: np.ndarray, h: int) -> np.ndarray:
        return np.concatenate([rows[:, :h], rows[:, :-h]], axis=1)

    def restarted(simulated: np.ndarray) -> list[np.ndarray]:
        return [delayed(measured, h) + simulated - delayed(simulated, h) for h in steps]

    baselines = _baseline_runs(channel, batch, steps)
    multi_step = {
        "persistence": [delayed(measured, h) for h in steps],
        "benchmark": restarted(benchmark),
        "greybox": list(np.asarray(channel.predict(batch, tuple(steps)))),
        **{name: baseline.multi_step or restarted(baseline.free_run) for name, baseline in baselines.items()},
    }
    return _ModelRuns(batch, steps, benchmark, np.asarray(channel.simulate(batch)), multi_step, baselines)


def _half_width(channel: Channel, runs: _ModelRuns, uncertainty: Uncertainty | None) -> np.ndarray | None:
    """Return the half width of the band around the free run; None where there is none, or it diverged."""
    if uncertainty is None or uncertainty.bands is None:
        return None
    half_width = free_run_band(channel, uncertainty.bands, runs.batch)
    return half_width if np.all(np.isfinite(runs.free_run)) and np.all(np.isfinite(half_width)) else None


def _figures(runs: _ModelRuns, tests: Sequence[Record], factor: float) -> dict:
    """Return accuracy of every model, horizons, and single tests."""
    actual = [factor * record.displacement for record in tests]

    def figures(rows: np.ndarray, skip: int = 0) -> dict:
        predicted = [factor * row for row in remove_padding(rows, tests)]
        return pooled([a[skip:] for a in actual], [p[skip:] for p in predicted])

    one_step = runs.multi_step["greybox"][0]
    baselines = {
        name: ({"one_step": figures(baseline.multi_step[0], 1)} if baseline.multi_step else {})
        | {"free_run": figures(baseline.free_run)}
        for name, baseline in runs.baselines.items()
    }
    horizons = {
        name: [figures(row, h)["rmse"] for h, row in zip(runs.steps, rows, strict=True)]
        for name, rows in runs.multi_step.items()
    }
    pairs = zip(tests, actual, remove_padding(runs.free_run, tests), strict=True)
    return {
        "tests": [record.name for record in tests],
        "benchmark": {"free_run": figures(runs.benchmark)},
        "greybox": {"one_step": figures(one_step, 1), "free_run": figures(runs.free_run)},
        "baselines": {
            "persistence": {"one_step": figures(runs.multi_step["persistence"][0], 1)},
            **baselines,
        },
        "horizons": {"steps": runs.steps, **horizons},
        "per_test": {record.name: {"free_run": pooled([a], [factor * f])} for record, a, f in pairs},
    }


def _predictions(
    runs: _ModelRuns, half_width: np.ndarray | None, tests: Sequence[Record], factor: float
) -> Predictions:
    def of_tests(rows: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(factor * row for row in remove_padding(rows, tests))

    models = {
        "benchmark": runs.benchmark,
        "one_step": runs.multi_step["greybox"][0],
        "free_run": runs.free_run,
        **{name: baseline.free_run for name, baseline in runs.baselines.items()},
    }
    return Predictions(
        names=tuple(record.name for record in tests),
        time_s=tuple(record.step_s * np.arange(len(record)) for record in tests),
        actual=tuple(factor * record.displacement for record in tests),
        models={name: of_tests(rows) for name, rows in models.items()},
        band=None
        if half_width is None
        else (of_tests(runs.free_run - half_width), of_tests(runs.free_run + half_width)),
    )


class _BaselineRun(NamedTuple):
    """A baseline's displacement in free run, shape [T, N], and predicted h samples ahead where it can."""

    free_run: np.ndarray
    multi_step: list[np.ndarray] | None = None


def _baseline_runs(channel: Channel, batch: Batch, steps: Sequence[int]) -> dict[str, _BaselineRun]:
    """Return the baselines that the model holds, by name."""
    runs = {}
    commands, initial = np.asarray(batch.command), np.asarray(batch.initial)
    travels = batch.sign * (np.asarray(batch.displacement) - initial[:, None])

    def of_travel(travel: np.ndarray) -> np.ndarray:
        return initial[:, None] + batch.sign * travel

    for name, model in (("arx", channel.arx), ("narx", channel.narx)):
        if model is not None:
            rows = [predict_ahead(model, u, w, steps) for u, w in zip(commands, travels, strict=True)]
            free_runs = np.array([model.free_run(u) for u in commands])
            runs[name] = _BaselineRun(
                of_travel(free_runs), [of_travel(row) for row in np.swapaxes(rows, 0, 1)]
            )
    if channel.black_box is not None:
        travel = eqx.filter_jit(BlackBox.free_run)(channel.black_box, batch.command, batch.initial)
        runs["lstm"] = _BaselineRun(of_travel(np.asarray(travel)))
    paper = paper_channel(channel)
    if paper is not None:
        batch = batch.with_dead_zone(paper.dead_zone)
        runs["transfer_function"] = _BaselineRun(np.asarray(paper.simulate_benchmark(batch)))
        if paper.compensator is not None:
            rows = list(np.asarray(paper.predict(batch, tuple(steps))))
            runs["paper"] = _BaselineRun(np.asarray(paper.simulate_closed_loop(batch)), rows)
    return runs


def paper_channel(channel: Channel) -> Channel | None:
    """Return the method of Sun et al. 2025 beside a channel, the channel itself where it is that.

    None where no baselines were fitted, or that one could not be.
    """
    if channel.paper is not None:
        return channel.paper
    physical_model = channel.benchmark
    is_paper_model = physical_model.structure.linear is not None and physical_model.nonlinearity is None
    return channel if is_paper_model and channel.arx is not None else None
