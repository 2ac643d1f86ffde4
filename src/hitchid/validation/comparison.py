"""Two models on tests that neither has seen: which errs less, and whether the tests prove it."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose
from typing import Any

import numpy as np

from hitchid._support import checks
from hitchid._support.progress import Progress, part, silent
from hitchid._support.storage import canonical_json
from hitchid.data.campaign import Campaign
from hitchid.errors import InputError
from hitchid.model import Hitch
from hitchid.uncertainty import stated
from hitchid.validation.limits import CYCLES
from hitchid.validation.predictions import FEWEST, Predictions
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
    def parts(self) -> tuple[str, ...]:
        """The directions that both models have, and `cycles` where both were run over some."""
        return tuple(name for name in self.first.predictions if name in self.second.predictions)

    def figures(self, part: str) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """Return the figures of both models for one of `parts`."""
        both = (self.first.metrics, self.second.metrics)
        if part == CYCLES:
            return both[0][CYCLES], both[1][CYCLES]
        return both[0]["channels"][part], both[1]["channels"][part]

    def free_runs(self, part: str) -> Predictions:
        """Return the tests of one of `parts` with the free runs of both models, `a` and `b`."""
        one, other = self.first.predictions[part], self.second.predictions[part]
        runs = {"a": one.models["free_run"], "b": other.models["free_run"]}
        return Predictions(one.names, one.time_s, one.actual, runs)

    def verdict(self, part: str) -> tuple[str | None, str]:
        """Return which model surely errs less in free run, None for neither, and a sentence that says so."""
        tests = self.free_runs(part)
        told = [
            "diverged" if free["rmse"] is None else f"{stated(free['rmse'], free['rmse_error'])} {self.unit}"
            for free in (figures["greybox"]["free_run"] for figures in self.figures(part))
        ]
        figures = f"RMSE {told[0]} with A, {told[1]} with B"
        count = len(tests.names)
        if count < FEWEST:
            few = f"{count} test{'s' if count > 1 else ''}"
            return None, f"{few}, too few to tell the models apart in free run: {figures}"
        for better, worse in (MODELS, MODELS[::-1]):
            if tests.errs_surely_less(better.lower(), worse.lower()):
                wins = int(np.sum(tests.rmse(better.lower()) < tests.rmse(worse.lower())))
                return better, f"{better} errs less in free run, on {wins} of {count} tests: {figures}"
        return None, f"{count} tests do not tell the models apart in free run: {figures}"

    def tables(self) -> list[Table]:
        """Return for each of `parts` figures and horizons of both models side by side, then parameters."""
        found = []
        for part_name in self.parts:
            found += [self.accuracy(part_name), self.horizons(part_name)]
        return [*found, *self.parameters()]

    def accuracy(self, part: str) -> Table:
        """Return how far both models err."""
        rows = [
            (f"model {name}", label, *error_cells(figures["greybox"][run]))
            for run, label in reversed(RUNS.items())
            for name, figures in zip(MODELS, self.figures(part), strict=True)
        ]
        count = len(self.first.predictions[part].names)
        title = f"{part}: accuracy on {count} test{'s' if count > 1 else ''} that neither has seen"
        return Table(title, error_header(self.unit, "model", "run"), tuple(rows))

    def horizons(self, part: str) -> Table:
        """Return how far both models err over each horizon."""
        both = [figures["horizons"] for figures in self.figures(part)]
        rows = [
            (f"model {name}", *(digits(value) for value in horizons["greybox"]))
            for name, horizons in zip(MODELS, both, strict=True)
        ]
        header = ("model", *(str(step) for step in both[0]["steps"]))
        return Table(f"{part}: RMSE / {self.unit} over the horizon in samples", header, tuple(rows))

    def parameters(self) -> list[Table]:
        """Return the parameters of both models side by side, as far as they are told."""
        found = []
        for mode in (name for name in self.parts if name != CYCLES):
            both = [figures.get("parameters", {}).get("estimates", {}) for figures in self.figures(mode)]
            names = dict.fromkeys([*both[0], *both[1]])
            rows = [(_called(name), *(_cell(known.get(name)) for known in both)) for name in names]
            if rows:
                header = ("parameter", *(f"model {name}" for name in MODELS))
                found.append(Table(f"{mode}: parameters", header, tuple(rows)))
        return found

    @property
    def notices(self) -> tuple[str, ...]:
        """What a reader should know of the tests and of either model."""
        ours, theirs = self.first.notices, self.second.notices
        left = [f"{self.left_out} tests are left out: one of the models was identified from them"]
        return (
            *(left if self.left_out else []),
            *self.lacking,
            *(each for each in ours if each in theirs),
            *(f"model A: {each}" for each in ours if each not in theirs),
            *(f"model B: {each}" for each in theirs if each not in ours),
        )

    @property
    def metrics(self) -> dict[str, Any]:
        """All figures, in the form of `comparison.json`."""
        return {
            "unit": self.unit,
            "left_out": self.left_out,
            "A": self.first.metrics,
            "B": self.second.metrics,
            "better": {name: self.verdict(name)[0] for name in self.parts},
        }

    def files(self) -> dict[str, bytes]:
        """Return `comparison.json` and `tables.md` with what they hold."""
        said = [f"{name}: {self.verdict(name)[1]}" for name in self.parts]
        text = markdown(self.tables(), [*said, *self.notices], title="Comparison")
        return {
            COMPARISON_FILE: canonical_json(self.metrics),
            TABLES_FILE: text.encode("utf-8", errors="backslashreplace"),
        }


def compare(
    first: Hitch, second: Hitch, campaign: Campaign, *, progress: Progress | None = None
) -> ModelComparison:
    """Compare two models on the tests of a campaign that neither identification has used.

    Args:
        first, second: identified hitches, called A and B.
        campaign: logs; those either identification used are left out, recognised by their content.
        progress: called with what is being done and the fraction of all work that is done.

    Raises:
        InputError: no test is left, or the models have no direction or not one clock in common.
        SettingsError: a unit is of another dimension than a model's.
    """
    for each in (first, second):
        checks.instance(each, Hitch, "model", "a model as hitchid.load returns it")
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
    left, lacking = with_covariates(unseen, first, second)
    cut_at = first.cut_at(campaign.units)
    one = validate(first, left, cut_at=cut_at, progress=part(report, 0.0, 0.5, "model A"))
    other = validate(second, left, cut_at=cut_at, progress=part(report, 0.5, 0.5, "model B"))
    found = ModelComparison(one, other, len(campaign.records) - len(unseen.records), first.step_s, lacking)
    if not found.parts:
        raise InputError("the models have no test in common; required tests of a direction that both have")
    return found


def _called(name: str) -> str:
    return name.replace("_", " ")


def _cell(each: Mapping[str, Any] | None) -> str:
    """Return a parameter as `K = 39.4 ± 0.6 mm/(s·A)`, or what is known of one that is not determined."""
    if each is None:
        return "not in the model"
    if not each["determined"]:
        return each["verdict"]
    unit = "" if each["unit"] == "1" else f" {each['unit']}"
    return f"{each['symbol']} = {stated(each['value'], each['standard_error'])}{unit}"
