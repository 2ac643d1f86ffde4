"""Figures 5 to 12 of the paper, each with its data."""

from collections.abc import Mapping
from typing import NamedTuple

from hitchid.bench.sun2025.results import DirectionResult, Subsets
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model.trace import TracedSearch
from hitchid.report import ChannelTraceFile, Picture, figures
from hitchid.report.figures.errors import MAX_SAMPLES
from hitchid.validation import Predictions

# Numbers of the figures in the paper, by direction.
CONVERGENCE = {LIFTING: 5, LOWERING: 6}
TRAINING = {LIFTING: 7, LOWERING: 8}
DISTRIBUTION = {LIFTING: 9, LOWERING: 10}
TEST = {LIFTING: 11, LOWERING: 12}
PAPER, DEFAULT = "the paper's method", "hitchid's default"
MODELS = ("mechanistic", "transfer_function", "paper_one_step", "paper", "one_step", "free_run")
DRAWN = ("transfer_function", "paper", "free_run", "one_step")


class PaperFigure(NamedTuple):
    """A reproduced figure of the paper: its number there and its pictures with their data."""

    number: int
    pictures: tuple[Picture, ...]


def paper_figures(
    direction: str,
    default: ChannelTraceFile,
    paper: ChannelTraceFile,
    result: DirectionResult,
    unit: str,
) -> list[PaperFigure]:
    """Return the four figures of one direction in the paper, each for both methods.

    Args:
        direction: lifting or lowering.
        default, paper: traces of the two identifications.
        result: predictions on training, validation and test tests.
        unit: of the displacement.
    """
    return [
        _convergence(direction, {PAPER: paper.phase1, DEFAULT: default.phase1}, unit),
        _predicted_errors(direction, {PAPER: result.paper, DEFAULT: result.default}, unit),
        _error_distribution(direction, result, unit),
        _test_set(direction, result.test, unit),
    ]


def _convergence(direction: str, searches: Mapping[str, TracedSearch], unit: str) -> PaperFigure:
    number = CONVERGENCE[direction]
    pictures = []
    for method, search in searches.items():
        names = [parameter.name for parameter in search.parameters]
        pictures.append(
            figures.convergence(
                _name(number, method),
                search,
                unit,
                f"Figure {number} of the paper: convergence of fitness and of each parameter, {direction}, "
                f"{method}.",
                f"Best RMSE and {', '.join(names)} over the iterations of the global search.",
            )
        )
    return PaperFigure(number, tuple(pictures))


def _predicted_errors(direction: str, results: Mapping[str, Subsets], unit: str) -> PaperFigure:
    number = TRAINING[direction]
    pictures = []
    for method, result in results.items():
        subsets = {"training": result.training, "validation": result.validation}
        pictures.append(
            figures.predicted_errors(
                _name(number, method),
                subsets,
                unit,
                f"Figure {number} of the paper: error of the physics model, actual and predicted one step "
                f"ahead, on training and validation tests, {direction}, {method}.",
                f"Actual and predicted error in {unit} over {MAX_SAMPLES} samples.",
            )
        )
    return PaperFigure(number, tuple(pictures))


def _error_distribution(direction: str, result: DirectionResult, unit: str) -> PaperFigure:
    rows = {
        f"{subset}, {method}": getattr(subsets, subset).errors("one_step")
        for method, subsets in (("paper", result.paper), ("default", result.default))
        for subset in ("training", "validation")
    }
    number = DISTRIBUTION[direction]
    picture = figures.error_distribution(
        _name(number),
        rows,
        unit,
        f"Figure {number} of the paper: one-step errors of both methods on training and validation tests, "
        f"histogram with fitted normal and cumulative distribution, {direction}.",
        f"Distribution of one-step errors in {unit}.",
    )
    return PaperFigure(number, (picture,))


def _test_set(direction: str, test: Predictions, unit: str) -> PaperFigure:
    number = TEST[direction]
    errors = {model: test.errors(model) for model in DRAWN}
    pictures = (
        figures.outputs(
            _name(number),
            test,
            unit,
            DRAWN,
            f"Figure {number} of the paper, upper half: outputs and errors on the test set, {direction}.",
            f"Displacement and error over time on {len(test.names)} unseen tests.",
            recorded=MODELS,
        ),
        figures.error_distribution(
            f"{_name(number)}-errors",
            errors,
            unit,
            f"Figure {number} of the paper, lower half: histogram and cumulative distribution of the errors "
            f"on the test set, {direction}.",
            f"Distribution of the errors in {unit} on {len(test.names)} unseen tests.",
        ),
    )
    return PaperFigure(number, pictures)


def _name(number: int, method: str = PAPER) -> str:
    return f"figure-{number:02d}" + ("-default" if method == DEFAULT else "")
