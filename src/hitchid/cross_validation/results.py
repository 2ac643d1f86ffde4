"""Results of a cross-validation: figures of each fold and pooled over all tests."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hitchid._support.dataframes import dataframe
from hitchid._support.summary import Summarised, Summary, first_notes
from hitchid.errors import HitchError
from hitchid.model import Hitch
from hitchid.validation import ModelFigures, Predictions, RunFigures, Validation
from hitchid.validation.leaderboard import value_text
from hitchid.validation.names import FREE_RUN, GREYBOX, ONE_STEP

if TYPE_CHECKING:
    from pandas import DataFrame

POOLED = "all"  # name of the pooled row in a table


@dataclass(frozen=True)
class FoldResult:
    """One fold: the model identified without its tests, and its errors on them.

    Attributes:
        number: of the fold, from 1.
        tests: names of the held-out tests.
        validation: of the model on the held-out tests; None where the fold failed.
        error: the error with which the fold ended; None where it did not fail.
    """

    number: int
    tests: tuple[str, ...]
    validation: Validation | None = field(default=None, repr=False)
    error: HitchError | None = None

    @property
    def model(self) -> Hitch | None:
        """The model identified without the held-out tests; None where the fold failed."""
        return None if self.validation is None else self.validation.model

    def figures(self, section: str) -> ModelFigures | None:
        """Return the errors in one section; None where the fold failed or has no test of it."""
        accuracy = {} if self.validation is None else self.validation.accuracy
        return accuracy[section].models[GREYBOX] if section in accuracy else None


@dataclass(frozen=True, repr=False)
class CrossValidation(Summarised):
    """Models identified without each fold of tests in turn, validated on it; iterates over the folds.

    Attributes:
        folds: each fold.
    """

    folds: tuple[FoldResult, ...]

    def __iter__(self) -> Iterator[FoldResult]:
        return iter(self.folds)

    def __len__(self) -> int:
        return len(self.folds)

    @property
    def validations(self) -> tuple[Validation, ...]:
        """Validations of the folds that did not fail, at least one."""
        return tuple(fold.validation for fold in self.folds if fold.validation is not None)

    @property
    def unit(self) -> str:
        """Unit of every error."""
        return self.validations[0].unit

    @property
    def sections(self) -> tuple[str, ...]:
        """Directions with results, and `cycles` where a campaign of mixed cycles alone was identified."""
        return tuple(dict.fromkeys(name for validation in self.validations for name in validation.accuracy))

    @property
    def notices(self) -> tuple[str, ...]:
        """A sentence for each fold that failed."""
        return tuple(
            f"fold {fold.number} failed and is left out of the pooled figures: {fold.error}"
            for fold in self.folds
            if fold.error is not None
        )

    def predictions(self, section: str) -> Predictions:
        """Return every test of a section with the predictions of the model identified without it."""
        parts = [
            validation.predictions[section]
            for validation in self.validations
            if section in validation.predictions
        ]
        return Predictions(
            names=tuple(name for part in parts for name in part.names),
            time_s=tuple(row for part in parts for row in part.time_s),
            actual=tuple(row for part in parts for row in part.actual),
            models={
                run: tuple(row for part in parts for row in part.models[run])
                for run in (FREE_RUN, ONE_STEP)
                if all(run in part.models for part in parts)
            },
        )

    def figures(self, section: str) -> ModelFigures:
        """Return the errors pooled over the tests of all folds.

        The standard error is over tests; it does not hold the correlation of tests that share a model.
        """
        tests = self.predictions(section)
        one_step = None
        if ONE_STEP in tests.models:  # a prediction needs the sample before
            pairs = zip(tests.actual, tests.models[ONE_STEP], strict=True)
            actual, predicted = zip(*((a[1:], p[1:]) for a, p in pairs), strict=True)
            one_step = RunFigures.of(actual, predicted)
        return ModelFigures(one_step, RunFigures.of(tests.actual, tests.models[FREE_RUN]))

    def to_dataframe(self) -> "DataFrame":
        """Return a DataFrame with a row for each section and fold, and one for all folds together.

        Raises:
            InputError: pandas is not installed.
        """
        rows: list[dict[str, object]] = []
        for section in self.sections:
            rows += [self._row(section, fold) for fold in self.folds]
            tests = {"tests": len(self.predictions(section).names)}
            rows.append(
                {"section": section, "fold": POOLED, **tests, **self.figures(section).columns(self.unit)}
            )
        return dataframe(rows)

    def _summary(self) -> Summary:
        rows = []
        for section in self.sections:
            figures = self.figures(section)
            runs = (figures.free_run, figures.one_step)
            cells = ["" if run is None else value_text(run.rmse, run.rmse_error) for run in runs]
            rows.append((section, str(len(self.predictions(section).names)), *cells))
        header = ("section", "tests", f"free run, RMSE / {self.unit}", f"one step, RMSE / {self.unit}")
        title = f"Cross-validation of {len(self)} folds, every test with the model identified without it"
        return Summary(title, header, tuple(rows), first_notes(self.notices, 3, "notices"))

    def _row(self, section: str, fold: FoldResult) -> dict[str, object]:
        row: dict[str, object] = {"section": section, "fold": str(fold.number)}
        figures = fold.figures(section)
        if fold.validation is None or figures is None:
            return {**row, "tests": 0, "error": fold.error and str(fold.error)}
        tests = len(fold.validation.accuracy[section].tests)
        return {**row, "tests": tests, **figures.columns(self.unit)}
