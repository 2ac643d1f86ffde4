"""One channel on tests it has not seen: every figure beside its baselines."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from hitchid._support.metrics import HORIZONS
from hitchid.baselines.autoregression import ahead
from hitchid.baselines.black_box import BlackBox
from hitchid.data.record import Record
from hitchid.model import Channel, unpadded
from hitchid.structures import Batch
from hitchid.structures.structure import LinearStructure
from hitchid.uncertainty import Uncertainty
from hitchid.validation.pooled import pooled
from hitchid.validation.predictions import Predictions
from hitchid.validation.uncertainty import band_figures, free_run_band, residual_figures, trust_figures


class _Runs(NamedTuple):
    """What a channel and its baselines say of tests, in the model's unit, rows of shape [T, N].

    Attributes:
        batch: the tests.
        steps: horizons, in samples.
        benchmark, free: free runs of the benchmark and of the grey box.
        ahead: model to its predictions, an entry a horizon; what only runs freely starts from the last
            measured displacement.
        rivals: the baselines, by name.
    """

    batch: Batch
    steps: list[int]
    benchmark: np.ndarray
    free: np.ndarray
    ahead: dict[str, list[np.ndarray]]
    rivals: dict[str, "_Rival"]


def channel_result(
    channel: Channel, tests: Sequence[Record], factor: float, known: Uncertainty | None
) -> tuple[dict, Predictions]:
    """Return a channel's figures on unseen tests, in the form of `metrics.json`, and what is behind them.

    Args:
        channel: of the model.
        tests: on the model's clock and in its units.
        factor: from the model's unit of displacement to that of the figures.
        known: how far the channel can be trusted; None where that was not asked for.
    """
    runs = _run(channel, tests)
    half = _half_width(channel, runs, known)
    trusted = {} if known is None else trust_figures(known, factor)
    if known is not None and known.bands is not None and half is not None:
        ahead = np.stack(runs.ahead["greybox"])
        trusted["bands"] = band_figures(known.bands, runs.batch, runs.free, half, ahead, runs.steps, factor)
    residuals = {
        run: residual_figures(channel, runs.batch, rows, factor)
        for run, rows in (("one_step", runs.ahead["greybox"][0]), ("free_run", runs.free))
    }
    metrics = {**_figures(runs, tests, factor), "residuals": residuals, **trusted}
    return metrics, _predictions(runs, half, tests, factor)


def _run(channel: Channel, tests: Sequence[Record]) -> _Runs:
    batch = channel.batch(tests)
    steps = [h for h in HORIZONS if h < min(map(len, tests))]
    benchmark = np.asarray(channel.simulate_benchmark(batch))
    held = np.asarray(batch.displacement)

    def before(rows: np.ndarray, h: int) -> np.ndarray:
        return np.concatenate([rows[:, :h], rows[:, :-h]], axis=1)

    def re_anchored(simulated: np.ndarray) -> list[np.ndarray]:
        return [before(held, h) + simulated - before(simulated, h) for h in steps]

    rivals = _rivals(channel, batch, steps)
    ahead = {
        "persistence": [before(held, h) for h in steps],
        "benchmark": re_anchored(benchmark),
        "greybox": list(np.asarray(channel.predict(batch, tuple(steps)))),
        **{name: rival.ahead or re_anchored(rival.free_run) for name, rival in rivals.items()},
    }
    return _Runs(batch, steps, benchmark, np.asarray(channel.simulate(batch)), ahead, rivals)


def _half_width(channel: Channel, runs: _Runs, known: Uncertainty | None) -> np.ndarray | None:
    """Return the half width of the band around the free run; None where there is none, or it diverged."""
    if known is None or known.bands is None:
        return None
    half = free_run_band(channel, known.bands, runs.batch)
    return half if np.all(np.isfinite(runs.free)) and np.all(np.isfinite(half)) else None


def _figures(runs: _Runs, tests: Sequence[Record], factor: float) -> dict:
    """Return accuracy of every model, horizons, and single tests."""
    actual = [factor * record.displacement for record in tests]

    def figures(rows: np.ndarray, skip: int = 0) -> dict:
        predicted = [factor * row for row in unpadded(rows, tests)]
        return pooled([a[skip:] for a in actual], [p[skip:] for p in predicted])

    grey = runs.ahead["greybox"][0]
    rivals = {
        name: ({"one_step": figures(rival.ahead[0], 1)} if rival.ahead else {})
        | {"free_run": figures(rival.free_run)}
        for name, rival in runs.rivals.items()
    }
    horizons = {
        name: [figures(row, h)["rmse"] for h, row in zip(runs.steps, rows, strict=True)]
        for name, rows in runs.ahead.items()
    }
    pairs = zip(tests, actual, unpadded(runs.free, tests), strict=True)
    return {
        "tests": [record.name for record in tests],
        "benchmark": {"free_run": figures(runs.benchmark)},
        "greybox": {"one_step": figures(grey, 1), "free_run": figures(runs.free)},
        "baselines": {"persistence": {"one_step": figures(runs.ahead["persistence"][0], 1)}, **rivals},
        "horizons": {"steps": runs.steps, **horizons},
        "per_test": {record.name: {"free_run": pooled([a], [factor * f])} for record, a, f in pairs},
    }


def _predictions(runs: _Runs, half: np.ndarray | None, tests: Sequence[Record], factor: float) -> Predictions:
    def of_tests(rows: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(factor * row for row in unpadded(rows, tests))

    models = {
        "benchmark": runs.benchmark,
        "one_step": runs.ahead["greybox"][0],
        "free_run": runs.free,
        **{name: rival.free_run for name, rival in runs.rivals.items()},
    }
    return Predictions(
        names=tuple(record.name for record in tests),
        time_s=tuple(record.step_s * np.arange(len(record)) for record in tests),
        actual=tuple(factor * record.displacement for record in tests),
        models={name: of_tests(rows) for name, rows in models.items()},
        band=None if half is None else (of_tests(runs.free - half), of_tests(runs.free + half)),
    )


class _Rival(NamedTuple):
    """A baseline's displacement in free run, shape [T, N], and predicted h samples ahead where it can."""

    free_run: np.ndarray
    ahead: list[np.ndarray] | None = None


def _rivals(channel: Channel, batch: Batch, steps: Sequence[int]) -> dict[str, _Rival]:
    """Return the baselines that the model holds, by name."""
    found = {}
    commands, initial = np.asarray(batch.command), np.asarray(batch.initial)
    travels = batch.direction * (np.asarray(batch.displacement) - initial[:, None])

    def of_travel(travel: np.ndarray) -> np.ndarray:
        return initial[:, None] + batch.direction * travel

    for name, model in (("arx", channel.arx), ("narx", channel.narx)):
        if model is not None:
            rows = [ahead(model, u, w, steps) for u, w in zip(commands, travels, strict=True)]
            free = np.array([model.free_run(u) for u in commands])
            found[name] = _Rival(of_travel(free), [of_travel(row) for row in np.swapaxes(rows, 0, 1)])
    if channel.black_box is not None:
        travel = eqx.filter_jit(BlackBox.free_run)(channel.black_box, batch.command, batch.initial)
        found["lstm"] = _Rival(of_travel(np.asarray(travel)))
    paper = papers_channel(channel)
    if paper is not None:
        batch = batch.with_dead_zone(paper.dead_zone)
        found["transfer_function"] = _Rival(np.asarray(paper.simulate_benchmark(batch)))
        if paper.compensator is not None:
            rows = list(np.asarray(paper.predict(batch, tuple(steps))))
            found["paper"] = _Rival(np.asarray(paper.echo(batch)), rows)
    return found


def papers_channel(channel: Channel) -> Channel | None:
    """Return the method of Sun et al. 2025 beside a channel, the channel itself where it is that.

    None where no baselines were fitted, or that one could not be.
    """
    if channel.paper is not None:
        return channel.paper
    benchmark = channel.benchmark
    plain = isinstance(benchmark.structure, LinearStructure) and benchmark.shape is None
    return channel if plain and channel.arx is not None else None
