"""What validations and comparisons show of themselves: the main figures of every model."""

from collections.abc import Iterable

from hitchid._support.tables import Summary, count, first_notes, sparkline
from hitchid.validation.comparison import ModelComparison
from hitchid.validation.results import (
    CYCLES,
    FREE_RUN,
    GREYBOX,
    Accuracy,
    ModelFigures,
    RunFigures,
    in_table_order,
    model_name,
)
from hitchid.validation.validation import Validation

MAX_NOTICES = 3  # that are shown; chosen
DIVERGED = "diverged"


def validation_summary(validation: Validation) -> Summary:
    """Return the errors of every model one step ahead and in free run, on the unseen tests."""
    rows, pictures = [], []
    for section, accuracy in validation.accuracy.items():
        for name in reversed(in_table_order(accuracy.models)):
            rows.append((section, model_name(name), *_cells(accuracy.models[name])))
            pictures.append(_picture(section, accuracy) if name == GREYBOX else "")
    return Summary(
        f"Validation on {_tests(validation.accuracy.items())}",
        ("direction", "model", *_header(validation.unit)),
        tuple(rows),
        first_notes(validation.notices, MAX_NOTICES, "notices"),
        tuple(pictures),
    )


def comparison_summary(comparison: ModelComparison) -> Summary:
    """Return the errors of the models that are compared, by rank, and which of them is better."""
    rows, pictures, notes = [], [], []
    for section in comparison.sections:
        by_label = dict(zip(comparison.labels, comparison.accuracy(section), strict=True))
        for row in comparison.leaderboard().section(section):
            rows.append((section, row.name, *_cells(by_label[row.label].models[GREYBOX])))
            pictures.append(_picture(section, by_label[row.label]))
        better = comparison.verdict(section).better
        verdict = "no significant difference" if better is None else f"{better} is better"
        notes.append(f"{section}: {verdict}")
    tests = _tests((section, comparison.accuracy(section)[0]) for section in comparison.sections)
    return Summary(
        f"Comparison of models on {tests}",
        ("direction", "model", *_header(comparison.unit)),
        tuple(rows),
        tuple(notes),
        tuple(pictures),
    )


def _header(unit: str) -> tuple[str, ...]:
    return f"RMSE one step / {unit}", f"RMSE free run / {unit}", "fit / %", f"largest / {unit}"


def _cells(figures: ModelFigures) -> tuple[str, ...]:
    one_step, free_run = figures.one_step, figures.free_run
    return (
        "" if one_step is None else _number(one_step.rmse),
        *(("", "", "") if free_run is None else _free_run_cells(free_run)),
    )


def _free_run_cells(figures: RunFigures) -> tuple[str, ...]:
    return _number(figures.rmse), _number(figures.fit), _number(figures.max_abs)


def _number(value: float | None) -> str:
    return DIVERGED if value is None else f"{value:.4g}"


def _tests(sections: Iterable[tuple[str, Accuracy]]) -> str:
    """Return how many unseen tests each direction has."""
    return ", ".join(
        count(len(accuracy.tests), "unseen cycle" if section == CYCLES else f"unseen {section} test")
        for section, accuracy in sections
    )


def _picture(section: str, accuracy: Accuracy) -> str:
    """Return measured displacement and free run of the first test as a small picture."""
    tests = accuracy.predictions
    measured, predicted = tests.actual[0], tests.models[FREE_RUN][0]
    label = f"{section}: {tests.names[0]}, measured and in free run"
    return sparkline([measured, predicted], label, [measured, measured])
