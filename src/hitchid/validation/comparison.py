"""Two models on tests that neither has seen: which errs less, and whether the tests prove it."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose
from typing import Any

import numpy as np

from hitchid._support import checks
from hitchid._support.progress import ProgressCallback, silent, subtask_progress
from hitchid._support.storage import canonical_json
from hitchid.data.campaign import Campaign
from hitchid.errors import InputError
from hitchid.model import Hitch
from hitchid.uncertainty import format_with_error
from hitchid.validation.limits import CYCLES
from hitchid.validation.predictions import MIN_TESTS, Predictions
from hitchid.validation.table import Table, digits, error_cells
from hitchid.validation.tables import RUNS, error_header, markdown
from hitchid.validation.usable import with_covariates
from hitchid.validation.validate import TABLES_FILE, Validation, validate

COMPARISON_FILE = "comparison.json"
MODELS = ("A", "B")
SAME_CLOCK = 1e-3


@dataclass(frozen=True)
class ModelComparison:
    """Two models on the same unseen tests.

    Attributes:
        first, second: what the validation of each found; the tests are the same, in the same order.
        left_out: how many tests one of them has seen.
        step_s: sampling time of both, s.
        lacking: which tests lack a covariate that one of them requires, as sentences.
    """

    first: Validation
    second: Validation
    left_out: int
    step_s: float
    lacking: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Unit of every error."""
        return self.first.metrics["unit"]

    @property
    def sections(self) -> tuple[str, ...]:
        """The directions that both models have, and `cycles` where both were run over some."""
        return tuple(name for name in self.first.predictions if name in self.second.predictions)

    def figures(self, section: str) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """Return the figures of both models for one of `parts`."""
        pair = (self.first.metrics, self.second.metrics)
        if section == CYCLES:
            return pair[0][CYCLES], pair[1][CYCLES]
        return pair[0]["channels"][section], pair[1]["channels"][section]

    def free_runs(self, section: str) -> Predictions:
        """Return the tests of one of `parts` with the free runs of both models, `a` and `b`."""
        one, other = self.first.predictions[section], self.second.predictions[section]
        runs = {"a": one.models["free_run"], "b": other.models["free_run"]}
        return Predictions(one.names, one.time_s, one.actual, runs)

    def verdict(self, section: str) -> tuple[str | None, str]:
        """Return which model surely errs less in free run, None for neither, and a sentence that says so."""
        tests = self.free_runs(section)
        error_texts = [
            "diverged"
            if free["rmse"] is None
            else f"{format_with_error(free['rmse'], free['rmse_error'])} {self.unit}"
            for free in (figures["greybox"]["free_run"] for figures in self.figures(section))
        ]
        figures = f"RMSE {error_texts[0]} with A, {error_texts[1]} with B"
        count = len(tests.names)
        if count < MIN_TESTS:
            count_text = f"{count} test{'s' if count > 1 else ''}"
            return None, f"{count_text}, too few to tell the models apart in free run: {figures}"
        for better, worse in (MODELS, MODELS[::-1]):
            if tests.is_significantly_better(better.lower(), worse.lower()):
                wins = int(np.sum(tests.rmse(better.lower()) < tests.rmse(worse.lower())))
                return better, f"{better} errs less in free run, on {wins} of {count} tests: {figures}"
        return None, f"{count} tests do not tell the models apart in free run: {figures}"

    def tables(self) -> list[Table]:
        """Return for each of `parts` figures and horizons of both models side by side, then parameters."""
        all_tables = []
        for section in self.sections:
            all_tables += [self.accuracy(section), self.horizons(section)]
        return [*all_tables, *self.parameters()]

    def accuracy(self, section: str) -> Table:
        """Return how far both models err."""
        rows = [
            (f"model {name}", label, *error_cells(figures["greybox"][run]))
            for run, label in reversed(RUNS.items())
            for name, figures in zip(MODELS, self.figures(section), strict=True)
        ]
        count = len(self.first.predictions[section].names)
        title = f"{section}: accuracy on {count} test{'s' if count > 1 else ''} that neither has seen"
        return Table(title, error_header(self.unit, "model", "run"), tuple(rows))

    def horizons(self, section: str) -> Table:
        """Return how far both models err over each horizon."""
        pair = [figures["horizons"] for figures in self.figures(section)]
        rows = [
            (f"model {name}", *(digits(value) for value in horizons["greybox"]))
            for name, horizons in zip(MODELS, pair, strict=True)
        ]
        header = ("model", *(str(step) for step in pair[0]["steps"]))
        return Table(f"{section}: RMSE / {self.unit} over the horizon in samples", header, tuple(rows))

    def parameters(self) -> list[Table]:
        """Return the parameters of both models side by side, as far as they are told."""
        all_tables = []
        for direction in (name for name in self.sections if name != CYCLES):
            pair = [figures.get("parameters", {}).get("estimates", {}) for figures in self.figures(direction)]
            names = dict.fromkeys([*pair[0], *pair[1]])
            rows = [(_label(name), *(_cell(estimates.get(name)) for estimates in pair)) for name in names]
            if rows:
                header = ("parameter", *(f"model {name}" for name in MODELS))
                all_tables.append(Table(f"{direction}: parameters", header, tuple(rows)))
        return all_tables

    @property
    def notices(self) -> tuple[str, ...]:
        """What a reader should know of the tests and of either model."""
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
    def metrics(self) -> dict[str, Any]:
        """All figures, in the form of `comparison.json`."""
        return {
            "unit": self.unit,
            "left_out": self.left_out,
            "A": self.first.metrics,
            "B": self.second.metrics,
            "better": {name: self.verdict(name)[0] for name in self.sections},
        }

    def files(self) -> dict[str, bytes]:
        """Return `comparison.json` and `tables.md` with what they hold."""
        verdicts = [f"{name}: {self.verdict(name)[1]}" for name in self.sections]
        text = markdown(self.tables(), [*verdicts, *self.notices], title="Comparison")
        return {
            COMPARISON_FILE: canonical_json(self.metrics),
            TABLES_FILE: text.encode("utf-8", errors="backslashreplace"),
        }


def compare(
    first: Hitch, second: Hitch, campaign: Campaign, *, progress: ProgressCallback | None = None
) -> ModelComparison:
    """Compare two models on the tests of a campaign that neither identification has used.

    Args:
        first, second: identified hitches, called A and B.
        campaign: logs; those either identification used are left out, recognised by their content.
        progress: called with what is being done and the fraction of all work that is done.

    Raises:
        InputError: no test is left, or the models have no direction or not one clock in common.
        InputError: a unit is of another dimension than a model's.
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
            f"{' and '.join(second.channels)}; required one in common"
        )
    if not isclose(first.step_s, second.step_s, rel_tol=SAME_CLOCK):
        raise InputError(
            f"model A has a sampling time of {first.step_s:g} s, model B of {second.step_s:g} s; required "
            "the same, for they are compared sample by sample"
        )
    if not unseen.records:
        raise InputError("one of the models was identified from every test; required tests neither has seen")
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
        raise InputError("the models have no test in common; required tests of a direction that both have")
    return comparison


def _label(name: str) -> str:
    return name.replace("_", " ")


def _cell(estimate: Mapping[str, Any] | None) -> str:
    """Return a parameter as `K = 39.4 ± 0.6 mm/(s·A)`, or what is known of one that is not determined."""
    if estimate is None:
        return "not in the model"
    if not estimate["determined"]:
        return estimate["verdict"]
    unit = "" if estimate["unit"] == "1" else f" {estimate['unit']}"
    return f"{estimate['symbol']} = {format_with_error(estimate['value'], estimate['standard_error'])}{unit}"
