"""Comparison of models on tests that none of their identifications used."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isclose
from string import ascii_uppercase
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support import checks
from hitchid._support.files import canonical_json
from hitchid._support.progress import ProgressCallback, silent, subtask_progress
from hitchid._support.records import Value
from hitchid._support.tables import DataTable, Summarised, Table, csv_files, stacked
from hitchid.errors import InputError
from hitchid.logs.campaign import Campaign
from hitchid.model import Hitch
from hitchid.validation.leaderboard import Leaderboard, LeaderboardRow, Standing, section_rows
from hitchid.validation.results import FREE_RUN, GREYBOX, Accuracy, Predictions, errors_summary
from hitchid.validation.validate import usable_tests, validate
from hitchid.validation.validation import TABLES_FILE, Validation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hitchid.report import Document

COMPARISON_FILE = "comparison.json"
MODEL = "a model as hitchid.load returns it"
SAME_CLOCK = 1e-3  # relative difference of two sampling times that counts as none


@dataclass(frozen=True)
class ComparisonVerdict:
    """Which model has the smallest error in free run.

    Attributes:
        better: label of the model that is significantly better than every other; None if there is none.
        wins: number of tests on which it has the smallest error.
        tests: number of tests.
    """

    better: str | None
    wins: int
    tests: int


@dataclass(frozen=True, eq=False, repr=False)
class ModelComparison(Value, Summarised):
    """Models on the same unseen tests; iterates over the validation of each.

    Attributes:
        names: of the models.
        validations: of each model; the tests are the same, in the same order.
        left_out: number of tests left out, used by one of the identifications.
        step_s: sampling time of all models, s.
        lacking: sentences on tests that lack a covariate required by one of the models.
    """

    names: tuple[str, ...]
    validations: tuple[Validation, ...]
    left_out: int
    step_s: float
    lacking: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[Validation]:
        return iter(self.validations)

    def __len__(self) -> int:
        return len(self.validations)

    @property
    def labels(self) -> tuple[str, ...]:
        """A letter for each model, A, B, C, …; after Z follow A1, B1, …."""
        return model_labels(len(self.validations))

    @property
    def unit(self) -> str:
        """Unit of every error."""
        return self.validations[0].unit

    @property
    def sections(self) -> tuple[str, ...]:
        """The directions that all models have, and `cycles` if all were validated on cycles."""
        first, *others = (validation.accuracy for validation in self.validations)
        return tuple(name for name in first if all(name in other for other in others))

    def accuracy(self, section: str) -> tuple[Accuracy, ...]:
        """Return the errors of each model in one of `sections`."""
        return tuple(validation.accuracy[section] for validation in self.validations)

    def free_runs(self, section: str) -> Predictions:
        """Return the tests of one of `sections` with the free runs of the models, by label."""
        predictions = [accuracy.predictions for accuracy in self.accuracy(section)]
        runs = {label: tests.models[FREE_RUN] for label, tests in zip(self.labels, predictions, strict=True)}
        first = predictions[0]
        return Predictions(first.names, first.time_s, first.actual, runs, commands=first.commands)

    def leaderboard(self) -> Leaderboard:
        """Return errors, ranks and significance of the differences, for each section and model."""
        return self._leaderboard

    @cached_property
    def _leaderboard(self) -> Leaderboard:
        names = dict(zip(self.labels, self.names, strict=True))
        rows: list[LeaderboardRow] = []
        for section in self.sections:
            rows += section_rows(section, names, self.accuracy(section), self.free_runs(section))
        return Leaderboard(self.unit, tuple(rows))

    def verdict(self, section: str) -> ComparisonVerdict:
        """Return which model is significantly better than every other in free run."""
        best, *others = self.leaderboard().section(section)
        if any(row.standing is not Standing.WORSE for row in others):
            return ComparisonVerdict(None, 0, best.tests)
        tests = self.free_runs(section)
        other_errors = np.min([tests.rmse(row.label) for row in others], axis=0)
        wins = int(np.sum(tests.rmse(best.label) < other_errors))
        return ComparisonVerdict(best.label, wins, best.tests)

    def plot(
        self,
        axes: "Sequence[Axes] | np.ndarray | None" = None,
        *,
        section: str | None = None,
        test: str | None = None,
    ) -> np.ndarray:
        """Draw measured on top of the free runs of the models, and their errors below.

        Args:
            axes: two matplotlib axes to draw into; None for a new figure of pyplot.
            section: one of `sections`; None for the first.
            test: name of one test; None for at most four, from the best to the worst.

        Returns:
            The two axes.

        Raises:
            InputError: there is no such section or test, or other than two axes are given.
        """
        from hitchid.validation.plotting import plot_fit

        section = checks.one_of(section or self.sections[0], self.sections, "section")
        tests = self.free_runs(section)
        return plot_fit(tests, tuple(tests.models), axes, section=section, test=test, unit=self.unit)

    @property
    def notices(self) -> tuple[str, ...]:
        """Warnings on the tests and on single models."""
        by_model = [validation.notices for validation in self.validations]
        shared = [notice for notice in by_model[0] if all(notice in notices for notices in by_model)]
        left_out_notices = [
            f"{self.left_out} tests are left out: at least one of the models was identified from them"
        ]
        return (
            *(left_out_notices if self.left_out else []),
            *self.lacking,
            *shared,
            *(
                f"model {label}: {notice}"
                for label, notices in zip(self.labels, by_model, strict=True)
                for notice in notices
                if notice not in shared
            ),
        )

    @property
    def metrics(self) -> dict[str, object]:
        """All figures, the content of `comparison.json`."""
        leaderboard = self.leaderboard()
        return {
            "unit": self.unit,
            "left_out": self.left_out,
            "models": dict(zip(self.labels, self.names, strict=True)),
            **{
                label: validation.metrics
                for label, validation in zip(self.labels, self.validations, strict=True)
            },
            "better": {section: self.verdict(section).better for section in self.sections},
            "leaderboard": {
                section: [row.describe() for row in leaderboard.section(section)] for section in self.sections
            },
        }

    def tables(self) -> dict[str, DataTable]:
        """Return every table as data by name, the models below each other; see `Validation.tables`."""
        by_model = zip(self.labels, self.validations, strict=True)
        return stacked({label: validation.tables() for label, validation in by_model}, "compared_model")

    def report(self, *, command: str = "") -> "Document":
        """Return the report, for `hitchid.report.render`.

        Args:
            command: the command line that wrote the report.
        """
        from hitchid.report.comparison_report import comparison_report

        return comparison_report(self, command=command)

    def files(self) -> dict[str, bytes]:
        """Return `comparison.json`, `tables.md` and `tables/*.csv` with their content."""
        from hitchid.report import comparison_tables, render

        tables = render(comparison_tables(self), "markdown")
        return {
            COMPARISON_FILE: canonical_json(self.metrics),
            TABLES_FILE: tables,
            **csv_files(self.tables().values()),
        }

    def _summary(self) -> Table:
        rows, notes = [], []
        for section in self.sections:
            by_label = dict(zip(self.labels, self.accuracy(section), strict=True))
            for row in self.leaderboard().section(section):
                accuracy = by_label[row.label]
                rows.append((section, row.name, accuracy.models[GREYBOX], accuracy))
            better = self.verdict(section).better
            verdict = "no significant difference" if better is None else f"{better} is better"
            notes.append(f"{section}: {verdict}")
        accuracies = {section: self.accuracy(section)[0] for section in self.sections}
        return errors_summary("Comparison of models on", self.unit, accuracies, rows, tuple(notes))


def model_labels(count: int) -> tuple[str, ...]:
    """Return letters for a number of models: A to Z, then A1 to Z1, and so on."""
    rounds = (divmod(index, len(ascii_uppercase)) for index in range(count))
    return tuple(f"{ascii_uppercase[letter]}{number or ''}" for number, letter in rounds)


@checks.named_arguments
def compare(
    models: Sequence[Hitch],
    campaign: Campaign,
    names: Sequence[str] | None = None,
    *,
    progress: ProgressCallback | None = None,
) -> ModelComparison:
    """Compare models on the tests of a campaign that none of their identifications used.

    Two models differ significantly if the ratio of their RMSE in free run does, over three tests or more, at
    2.5 % (one-sided; jackknife over the tests and Student's t), adjusted for the number of pairs of models
    (Holm 1979).

    Args:
        models: identified hitches, two or more.
        campaign: logs; those that one of the identifications used are left out, recognised by their content.
        names: of the models, for tables and reports; by default the letters A, B, C, ….
        progress: called with the current task and the completed fraction of the work.

    Raises:
        InputError: fewer than two models, no test is left, the models have no common direction or different
            sampling times, or a unit has another dimension than a model's.
    """
    models = checks.tuple_of(models, Hitch, "models", f"several, each {MODEL}")
    checks.instance(campaign, Campaign, "campaign", 'a campaign as hitchid.read("logs") returns it')
    if len(models) < 2:
        raise InputError(f"models: expected two or more, got {len(models)}")
    model_names = _names(names, len(models))
    labels = model_labels(len(models))
    _check_comparable(dict(zip(labels, models, strict=True)))
    unseen = campaign.without(frozenset().union(*(model.provenance.seen for model in models)))
    if not unseen.records:
        raise InputError(
            "every test was used to identify at least one of the models; expected at least "
            "one test that none of them used"
        )
    # The same tests for all, cut in the same places: errors are compared sample by sample.
    usable, lacking = usable_tests(unseen, *models)
    report, width = progress or silent, 1.0 / len(models)
    segmentation_dead_zones = models[0].segmentation_dead_zones(campaign.units)
    validations = tuple(
        validate(
            model,
            usable,
            segmentation_dead_zones=segmentation_dead_zones,
            progress=subtask_progress(report, number * width, width, f"model {labels[number]}"),
        )
        for number, model in enumerate(models)
    )
    left_out = len(campaign.records) - len(unseen.records)
    comparison = ModelComparison(model_names, validations, left_out, models[0].step_s, lacking)
    if not comparison.sections:
        raise InputError(
            "no unseen test is in a direction that all models have; expected at least one such test"
        )
    return comparison


def _names(names: Sequence[str] | None, count: int) -> tuple[str, ...]:
    """Return a name for each model; raises InputError for another number of names or equal ones."""
    if names is None:
        return model_labels(count)
    model_names = checks.tuple_of(names, str, "names", "names of the models, each a string")
    if len(model_names) != count:
        raise InputError(f"names: expected {count}, one for each model, got {len(model_names)}")
    for name in model_names:
        if model_names.count(name) > 1:
            raise InputError(f"names: two models are called '{name}'; expected names that differ")
    return model_names


def _check_comparable(models: dict[str, Hitch]) -> None:
    """Raise InputError for models without a common direction or with different sampling times."""
    (first_label, first), *others = models.items()
    if not any(all(name in other.channels for _, other in others) for name in first.channels):
        listed = ", ".join(f"model {label} for {' and '.join(m.channels)}" for label, m in models.items())
        raise InputError(
            f"the models have no direction in common: {listed}; expected at least one common direction"
        )
    for label, other in others:
        if not isclose(first.step_s, other.step_s, rel_tol=SAME_CLOCK):
            raise InputError(
                f"model {first_label} has a sampling time of {first.step_s:g} s, model {label} of "
                f"{other.step_s:g} s; expected the same, because they are compared sample by sample"
            )
