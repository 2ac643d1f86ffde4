"""Cross-validation of an identification by tests held out in turn."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support import checks
from hitchid._support.numbers import digits
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent, subtask_progress
from hitchid._support.screen import first_notes
from hitchid._support.tables import Summarised, Table, dataframe
from hitchid.errors import HitchError, InputError
from hitchid.estimation import Search
from hitchid.identification.candidates import operating_points
from hitchid.identification.config import (
    DEFAULT_STRUCTURES,
    NO_DEAD_ZONES,
    TRAINING,
    WHALE,
    RivalsConfig,
    Structures,
    check_campaign,
)
from hitchid.identification.identify import identify_many
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.result import Identification
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import CYCLE, Record
from hitchid.model import Hitch
from hitchid.validation import ModelFigures, Predictions, RunFigures, Validation, validate
from hitchid.validation.results import FREE_RUN, GREYBOX, ONE_STEP

if TYPE_CHECKING:
    from pandas import DataFrame


# Results of a cross-validation: figures of each fold and pooled over all tests.

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
        of_folds = [validation.predictions for validation in self.validations]
        parts = [predictions[section] for predictions in of_folds if section in predictions]
        runs = [run for run in (FREE_RUN, ONE_STEP) if all(run in part.models for part in parts)]
        return Predictions(
            names=tuple(name for part in parts for name in part.names),
            time_s=tuple(row for part in parts for row in part.time_s),
            actual=tuple(row for part in parts for row in part.actual),
            models={run: tuple(row for part in parts for row in part.models[run]) for run in runs},
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

    def _summary(self) -> Table:
        rows = []
        for section in self.sections:
            figures = self.figures(section)
            runs = (figures.free_run, figures.one_step)
            cells = ["" if run is None else digits(run.rmse, run.rmse_error) for run in runs]
            rows.append((section, str(len(self.predictions(section).names)), *cells))
        header = ("section", "tests", f"free run, RMSE / {self.unit}", f"one step, RMSE / {self.unit}")
        title = f"Cross-validation of {len(self)} folds, every test with the model identified without it"
        return Table(title, header, tuple(rows), first_notes(self.notices, 3, "notices"))

    def _row(self, section: str, fold: FoldResult) -> dict[str, object]:
        row: dict[str, object] = {"section": section, "fold": str(fold.number)}
        figures = fold.figures(section)
        if fold.validation is None or figures is None:
            return {**row, "tests": 0, "error": fold.error and str(fold.error)}
        tests = len(fold.validation.accuracy[section].tests)
        return {**row, "tests": tests, **figures.columns(self.unit)}


# Division of the tests of a campaign into folds, by operating point.


@dataclass(frozen=True)
class Fold:
    """One division: the held-out tests alone, and all but them and their copies, none of it held out."""

    training: Campaign
    held_out: Campaign


def divide(campaign: Campaign, count: int, seed: int) -> tuple[Fold, ...]:
    """Return folds such that each test is held out in one of them.

    The tests of each direction are dealt separately, all tests of one operating point to the same fold; of a
    campaign of mixed cycles alone the cycles are. Ramps are never held out.

    Args:
        campaign: its own division into tests for identification and held-out tests is not used.
        count: number of folds.
        seed: of the order in which operating points are dealt.

    Raises:
        InputError: a direction has fewer operating points than there are folds.
    """
    rng = np.random.default_rng(seed)
    held_out: list[list[Record]] = [[] for _ in range(count)]
    for kind in campaign.directions or (CYCLE,):
        records = campaign.of_kind(kind)
        # Tests at one level of command share a point, unless a covariate may differ between them; every mixed
        # cycle is a point of its own.
        points = np.arange(len(records))
        if kind != CYCLE:
            magnitudes = [np.abs(record.command(kind)) for record in records]
            levels = np.array([float(row[row > 0].mean()) for row in magnitudes])
            points = operating_points(levels, separate_tests=bool(campaign.covariates))
        present = np.unique(points)
        if present.size < count:
            raise InputError(
                f"folds: expected at most {present.size} for {len(records)} {kind} tests at {present.size} "
                f"operating points, got {count}"
            )
        folds = np.arange(present.size) % count
        fold_of_point = dict(zip(rng.permutation(present).tolist(), folds.tolist(), strict=True))
        for record, point in zip(records, points.tolist(), strict=True):
            held_out[fold_of_point[point]].append(record)
    divided = []
    for records in held_out:
        # By content, not by name: a copy of a held-out test is not identified from either.
        others = campaign.without({record.fingerprint for record in records})
        training = replace(others, test_patterns=(), unmatched=())
        tests = replace(campaign, records=tuple(records), test_patterns=None, unmatched=())
        divided.append(Fold(training, tests))
    return tuple(divided)


IDENTIFICATION_SHARE = 0.9  # of the work; the rest is validation (measured at default settings)


@checks.named_arguments
def cross_validate(
    campaign: Campaign,
    folds: int = 5,
    *,
    structure: Structures = DEFAULT_STRUCTURES,
    search: Search | str = WHALE,
    training: CompensatorConfig | None = TRAINING,
    dead_zones: Mapping[str, float] = NO_DEAD_ZONES,
    drift: bool | None = None,
    rivals: RivalsConfig | bool | None = False,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> CrossValidation:
    """Identify a model without each fold of the tests in turn, and validate it on that fold.

    The tests of each direction are divided into folds by operating point, so that each test is held out once.
    The identification of a fold (dead zone, structure, parameters, training) gets none of its held-out tests.
    The campaign's own division into tests for identification and held-out tests is not used.

    Args:
        campaign: tests of one direction, or mixed cycles alone; ramps are used in every fold.
        folds: number of folds, from 2 to the number of operating points of each direction.
        structure, search, training, dead_zones, drift, rivals: as for `identify`, the same in all folds.
        seed: of the division into folds and of every other random draw.
        progress: called with the current task and the completed fraction of the work.

    Returns:
        Errors of each fold and pooled over all; a fold that fails has its error instead.

    Raises:
        InputError: a direction has fewer operating points than folds, or an argument does not fit.
        HitchError: every fold fails; the error is that of the first.
    """
    count = checks.integer(folds, "folds", minimum=2)
    divided = divide(check_campaign(campaign), count, checks.integer(seed, "seed"))
    report = progress or silent
    identifications = identify_many(
        [fold.training for fold in divided],
        structure=structure,
        search=search,
        training=training,
        dead_zones=dead_zones,
        drift=drift,
        rivals=rivals,
        seed=seed,
        progress=subtask_progress(report, 0.0, IDENTIFICATION_SHARE),
    )
    results = []
    for number, (fold, identification) in enumerate(zip(divided, identifications, strict=True), start=1):
        done = IDENTIFICATION_SHARE + (1 - IDENTIFICATION_SHARE) * (number - 1) / len(divided)
        report(ProgressUpdate(f"validation of fold {number}", done))
        results.append(_fold_result(number, fold, identification))
    errors = [result.error for result in results if result.error is not None]
    if len(errors) == len(results):
        raise errors[0]
    return CrossValidation(tuple(results))


def _fold_result(number: int, fold: Fold, identification: Identification | HitchError) -> FoldResult:
    tests = tuple(record.name for record in fold.held_out.records)
    if isinstance(identification, HitchError):
        return FoldResult(number, tests, error=identification)
    try:
        return FoldResult(number, tests, validate(identification.model, fold.held_out))
    except HitchError as error:
        return FoldResult(number, tests, error=error)
