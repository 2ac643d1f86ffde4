"""One direction from its tests to a channel: benchmark and compensators, with their uncertainty."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import jax.numpy as jnp
import numpy as np

from hitchid._support.checkpoints import DISABLED
from hitchid._support.progress import ProgressCallback, ProgressUpdate, attempt, silent, split_progress
from hitchid.estimation.training import TrainingHistory
from hitchid.identification.config import ChannelConfig
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.held_out import HeldOut, cross_fitted
from hitchid.identification.held_out_training import (
    FEWEST_TESTS,
    CompensatorTraining,
    JudgedCompensator,
    band_notices,
    calibrate_bands,
    judge_compensator,
    with_compensators,
)
from hitchid.identification.load_filter_fit import with_load_filters
from hitchid.identification.mode_test import with_gain
from hitchid.identification.phase1 import Phase1, identify_benchmark
from hitchid.identification.phase2 import CompensatorConfig, epoch_callback, with_compensator
from hitchid.identification.preparation import ChannelData
from hitchid.identification.repeated_choice import repeat_choice
from hitchid.identification.result import ChannelTrace
from hitchid.identification.rivals import quick_rivals
from hitchid.identification.selection import AutoStructure, Candidate, choose_spec
from hitchid.identification.speed_training import HoldoutTest, train_speed_compensator
from hitchid.model import Channel, Characteristics, Uncertainty
from hitchid.model.estimates import MAX_INTERVAL_RATIO, Estimate
from hitchid.networks.operating_range import OperatingRange, SignalRange
from hitchid.structures import Batch
from hitchid.structures.structure import DEAD_TIME
from hitchid.uncertainty import characteristics, information_of, load_scatter
from hitchid.uncertainty.conformal import HeldOutErrors

POOR_FIT = 0.05  # RMSE in free run over the travel, from which on something is not as assumed (chosen)
FEWEST_LOADS = 3  # tests, of which two differences are left beside the gain


@dataclass(frozen=True)
class _Log:
    """Progress, notices and durations of one direction, added to as the work goes on."""

    parts: Mapping[str, ProgressCallback]
    notices: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def tell(self, part: str, doing: str) -> None:
        """Report the start of a part."""
        self.parts[part](ProgressUpdate(doing, 0.0))

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Store the duration of the block, s, under a name."""
        started = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - started


def find_benchmark(
    data: ChannelData, config: ChannelConfig, progress: ProgressCallback
) -> tuple[Channel, ChannelTrace]:
    """Identify the benchmark of one direction (phase 1).

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    log = _Log(split_progress(progress, {"benchmark": 0.85, "speed map": 0.15}), list(data.notices))
    tests, unit = data.all_tests, config.units["x"]
    with log.timed("benchmark"):
        phase1, candidates = _fit_benchmark(data, config, log.parts["benchmark"])
    phase1 = _within_update_interval(phase1, data.update_s)
    travel = float(np.max(np.abs(np.asarray(tests.travel)) * np.asarray(tests.loss_mask)))
    if phase1.rmse > POOR_FIT * travel:
        log.notices.append(
            f"poor fit: the RMSE of {phase1.rmse:.3g} {unit} is {phase1.rmse / travel:.0%} of the travel; "
            "check the logs (hitchid inspect), and say known end stops: "
            "end_stops = [low, high] in campaign.toml"
        )
    log.notices.extend(
        f"{estimate.name.replace('_', ' ')}: {estimate.verdict}"
        for estimate in phase1.parameter_estimates
        if not estimate.determined
    )
    if isinstance(config.spec, AutoStructure) and config.spec.repeats and candidates:
        log.tell("speed map", "repeating the choice of the form")
        with log.timed("repeated choices"):
            repeats = config.spec.repeats
            sentence = attempt("repeated choices", lambda: _repeated(data, config, repeats), log.notices)
        log.notices.extend([sentence] if sentence else [])
    # The form that was chosen may have a smaller dead zone; its shift is part of the error.
    dead_zone = data.dead_zone
    for candidate in candidates:
        if candidate.chosen and candidate.dead_zone != dead_zone.value:
            spread = max(dead_zone.spread or 0.0, abs(candidate.dead_zone - dead_zone.value))
            dead_zone = replace(dead_zone, value=candidate.dead_zone, spread=spread)
    data = data.with_dead_zone(dead_zone)
    channel = data.channel(phase1.benchmark, operating_range_of(data.all_tests, phase1.benchmark.covariates))
    log.tell("speed map", "speed map")
    with log.timed("speed map"):
        operating_characteristics = _characteristics(dead_zone, phase1, config.units, log.notices)
    return channel, ChannelTrace(
        dead_zone=dead_zone,
        phase1=phase1,
        notices=tuple(log.notices),
        candidates=candidates,
        seconds=log.seconds,
        uncertainty=Uncertainty(phase1.assessment, characteristics=operating_characteristics),
        characteristics=operating_characteristics,
    )


def with_calibrated_gain(
    channel: Channel, trace: ChannelTrace, factor: float
) -> tuple[Channel, ChannelTrace]:
    """Return a channel with a factor on its gain, and its trace with it."""
    channel = with_gain(channel, factor)
    assessment = trace.phase1.assessment.scaled(channel.benchmark.structure.gain, factor)
    phase1 = replace(trace.phase1, benchmark=channel.benchmark, assessment=assessment)
    notice = f"the gain was multiplied by {factor:.4f} to make the free-run error on the mixed logs smallest"
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
    """Fit the load filter, train the compensators (phase 2), fit quick rivals, and calibrate the bands.

    What fails leaves a notice.
    """
    initial_data, data, training = data, data.with_dead_zone(trace.dead_zone), config.training
    shares = {  # relative work (measured at default settings)
        "load filter": 0.1,
        "compensator": 0.35 if training else 0.0,
        "free runs": 0.1 if training and training.free_run else 0.0,
        "horizon": 0.3 if training else 0.0,
        "rivals": 0.1 if config.quick_rivals else 0.0,
        "bands": 0.05,
        "information": 0.05,
    }
    parts = split_progress(progress, {name: share for name, share in shares.items() if share})
    log, batch, phase1 = _Log(parts, list(trace.notices), dict(trace.seconds)), data.all_tests, trace.phase1
    held_out = cross_fitted(channel, phase1)
    # First the filter: the compensator predicts its innovations.
    log.tell("load filter", "filter for loads that are not measured")
    with log.timed("load filter"):
        filtered = attempt("load filter", lambda: with_load_filters(channel, held_out, batch), log.notices)
    channel, held_out = filtered or (channel, held_out)
    errors, history, holdout_test = None, None, None
    if training is not None:
        judged, history, holdout_test = _trained(channel, held_out, data, training, config, log)
        channel, held_out, errors = judged.channel, judged.held_out, judged.errors
    # The bands come last: they are calibrated on the channels as they ship, compensators judged and limited.
    rivals = None
    if config.quick_rivals:
        with log.timed("rivals"):
            rivals = quick_rivals(data, initial_data, config, trace.candidates, parts["rivals"])
        log.notices.extend(rivals.notices)
    return channel, replace(
        trace,
        phase2=history,
        holdout_test=holdout_test,
        uncertainty=_uncertainty(channel, held_out, errors, trace, data, log),
        rivals=rivals,
        seconds=log.seconds,
        notices=tuple(log.notices),
    )


def _uncertainty(
    channel: Channel,
    held_out: tuple[HeldOut, ...],
    errors: Mapping[int, HeldOutErrors] | None,
    trace: ChannelTrace,
    data: ChannelData,
    log: _Log,
) -> Uncertainty:
    """Return the bands around predictions, the information of the tests and the scatter of their loads."""
    phase1, batch = trace.phase1, data.all_tests
    objective, position, influence = phase1.fit.objective, phase1.fit.position, phase1.influence
    tests, bands, scatter = batch.command.shape[0], None, None
    log.tell("bands", "bands around predictions")
    with log.timed("bands"):
        if tests >= FEWEST_TESTS:
            bands = attempt(
                "bands around predictions",
                lambda: calibrate_bands(channel, phase1, batch, held_out, errors),
                log.notices,
            )
    log.notices.extend(band_notices(tests) if bands is not None or tests < FEWEST_TESTS else ())
    stage = "information for the design of tests"
    log.tell("information", stage)
    information = attempt(stage, lambda: information_of(objective, position, influence), log.notices)
    if len(data.names) >= FEWEST_LOADS:
        scatter = attempt(
            "scatter of the load between tests",
            lambda: load_scatter(objective, position, influence.free, data.names),
            log.notices,
        )
    return Uncertainty(phase1.assessment, bands, information, trace.characteristics, scatter)


def _trained(
    channel: Channel,
    held_out: tuple[HeldOut, ...],
    data: ChannelData,
    training: CompensatorConfig,
    config: ChannelConfig,
    log: _Log,
) -> tuple[JudgedCompensator, TrainingHistory, HoldoutTest | None]:
    """Return a channel with its compensators, for predictions and for free run, as far as they help."""
    key, stage = config.random_keys(data.direction)[0], "training the correction of predictions"
    log.tell("compensator", stage)
    with log.timed("compensator"):
        channel, history = with_compensator(
            channel,
            data,
            training,
            key,
            epoch_callback(log.parts["compensator"], stage),
            config.checkpoints.child("compensator"),
        )
    holdout_test = None
    if training.free_run is not None:
        log.tell("free runs", "training the correction of free runs")
        with log.timed("compensator for free run"):
            compensator, holdout_test, held_out = train_speed_compensator(
                channel, held_out, data.all_tests, training.free_run, config.seed, config.checkpoints
            )
        channel = replace(channel, speed_compensator=compensator)
        log.notices.append(holdout_test.sentence)
    log.tell("horizon", "how far ahead the correction holds")
    with log.timed("compensator's horizon"):
        how = CompensatorTraining(training, history.best_epoch, key)
        judged = _judged(channel, held_out, data.all_tests, how)
    log.notices.extend(judged.notices)
    return judged, history, holdout_test


def _judged(
    channel: Channel, held_out: Sequence[HeldOut], batch: Batch, training: CompensatorTraining
) -> JudgedCompensator:
    """Return the channel with a compensator that corrects only so far ahead that predictions do not diverge.

    With too few tests to train others without each it is judged on its own tests: they show whether it
    diverges, and no more. A compensator that cannot be judged is not used.
    """

    def judge() -> JudgedCompensator:
        tests = batch.command.shape[0]
        if tests < FEWEST_TESTS:
            return judge_compensator(channel, [HeldOut(np.ones(tests, dtype=bool), channel)], batch)
        return judge_compensator(channel, with_compensators(held_out, batch, training), batch)

    notices: list[str] = []
    judged = attempt(
        "how far ahead the compensator for predictions corrects; the model is without it", judge, notices
    )
    if judged is None:
        return JudgedCompensator(replace(channel, compensator=None), tuple(held_out), None, tuple(notices))
    return judged


def operating_range_of(batch: Batch, covariates: Sequence[str]) -> OperatingRange:
    """Return the ranges of signals in tests, over the samples that count."""
    loss_mask = np.asarray(batch.loss_mask)
    loads = batch.load(covariates)

    def range_of(values: np.ndarray) -> SignalRange:
        return SignalRange(jnp.asarray(float(values.min())), jnp.asarray(float(values.max())))

    return OperatingRange(
        command=range_of(np.abs(np.asarray(batch.command))[loss_mask]),
        displacement=range_of(np.asarray(batch.displacement)[loss_mask]),
        load=SignalRange(loads.min(axis=0), loads.max(axis=0)),
    )


def _characteristics(
    dead_zone: DeadZone, phase1: Phase1, units: Mapping[str, str], notices: list[str]
) -> Characteristics | None:
    """Return the operating characteristics; a notice takes their place where they cannot be computed."""
    if not phase1.influence.free.any():
        return None
    return attempt(
        "speed map, delay and response time",
        lambda: characteristics(
            phase1.fit.objective,
            phase1.fit.position,
            phase1.influence,
            dead_zone=dead_zone.to_quantity(units["u"]),
            dead_zone_error=dead_zone.error,
            units=units,
        ),
        notices,
    )


def _within_update_interval(phase1: Phase1, update_s: float) -> Phase1:
    """Return the fit with a dead time that may be shorter by the interval at which the sensor is updated.

    A reading that is held until the next is late by up to that interval, which the fit takes for dead time.
    It stays determined where that is little beside it.
    """
    if not update_s:
        return phase1

    def widened(estimate: Estimate) -> Estimate:
        if estimate.name != DEAD_TIME.name:
            return estimate
        low, high = estimate.interval
        low = max(estimate.lower, (estimate.value if low is None else low) - update_s)
        if estimate.determined and high is not None and high <= MAX_INTERVAL_RATIO * low:
            return replace(estimate, interval=(low, high))
        reason = f"not determined: the sensor is updated every {update_s:.3g} s, by which it may be shorter"
        return replace(estimate, interval=(low, high), determined=False, verdict=reason)

    parameters = tuple(widened(estimate) for estimate in phase1.assessment.parameters)
    return replace(phase1, assessment=replace(phase1.assessment, parameters=parameters))


def _repeated(data: ChannelData, config: ChannelConfig, repeats: int) -> str:
    """Return how often tests that differ a little give the same form; nothing of it is resumed."""
    quiet = replace(config, checkpoints=DISABLED)

    def choose(batch: Batch) -> Sequence[Candidate]:
        return _fit_benchmark(replace(data, all_tests=batch), quiet, silent)[1]

    return repeat_choice(
        data.all_tests,
        choose,
        repeats,
        dead_zone=data.dead_zone.error,
        unit=config.units["x"],
        seed=config.seed,
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
    phase1 = identify_benchmark(
        batch,
        config.spec,
        config.search,
        config.seed,
        units=config.units,
        dead_zone=data.dead_zone.error,
        progress=progress,
        checkpoints=config.checkpoints,
    )
    return phase1, ()
