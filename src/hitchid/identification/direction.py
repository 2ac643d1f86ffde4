"""One direction from its tests to a channel: benchmark and compensators, with their uncertainty."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from hitchid._support.progress import ProgressCallback, ProgressUpdate, attempt, split_progress
from hitchid.identification.channel_trace import ChannelConfig, ChannelTrace, timed
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
from hitchid.identification.phase2 import epoch_callback, with_compensator
from hitchid.identification.preparation import ChannelData
from hitchid.identification.rivals import quick_rivals
from hitchid.identification.selection import AutoStructure, Candidate, choose_spec
from hitchid.identification.speed_training import train_speed_compensator
from hitchid.logs.record import DIRECTIONS
from hitchid.model import Bands, Channel, Characteristics, Uncertainty
from hitchid.model.estimates import MAX_INTERVAL_RATIO, Estimate
from hitchid.networks.operating_range import OperatingRange, SignalRange
from hitchid.structures import Batch
from hitchid.structures.structure import DEAD_TIME
from hitchid.uncertainty import characteristics, information_of, load_scatter
from hitchid.uncertainty.conformal import HeldOutErrors

POOR_FIT = 0.05  # RMSE in free run over the travel, from which on something is not as assumed (chosen)
FEWEST_LOADS = 3  # tests, of which two differences are left beside the gain


def find_benchmark(
    data: ChannelData, config: ChannelConfig, progress: ProgressCallback
) -> tuple[Channel, ChannelTrace]:
    """Identify the benchmark of one direction (phase 1).

    Args:
        data: its tests.
        config: settings.
        progress: called with what is being done and the fraction that is done.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    seconds: dict[str, float] = {}
    parts = split_progress(progress, {"benchmark": 0.85, "speed map": 0.15})
    with timed(seconds, "benchmark"):
        phase1, candidates = _fit_benchmark(data, config, parts["benchmark"])
    phase1 = _within_update_interval(phase1, data.update_s)
    data = data.with_dead_zone(_revised_dead_zone(data.dead_zone, candidates))
    channel = data.channel(phase1.benchmark, operating_range_of(data.all_tests, phase1.benchmark.covariates))
    parts["speed map"](ProgressUpdate("speed map", 0.0))
    with timed(seconds, "speed map"):
        operating_characteristics, characteristics_notices = _characteristics(
            data.dead_zone, phase1, config.units
        )
    trace = ChannelTrace(
        dead_zone=data.dead_zone,
        phase1=phase1,
        notices=(
            *data.notices,
            *_poor_fit_notices(phase1, data.all_tests, config.units["x"]),
            *_undetermined_notices(phase1),
            *characteristics_notices,
        ),
        candidates=candidates,
        seconds=seconds,
        uncertainty=Uncertainty(phase1.assessment, characteristics=operating_characteristics),
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
    """Train the compensators of one direction (phase 2), and fit the rivals that cost little.

    Args:
        channel, trace: of phase 1.
        data, config, progress: as for `find_benchmark`.
    """
    seconds, initial_data, data = dict(trace.seconds), data, data.with_dead_zone(trace.dead_zone)
    parts = split_progress(progress, _phase2_shares(config))
    held_out, filter_notices = cross_fitted(channel, trace.phase1), []
    parts["load filter"](ProgressUpdate("filter for loads that are not measured", 0.0))
    with timed(seconds, "load filter"):
        filtered = attempt(
            "load filter", lambda: with_load_filters(channel, held_out, data.all_tests), filter_notices
        )
    channel, held_out = filtered or (channel, held_out)
    trace = replace(trace, notices=(*trace.notices, *filter_notices))
    if config.training is None:
        calibrate = partial(_bands, channel, trace.phase1, data.all_tests, held_out)
        return channel, _finished(trace, data, initial_data, config, calibrate, seconds, parts)
    keys = jax.random.split(
        jax.random.fold_in(jax.random.key(config.seed), DIRECTIONS.index(data.direction)), 4
    )
    stage = "training the correction of predictions"
    parts["compensator"](ProgressUpdate(stage, 0.0))
    with timed(seconds, "compensator"):
        channel, training_history = with_compensator(
            channel,
            data,
            config.training,
            keys[0],
            epoch_callback(parts["compensator"], stage),
            config.checkpoints.child("compensator"),
        )
    trace = replace(trace, phase2=training_history)
    if config.training.free_run is not None:
        parts["free runs"](ProgressUpdate("training the correction of free runs", 0.0))
        with timed(seconds, "compensator for free run"):
            judged = train_speed_compensator(
                channel,
                held_out,
                data.all_tests,
                config.training.free_run,
                config.seed,
                config.checkpoints,
            )
        channel, held_out = replace(channel, speed_compensator=judged.compensator), judged.held_out
        notices = (*trace.notices, judged.holdout_test.sentence)
        trace = replace(trace, holdout_test=judged.holdout_test, notices=notices)
    compensator_training = CompensatorTraining(config.training, training_history.best_epoch, keys[0])
    parts["horizon"](ProgressUpdate("how far ahead the correction holds", 0.0))
    with timed(seconds, "compensator's horizon"):
        judged = _judged(channel, held_out, data.all_tests, compensator_training)
    channel, held_out = judged.channel, judged.held_out
    trace = replace(trace, notices=(*trace.notices, *judged.notices))
    calibrate = partial(_bands, channel, trace.phase1, data.all_tests, held_out, judged.errors)
    return channel, _finished(trace, data, initial_data, config, calibrate, seconds, parts)


def _phase2_shares(config: ChannelConfig) -> dict[str, float]:
    """Return the parts of phase 2 with their relative work (measured at default settings)."""
    training = config.training
    parts = {
        "load filter": 0.1,
        "compensator": 0.35 if training else 0.0,
        "free runs": 0.1 if training and training.free_run else 0.0,
        "horizon": 0.3 if training else 0.0,
        "rivals": 0.1 if config.quick_rivals else 0.0,
        "bands": 0.05,
        "information": 0.05,
    }
    return {name: share for name, share in parts.items() if share}


def _finished(
    trace: ChannelTrace,
    data: ChannelData,
    initial_data: ChannelData,
    config: ChannelConfig,
    calibrate: Callable[[], Bands | None],
    seconds: dict[str, float],
    parts: Mapping[str, ProgressCallback],
) -> ChannelTrace:
    """Return the trace with quick rivals, bands and information; what fails leaves a notice."""
    notices: list[str] = []
    rivals = None
    if config.quick_rivals:
        with timed(seconds, "rivals"):
            rivals = quick_rivals(data, initial_data, config, trace.candidates, parts["rivals"])
        notices += rivals.notices
    parts["bands"](ProgressUpdate("bands around predictions", 0.0))
    with timed(seconds, "bands"):
        bands = attempt("bands around predictions", calibrate, notices)
    notices += band_notices(data.all_tests.command.shape[0])
    parts["information"](ProgressUpdate("information for the design of tests", 0.0))
    fit = trace.phase1.fit
    information = attempt(
        "information for the design of tests",
        lambda: information_of(fit.objective, fit.position, trace.phase1.influence),
        notices,
    )
    scatter = None
    if len(data.names) >= FEWEST_LOADS:
        scatter = attempt(
            "scatter of the load between tests",
            lambda: load_scatter(fit.objective, fit.position, trace.phase1.influence.free, data.names),
            notices,
        )
    uncertainty = Uncertainty(trace.phase1.assessment, bands, information, trace.characteristics, scatter)
    return replace(
        trace,
        uncertainty=uncertainty,
        rivals=rivals,
        seconds=seconds,
        notices=(*trace.notices, *notices),
    )


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


def _bands(
    channel: Channel,
    phase1: Phase1,
    batch: Batch,
    held_out: Sequence[HeldOut],
    predicted: Mapping[int, HeldOutErrors] | None = None,
) -> Bands | None:
    """Return the bands of a channel; None where there are too few tests."""
    if batch.command.shape[0] < FEWEST_TESTS:
        return None
    return calibrate_bands(channel, phase1, batch, held_out, predicted)


def operating_range_of(batch: Batch, covariates: Sequence[str]) -> OperatingRange:
    """Return the ranges of signals in tests, over the samples that count.

    Args:
        batch: the tests.
        covariates: names of those that the model uses.
    """
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


def _poor_fit_notices(phase1: Phase1, tests: Batch, unit: str) -> list[str]:
    """Return what to look for where the error is a large share of the travel."""
    travel = float(np.max(np.abs(np.asarray(tests.travel)) * np.asarray(tests.loss_mask)))
    if not phase1.rmse > POOR_FIT * travel:
        return []
    return [
        f"poor fit: the RMSE of {phase1.rmse:.3g} {unit} is {phase1.rmse / travel:.0%} of the travel; check "
        "the logs (hitchid inspect), and say known end stops: end_stops = [low, high] in campaign.toml"
    ]


def _undetermined_notices(phase1: Phase1) -> list[str]:
    """Return the verdict on each parameter that the tests do not determine."""
    return [
        f"{estimate.name.replace('_', ' ')}: {estimate.verdict}"
        for estimate in phase1.parameter_estimates
        if not estimate.determined
    ]


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


def _revised_dead_zone(dead_zone: DeadZone, candidates: Iterable[Candidate]) -> DeadZone:
    """Return the dead zone of the structure chosen; its shift is part of its error."""
    selected = next((candidate for candidate in candidates if candidate.chosen), None)
    if selected is None or selected.dead_zone == dead_zone.value:
        return dead_zone
    shift = abs(selected.dead_zone - dead_zone.value)
    return replace(dead_zone, value=selected.dead_zone, spread=max(dead_zone.spread or 0.0, shift))
