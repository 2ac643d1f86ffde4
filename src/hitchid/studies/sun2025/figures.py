"""Figures 5 to 12 of the paper, each with its data."""

from typing import NamedTuple

from hitchid.data.record import LIFTING, LOWERING
from hitchid.report import ChannelTraceFile, Picture, figure_data, figures
from hitchid.report.figures.errors import MAX_SAMPLES
from hitchid.report.trace_file import TracedSearch
from hitchid.studies.sun2025.results import DirectionResult
from hitchid.validation import Predictions

# Numbers of the figures in the paper, by direction.
CONVERGENCE = {LIFTING: 5, LOWERING: 6}
TRAINING = {LIFTING: 7, LOWERING: 8}
DISTRIBUTION = {LIFTING: 9, LOWERING: 10}
TEST = {LIFTING: 11, LOWERING: 12}
MODELS = ("mechanistic", "benchmark", "free_run", "one_step")


class PaperFigure(NamedTuple):
    """A reproduced figure of the paper: its number there and its pictures with their data."""

    number: int
    pictures: tuple[Picture, ...]


def paper_figures(
    direction: str, trace: ChannelTraceFile, result: DirectionResult, unit: str
) -> list[PaperFigure]:
    """Return the four figures of one direction in the paper.

    Args:
        direction: lifting or lowering.
        trace: trace of the identification.
        result: predictions on training, validation and test tests.
        unit: of the displacement.
    """
    return [
        _convergence(direction, trace.phase1, unit),
        _predicted_errors(direction, result, unit),
        _error_distribution(direction, result, unit),
        _test_set(direction, result.test, unit),
    ]


def _convergence(direction: str, search: TracedSearch, unit: str) -> PaperFigure:
    number = CONVERGENCE[direction]
    names = [parameter.name for parameter in search.parameters]
    picture = Picture(
        _name(number),
        figures.convergence(search, unit),
        f"Figure {number} of the paper: convergence of fitness and of each parameter, {direction}.",
        f"Best RMSE and {', '.join(names)} over the iterations of the whale optimisation.",
        data=figure_data.convergence(search, unit),
    )
    return PaperFigure(number, (picture,))


def _predicted_errors(direction: str, result: DirectionResult, unit: str) -> PaperFigure:
    subsets = {"training": result.training, "validation": result.validation}
    number = TRAINING[direction]
    picture = Picture(
        _name(number),
        figures.predicted_errors(subsets, unit),
        f"Figure {number} of the paper: error of the transfer function, actual and predicted one step ahead, "
        f"on training and validation tests, {direction}.",
        f"Actual and predicted error in {unit} over {MAX_SAMPLES} samples.",
        data=figure_data.predicted_errors(subsets, unit, MAX_SAMPLES),
    )
    return PaperFigure(number, (picture,))


def _error_distribution(direction: str, result: DirectionResult, unit: str) -> PaperFigure:
    subsets = {"training": result.training, "validation": result.validation}
    rows = {subset: tests.errors("one_step") for subset, tests in subsets.items()}
    number = DISTRIBUTION[direction]
    picture = Picture(
        _name(number),
        figures.error_distribution(rows, unit),
        f"Figure {number} of the paper: one-step errors on training and validation tests, histogram with "
        f"fitted normal and cumulative distribution, {direction}.",
        f"Distribution of one-step errors in {unit}.",
        data=figure_data.errors(rows, unit),
    )
    return PaperFigure(number, (picture,))


def _test_set(direction: str, test: Predictions, unit: str) -> PaperFigure:
    number = TEST[direction]
    errors = {model: test.errors(model) for model in MODELS[1:]}
    pictures = (
        Picture(
            _name(number),
            figures.outputs(test, unit, MODELS[1:]),
            f"Figure {number} of the paper, upper half: outputs and errors on the test set, {direction}.",
            f"Displacement and error over time on {len(test.names)} unseen tests.",
            data=figure_data.outputs(test, unit, MODELS),
        ),
        Picture(
            f"{_name(number)}-errors",
            figures.error_distribution(errors, unit),
            f"Figure {number} of the paper, lower half: histogram and cumulative distribution of the errors "
            f"on the test set, {direction}.",
            f"Distribution of the errors in {unit} on {len(test.names)} unseen tests.",
            data=figure_data.errors(errors, unit),
        ),
    )
    return PaperFigure(number, pictures)


def _name(number: int) -> str:
    return f"figure-{number:02d}"
