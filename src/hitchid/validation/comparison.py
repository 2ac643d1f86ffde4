"""Comparison of two models on tests that neither identification used."""

from dataclasses import dataclass
from math import isclose
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support import checks
from hitchid._support.data_table import DataTable, csv_files, stacked
from hitchid._support.progress import ProgressCallback, silent, subtask_progress
from hitchid._support.storage import canonical_json
from hitchid.data.campaign import Campaign
from hitchid.errors import InputError
from hitchid.model import Hitch
from hitchid.validation.names import FREE_RUN
from hitchid.validation.predictions import Predictions
from hitchid.validation.results import Accuracy
from hitchid.validation.usable import with_covariates
from hitchid.validation.validate import validate
from hitchid.validation.validation import TABLES_FILE, Validation

if TYPE_CHECKING:
    from hitchid.report import Document

COMPARISON_FILE = "comparison.json"
MODELS = ("A", "B")
SAME_CLOCK = 1e-3  # relative difference of two sampling times that counts as none


@dataclass(frozen=True)
class ComparisonVerdict:
    """Which of two models has the smaller error in free run.

    Attributes:
        better: `A` or `B`; None if the difference is not significant.
        wins: number of tests on which the better one has the smaller error.
        tests: number of tests.
    """

    better: str | None
    wins: int
    tests: int


@dataclass(frozen=True)
class ModelComparison:
    """Two models on the same unseen tests.

    Attributes:
        first, second: validation of each; the tests are the same, in the same order.
        left_out: number of tests left out, used by one of the identifications.
        step_s: sampling time of both, s.
        lacking: sentences on tests that lack a covariate required by one of them.
    """

    first: Validation
    second: Validation
    left_out: int
    step_s: float
    lacking: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Unit of every error."""
        return self.first.unit

    @property
    def sections(self) -> tuple[str, ...]:
        """The directions that both models have, and `cycles` if both were validated on cycles."""
        return tuple(name for name in self.first.accuracy if name in self.second.accuracy)

    def accuracy(self, section: str) -> tuple[Accuracy, Accuracy]:
        """Return the errors of both models in one of `sections`."""
        return self.first.accuracy[section], self.second.accuracy[section]

    def free_runs(self, section: str) -> Predictions:
        """Return the tests of one of `sections` with the free runs of both models, `a` and `b`."""
        one, other = (accuracy.predictions for accuracy in self.accuracy(section))
        runs = {"a": one.models[FREE_RUN], "b": other.models[FREE_RUN]}
        return Predictions(one.names, one.time_s, one.actual, runs, commands=one.commands)

    def verdict(self, section: str) -> ComparisonVerdict:
        """Return which model has the smaller error in free run, tested at 2.5 % over the tests."""
        tests = self.free_runs(section)
        for better, worse in (MODELS, MODELS[::-1]):
            if tests.is_significantly_better(better.lower(), worse.lower()):
                wins = int(np.sum(tests.rmse(better.lower()) < tests.rmse(worse.lower())))
                return ComparisonVerdict(better, wins, len(tests.names))
        return ComparisonVerdict(None, 0, len(tests.names))

    @property
    def notices(self) -> tuple[str, ...]:
        """Warnings on the tests and on either model."""
        ours, theirs = self.first.notices, self.second.notices
        left_out_notices = [f"{self.left_out} tests are left out: one of the models was identified from them"]
        return (
            *(left_out_notices if self.left_out else []),
            *self.lacking,
            *(notice for notice in ours if notice in theirs),
            *(f"model A: {notice}" for notice in ours if notice not in theirs),
            *(f"model B: {notice}" for notice in theirs if notice not in ours),
        )

    @property
    def metrics(self) -> dict[str, object]:
        """All figures, the content of `comparison.json`."""
        return {
            "unit": self.unit,
            "left_out": self.left_out,
            "A": self.first.metrics,
            "B": self.second.metrics,
            "better": {name: self.verdict(name).better for name in self.sections},
        }

    def tables(self) -> dict[str, DataTable]:
        """Return every table as data by name, the models below each other; see `Validation.tables`."""
        validations = zip(MODELS, (self.first, self.second), strict=True)
        return stacked({name: validation.tables() for name, validation in validations}, "compared_model")

    def report(self, *, names: tuple[str, str], command: str = "") -> "Document":
        """Return the report, for `hitchid.report.render`.

        Args:
            names: of the models A and B.
            command: the command line that wrote the report.
        """
        from hitchid.report import comparison_report

        return comparison_report(self, names=names, command=command)

    def files(self) -> dict[str, bytes]:
        """Return `comparison.json`, `tables.md` and `tables/*.csv` with their content."""
        from hitchid.report import comparison_tables, render

        tables = render(comparison_tables(self), "markdown")
        return {
            COMPARISON_FILE: canonical_json(self.metrics),
            TABLES_FILE: tables,
            **csv_files(self.tables().values()),
        }


def compare(
    first: Hitch, second: Hitch, campaign: Campaign, *, progress: ProgressCallback | None = None
) -> ModelComparison:
    """Compare two models on the tests of a campaign that neither identification used.

    Args:
        first, second: identified hitches, called A and B.
        campaign: logs; those that either identification used are left out, recognised by their content.
        progress: called with the current task and the completed fraction of the work.

    Raises:
        InputError: no test is left, the models have no common direction or different sampling times, or a
            unit has another dimension than a model's.
    """
    for model in (first, second):
        checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    checks.instance(campaign, Campaign, "campaign", 'a campaign as hitchid.read("logs") returns it')
    report = progress or silent
    seen = first.provenance.seen | second.provenance.seen
    unseen = campaign.without(seen)
    if not any(name in second.channels for name in first.channels):
        raise InputError(
            f"model A has channels for {' and '.join(first.channels)}, model B for "
            f"{' and '.join(second.channels)}; expected one in common"
        )
    if not isclose(first.step_s, second.step_s, rel_tol=SAME_CLOCK):
        raise InputError(
            f"model A has a sampling time of {first.step_s:g} s, model B of {second.step_s:g} s; expected "
            "the same, for they are compared sample by sample"
        )
    if not unseen.records:
        raise InputError("one of the models was identified from every test; expected tests neither has seen")
    usable, lacking = with_covariates(unseen, first, second)
    segmentation_dead_zones = first.segmentation_dead_zones(campaign.units)
    one = validate(
        first,
        usable,
        segmentation_dead_zones=segmentation_dead_zones,
        progress=subtask_progress(report, 0.0, 0.5, "model A"),
    )
    other = validate(
        second,
        usable,
        segmentation_dead_zones=segmentation_dead_zones,
        progress=subtask_progress(report, 0.5, 0.5, "model B"),
    )
    comparison = ModelComparison(
        one, other, len(campaign.records) - len(unseen.records), first.step_s, lacking
    )
    if not comparison.sections:
        raise InputError("the models have no test in common; expected tests of a direction that both have")
    return comparison
