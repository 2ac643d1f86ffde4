"""Identification of several campaigns phase by phase, with all directions in parallel."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ParamSpec, TypeVar

from hitchid._support.parallel import parallel
from hitchid._support.progress import ProgressCallback, ProgressUpdate, parallel_progress, split_progress
from hitchid.data.campaign import Campaign
from hitchid.errors import HitchError
from hitchid.identification.campaign_job import (
    CampaignJob,
    ChannelResults,
)
from hitchid.identification.channel_trace import ChannelTrace
from hitchid.identification.config import IdentificationConfig
from hitchid.identification.direction import find_benchmark, find_compensators
from hitchid.identification.result import Identification
from hitchid.model import Channel

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

    Args:
        campaigns: of one machine each.
        config: configuration, the same for all.
        progress: called with the current task and the completed fraction.
        checkpoints: folder of finished partial results, for one campaign.
        on_physics: called with each model of phase 1, before compensators are trained; what it returns is
            shown with the progress.

    Returns:
        In the order of the campaigns the identification, or the error that ended it.
    """

    shares = SHARES if config.training else SHARES_WITHOUT_TRAINING
    rivals_share = {"rivals": RIVALS_SHARE} if config.rivals.trained else {}
    parts = split_progress(progress, {**shares, **rivals_share})
    parts["tests"](ProgressUpdate("finding dead zones in the tests", 0.0))

    def prepare_job(campaign: Campaign) -> CampaignJob:
        campaign_config = config.with_campaign_covariates(campaign)
        return CampaignJob.of(campaign, campaign_config, campaign_config.checkpoints(checkpoints, campaign))

    numbers = range(len(campaigns))
    jobs_or_errors = parallel(lambda number: _result_or_error(prepare_job, campaigns[number]), numbers)
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

    def with_rivals(number: int, identification: Identification | HitchError) -> Identification | HitchError:
        if isinstance(identification, HitchError):
            return identification
        model = jobs[number].with_rivals(identification.model, parts["rivals"])
        return replace(identification, model=model)

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
    models = parallel(lambda number: _result_or_error(build_model, number), jobs)
    if config.rivals.trained:
        models = {number: with_rivals(number, models[number]) for number in jobs}
    return tuple(
        job if isinstance(job, HitchError) else models[number] for number, job in jobs_or_errors.items()
    )


def _phase(
    work: Callable[[Key, ProgressCallback], ChannelResult],
    keys: Sequence[Key],
    progress: ProgressCallback,
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
