"""One channel on tests it has not seen: every figure beside its baselines."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hitchid.baselines import BlackBox, ahead
from hitchid.benchmark import Batch
from hitchid.metrics import HORIZONS
from hitchid.model import Channel, unpadded
from hitchid.record import Record
from hitchid.uncertainty import Uncertainty
from hitchid.validation.pooled import pooled
from hitchid.validation.predictions import Predictions
from hitchid.validation.uncertainty import band_figures, free_run_band, residual_figures, trust_figures


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
    batch = channel.batch(tests)
    actual = [factor * record.displacement for record in tests]

    def figures(rows: np.ndarray, skip: int = 0) -> dict:
        predicted = [factor * row for row in unpadded(rows, tests)]
        return pooled([a[skip:] for a in actual], [p[skip:] for p in predicted])

    benchmark = np.asarray(channel.simulate_benchmark(batch))
    free = np.asarray(channel.simulate(batch))
    steps = [h for h in HORIZONS if h < min(map(len, tests))]
    held = np.asarray(batch.displacement)

    def last_measured(h: int) -> np.ndarray:
        return np.concatenate([held[:, :h], held[:, :-h]], axis=1)

    def re_anchored(simulated: np.ndarray) -> list[np.ndarray]:
        return [
            last_measured(h) + simulated - np.concatenate([simulated[:, :h], simulated[:, :-h]], axis=1)
            for h in steps
        ]

    rivals = _rivals(channel, batch, steps)
    predicted = {
        "persistence": [last_measured(h) for h in steps],
        "benchmark": re_anchored(benchmark),
        "greybox": list(np.asarray(channel.predict(batch, tuple(steps)))),
        **{name: rival.ahead or re_anchored(rival.free_run) for name, rival in rivals.items()},
    }
    trusted, band = {} if known is None else trust_figures(known, factor), None
    if known is not None and known.bands is not None:
        half = free_run_band(channel, known.bands, batch)
        if np.all(np.isfinite(free)) and np.all(np.isfinite(half)):
            looked = np.stack(predicted["greybox"])
            trusted["bands"] = band_figures(known.bands, batch, free, half, looked, steps, factor)
            band = (free - half, free + half)
    metrics = {
        "tests": [record.name for record in tests],
        "benchmark": {"free_run": figures(benchmark)},
        "greybox": {"one_step": figures(predicted["greybox"][0], 1), "free_run": figures(free)},
        "baselines": {
            "persistence": {"one_step": figures(last_measured(1), 1)},
            **{
                name: ({"one_step": figures(rival.ahead[0], 1)} if rival.ahead else {})
                | {"free_run": figures(rival.free_run)}
                for name, rival in rivals.items()
            },
        },
        "horizons": {
            "steps": steps,
            **{
                name: [figures(row, h)["rmse"] for h, row in zip(steps, rows, strict=True)]
                for name, rows in predicted.items()
            },
        },
        "per_test": {
            record.name: {
                "free_run": pooled([a], [factor * f]),
            }
            for record, a, f in zip(tests, actual, unpadded(free, tests), strict=True)
        },
        "residuals": {
            run: residual_figures(channel, batch, rows, factor)
            for run, rows in (("one_step", predicted["greybox"][0]), ("free_run", free))
        },
        **trusted,
    }

    def of_tests(rows: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(factor * row for row in unpadded(rows, tests))

    free_runs = {name: rival.free_run for name, rival in rivals.items()}
    models = {
        "benchmark": benchmark,
        "one_step": predicted["greybox"][0],
        "free_run": free,
        "persistence": predicted["persistence"][0],
        **free_runs,
    }
    return metrics, Predictions(
        names=tuple(record.name for record in tests),
        time_s=tuple(record.step_s * np.arange(len(record)) for record in tests),
        actual=tuple(actual),
        models={name: of_tests(rows) for name, rows in models.items()},
        band=None if band is None else (of_tests(band[0]), of_tests(band[1])),
    )


class _Rival(NamedTuple):
    """A baseline's displacement in free run, shape [T, N], and predicted h samples ahead where it can."""

    free_run: np.ndarray
    ahead: list[np.ndarray] | None = None


def _rivals(channel: Channel, batch: Batch, steps: Sequence[int]) -> dict[str, _Rival]:
    """Return the baselines that the model holds, by name."""
    found = {}
    commands, travels = np.asarray(batch.command), np.asarray(batch.travel)

    def of_travel(travel: np.ndarray) -> np.ndarray:
        return np.asarray(batch.displaced(jnp.asarray(travel)))

    for name, model in (("arx", channel.arx), ("narx", channel.narx)):
        if model is not None:
            rows = [ahead(model, u, w, steps) for u, w in zip(commands, travels, strict=True)]
            free = np.array([model.free_run(u) for u in commands])
            found[name] = _Rival(of_travel(free), [of_travel(row) for row in np.swapaxes(rows, 0, 1)])
    if channel.black_box is not None:
        travel = eqx.filter_jit(BlackBox.free_run)(channel.black_box, batch.command, batch.initial)
        found["lstm"] = _Rival(of_travel(np.asarray(travel)))
    paper = channel if channel.paper is None else channel.paper
    if channel.arx is not None:
        found["transfer_function"] = _Rival(np.asarray(paper.simulate_benchmark(batch)))
        if paper.compensator is not None:
            rows = list(np.asarray(paper.predict(batch, tuple(steps))))
            found["paper"] = _Rival(np.asarray(paper.echo(batch)), rows)
    return found
