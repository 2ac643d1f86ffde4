"""Results of one direction of the study: predictions on each subset of the data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchid._support.metrics import error_figures, rmse_error
from hitchid._support.precision import double_precision
from hitchid.data.campaign import Campaign
from hitchid.data.record import Record
from hitchid.identification import Identification
from hitchid.model import Channel, remove_padding
from hitchid.studies.sun2025.mechanistic import Mechanistic
from hitchid.validation import Predictions

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

    Args:
        default: the model identified by default.
        paper: the model identified by the paper's method.
        campaign: the tests.
        direction: lifting or lowering.
        mechanistic: model from the rig's parameters, simulated on the same tests.
    """
    ours = _subsets(default, campaign, direction, closed_loop=False)
    theirs = _subsets(paper, campaign, direction, closed_loop=True)
    channel = paper.model.channels[direction]
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
    return Subsets(
        *(
            _predictions(channel, records, closed_loop=closed_loop)
            for records in (
                [record for record in identification if record.name not in validation_names],
                [record for record in identification if record.name in validation_names],
                campaign.held_out(direction),
            )
        )
    )


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
