"""Identification of a campaign: dead zones, phase 1, then phase 2, for both directions in parallel."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ParamSpec, TypeVar

from hitchid._support.checks import instance, named_arguments, path, tuple_of
from hitchid._support.precision import double_precision, parallel
from hitchid._support.progress import ProgressCallback, ProgressUpdate, parallel_progress, split_progress
from hitchid._support.progress_display import shown
from hitchid.errors import HitchError, InputError
from hitchid.estimation import Search, SearchComparison
from hitchid.identification.campaign_job import CampaignJob, ChannelResults
from hitchid.identification.config import (
    CAMPAIGN,
    DEFAULT_STRUCTURES,
    NO_DEAD_ZONES,
    TRAINING,
    WHALE,
    IdentificationConfig,
    RivalsConfig,
    Structures,
    check_campaign,
)
from hitchid.identification.config import PAPER_SPECS as PAPER_SPECS
from hitchid.identification.direction import find_benchmark, find_compensators
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.result import ChannelTrace, Identification
from hitchid.identification.settings_file import settings_of_model
from hitchid.logs.campaign import Campaign
from hitchid.model import Channel, Hitch

# Parts of an identification with their relative work (measured at default settings).
SHARES = {"tests": 0.03, "phase 1": 0.45, "phase 2": 0.5, "model": 0.02}
SHARES_WITHOUT_TRAINING = {"tests": 0.05, "phase 1": 0.75, "phase 2": 0.17, "model": 0.03}
RIVALS_SHARE = 1.5  # the work of all rivals, of that of the model (measured)
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Key = tuple[int, str]
ChannelResult = tuple[Channel, ChannelTrace]
PhysicsCallback = Callable[[Identification], str]


def run_pipeline(
    campaigns: Sequence[Campaign],
    config: IdentificationConfig,
    progress: ProgressCallback,
    checkpoints: Path | None = None,
    on_physics: PhysicsCallback | None = None,
) -> tuple[Identification | HitchError, ...]:
    """Carry out phase 1, then phase 2, and put the models together.

    Returns:
        In the order of the campaigns the identification, or the error that ended it.
    """

    shares = SHARES if config.training else SHARES_WITHOUT_TRAINING
    parts = split_progress(progress, shares | ({"rivals": RIVALS_SHARE} if config.rivals.trained else {}))
    parts["tests"](ProgressUpdate("finding dead zones in the tests", 0.0))
    jobs_or_errors = parallel(
        lambda number: _result_or_error(CampaignJob.of, campaigns[number], config, checkpoints),
        range(len(campaigns)),
    )
    jobs = {number: job for number, job in jobs_or_errors.items() if isinstance(job, CampaignJob)}
    keys = [(number, direction) for number, job in jobs.items() for direction in job.channel_configs]

    def run_phase1(key: Key, channel_progress: ProgressCallback) -> ChannelResult:
        job, direction = jobs[key[0]], key[1]
        return find_benchmark(job.channel_data[direction], job.channel_configs[direction], channel_progress)

    def calibrate_gains(number: int) -> ChannelResults:
        return jobs[number].calibrate_gains(_campaign_results(phase1_results, number))

    def run_phase2(key: Key, channel_progress: ProgressCallback) -> ChannelResult:
        job, direction = jobs[key[0]], key[1]
        results = _or_raise(calibrated_results[key[0]])
        return find_compensators(
            *results[direction], job.channel_data[direction], job.channel_configs[direction], channel_progress
        )

    def build_model(number: int) -> Identification:
        return jobs[number].build_model(_campaign_results(phase2_results, number))

    # Phase by phase over all campaigns, so that each program is compiled once and no core waits.
    phase1_results = _phase(run_phase1, keys, parts["phase 1"])
    calibrated_results = parallel(lambda number: _result_or_error(calibrate_gains, number), jobs)
    if on_physics is not None and config.training is not None:
        for number, results in calibrated_results.items():
            if not isinstance(results, HitchError):
                message = on_physics(jobs[number].assemble(results))
                parts["phase 2"](ProgressUpdate("physics model", 0.0, message=message))
    phase2_results = _phase(run_phase2, keys, parts["phase 2"])
    if jobs:
        parts["model"](ProgressUpdate("putting the model together", 0.0))
    outcomes = dict(parallel(lambda number: _result_or_error(build_model, number), jobs))
    if config.rivals.trained:
        for number, outcome in outcomes.items():
            if isinstance(outcome, Identification):
                model = jobs[number].with_rivals(outcome.model, parts["rivals"])
                outcomes[number] = replace(outcome, model=model)
    return tuple(
        job if isinstance(job, HitchError) else outcomes[number] for number, job in jobs_or_errors.items()
    )


def _phase(
    work: Callable[[Key, ProgressCallback], ChannelResult], keys: Sequence[Key], progress: ProgressCallback
) -> Mapping[Key, ChannelResult | HitchError]:
    """Do one phase for all directions at the same time."""
    single_campaign = len({number for number, _ in keys}) == 1
    names = {key: key[1] if single_campaign else f"{key[0] + 1}, {key[1]}" for key in keys}
    channel_progress = parallel_progress(progress, tuple(names.values()))
    return parallel(lambda key: _result_or_error(work, key, channel_progress[names[key]]), keys)


def _campaign_results(results: Mapping[Key, ChannelResult | HitchError], number: int) -> ChannelResults:
    """Return direction to result of one campaign; raises the HitchError of a failed direction."""
    return {
        direction: _or_raise(result)
        for (campaign_number, direction), result in results.items()
        if campaign_number == number
    }


def _or_raise(result: Result | HitchError) -> Result:
    if isinstance(result, HitchError):
        raise result
    return result


def _result_or_error(
    work: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs
) -> Result | HitchError:
    try:
        return work(*args, **kwargs)
    except HitchError as error:
        return error


@named_arguments
@double_precision
def identify(
    campaign: Campaign,
    *,
    structure: Structures = DEFAULT_STRUCTURES,
    search: Search | str = WHALE,
    training: CompensatorConfig | None = TRAINING,
    dead_zones: Mapping[str, float] = NO_DEAD_ZONES,
    drift: bool | None = None,
    rivals: RivalsConfig | bool | None = False,
    seed: int = 0,
    progress: ProgressCallback | bool | None = True,
    checkpoints: str | Path | None = None,
    on_physics: PhysicsCallback | None = None,
) -> Identification:
    """Identify a grey-box model from the tests of a campaign that are not held out.

    Phase 1 finds each benchmark by a global search and least squares, phase 2 trains each compensator on the
    error of its frozen benchmark (Sun et al. 2025, sec. 2.4.2). Tests of one direction are used where there
    are any; a campaign of mixed cycles alone is cut into strokes.

    Args:
        campaign: tests; ramps, where there are any, give the dead zones.
        structure: name of a structure or form of a benchmark, for both directions or by direction;
            "automatic", the default, or `AutoStructure` for the choice by free run on operating points held
            out in turn; `PAPER_SPECS` are the paper's.
        search: the global search of phase 1: "whale", "differential-evolution" or "multi-start", or one with
            settings, `Whale`, `DifferentialEvolution` or `MultiStart`.
        training: settings of phase 2; None identifies benchmarks alone.
        dead_zones: direction to dead zone, in the command's unit, where it is known.
        drift: whether a held piston is given a drift; None: where the logs show one.
        rivals: models that are fitted for comparison. False for those that cost little, ARX and the paper's
            transfer function; True for all, which takes longer than the model and may follow later, see
            `train_rivals`; None for none.
        seed: every random draw comes from it.
        progress: True for a bar in a terminal or a notebook, False for none, or a function that is called
            with what is being done and the fraction of all work that is done.
        checkpoints: folder where finished searches and trainings are kept; with those of a run that was
            stopped, it continues from there to the same model. None keeps none.
        on_physics: called with the physics model as soon as there is one, before corrections are trained;
            the sentence that it returns is shown with the progress.

    Raises:
        InputError: there is no test of one direction, all are held out or cannot be used, or an
            argument does not fit.
        FitError: the identification could not be carried out on these data.
    """
    config = IdentificationConfig.of(structure, search, training, dead_zones, drift, rivals, seed)
    folder = None if checkpoints is None else path(checkpoints, "checkpoints")
    with shown(progress) as report:
        (result,) = run_pipeline([check_campaign(campaign)], config, report, folder, on_physics)
    if isinstance(result, HitchError):
        raise result
    return result


@named_arguments
@double_precision
def identify_many(
    campaigns: Sequence[Campaign],
    *,
    structure: Structures = DEFAULT_STRUCTURES,
    search: Search | str = WHALE,
    training: CompensatorConfig | None = TRAINING,
    dead_zones: Mapping[str, float] = NO_DEAD_ZONES,
    drift: bool | None = None,
    rivals: RivalsConfig | bool | None = False,
    seed: int = 0,
    progress: ProgressCallback | bool | None = True,
) -> tuple[Identification | HitchError, ...]:
    """Identify a model from each of many campaigns, such as those of a fleet, in one process.

    Each becomes the model that `identify` finds. Programs are compiled once for all campaigns of like shape,
    and all cores work on them.

    Args:
        campaigns: of one machine each.
        structure, search, training, dead_zones, drift, rivals, seed: as for `identify`, the same for all.
        progress: as for `identify`.

    Returns:
        In the order of the campaigns the identification, or the error with which it ended; an error does not
        affect the others.
    """
    config = IdentificationConfig.of(structure, search, training, dead_zones, drift, rivals, seed)
    checked_campaigns = tuple_of(campaigns, Campaign, "campaigns", f"several, each {CAMPAIGN}")
    with shown(progress) as report:
        return run_pipeline(checked_campaigns, config, report)


COMPARED_SEARCHES = SearchComparison()


@named_arguments
@double_precision
def train_rivals(
    model: Hitch,
    campaign: Campaign,
    *,
    searches: SearchComparison | None = COMPARED_SEARCHES,
    progress: ProgressCallback | bool | None = True,
    checkpoints: str | Path | None = None,
) -> Hitch:
    """Return a model with all its rivals, trained on the tests that the model was identified from.

    They are ARX, OE, NARX, a black-box LSTM, the method of Sun et al. 2025, and baselines of other packages,
    with the settings and the seed of the identification.

    Args:
        model: an identified model.
        campaign: the tests that it was identified from, and those held out.
        searches: the global searches of the parameters that are compared; None compares none.
        progress, checkpoints: as for `identify`.

    Raises:
        InputError: the campaign is not that of the model, or an argument does not fit.
    """
    instance(model, Hitch, "model", "a model as hitchid.load returns it")
    settings = settings_of_model(model.provenance.settings)
    rivals = RivalsConfig(trained=True, searches=searches)
    config = IdentificationConfig.of(**{**settings, "seed": model.provenance.seed, "rivals": rivals})
    campaign = check_campaign(campaign)
    folder = None if checkpoints is None else path(checkpoints, "checkpoints")
    job = CampaignJob.of(campaign, config, folder)
    if job.fingerprints != model.provenance.seen:
        raise InputError(
            "rivals are trained on the tests of their model: expected the logs and the split that it was "
            f"identified from, got {len(job.fingerprints & model.provenance.seen)} of "
            f"{len(model.provenance.seen)} of them and {len(job.fingerprints - model.provenance.seen)} others"
        )
    with shown(progress) as report:
        return job.with_rivals(model, report)
