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


@dataclass(frozen=True)
class DirectionResult:
    """One direction of the study.

    Attributes:
        training, validation, test: predictions on the three subsets of the data.
        mechanistic: model from the rig's parameters.
    """

    training: Predictions
    validation: Predictions
    test: Predictions
    mechanistic: Mechanistic


@double_precision
def direction_result(
    identified: Identification, campaign: Campaign, direction: str, mechanistic: Mechanistic
) -> DirectionResult:
    """Simulate one channel of an identified model on the training, validation and test data.

    Args:
        identified: the identified model.
        campaign: the tests.
        direction: lifting or lowering.
        mechanistic: model from the rig's parameters, simulated on the same tests.
    """
    channel = identified.model.channels[direction]
    validation_names = set(identified.model.provenance.validation[direction])
    identification, held_out = campaign.identification(direction), campaign.held_out(direction)
    all_tests = _predictions(channel, mechanistic, [*identification, *held_out])
    count = len(identification)
    validation_indices = [i for i, record in enumerate(identification) if record.name in validation_names]
    return DirectionResult(
        training=all_tests.take([i for i in range(count) if i not in validation_indices]),
        validation=all_tests.take(validation_indices),
        test=all_tests.take(range(count, count + len(held_out))),
        mechanistic=mechanistic,
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
    first = 1 if model == "one_step" else 0
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


def _predictions(channel: Channel, mechanistic: Mechanistic, records: Sequence[Record]) -> Predictions:
    batch = channel.batch(records)
    unfitted = replace(channel, benchmark=mechanistic.physical_model, dead_zone=mechanistic.dead_zone)

    def rows(padded: object) -> tuple[np.ndarray, ...]:
        return tuple(remove_padding(np.asarray(padded), records))

    return Predictions(
        names=tuple(record.name for record in records),
        time_s=tuple(record.step_s * np.arange(len(record)) for record in records),
        actual=tuple(record.displacement for record in records),
        models={
            "benchmark": rows(channel.simulate_benchmark(batch)),
            "one_step": rows(channel.predict(batch, (1,))[0]),
            "free_run": rows(channel.simulate(batch)),
            "mechanistic": rows(unfitted.simulate_benchmark(unfitted.batch(records))),
        },
    )
