"""One direction from its tests to a channel: benchmark, compensators, and the baselines beside them."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key, PRNGKeyArray

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.progress import (
    TYPICAL_ITERATIONS,
    IterationCallback,
    ProgressCallback,
    ProgressUpdate,
    iteration_progress,
    subtask_progress,
)
from hitchid.baselines.black_box import BlackBox
from hitchid.data.record import DIRECTIONS
from hitchid.estimation import Objective, Search, SearchComparison, SearchHistory, compare_searches
from hitchid.identification.band_calibration import calibrate_bands
from hitchid.identification.baselines import fit_arx, fit_black_box
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.gain_calibration import with_gain
from hitchid.identification.narx import fit_narx
from hitchid.identification.optional import attempt
from hitchid.identification.phase1 import Phase1, identify_benchmark
from hitchid.identification.phase2 import CompensatorConfig, train_compensator
from hitchid.identification.preparation import ChannelData
from hitchid.identification.rollouts import HoldoutTest, train_on_rollouts
from hitchid.identification.selection import AutoStructure, Candidate, choose_spec
from hitchid.identification.training import TrainingHistory
from hitchid.model import Channel
from hitchid.networks.operating_range import OperatingRange, SignalRange
from hitchid.structures import Batch, ModelSpec
from hitchid.uncertainty import Characteristics, Estimates, Information, Uncertainty, characteristics


@dataclass(frozen=True)
class ChannelTrace:
    """How one direction was identified.

    Attributes:
        dead_zone: the dead zone and where it came from.
        phase1: benchmark, parameters, search.
        phase2: losses of the training of the compensator for predictions; None where none was trained.
        holdout_test: what decided on the compensator for free run; None where none was trained.
        notices: what the user should know of the data and of the choices made for them.
        candidates: the forms that were compared, where the form was chosen automatically.
        seconds: what was fitted to the time it took, s.
        uncertainty: how far the channel can be trusted.
        characteristics: speed map, dead zone, delay and response time; None where there are none.
    """

    dead_zone: DeadZone
    phase1: Phase1
    phase2: TrainingHistory | None = None
    holdout_test: HoldoutTest | None = None
    notices: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    uncertainty: Uncertainty | None = None
    characteristics: Characteristics | None = None


@dataclass(frozen=True)
class ChannelConfig:
    """What is asked of one direction.

    Attributes:
        spec: of its benchmark, or how it is chosen.
        paper_spec: the paper's form, for the paper's method beside it.
        search: of phase 1.
        training: of phase 2; None for the benchmark alone.
        seed: every random draw comes from it.
        units: `x` and `u` to the units of displacement and command.
        comparison: how searches are compared; None compares none.
        checkpoints: where what is found is kept and found again.
    """

    spec: ModelSpec | AutoStructure
    paper_spec: ModelSpec
    search: Search
    training: CompensatorConfig | None
    seed: int
    units: Mapping[str, str]
    comparison: SearchComparison | None = None
    checkpoints: Checkpoints = DISABLED

    @property
    def search_spec(self) -> ModelSpec:
        """The form that searches are compared on: what is asked for, or what a choice starts from."""
        return self.spec.baseline_spec if isinstance(self.spec, AutoStructure) else self.spec


def find_benchmark(
    data: ChannelData, config: ChannelConfig, progress: ProgressCallback
) -> tuple[Channel, ChannelTrace]:
    """Carry out phase 1 for one direction.

    Args:
        data: its tests.
        config: what is asked for.
        progress: called with what is being done and the fraction that is done.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    seconds: dict[str, float] = {}
    progress(ProgressUpdate(f"phase 1, {config.search.name}", 0.02))
    with _timed(seconds, "benchmark"):
        phase1, candidates = _fit_benchmark(data, config, subtask_progress(progress, 0.02, 0.98))
    data = data.with_dead_zone(_revised_dead_zone(data.dead_zone, candidates))
    channel = replace(_benchmark_channel(data, phase1), envelope=operating_range_of(data.all_tests))
    with _timed(seconds, "speed map"):
        operating_characteristics, characteristics_notices = _characteristics(
            data.dead_zone, phase1, config.units
        )
    trace = ChannelTrace(
        dead_zone=data.dead_zone,
        phase1=phase1,
        notices=(*data.notices, *_undetermined_notices(phase1), *characteristics_notices),
        candidates=candidates,
        seconds=seconds,
        characteristics=operating_characteristics,
    )
    return channel, trace


def with_calibrated_gain(
    channel: Channel, trace: ChannelTrace, factor: float
) -> tuple[Channel, ChannelTrace]:
    """Return a channel with a factor on its gain, and its trace with it."""
    channel = with_gain(channel, factor)
    assessment = trace.phase1.assessment.scaled(channel.benchmark.structure.gain, factor)
    phase1 = replace(trace.phase1, benchmark=channel.benchmark, assessment=assessment)
    notice = f"gain times {factor:.4f}, so that whole mixed logs agree best in free run"
    scaled_characteristics = trace.characteristics and trace.characteristics.scaled(factor)
    return channel, replace(
        trace, phase1=phase1, notices=(*trace.notices, notice), characteristics=scaled_characteristics
    )


def find_compensators(
    channel: Channel,
    trace: ChannelTrace,
    data: ChannelData,
    config: ChannelConfig,
    progress: ProgressCallback,
) -> tuple[Channel, ChannelTrace]:
    """Carry out phase 2 for one direction, and fit the baselines.

    Args:
        channel, trace: of phase 1.
        data, config, progress: as for `find_benchmark`.
    """
    seconds, initial_data, data = dict(trace.seconds), data, data.with_dead_zone(trace.dead_zone)
    if config.training is None:
        return channel, _with_uncertainty(channel, trace, data, config, None, seconds)
    keys = jax.random.split(
        jax.random.fold_in(jax.random.key(config.seed), DIRECTIONS.index(data.direction)), 4
    )
    with _timed(seconds, "compensator"):
        channel, training_history = _with_compensator(
            channel,
            data,
            config.training,
            keys[0],
            _epoch_callback(progress, "phase 2", 0.2, 0.3),
            config.checkpoints.child("compensator"),
        )
    trace = replace(trace, phase2=training_history)
    if config.training.rollouts is not None:
        progress(ProgressUpdate("free runs", 0.5))
        with _timed(seconds, "compensator for free run"):
            travel = channel.benchmark.travel(data.all_tests)
            assert channel.envelope is not None  # noqa: S101 - given above
            speed_compensator, holdout_test = train_on_rollouts(
                data.all_tests,
                travel,
                channel.envelope,
                config.training.rollouts,
                keys[1],
                config.checkpoints,
            )
        channel = replace(channel, speed_compensator=speed_compensator)
        trace = replace(trace, holdout_test=holdout_test, notices=(*trace.notices, holdout_test.sentence))
    notices: list[str] = []
    paper_assessment = None
    if config.training.baselines:
        channel, paper_assessment = _with_baselines(
            channel, data, initial_data, config, keys[2:], progress, seconds, notices
        )
    trace = replace(trace, notices=(*trace.notices, *notices))
    return channel, _with_uncertainty(channel, trace, data, config, paper_assessment, seconds)


def _with_uncertainty(
    channel: Channel,
    trace: ChannelTrace,
    data: ChannelData,
    config: ChannelConfig,
    paper_assessment: Estimates | None,
    seconds: dict[str, float],
) -> ChannelTrace:
    notices: list[str] = []
    histories: tuple[SearchHistory, ...] = ()
    comparison = config.comparison
    if comparison is not None:
        with _timed(seconds, "searches compared"):
            objective = Objective.of(data.all_tests, config.search_spec)
            compared = attempt(
                "comparison of searches",
                lambda: compare_searches(objective, comparison, config.seed),
                notices,
            )
            histories = compared or ()
    with _timed(seconds, "bands"):
        bands = attempt(
            "bands around predictions",
            lambda: calibrate_bands(channel, trace.phase1, data.all_tests, data.validation),
            notices,
        )
    parameter_names = (
        tuple(parameter.name for parameter in config.search_spec.parameters) if histories else ()
    )
    fit = trace.phase1.fit
    information = attempt(
        "information for the design of tests",
        lambda: Information.of(fit.objective, fit.position, trace.phase1.influence),
        notices,
    )
    uncertainty = Uncertainty(
        trace.phase1.assessment,
        paper_assessment,
        bands,
        histories,
        parameter_names,
        information,
        trace.characteristics,
    )
    return replace(trace, uncertainty=uncertainty, seconds=seconds, notices=(*trace.notices, *notices))


def operating_range_of(batch: Batch) -> OperatingRange:
    """Return the ranges that tests cover, over the samples that count."""
    loss_mask = np.asarray(batch.loss_mask)

    def range_of(values: np.ndarray) -> SignalRange:
        return SignalRange(jnp.asarray(float(values.min())), jnp.asarray(float(values.max())))

    return OperatingRange(
        command=range_of(np.abs(np.asarray(batch.command))[loss_mask]),
        displacement=range_of(np.asarray(batch.displacement)[loss_mask]),
        load=range_of(np.asarray(batch.covariate)),
    )


def _characteristics(
    dead_zone: DeadZone, phase1: Phase1, units: Mapping[str, str]
) -> tuple[Characteristics | None, list[str]]:
    """Return the operating characteristics; a notice takes their place where they cannot be computed."""
    notices: list[str] = []
    influence = phase1.influence
    if not influence.free.any():
        return None, notices
    result = attempt(
        "speed map, delay and response time",
        lambda: characteristics(
            phase1.fit.objective,
            phase1.fit.position,
            influence,
            dead_zone=dead_zone.to_quantity(units["u"]),
            dead_zone_error=dead_zone.error,
            units=units,
        ),
        notices,
    )
    return result, notices


def _undetermined_notices(phase1: Phase1) -> list[str]:
    """Return what the tests say of each parameter that they do not determine."""
    return [
        f"{estimate.name.replace('_', ' ')}: {estimate.verdict}"
        for estimate in phase1.parameter_estimates
        if not estimate.determined
    ]


def _benchmark_channel(data: ChannelData, phase1: Phase1) -> Channel:
    return Channel(
        direction=data.direction,
        sign=data.sign,
        dead_zone=data.dead_zone.value,
        end_stop=data.end_stop,
        benchmark=phase1.benchmark,
    )


def _fit_benchmark(
    data: ChannelData, config: ChannelConfig, progress: ProgressCallback
) -> tuple[Phase1, tuple[Candidate, ...]]:
    batch, from_ramps = data.all_tests, data.dead_zone.origin == "ramps"
    if isinstance(config.spec, AutoStructure):
        return choose_spec(
            batch,
            config.spec,
            config.search,
            config.seed,
            units=config.units,
            opening_known=from_ramps,
            revised=data.dead_zone.origin == "tests" and data.dead_zone.value > 0,
            dead_zone=data.dead_zone.error,
            progress=progress,
            checkpoints=config.checkpoints,
        )
    error = f"RMSE / {config.units['x']}"
    callback = iteration_progress(progress, f"phase 1, {config.search.name}", 0.0, 0.9, error)
    return _identify_spec(data, config, config.spec, config.checkpoints, callback), ()


def _revised_dead_zone(dead_zone: DeadZone, candidates: Iterable[Candidate]) -> DeadZone:
    """Return the dead zone behind which the form taken was fitted; how far it moved is part of its error."""
    selected = next((candidate for candidate in candidates if candidate.chosen), None)
    if selected is None or selected.dead_zone == dead_zone.value:
        return dead_zone
    shift = abs(selected.dead_zone - dead_zone.value)
    return replace(dead_zone, value=selected.dead_zone, spread=max(dead_zone.spread or 0.0, shift))


def _identify_spec(
    data: ChannelData,
    config: ChannelConfig,
    spec: ModelSpec,
    checkpoints: Checkpoints,
    callback: IterationCallback | None = None,
) -> Phase1:
    return identify_benchmark(
        data.all_tests,
        spec,
        config.search,
        config.seed,
        units=config.units,
        dead_zone=data.dead_zone.error,
        callback=callback,
        checkpoints=checkpoints,
    )


def _with_compensator(
    channel: Channel,
    data: ChannelData,
    training: CompensatorConfig,
    key: PRNGKeyArray,
    progress: Callable,
    checkpoints: Checkpoints,
) -> tuple[Channel, TrainingHistory]:
    compensator, training_history = train_compensator(
        (data.training, channel.simulate_benchmark(data.training)),
        (data.validation, channel.simulate_benchmark(data.validation)),
        training,
        key,
        progress,
        checkpoints,
    )
    return replace(channel, compensator=compensator), training_history


def _with_baselines(
    channel: Channel,
    data: ChannelData,
    initial_data: ChannelData,
    config: ChannelConfig,
    keys: Key[Array, " k"],
    progress: ProgressCallback,
    seconds: dict[str, float],
    notices: list[str],
) -> tuple[Channel, Estimates | None]:
    training = config.training
    assert training is not None  # noqa: S101 - baselines are fitted beside a compensator

    def black_box() -> BlackBox:
        return fit_black_box(
            data.training,
            data.validation,
            hidden=training.hidden,
            adam=training.adam,
            key=keys[0],
            progress=_epoch_callback(progress, "black-box baseline", 0.6, 0.2),
            checkpoints=config.checkpoints.child("black box"),
        )

    def fit_paper_method() -> tuple[Channel, Phase1]:
        checkpoints = config.checkpoints.child("paper")
        # Its valve is linear: it keeps the dead zone that was found with a linear valve.
        phase1 = _identify_spec(initial_data, config, config.paper_spec, checkpoints)
        benchmark_channel = _benchmark_channel(initial_data, phase1)
        report_epoch = _epoch_callback(progress, "paper's method", 0.8, 0.2)
        return _with_compensator(
            benchmark_channel, initial_data, training, keys[1], report_epoch, checkpoints
        )[0], phase1

    with _timed(seconds, "ARX"):
        arx = attempt("ARX", lambda: fit_arx(data.training, data.validation), notices)
    with _timed(seconds, "NARX"):
        narx = attempt("NARX", lambda: fit_narx(data.training, data.validation), notices)
    with _timed(seconds, "black-box LSTM"):
        lstm = attempt("black-box LSTM", black_box, notices)
    channel = replace(channel, arx=arx, narx=narx, black_box=lstm)
    if config.spec == config.paper_spec:
        return channel, None
    with _timed(seconds, "paper's method"):
        paper_result = attempt("the paper's method", fit_paper_method, notices)
    if paper_result is None:
        return channel, None
    paper, phase1 = paper_result
    return replace(channel, paper=paper), phase1.assessment


def _epoch_callback(
    progress: ProgressCallback, stage: str, start: float, width: float
) -> Callable[[int, float, float], None]:
    """Return what shows an epoch; a training stops early, so its length is not known before."""

    def show(number: int, training_loss: float, validation_loss: float) -> None:
        done = start + width * number / (number + TYPICAL_ITERATIONS)
        figures = {"training loss": training_loss, "validation loss": validation_loss}
        progress(ProgressUpdate(stage, done, f"epoch {number}", figures))

    return show


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - started
