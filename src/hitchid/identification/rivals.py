"""Rivals of one direction: baselines, the method of Sun et al. 2025, and global searches.

None of them is deployed. The quick ones are fitted beside every model; the others, whose training takes
longer than the model, only on request.
"""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from hitchid._support.progress import ProgressCallback, ProgressUpdate, attempt, split_progress
from hitchid.baselines.baseline import Baseline, FitContext, FittedBaseline
from hitchid.baselines.registry import all_baselines
from hitchid.estimation import Objective, SearchComparison, compare_searches
from hitchid.identification.candidates import Candidate
from hitchid.identification.config import ChannelConfig
from hitchid.identification.phase1 import find_parameters, identify_benchmark
from hitchid.identification.phase2 import CompensatorConfig, epoch_callback, with_compensator
from hitchid.identification.preparation import ChannelData
from hitchid.model import Channel, Estimates, Rivals, SearchSummary
from hitchid.networks.operating_range import OperatingRange
from hitchid.structures import PhysicalModel

# Gradient steps of a baseline's training for an epoch of the compensator's: 3000 by default, and a short
# training shortens both; chosen.
STEPS_PER_EPOCH = 10


def quick_rivals(
    data: ChannelData,
    initial_data: ChannelData,
    config: ChannelConfig,
    candidates: Sequence[Candidate],
    progress: ProgressCallback,
) -> Rivals:
    """Fit ARX and the paper's transfer function.

    The paper's method gets the tests with the dead zone of a linear valve; the first candidate of the choice
    may be it.
    """
    notices: list[str] = []
    quick = {name: baseline for name, baseline in all_baselines().items() if baseline.quick}
    parts = split_progress(progress, {"baselines": 0.5, "paper": 0.5})
    key = config.random_keys(data.direction)[2]
    baselines = _fit_baselines(quick, data, config, CompensatorConfig(), key, parts["baselines"], notices)
    paper = None
    if config.spec != config.paper_spec:
        parts["paper"](ProgressUpdate("the paper's transfer function", 0.0))
        paper = attempt(
            "the paper's transfer function",
            lambda: initial_data.channel(
                _paper_transfer_function(initial_data, config, candidates), OperatingRange.unbounded()
            ),
            notices,
        )
    return Rivals(baselines, paper, covariates=data.all_tests.covariate_names, notices=tuple(notices))


def trained_rivals(
    data: ChannelData,
    initial_data: ChannelData,
    config: ChannelConfig,
    training: CompensatorConfig,
    searches: SearchComparison | None,
    progress: ProgressCallback,
) -> Rivals:
    """Fit all baselines, the paper's method where the channel has another form, and the searches."""
    notices: list[str] = []
    parts = split_progress(progress, {"baselines": 0.55, "paper": 0.35, "searches": 0.1})
    _, _, baseline_key, paper_key = config.random_keys(data.direction)
    baselines = _fit_baselines(
        all_baselines(), data, config, training, baseline_key, parts["baselines"], notices
    )
    paper, estimates = None, None
    if config.spec != config.paper_spec:
        paper, estimates = attempt(
            "the paper's method",
            lambda: _fit_paper_method(initial_data, config, training, paper_key, parts["paper"]),
            notices,
        ) or (None, None)
    summaries = None
    if searches is not None:
        parts["searches"](ProgressUpdate("comparing searches", 0.0))
        summaries = attempt(
            "comparison of searches",
            lambda: _compare_searches(Objective.of(data.all_tests, config.search_spec), searches, config),
            notices,
        )
    return Rivals(
        baselines,
        paper,
        estimates,
        summaries or (),
        data.all_tests.covariate_names,
        tuple(notices),
        trained=True,
    )


def _compare_searches(
    objective: Objective, searches: SearchComparison, config: ChannelConfig
) -> tuple[SearchSummary, ...]:
    """Return summaries of the global searches, each run from several seeds."""
    summaries = []
    for history in compare_searches(objective, searches, config.seed):
        runs = history.runs
        median_run = runs[int(np.argsort(history.final_fitnesses)[len(runs) // 2])]
        summaries.append(
            SearchSummary(
                history.name,
                tuple(run.final_fitness for run in runs),
                tuple(run.evaluations for run in runs),
                tuple(run.failures for run in runs),
                median_run.fitness,
                median_run.values,
            )
        )
    return tuple(summaries)


def _fit_baselines(
    available: Mapping[str, Baseline],
    data: ChannelData,
    config: ChannelConfig,
    training: CompensatorConfig,
    key: PRNGKeyArray,
    progress: ProgressCallback,
    notices: list[str],
) -> dict[str, FittedBaseline]:
    baselines: dict[str, FittedBaseline] = {}
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
        fitted = attempt(
            baseline.title,
            lambda baseline=baseline, context=context: baseline.fit(data.all_tests, context),
            notices,
        )
        if fitted is not None:
            baselines[name] = fitted
    return baselines


def _paper_transfer_function(
    data: ChannelData, config: ChannelConfig, candidates: Sequence[Candidate]
) -> PhysicalModel:
    """Return the paper's transfer function; that of the first candidate where it has the paper's form."""
    if candidates and candidates[0].spec == config.paper_spec:
        values = candidates[0].values
        scales = Objective.of(data.all_tests, config.paper_spec).scales
    else:
        checkpoints = config.checkpoints.child("paper's transfer function")
        fit = find_parameters(
            data.all_tests, config.paper_spec, config.search, config.seed, checkpoints=checkpoints
        )
        values, scales = fit.values, fit.objective.scales
    return config.paper_spec.physical_model(jnp.asarray(values), scales)


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
    parts["phase 1"](ProgressUpdate("the paper's method", 0.0))
    phase1 = identify_benchmark(
        data.all_tests,
        config.paper_spec,
        config.search,
        config.seed,
        units=config.units,
        dead_zone=data.dead_zone.error,
        checkpoints=checkpoints,
    )
    channel, _ = with_compensator(
        data.channel(phase1.benchmark, OperatingRange.unbounded()),
        data,
        training,
        key,
        epoch_callback(parts["phase 2"], "the paper's method"),
        checkpoints,
    )
    return channel, phase1.assessment
