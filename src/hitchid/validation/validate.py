"""Model and campaign in, one result out: every figure beside its baselines, on tests not seen before."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent
from hitchid._support.storage import canonical_json, write_files, write_folder
from hitchid.data.campaign import Campaign
from hitchid.data.record import CYCLE, DISPLACEMENT, Record
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model import Channel, Comparison, Hitch
from hitchid.validation.channels import channel_result
from hitchid.validation.cycles import cycle_result
from hitchid.validation.predictions import Predictions
from hitchid.validation.tables import NAMES, RUNS, markdown, tables
from hitchid.validation.usable import with_covariates

METRICS_FILE = "metrics.json"
TABLES_FILE = "tables.md"
WORKERS = 2


@dataclass(frozen=True)
class Validation:
    """How well a model predicts tests it has not seen.

    Attributes:
        metrics: all figures, in the form of `metrics.json`: errors in the displacement's unit, R² a fraction,
            fit in percent.
        notices: what the figures say that a reader should not miss.
        predictions: mode, or `cycles`, to the unseen tests with what the models say of them.
    """

    metrics: Mapping[str, Any]
    notices: tuple[str, ...]
    predictions: Mapping[str, Predictions] = field(default_factory=dict)

    def markdown(self) -> str:
        """Return every table as Markdown."""
        return markdown(tables(self.metrics), self.notices)

    def write(self, folder: str | Path, *, force: bool = False) -> None:
        """Write `metrics.json` and `tables.md`, both or neither; `report.write_report` adds a report.

        Raises:
            OutputError: the folder exists and `force` is not given, or it cannot be written.
        """

        write_folder(
            checks.path(folder, "folder"),
            lambda target: write_files(target, self.files()),
            result_kind=METRICS_FILE,
            force=force,
        )

    def files(self) -> dict[str, bytes]:
        """Return `metrics.json` and `tables.md` with what they hold."""
        text = self.markdown().encode("utf-8", errors="backslashreplace")
        return {METRICS_FILE: canonical_json(self.metrics), TABLES_FILE: text}


@double_precision
def validate(
    model: Hitch,
    campaign: Campaign,
    *,
    segmentation_dead_zones: Mapping[str, float] | None = None,
    progress: ProgressCallback | None = None,
) -> Validation:
    """Compare a model with the tests of a campaign that its identification has not used.

    Free run: commands and initial displacement only, for the whole test. One step and horizon h: measured
    displacement up to 1 and h samples before; the first h samples of a test are left out. Beside the grey box
    stand the benchmark alone, persistence (the last measured displacement), ARX, NARX, a black-box LSTM, and
    the transfer function and the grey box of Sun et al. 2025. What only runs freely (benchmark, LSTM,
    transfer function) starts over a horizon from the last measured displacement.

    Args:
        model: an identified hitch.
        campaign: logs; those the identification used are left out, recognised by their content, and those
            that lack a covariate the model requires.
        segmentation_dead_zones: mode to dead zone, with which mixed cycles are cut into strokes where there
            is nothing else; by default the model's own.
        progress: called with what is being done and the fraction of all work that is done.

    Raises:
        InputError: the identification used every test, or none fits the model's channels.
        SettingsError: a unit is of another dimension than the model's.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    checks.instance(campaign, Campaign, "campaign", 'a campaign as hitchid.read("logs") returns it')
    report = progress or silent
    campaign, lacking = with_covariates(campaign, model)
    full_campaign = campaign
    if not campaign.directions:
        campaign = campaign.segmented(
            segmentation_dead_zones or model.segmentation_dead_zones(campaign.units)
        )
    unit = campaign.records[0].unit
    factor = conversion_factor(model.units[DISPLACEMENT], unit, "displacement")
    both_directions = len(model.channels) > 1
    unseen_cycles = [
        model.to_model_units(r)
        for r in full_campaign.of_kind(CYCLE)
        if both_directions and not _seen(model, r)
    ]
    channels, cycles, notices, predictions = {}, {"tests": []}, [*lacking], {}
    with ThreadPoolExecutor(WORKERS) as pool:
        cycle_job = (
            pool.submit(double_precision(cycle_result), model, unseen_cycles, factor)
            if unseen_cycles
            else None
        )
        jobs = {
            direction: pool.submit(_validate_direction, model, direction, campaign.of_kind(direction), factor)
            for direction in campaign.directions
        }
        for number, (direction, future) in enumerate(jobs.items()):
            report(ProgressUpdate(f"{direction}: horizons and free run", number / (len(jobs) + 1)))
            result, direction_notices = future.result()
            notices += direction_notices
            if result is not None:
                channels[direction], predictions[direction] = result
        report(ProgressUpdate("cycles", len(jobs) / (len(jobs) + 1)))
        if cycle_job is not None:
            cycles, predictions["cycles"] = cycle_job.result()
            notices += _limit_notices(model, predictions["cycles"], factor)
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
    return Validation(metrics, tuple(notices), predictions)


@double_precision
def _validate_direction(
    model: Hitch, direction: str, records: Sequence[Record], factor: float
) -> tuple[tuple[dict, Predictions] | None, list[str]]:
    """Return one direction's figures with what is behind them, None without unseen tests, and notices."""
    tests = [record for record in records if not _seen(model, record)]
    if direction not in model.channels:
        return None, [f"{len(tests)} {direction} tests are left out: the model has no {direction} channel"]
    if not tests:
        return None, []
    converted_tests, channel = [model.to_model_units(record) for record in tests], model.channels[direction]
    figures, predictions = channel_result(
        channel,
        converted_tests,
        factor,
        model.uncertainty.get(direction),
        model.comparison.get(direction, Comparison()),
    )
    notices = _channel_notices(direction, figures) + _out_of_range_notices(
        direction, channel, converted_tests
    )
    if (covariate := channel.benchmark.covariate) is not None:
        notices.append(
            f"{direction}: in free run too the model hears '{covariate}' as measured before motion"
        )
    return (figures, predictions), notices


def _seen(model: Hitch, record: Record) -> bool:
    return record.fingerprint in model.provenance.seen


def _out_of_range_notices(direction: str, channel: Channel, tests: Sequence[Record]) -> list[str]:
    batch = channel.batch(tests)
    out_of_range = channel.out_of_range(batch, channel.simulate(batch))
    return [
        f"{direction}: in {int(rows.any(axis=1).sum())} of {len(tests)} tests the {name} leaves what the "
        "identification covered"
        for name, rows in out_of_range.items()
        if rows.any()
    ]


def _channel_notices(direction: str, metrics: dict) -> list[str]:
    uncompensated = metrics["greybox"]["free_run"] == metrics["benchmark"]["free_run"]
    baselines = metrics["baselines"] | ({} if uncompensated else {"benchmark": metrics["benchmark"]})
    notices = [f"{direction}: in free run the grey box is the benchmark alone"] if uncompensated else []
    for run in ("one_step", "free_run"):
        figures = metrics["greybox"][run]
        better = [
            NAMES[name]
            for name, baseline in baselines.items()
            if run in baseline and not _errs_less(figures, baseline[run])
        ]
        if better:
            notices.append(
                f"{direction}: in {RUNS[run]} the grey box is no better than {' and '.join(better)}"
            )
    return notices


def _limit_notices(model: Hitch, cycles: Predictions, factor: float) -> list[str]:
    """Tell in how many mixed logs the free run is held at a limit that is no mechanical stop."""
    if model.limits is None:
        return []
    limits = model.limits
    limited_runs = sum(bool(np.any(limits.at_soft_limit(run / factor))) for run in cycles.models["free_run"])
    sentence = limits.sentence(model.units[DISPLACEMENT])
    return (
        [f"cycles: {sentence}; {limited_runs} of {len(cycles.names)} reach a limit"] if limited_runs else []
    )


def _cycle_notices(cycles: dict) -> list[str]:
    if cycles["tests"] and not _errs_less(cycles["greybox"]["free_run"], cycles["benchmark"]["free_run"]):
        return [f"cycles: in free run the grey box is no better than {NAMES['benchmark']}"]
    return []


def _errs_less(one: dict, other: dict) -> bool:
    """Tell whether one error is finite and below the other; what diverged is never better."""
    return one["rmse"] is not None and (other["rmse"] is None or one["rmse"] < other["rmse"])
