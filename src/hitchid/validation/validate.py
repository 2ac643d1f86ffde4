"""Model and campaign in, one result out: every figure beside its baselines, on tests not seen before."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hitchid.baselines import BlackBox
from hitchid.benchmark import Batch
from hitchid.campaign import Campaign
from hitchid.errors import InputError
from hitchid.metrics import ErrorFigures, error_figures
from hitchid.model import Channel, Hitch, unpadded
from hitchid.precision import double_precision
from hitchid.record import CYCLE, DISPLACEMENT, Record
from hitchid.storage import canonical_json, write_folder
from hitchid.units import conversion_factor
from hitchid.validation.tables import NAMES, RUNS, markdown, tables

HORIZONS = (1, 2, 5, 10, 20, 50, 100)
METRICS_FILE = "metrics.json"
TABLES_FILE = "tables.md"
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Validation:
    """How well a model predicts tests it has not seen.

    Attributes:
        metrics: all figures, in the form of `metrics.json`: errors in the displacement's unit, R² a fraction,
            fit in percent.
        notices: what the figures say that a reader should not miss.
    """

    metrics: Mapping[str, object]
    notices: tuple[str, ...]

    def markdown(self) -> str:
        """Return every table as Markdown."""
        return markdown(tables(self.metrics), self.notices)

    def write(self, folder: str | Path, *, force: bool = False) -> None:
        """Write `metrics.json` and `tables.md`, both or neither.

        Raises:
            OutputError: the folder exists and `force` is not given, or it cannot be written.
        """

        write_folder(Path(folder), self.fill, mark=METRICS_FILE, force=force)

    def fill(self, folder: Path) -> None:
        """Write both files into a folder that is being filled."""
        (folder / METRICS_FILE).write_bytes(canonical_json(self.metrics))
        (folder / TABLES_FILE).write_text(self.markdown(), encoding="utf-8", errors="backslashreplace")


@double_precision
def validate(model: Hitch, campaign: Campaign, *, progress: Progress | None = None) -> Validation:
    """Compare a model with the tests of a campaign that its identification has not used.

    Free run: commands and initial displacement only, for the whole test. One step and horizon h: measured
    displacement up to 1 and h samples before; the first h samples of a test are left out. Beside the grey box
    stand persistence (the last measured displacement), ARX, a black-box LSTM, and the benchmark alone, which
    over a horizon starts from the last measured displacement.

    Args:
        model: an identified hitch.
        campaign: logs; those the identification used are left out, recognised by their content.
        progress: called with what is being done and the fraction of all work that is done.

    Raises:
        InputError: the identification used every test, or none fits the model's channels.
        SettingsError: a unit is of another dimension than the model's.
    """
    report = progress or (lambda stage, fraction: None)
    whole = campaign
    if not campaign.modes:
        campaign = campaign.segmented(model.provenance.cut_at or model.dead_zones)
    unit = campaign.records[0].unit
    factor = conversion_factor(model.units[DISPLACEMENT], unit, "displacement")
    channels, notices = {}, []
    for number, mode in enumerate(campaign.modes):
        report(f"{mode}: horizons and free run", number / (len(campaign.modes) + 1))
        tests = [r for r in campaign.of_kind(mode) if not _seen(model, r)]
        if mode not in model.channels:
            notices.append(f"{len(tests)} {mode} tests are left out: the model has no {mode} channel")
        elif tests:
            own = [model.adopt(record) for record in tests]
            channels[mode] = _channel_metrics(model.channels[mode], own, factor)
            notices += _channel_notices(mode, channels[mode])
            heard = model.channels[mode].benchmark.load
            if heard is not None:
                notices.append(f"{mode}: in free run too the model hears the measured '{heard}'")
    report("cycles", len(campaign.modes) / (len(campaign.modes) + 1))
    unseen = [record for record in whole.of_kind(CYCLE) if not _seen(model, record)]
    cycles = _cycle_metrics(model, unseen) if len(model.channels) > 1 else {"tests": []}
    if not channels and not cycles["tests"]:
        raise InputError(
            "the identification used every test of these logs or has no channel for them; "
            "required tests it has not seen"
        )
    notices += _cycle_notices(cycles)
    return Validation({"unit": unit, "channels": channels, "cycles": cycles}, tuple(notices))


def _seen(model: Hitch, record: Record) -> bool:
    return record.fingerprint in model.provenance.seen


def _channel_metrics(channel: Channel, tests: Sequence[Record], factor: float) -> dict:
    batch = channel.batch(tests)
    actual = [factor * record.displacement for record in tests]

    def figures(rows: np.ndarray, skip: int = 0) -> dict:
        predicted = [factor * row for row in unpadded(rows, tests)]
        return _figures([a[skip:] for a in actual], [p[skip:] for p in predicted])

    benchmark = np.asarray(channel.simulate_benchmark(batch))
    free = np.asarray(channel.simulate(batch))
    steps = [h for h in HORIZONS if h < min(map(len, tests))]
    ahead = np.asarray(channel.predict(batch, tuple(steps)))
    held = np.asarray(batch.displacement)

    def last_measured(h: int) -> np.ndarray:
        return np.concatenate([held[:, :h], held[:, :-h]], axis=1)

    def re_anchored(h: int) -> np.ndarray:
        return last_measured(h) + benchmark - np.concatenate([benchmark[:, :h], benchmark[:, :-h]], axis=1)

    return {
        "tests": [record.name for record in tests],
        "benchmark": {"free_run": figures(benchmark)},
        "greybox": {"one_step": figures(ahead[0], 1), "free_run": figures(free)},
        "baselines": {
            "persistence": {"one_step": figures(last_measured(1), 1)},
            **_baseline_metrics(channel, batch, figures),
        },
        "horizons": {
            "steps": steps,
            "greybox": [figures(row, h)["rmse"] for h, row in zip(steps, ahead, strict=True)],
            "benchmark": [figures(re_anchored(h), h)["rmse"] for h in steps],
            "persistence": [figures(last_measured(h), h)["rmse"] for h in steps],
        },
        "per_test": {
            record.name: {
                "free_run": _figures([a], [factor * f]),
            }
            for record, a, f in zip(tests, actual, unpadded(free, tests), strict=True)
        },
    }


def _baseline_metrics(channel: Channel, batch: Batch, figures: Callable[..., dict]) -> dict:
    measured = {}

    def of_travel(travel: np.ndarray) -> np.ndarray:
        return np.asarray(batch.displaced(jnp.asarray(travel)))

    if channel.arx is not None:
        arx = channel.arx
        commands, travels = np.asarray(batch.command), np.asarray(batch.travel)
        one = np.array([arx.one_step(u, w) for u, w in zip(commands, travels, strict=True)])
        free = np.array([arx.free_run(u) for u in commands])
        measured["arx"] = {
            "one_step": figures(of_travel(one), 1),
            "free_run": figures(of_travel(free)),
        }
    if channel.black_box is not None:
        travel = eqx.filter_jit(BlackBox.free_run)(channel.black_box, batch.command, batch.initial)
        measured["lstm"] = {"free_run": figures(of_travel(np.asarray(travel)))}
    return measured


def _cycle_metrics(model: Hitch, cycles: Sequence[Record]) -> dict:
    if not cycles:
        return {"tests": []}
    actual = [record.displacement for record in cycles]
    grey = [model.simulate(record) for record in cycles]
    benchmark = [model.simulate(record, compensated=False) for record in cycles]
    return {
        "tests": [record.name for record in cycles],
        "greybox": {"free_run": _figures(actual, grey)},
        "benchmark": {"free_run": _figures(actual, benchmark)},
    }


def _figures(actual: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> dict[str, float | None]:
    figures: ErrorFigures = error_figures(actual, predicted)
    return {name: value if np.isfinite(value) else None for name, value in figures._asdict().items()}


def _channel_notices(mode: str, metrics: dict) -> list[str]:
    rivals = {**metrics["baselines"], "benchmark": metrics["benchmark"]}
    said = []
    for run in ("one_step", "free_run"):
        figures = metrics["greybox"][run]
        better = [
            NAMES[name] for name, rival in rivals.items() if run in rival and not _better(figures, rival[run])
        ]
        if better:
            said.append(f"{mode}: in {RUNS[run]} the grey box is no better than {' and '.join(better)}")
    return said


def _cycle_notices(cycles: dict) -> list[str]:
    if cycles["tests"] and not _better(cycles["greybox"]["free_run"], cycles["benchmark"]["free_run"]):
        return [f"cycles: in free run the grey box is no better than {NAMES['benchmark']}"]
    return []


def _better(one: dict, other: dict) -> bool:
    """Tell whether one error is finite and below the other; what diverged is never better."""
    return one["rmse"] is not None and (other["rmse"] is None or one["rmse"] < other["rmse"])
