"""Two models on tests that neither has seen: which errs less, and whether the tests prove it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchid.campaign import Campaign
from hitchid.errors import InputError
from hitchid.metrics import proven_better
from hitchid.model import Hitch
from hitchid.progress import Progress, part, silent
from hitchid.storage import canonical_json
from hitchid.uncertainty import stated
from hitchid.validation.predictions import Predictions
from hitchid.validation.table import Table, digits, error_cells
from hitchid.validation.tables import error_header, markdown
from hitchid.validation.validate import TABLES_FILE, Validation, validate

COMPARISON_FILE = "comparison.json"
NAMES = ("A", "B")
FEWEST = 3
RUNS = {"free_run": "free run", "one_step": "one step"}


@dataclass(frozen=True)
class ModelComparison:
    """Two models on the same unseen tests.

    Attributes:
        first, second: what the validation of each found; the tests are the same, in the same order.
        left_out: how many tests one of them has seen.
    """

    first: Validation
    second: Validation
    left_out: int

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
        if part == "cycles":
            return both[0]["cycles"], both[1]["cycles"]
        return both[0]["channels"][part], both[1]["channels"][part]

    def free_runs(self, part: str) -> Predictions:
        """Return the tests of one of `parts` with the free runs of both models, `a` and `b`."""
        one, other = self.first.predictions[part], self.second.predictions[part]
        runs = {"a": one.models["free_run"], "b": other.models["free_run"]}
        return Predictions(one.names, one.time_s, one.actual, runs)

    def verdict(self, part: str) -> tuple[str | None, str]:
        """Return which model is proven better in free run, None for neither, and a sentence that says so."""
        tests = self.free_runs(part)
        errors = {name: np.nan_to_num(tests.rmse(name.lower()), nan=np.inf) for name in NAMES}
        told = {name: float(np.sqrt(np.mean(each**2))) for name, each in errors.items()}
        figures = f"RMSE {_told(told['A'])} {self.unit} with A, {_told(told['B'])} {self.unit} with B"
        if len(tests.names) < FEWEST:
            count = f"{len(tests.names)} test{'s' if len(tests.names) > 1 else ''}"
            return None, f"{count}, too few to prove either model better in free run: {figures}"
        for better, worse in (NAMES, NAMES[::-1]):
            if proven_better(errors[better], errors[worse]):
                count = f"{int(np.sum(errors[better] < errors[worse]))} of {len(tests.names)} tests"
                return better, f"{better} errs less in free run, on {count}: {figures}"
        return None, f"the tests prove neither model better in free run: {figures}"

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
            for run, label in RUNS.items()
            for name, figures in zip(NAMES, self.figures(part), strict=True)
        ]
        count = len(self.first.predictions[part].names)
        title = f"{part}: accuracy on {count} test{'s' if count > 1 else ''} that neither has seen"
        return Table(title, error_header(self.unit, "model", "run"), tuple(rows))

    def horizons(self, part: str) -> Table:
        """Return how far both models err over each horizon."""
        both = [figures["horizons"] for figures in self.figures(part)]
        rows = [
            (f"model {name}", *(digits(value) for value in horizons["greybox"]))
            for name, horizons in zip(NAMES, both, strict=True)
        ]
        header = ("model", *(str(step) for step in both[0]["steps"]))
        return Table(f"{part}: RMSE / {self.unit} over the horizon in samples", header, tuple(rows))

    def parameters(self) -> list[Table]:
        """Return the parameters of both models side by side, as far as they are told."""
        found = []
        for mode in (name for name in self.parts if name != "cycles"):
            both = [figures.get("parameters", {}).get("estimates", {}) for figures in self.figures(mode)]
            names = list(dict.fromkeys([*both[0], *both[1]]))

            def cell(known: Mapping[str, Any], name: str) -> str:
                if name not in known:
                    return "not in the model"
                each = known[name]
                return (
                    stated(each["value"], each["standard_error"]) if each["determined"] else each["verdict"]
                )

            rows = []
            for name in names:
                one = both[0].get(name) or both[1][name]
                rows.append((one["symbol"], one["unit"], cell(both[0], name), cell(both[1], name)))
            if rows:
                header = ("parameter", "unit", "model A", "model B")
                found.append(Table(f"{mode}: parameters", header, tuple(rows)))
        return found

    @property
    def notices(self) -> tuple[str, ...]:
        """What a reader should know of the tests."""
        if not self.left_out:
            return ()
        return (f"{self.left_out} tests are left out: one of the models was identified from them",)

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
        InputError: no test is left, or the models have no direction in common.
        SettingsError: a unit is of another dimension than a model's.
    """
    report = progress or silent
    seen = first.provenance.seen | second.provenance.seen
    left = campaign.without(seen)
    if not any(name in second.channels for name in first.channels):
        raise InputError(
            f"model A has channels for {' and '.join(first.channels)}, model B for "
            f"{' and '.join(second.channels)}; required one in common"
        )
    if not left.records:
        raise InputError("one of the models was identified from every test; required tests neither has seen")
    cut_at = first.provenance.cut_at or first.dead_zones
    one = validate(first, left, cut_at=cut_at, progress=part(report, 0.0, 0.5, "model A"))
    other = validate(second, left, cut_at=cut_at, progress=part(report, 0.5, 0.5, "model B"))
    found = ModelComparison(one, other, len(campaign.records) - len(left.records))
    if not found.parts:
        raise InputError("the models have no test in common; required tests of a direction that both have")
    return found


def _told(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "diverged"
