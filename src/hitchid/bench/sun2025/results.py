"""Results of one direction of the study: predictions on each subset of the data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hitchid._support.metrics import error_figures, rmse_error
from hitchid._support.precision import double_precision
from hitchid.bench.excitation import HIGH, LOW
from hitchid.bench.parameter_files import load_rig
from hitchid.bench.plant import Rig, rig_limits
from hitchid.bench.small_signal import OperatingPoint, SmallSignal, lowering_small_signal, small_signal
from hitchid.bench.virtual_campaign import DYNAMIC_S, STROKE_FRACTION
from hitchid.identification import Identification
from hitchid.logs import LIFTING, Campaign, Record
from hitchid.model import Channel, remove_padding
from hitchid.structures import PhysicalModel, structure_named
from hitchid.validation import Predictions

# Mechanistic model from data sheets and mechanics, without fitted parameters.

STRUCTURE = "integrator-second-order"
STEPS = 6  # of Newton's method; chosen, enough for convergence


class Mechanistic(NamedTuple):
    """Transfer function of one direction, in mm and A, and the dead zone before it, in A."""

    physical_model: PhysicalModel
    dead_zone: float


@double_precision
def mechanistic(rig: str | Path | Rig, direction: str) -> Mechanistic:
    """Return the transfer function of one direction computed from a rig's parameters alone.

    K/(s (s²/ωh² + 2 ξh s/ωh + 1)), in mm, s and A; ωh and ξh by `small_signal`, for lowering, where gravity
    drives the oil through the throttle, by `lowering_small_signal`. The operating point is the mean one of
    the tests of `virtual_campaign`: speed v₀ at the mean level, where the highest level covers 0.6 of the
    stroke in 10 s, and the middle of that travel, 5 s · v₀ from the start. The command is effective above the
    dead zone, so the gain is the secant of speed over current from the dead zone to that point, not the slope
    there; v(u₀) = v₀ is solved by Newton's method with that slope:

        K = v₀/u₀,  u₀ = current − dead zone,  dead zone = overlap + half the hysteresis (a rising current)

    The lags of solenoid, spool and pressure compensator are neglected. Sun et al. 2025 cite
    such a model in their discussion (their ref. 9).

    Args:
        rig: parameter set of the virtual test bench, or the rig itself.
        direction: lifting or lowering.

    Raises:
        SettingsError: the rig's parameters cannot be used.
    """
    bench = rig if isinstance(rig, Rig) else load_rig(rig)
    limits, lifting = rig_limits(bench), direction == LIFTING
    spool = bench.lifting_valve.spool if lifting else bench.lowering_valve.spool
    mean_level = float(np.mean(LOW + HIGH))
    travel = mean_level * STROKE_FRACTION * limits.stroke_m
    # The middle of a test's way: lifting begins at the bottom, lowering at the top.
    displacement = 0.5 * travel if lifting else limits.stroke_m - 0.5 * travel

    def linearise(effective: float) -> SmallSignal:
        point = OperatingPoint(displacement, float(spool.dead_zone) + effective)
        return small_signal(bench, point) if lifting else lowering_small_signal(bench, point)

    wide_open = float(spool.saturation - spool.dead_zone)
    effective = 0.5 * wide_open
    for _ in range(STEPS):  # speed is convex in the current: from the second, iterates are above
        linear_model = linearise(effective)
        # Never beyond the stop, where the speed does not rise and a step would lead anywhere.
        effective = min(
            effective + (1e3 * travel / DYNAMIC_S - linear_model.speed) / linear_model.gain, wide_open
        )
    linear_model = linearise(effective)
    values = jnp.asarray(
        [linear_model.speed / effective, linear_model.natural_frequency, linear_model.damping_ratio]
    )
    return Mechanistic(
        PhysicalModel(structure_named(STRUCTURE), values, jnp.asarray(0.0)),
        limits.lifting_dead_zone_a if lifting else limits.lowering_dead_zone_a,
    )


ONE_STEP = ("one_step", "paper_one_step")


@dataclass(frozen=True)
class Subsets:
    """Predictions of one method on the three subsets of the data."""

    training: Predictions
    validation: Predictions
    test: Predictions


@dataclass(frozen=True)
class DirectionResult:
    """One direction of the study.

    Attributes:
        default: `benchmark`, `one_step` and `free_run` of the model that `identify` finds by default.
        paper: the same of the paper's method: transfer function, and its compensator one step ahead and, in
            free run, on its own predictions.
        test: all models on the test data: `one_step`, `free_run` of the default; `transfer_function`,
            `paper_one_step` and `paper` of the paper's method; `mechanistic`.
        mechanistic: model from the rig's parameters.
    """

    default: Subsets
    paper: Subsets
    test: Predictions
    mechanistic: Mechanistic


@double_precision
def direction_result(
    default: Identification,
    paper: Identification,
    campaign: Campaign,
    direction: str,
    mechanistic: Mechanistic,
) -> DirectionResult:
    """Simulate one channel of both identified models on the training, validation and test data.

    The mechanistic model, from the rig's parameters, is simulated on the same test data.
    """
    ours = _subsets(default, campaign, direction, closed_loop=False)
    theirs = _subsets(paper, campaign, direction, closed_loop=True)
    channel = paper.model.channels[direction]
    # In the channel of the paper's method, so that batches and units are the same.
    unfitted = replace(channel, benchmark=mechanistic.physical_model, dead_zone=mechanistic.dead_zone)
    held_out = campaign.held_out(direction)
    test = replace(
        ours.test,
        models={
            "mechanistic": _rows(unfitted.simulate_benchmark(unfitted.batch(held_out)), held_out),
            "transfer_function": theirs.test.models["benchmark"],
            "paper_one_step": theirs.test.models["one_step"],
            "paper": theirs.test.models["free_run"],
            "one_step": ours.test.models["one_step"],
            "free_run": ours.test.models["free_run"],
        },
    )
    return DirectionResult(ours, theirs, test, mechanistic)


def _subsets(identified: Identification, campaign: Campaign, direction: str, *, closed_loop: bool) -> Subsets:
    channel = identified.model.channels[direction]
    validation_names = set(identified.model.provenance.validation[direction])
    identification = campaign.identification(direction)
    parts = (
        [record for record in identification if record.name not in validation_names],
        [record for record in identification if record.name in validation_names],
        campaign.held_out(direction),
    )
    return Subsets(*(_predictions(channel, records, closed_loop=closed_loop) for records in parts))


@dataclass(frozen=True)
class ErrorSummary:
    """Errors as in the paper's Tables 3 and 4, in mm, R² and `within_1` as fractions.

    Attributes:
        rmse, mae, r2, within_1: as in `RunFigures`.
        mean, std: mean and standard deviation of measured minus predicted.
        rmse_error: standard error of the RMSE over tests; None for one test.
    """

    rmse: float
    mae: float
    r2: float
    within_1: float
    mean: float
    std: float
    rmse_error: float | None = None


def summary(predictions: Predictions, model: str) -> ErrorSummary:
    """Return the errors of one model.

    One step ahead, the first sample of a test is left out: it is the initial value.
    """
    first = 1 if model in ONE_STEP else 0
    actual = [row[first:] for row in predictions.actual]
    predicted = [row[first:] for row in predictions.models[model]]
    figures = error_figures(actual, predicted)
    errors = np.concatenate([a - p for a, p in zip(actual, predicted, strict=True)])
    return ErrorSummary(
        rmse=figures.rmse,
        mae=figures.mae,
        r2=figures.r2,
        within_1=figures.within_1,
        mean=float(errors.mean()),
        std=float(errors.std()),
        rmse_error=rmse_error(actual, predicted),
    )


def end_deviation(predictions: Predictions, model: str) -> float:
    """Return the mean over tests of the final error relative to the travel, |y − ŷ|/|y − y(0)|."""
    pairs = zip(predictions.actual, predictions.models[model], strict=True)
    return float(np.mean([abs(a[-1] - p[-1]) / abs(a[-1] - a[0]) for a, p in pairs]))


def _predictions(channel: Channel, records: Sequence[Record], *, closed_loop: bool) -> Predictions:
    batch = channel.batch(records)
    free_run = channel.simulate_closed_loop(batch) if closed_loop else channel.simulate(batch)
    return Predictions(
        names=tuple(record.name for record in records),
        time_s=tuple(record.step_s * np.arange(len(record)) for record in records),
        actual=tuple(record.displacement for record in records),
        models={
            "benchmark": _rows(channel.simulate_benchmark(batch), records),
            "one_step": _rows(channel.predict(batch, (1,))[0], records),
            "free_run": _rows(free_run, records),
        },
    )


def _rows(padded: object, records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    return tuple(remove_padding(np.asarray(padded), records))
