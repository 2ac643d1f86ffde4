"""Fits for comparison only: baselines, the method of Sun et al. 2025, global searches."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Array, Key, PRNGKeyArray

from hitchid._support.checkpoints import Checkpoints
from hitchid._support.progress import (
    TYPICAL_ITERATIONS,
    ProgressCallback,
    ProgressUpdate,
    silent,
    split_progress,
    subtask_progress,
)
from hitchid.baselines.baseline import FitContext
from hitchid.baselines.fitted import FittedBaseline
from hitchid.baselines.registry import all_baselines
from hitchid.estimation import Objective, SearchHistory, compare_searches
from hitchid.estimation.training import EpochCallback, TrainingHistory
from hitchid.identification.channel_trace import ChannelConfig, timed
from hitchid.identification.optional import attempt
from hitchid.identification.phase1 import Phase1, identify_benchmark
from hitchid.identification.phase2 import CompensatorConfig, train_compensator
from hitchid.identification.preparation import ChannelData
from hitchid.model import Channel, Comparison, Estimates, SearchSummary
from hitchid.networks.operating_range import OperatingRange
from hitchid.structures import ModelSpec

# Gradient steps of a baseline's training for an epoch of the compensator's: 3000 by default, and a short
# training shortens both; chosen.
STEPS_PER_EPOCH = 10


def fit_comparison(
    channel: Channel,
    data: ChannelData,
    initial_data: ChannelData,
    config: ChannelConfig,
    training: CompensatorConfig,
    keys: Key[Array, " k"],
    progress: ProgressCallback,
    seconds: dict[str, float],
) -> tuple[Comparison, list[str]]:
    """Fit the baselines, and the method of Sun et al. 2025 where the channel has another structure.

    Args:
        channel: the identified channel.
        data: its tests.
        initial_data: its tests with the dead zone of a linear valve, for the paper's method.
        config: settings of the direction.
        training: size and training of networks.
        keys: random keys of the baselines and of the paper's method.
        progress: called with the current task and the completed fraction.
        seconds: filled with the duration of each fit, s.

    Returns:
        The fitted models, and a notice for each fit that failed.
    """
    notices: list[str] = []
    parts = split_progress(progress, {"baselines": 0.6, "paper": 0.4})
    comparison = Comparison(
        _fit_baselines(data, config, training, keys[0], parts["baselines"], seconds, notices),
        covariates=data.all_tests.covariate_names,
    )
    if config.spec == config.paper_spec:
        return comparison, notices
    with timed(seconds, "paper's method"):
        fitted = attempt(
            "the paper's method",
            lambda: _fit_paper_method(initial_data, config, training, keys[1], parts["paper"]),
            notices,
        )
    if fitted is None:
        return comparison, notices
    paper, estimates = fitted
    return replace(comparison, paper=paper, paper_estimates=estimates), notices


def search_summaries(objective: Objective, config: ChannelConfig) -> tuple[SearchSummary, ...]:
    """Return summaries of the global searches, each run from several seeds."""
    if config.comparison is None:
        return ()
    histories = compare_searches(objective, config.comparison, config.seed)
    return tuple(_search_summary(history) for history in histories)


def _search_summary(history: SearchHistory) -> SearchSummary:
    median_run = history.runs[int(np.argsort(history.final_fitnesses)[len(history.runs) // 2])]
    return SearchSummary(
        history.name,
        tuple(run.final_fitness for run in history.runs),
        tuple(run.evaluations for run in history.runs),
        tuple(run.failures for run in history.runs),
        median_run.fitness,
        median_run.values,
    )


def _fit_baselines(
    data: ChannelData,
    config: ChannelConfig,
    training: CompensatorConfig,
    key: PRNGKeyArray,
    progress: ProgressCallback,
    seconds: dict[str, float],
    notices: list[str],
) -> Mapping[str, FittedBaseline]:
    baselines, available = {}, all_baselines()
    parts = split_progress(progress, dict.fromkeys(available, 1.0))
    for name, baseline in available.items():
        stage = f"{baseline.title} baseline"
        parts[name](ProgressUpdate(stage, 0.0))
        context = FitContext(
            STEPS_PER_EPOCH * training.adam.epochs,
            key,
            epoch_callback(parts[name], stage),
            config.checkpoints.child(f"baseline {name}"),
        )
        with timed(seconds, baseline.title):
            fitted = attempt(
                baseline.title,
                lambda baseline=baseline, context=context: baseline.fit(data.all_tests, context),
                notices,
            )
        if fitted is not None:
            baselines[name] = fitted
    return baselines


def _fit_paper_method(
    data: ChannelData,
    config: ChannelConfig,
    training: CompensatorConfig,
    key: PRNGKeyArray,
    progress: ProgressCallback,
) -> tuple[Channel, Estimates]:
    """Return the channel of the paper's method; `data` has the dead zone found with a linear valve."""
    checkpoints = config.checkpoints.child("paper")
    parts = split_progress(progress, {"phase 1": 0.6, "phase 2": 0.4})
    searched = subtask_progress(parts["phase 1"], 0.0, 1.0, "paper's method")
    phase1 = identify_spec(data, config, config.paper_spec, checkpoints, searched)
    channel, _ = with_compensator(
        benchmark_channel(data, phase1, OperatingRange.unbounded()),
        data,
        training,
        key,
        epoch_callback(parts["phase 2"], "paper's method"),
        checkpoints,
    )
    return channel, phase1.assessment


def benchmark_channel(data: ChannelData, phase1: Phase1, operating_range: OperatingRange) -> Channel:
    """Return a channel with a benchmark and no compensators."""
    return Channel(
        direction=data.direction,
        sign=data.sign,
        dead_zone=data.dead_zone.value,
        end_stop=data.end_stop,
        benchmark=phase1.benchmark,
        operating_range=operating_range,
    )


def identify_spec(
    data: ChannelData,
    config: ChannelConfig,
    spec: ModelSpec,
    checkpoints: Checkpoints,
    progress: ProgressCallback = silent,
) -> Phase1:
    """Identify a benchmark of a given structure."""
    return identify_benchmark(
        data.all_tests,
        spec,
        config.search,
        config.seed,
        units=config.units,
        dead_zone=data.dead_zone.error,
        progress=progress,
        checkpoints=checkpoints,
    )


def with_compensator(
    channel: Channel,
    data: ChannelData,
    training: CompensatorConfig,
    key: PRNGKeyArray,
    progress: EpochCallback,
    checkpoints: Checkpoints,
) -> tuple[Channel, TrainingHistory]:
    """Train the compensator for predictions of a channel."""
    compensator, training_history = train_compensator(
        (data.training, channel.simulate_benchmark(data.training)),
        (data.validation, channel.simulate_benchmark(data.validation)),
        channel.load_filter,
        training,
        key,
        progress,
        checkpoints,
    )
    return replace(channel, compensator=compensator), training_history


def epoch_callback(progress: ProgressCallback, stage: str) -> EpochCallback:
    """Return a callback that reports epochs; early stopping leaves the total number unknown."""

    def show(number: int, training_loss: float, validation_loss: float) -> None:
        done = number / (number + TYPICAL_ITERATIONS)
        figures = {"training loss": training_loss, "validation loss": validation_loss}
        progress(ProgressUpdate(stage, done, f"epoch {number}", figures))

    return show
