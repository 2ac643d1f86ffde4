"""Validation: a model and its baselines on tests that the identification did not use."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from hitchid._support import checks
from hitchid._support.metrics import HORIZONS
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent
from hitchid.errors import InputError
from hitchid.logs.campaign import Campaign
from hitchid.logs.from_rest import from_rest
from hitchid.logs.record import CYCLE, DISPLACEMENT, Record
from hitchid.logs.unification import left_out_notices, refuse, split_usable
from hitchid.logs.units import conversion_factor
from hitchid.model import Band, Channel, FreeRun, Hitch, Rivals, Simulation
from hitchid.validation.channels import COVERAGE, channel_result, cycle_band_figures, paper_channel
from hitchid.validation.results import (
    BENCHMARK,
    FREE_RUN,
    GREYBOX,
    PERSISTENCE,
    RUNS,
    Accuracy,
    ChannelResult,
    CycleResult,
    Horizons,
    ModelFigures,
    Predictions,
    RunFigures,
    figures_by_test,
    model_name,
)
from hitchid.validation.validation import Validation

# Tests that a model can be validated on: they begin at rest and have every covariate it requires.


def usable_tests(campaign: Campaign, *models: Hitch) -> tuple[Campaign, tuple[str, ...]]:
    """Return a campaign without the tests that lack a covariate one of the models requires, and notices.

    Parts of logs after gaps begin at rest.

    Raises:
        InputError: no test is left, or the campaign is strict and a test lacks a covariate.
    """

    def complete(record: Record) -> Record:
        for model in models:
            for direction, channel in model.channels.items():
                if record.kind in (direction, CYCLE):
                    record.require(channel.benchmark.covariates)
        return record

    campaign, in_motion = from_rest(campaign, otherwise="errors contain the motion before")
    records = [(record.name, record) for record in campaign.records]
    usable, lacking = split_usable(records, complete, strict=campaign.strict)
    if lacking and not usable:
        refuse(lacking, "tests")
    notices = left_out_notices(lacking, len(records), "tests")
    return replace(campaign, records=tuple(usable)), (*in_motion, *map(str, notices))


# Notices of a validation: warnings on the figures.


def channel_notices(
    direction: str, accuracy: Accuracy, channel: Channel, tests: Sequence[Record]
) -> list[str]:
    """Return the notices of one direction; the tests are on the model's clock and in its units."""
    uncompensated = accuracy.uncompensated
    left_out = (GREYBOX, BENCHMARK) if uncompensated else (GREYBOX,)
    notices = [f"{direction}: the network correction is not used in simulation"] if uncompensated else []
    for run, label in RUNS.items():
        greybox = accuracy.models[GREYBOX].run(run)
        others = {name: models.run(run) for name, models in accuracy.models.items() if name not in left_out}
        better = [
            model_name(name)
            for name, figures in others.items()
            if figures is not None and greybox is not None and not greybox.errs_less(figures)
        ]
        if better:
            notices.append(f"{direction}: in {label} the grey box is no better than {' and '.join(better)}")
    batch = channel.batch(tests)
    out_of_range = channel.out_of_range(batch, channel.simulate(batch))
    notices += [
        f"{direction}: in {int(rows.any(axis=1).sum())} of {len(tests)} tests the {name} is outside the "
        "identified range"
        for name, rows in out_of_range.items()
        if rows.any()
    ]
    return notices + [
        f"{direction}: the free run uses the mean of '{name}' before motion"
        for name in channel.benchmark.covariates
    ]


def baseline_notices(direction: str, rivals: Rivals, tests: Sequence[Record]) -> list[str]:
    """Return the notices of baselines that are not compared."""
    notices = [f"{direction}: {notice}" for notice in rivals.notices]
    lacking = [(test.name, name) for test in tests for name in rivals.covariates if name not in test.signals]
    if rivals.baselines and lacking:
        (test, covariate), *_ = lacking
        notices.append(
            f"{direction}: the baselines are not compared: they use '{covariate}', which {test} lacks"
        )
    return notices


def set_by_hand_notices(model: Hitch, direction: str) -> list[str]:
    """Return the notice of the parameters of a direction that were set by hand, if any were."""
    names = model.provenance.set_by_hand.get(direction, {})
    values = ", ".join(
        f"{row.name.replace('_', ' ')} {row.value:.5g} {row.unit}"
        for row in model.parameters[direction]
        if row.name in names
    )
    return (
        [(f"{direction}: {values} set by hand; this direction has no compensators and no bands")]
        if names
        else []
    )


def cycle_notices(model: Hitch, result: CycleResult, factor: float) -> list[str]:
    """Return the notices of mixed cycles; the factor is that from the model's unit to the figures'."""
    accuracy, limits, notices = result.accuracy, model.limits, []
    if limits is not None:
        free_runs = accuracy.predictions.models["free_run"]
        limited_runs = sum(bool(np.any(limits.at_soft_limit(run / factor))) for run in free_runs)
        sentence = limits.sentence(model.units[DISPLACEMENT])
        if limited_runs:
            notices.append(f"cycles: {sentence}; {limited_runs} of {len(free_runs)} reach a limit")
    if not accuracy.free_run().errs_less(accuracy.free_run(BENCHMARK)):
        notices.append(f"cycles: in free run the grey box is no better than {model_name(BENCHMARK)}")
    return notices


# A model on unseen mixed cycles: both channels, switched by the commands.

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
    return Predictions.of(cycles, runs, factor)


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


WORKERS = 2  # threads for directions and cycles; chosen


@checks.named_arguments
@double_precision
def validate(
    model: Hitch,
    campaign: Campaign,
    *,
    segmentation_dead_zones: Mapping[str, float] | None = None,
    progress: ProgressCallback | None = None,
) -> Validation:
    """Compare a model with the tests of a campaign that its identification did not use.

    Free run: commands and initial displacement only, for the whole test. One step and horizon h: measured
    displacement up to 1 and h samples before; the first h samples of a test are left out. The baselines are
    the benchmark alone, persistence (the last measured displacement), ARX, OE, NARX, a black-box LSTM, and
    the transfer function and the grey box of Sun et al. 2025. Models that only run freely (benchmark, OE,
    LSTM, transfer function) are simulated over a horizon from the last measured displacement. Baselines use
    the same covariate that the grey box may use, and keep to the same end stop and limits.

    Args:
        model: an identified hitch.
        campaign: logs; those the identification used are left out, recognised by their content, and those
            that lack a covariate the model requires.
        segmentation_dead_zones: direction to the dead zone by which mixed cycles are cut into strokes where
            there are no single-direction tests; by default the model's own.
        progress: called with the current task and the completed fraction of the work.

    Raises:
        InputError: the identification used every test, none fits the model's channels, or a unit has another
            dimension than the model's.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    checks.instance(campaign, Campaign, "campaign", 'a campaign as hitchid.read("logs") returns it')
    report = progress or silent
    usable, lacking = usable_tests(campaign, model)
    single_direction = usable
    # Of mixed cycles alone, their strokes are the tests of each direction.
    if not usable.directions:
        dead_zones = segmentation_dead_zones or model.segmentation_dead_zones(usable.units)
        single_direction = usable.segmented(dead_zones)
    # Figures are in the unit of the logs, which need not be the model's.
    unit = single_direction.records[0].unit
    factor = conversion_factor(model.units[DISPLACEMENT], unit, "displacement")
    unseen_cycles = []
    if len(model.channels) > 1:
        unseen_cycles = [model.to_model_units(record) for record in _unseen(model, usable.of_kind(CYCLE))]
    tests = {name: single_direction.of_kind(name) for name in single_direction.directions}
    channels, cycles, notices = _results(model, tests, unseen_cycles, factor, report)
    notices = [*lacking, *notices]
    if not channels and cycles is None:
        raise InputError(
            "every test of these logs was used for identification, or is in a direction "
            "that the model does not have; expected at least one other test"
        )
    if not model.has_trained_rivals:
        notices.append(
            "no trained rivals to compare with: hitchid rivals MODEL LOGS trains OE, NARX, a black-box LSTM "
            "and the paper's grey box"
        )
    mode_test = model.two_modes
    if mode_test is not None:
        notices.append(mode_test.sentence)
    return Validation(unit, channels, cycles, mode_test, tuple(notices), model, campaign)


def _results(
    model: Hitch,
    tests: Mapping[str, Sequence[Record]],
    unseen_cycles: Sequence[Record],
    factor: float,
    report: ProgressCallback,
) -> tuple[dict[str, ChannelResult], CycleResult | None, list[str]]:
    """Return the results of each direction with unseen tests and of the cycles, side by side, and notices."""
    channels: dict[str, ChannelResult] = {}
    cycles: CycleResult | None = None
    notices: list[str] = []
    with ThreadPoolExecutor(WORKERS) as pool:
        cycle_job = (
            pool.submit(double_precision(cycle_result), model, unseen_cycles, factor)
            if unseen_cycles
            else None
        )
        jobs = {
            direction: pool.submit(_validate_direction, model, direction, records, factor)
            for direction, records in tests.items()
        }
        for number, (direction, future) in enumerate(jobs.items()):
            report(ProgressUpdate(f"{direction}: horizons and free run", number / (len(jobs) + 1)))
            result, direction_notices = future.result()
            notices += direction_notices
            if result is not None:
                channels[direction] = result
        report(ProgressUpdate("cycles", len(jobs) / (len(jobs) + 1)))
        if cycle_job is not None:
            cycles = cycle_job.result()
            notices += cycle_notices(model, cycles, factor)
    return channels, cycles, notices


@double_precision
def _validate_direction(
    model: Hitch, direction: str, records: Sequence[Record], factor: float
) -> tuple[ChannelResult | None, list[str]]:
    """Return the results of one direction, None without unseen tests, and its notices."""
    unseen = _unseen(model, records)
    if direction not in model.channels:
        return None, [f"{len(unseen)} {direction} tests are left out: the model has no {direction} channel"]
    if not unseen:
        return None, []
    tests = [model.to_model_units(record) for record in unseen]
    channel, rivals = model.channels[direction], model.rivals.get(direction, Rivals())
    result = channel_result(channel, tests, factor, model.uncertainty.get(direction), rivals)
    notices = channel_notices(direction, result.accuracy, channel, tests)
    notices = [*notices, *baseline_notices(direction, rivals, tests)]
    return result, [*set_by_hand_notices(model, direction), *notices]


def _unseen(model: Hitch, records: Sequence[Record]) -> list[Record]:
    return [record for record in records if record.fingerprint not in model.provenance.seen]
