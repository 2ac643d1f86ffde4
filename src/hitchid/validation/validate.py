"""Model and campaign in, one result out: every figure beside its baselines, on tests not seen before."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hitchid.baselines import BlackBox, ahead
from hitchid.benchmark import Batch
from hitchid.campaign import Campaign
from hitchid.errors import InputError
from hitchid.metrics import HORIZONS, ErrorFigures, error_figures
from hitchid.model import Channel, Hitch, unpadded
from hitchid.precision import double_precision
from hitchid.record import CYCLE, DISPLACEMENT, Record
from hitchid.storage import canonical_json, write_folder
from hitchid.uncertainty import Uncertainty
from hitchid.units import conversion_factor
from hitchid.validation.tables import NAMES, RUNS, markdown, tables
from hitchid.validation.uncertainty import band_figures, cycle_band_figures, residual_figures, trust_figures

ORIGINS = 5
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
    stand the benchmark alone, persistence (the last measured displacement), ARX, NARX, a black-box LSTM, and
    the transfer function and the grey box of Sun et al. 2025. What only runs freely (benchmark, LSTM,
    transfer function) starts over a horizon from the last measured displacement.

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
            channels[mode] = _channel_metrics(model.channels[mode], own, factor, model.uncertainty.get(mode))
            notices += _channel_notices(mode, channels[mode])
            heard = model.channels[mode].benchmark.load
            notices += _outside_notices(mode, model.channels[mode], own)
            if heard is not None:
                notices.append(f"{mode}: in free run too the model hears '{heard}' as measured before motion")
    report("cycles", len(campaign.modes) / (len(campaign.modes) + 1))
    unseen = [record for record in whole.of_kind(CYCLE) if not _seen(model, record)]
    cycles = _cycle_metrics(model, unseen) if len(model.channels) > 1 else {"tests": []}
    if not channels and not cycles["tests"]:
        raise InputError(
            "the identification used every test of these logs or has no channel for them; "
            "required tests it has not seen"
        )
    notices += _cycle_notices(cycles)
    metrics: dict[str, object] = {"unit": unit, "channels": channels, "cycles": cycles}
    if model.two_modes is not None:
        metrics["two_modes"] = asdict(model.two_modes)
        notices.append(model.two_modes.sentence)
    return Validation(metrics, tuple(notices))


def _seen(model: Hitch, record: Record) -> bool:
    return record.fingerprint in model.provenance.seen


def _channel_metrics(
    channel: Channel, tests: Sequence[Record], factor: float, known: Uncertainty | None
) -> dict:
    batch = channel.batch(tests)
    actual = [factor * record.displacement for record in tests]

    def figures(rows: np.ndarray, skip: int = 0) -> dict:
        predicted = [factor * row for row in unpadded(rows, tests)]
        return _figures([a[skip:] for a in actual], [p[skip:] for p in predicted])

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
    trusted = {} if known is None else trust_figures(known)
    if known is not None and known.bands is not None:
        ahead = np.stack(predicted["greybox"])
        trusted["bands"] = band_figures(channel, known.bands, batch, ahead, steps, factor)
    return {
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
                "free_run": _figures([a], [factor * f]),
            }
            for record, a, f in zip(tests, actual, unpadded(free, tests), strict=True)
        },
        "residuals": {
            run: residual_figures(channel, batch, rows, factor)
            for run, rows in (("one_step", predicted["greybox"][0]), ("free_run", free))
        },
        **trusted,
    }


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


def _cycle_metrics(model: Hitch, cycles: Sequence[Record]) -> dict:
    if not cycles:
        return {"tests": []}
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
        return _figures(
            [y[here] for y, here in zip(actual, told, strict=True)],
            [p[here] for p, here in zip(predicted, told, strict=True)],
        )

    found = {name: {"free_run": _figures(actual, rows)} for name, rows in free.items()}
    found["greybox"]["one_step"] = figures([rows[0] for rows in ahead], 1)
    return {
        "tests": [record.name for record in cycles],
        **found,
        "persistence": {"one_step": figures(held[1], 1)},
        "horizons": {
            "steps": steps,
            "greybox": [figures([rows[i] for rows in ahead], h)["rmse"] for i, h in enumerate(steps)],
            "persistence": [figures(held[h], h)["rmse"] for h in steps],
        },
        "per_test": {
            record.name: {"free_run": _figures([y], [g])}
            for record, y, g in zip(cycles, actual, grey, strict=True)
        },
        "max_jump": max(_largest_jump(model, record) for record in cycles),
        **({"bands": cycle_band_figures(model, cycles)} if model.has_bands else {}),
    }


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


def _figures(actual: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> dict[str, float | None]:
    figures: ErrorFigures = error_figures(actual, predicted)
    return {name: value if np.isfinite(value) else None for name, value in figures._asdict().items()}


def _outside_notices(mode: str, channel: Channel, tests: Sequence[Record]) -> list[str]:
    batch = channel.batch(tests)
    outside = channel.outside(batch, channel.simulate(batch))
    return [
        f"{mode}: in {int(rows.any(axis=1).sum())} of {len(tests)} tests the {name} leaves what the "
        "identification covered"
        for name, rows in outside.items()
        if rows.any()
    ]


def _channel_notices(mode: str, metrics: dict) -> list[str]:
    same = metrics["greybox"]["free_run"] == metrics["benchmark"]["free_run"]
    rivals = metrics["baselines"] | ({} if same else {"benchmark": metrics["benchmark"]})
    said = [f"{mode}: in free run the grey box is the benchmark alone"] if same else []
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
