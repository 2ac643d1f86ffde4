"""Leaderboard of models on the same tests: errors, ranks, and which differences are significant."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations
from typing import TYPE_CHECKING

from hitchid._support.metrics import SIGNIFICANCE, holm
from hitchid._support.numbers import count, digits
from hitchid._support.records import short_repr
from hitchid._support.tables import Summarised, Table, dataframe
from hitchid.validation.results import (
    FREE_RUN,
    GREYBOX,
    MIN_TESTS,
    ONE_STEP,
    Accuracy,
    ModelFigures,
    Predictions,
    RunFigures,
)

if TYPE_CHECKING:
    from pandas import DataFrame


class Standing(Enum):
    """Comparison of one model with the best one of its section, in free run."""

    BEST = "best"
    WORSE = "significantly worse"
    SIMILAR = "not distinguishable"
    UNTESTED = "too few tests to tell"


@short_repr
@dataclass(frozen=True)
class LeaderboardRow:
    """One model on the tests of one section.

    Attributes:
        section: a direction or `cycles`.
        label: letter of the model.
        name: of the model.
        rank: 1 for the smallest RMSE in free run; models with the same RMSE share a rank.
        tests: number of tests.
        free_run, one_step: errors over these tests; no one step without a prediction over horizons.
        horizons: horizon in samples to RMSE and its standard error, in the displacement's unit.
        standing: comparison with the best model.
        p_value: of the best model having a smaller error than this one (one-sided, adjusted by Holm for all
            pairs of models); None for the best model.
    """

    section: str
    label: str
    name: str
    rank: int
    tests: int
    free_run: RunFigures
    one_step: RunFigures | None
    horizons: Mapping[int, tuple[float | None, float | None]]
    standing: Standing
    p_value: float | None

    @property
    def tested(self) -> float | None:
        """The p-value; None for the best model, and where the tests are too few for one."""
        return None if self.standing is Standing.UNTESTED else self.p_value

    def describe(self) -> dict[str, object]:
        """Return the row as JSON values, without its section."""
        runs = {ONE_STEP: self.one_step, FREE_RUN: self.free_run}
        return {
            "rank": self.rank,
            "model": self.label,
            "name": self.name,
            "tests": self.tests,
            **{run: figures.main for run, figures in runs.items() if figures is not None},
            "horizons": {
                "steps": list(self.horizons),
                "rmse": [rmse for rmse, _ in self.horizons.values()],
                "rmse_error": [error for _, error in self.horizons.values()],
            },
            "standing": self.standing.value,
            "p_value": self.p_value,
        }

    def columns(self, unit: str) -> dict[str, object]:
        """Return the row as columns of a table; errors are in `unit`, the fit is in percent."""
        columns: dict[str, object] = {
            "section": self.section,
            "rank": self.rank,
            "model": self.name,
            "tests": self.tests,
            **ModelFigures(self.one_step, self.free_run).columns(unit),
        }
        for steps, (rmse, error) in self.horizons.items():
            columns |= {f"{steps}_steps_rmse_{unit}": rmse, f"{steps}_steps_rmse_error_{unit}": error}
        return {**columns, "standing": self.standing.value, "p_value": self.p_value}


@dataclass(frozen=True, repr=False)
class Leaderboard(Summarised):
    """Models on the same tests, the best of each section first.

    Attributes:
        unit: of every error.
        rows: of all sections, by rank.
    """

    unit: str
    rows: tuple[LeaderboardRow, ...]

    def __iter__(self) -> Iterator[LeaderboardRow]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def section(self, name: str) -> tuple[LeaderboardRow, ...]:
        """Return the rows of a direction or of `cycles`, by rank."""
        return tuple(row for row in self.rows if row.section == name)

    def to_dataframe(self) -> "DataFrame":
        """Return a DataFrame with one row for each section and model; units are in the column names.

        Raises:
            InputError: pandas is not installed.
        """
        return dataframe([row.columns(self.unit) for row in self.rows])

    def _summary(self) -> Table:
        names = dict.fromkeys(row.name for row in self.rows)
        header = ("section", "rank", "model", f"free run, RMSE / {self.unit}", "fit / %", "difference")
        rows = (
            (
                row.section,
                str(row.rank),
                row.name,
                digits(row.free_run.rmse, row.free_run.rmse_error),
                digits(row.free_run.fit, row.free_run.fit_error),
                row.standing.value if row.tested is None else f"{row.standing.value}, p = {row.tested:.2g}",
            )
            for row in self.rows
        )
        return Table(f"Leaderboard of {count(len(names), 'model')}", header, tuple(rows))


def section_rows(
    section: str, names: Mapping[str, str], results: Sequence[Accuracy], free_runs: Predictions
) -> tuple[LeaderboardRow, ...]:
    """Return the rows of one section, by rank.

    The best model is compared with every other by `better_p_value`. It is chosen from the same tests, so the
    p-values are adjusted for all pairs of models, not only for those with the best one (Holm 1979).
    """
    ordered = sorted(zip(names, results, strict=True), key=lambda item: _sort_key(item[1]))
    pairs = list(combinations([label for label, _ in ordered], 2))
    adjusted = dict(zip(pairs, holm([free_runs.better_p_value(*pair) for pair in pairs]), strict=True))
    best = ordered[0][0]
    keys = [_sort_key(accuracy) for _, accuracy in ordered]

    def row(label: str, accuracy: Accuracy) -> LeaderboardRow:
        p_value = adjusted.get((best, label))
        standing = Standing.BEST
        if p_value is not None:
            standing = Standing.WORSE if p_value < SIGNIFICANCE else Standing.SIMILAR
            standing = Standing.UNTESTED if len(accuracy.tests) < MIN_TESTS else standing
        horizons = accuracy.horizons
        errors = zip(horizons.rmse[GREYBOX], horizons.rmse_error[GREYBOX], strict=True)
        return LeaderboardRow(
            section=section,
            label=label,
            name=names[label],
            rank=1 + keys.index(_sort_key(accuracy)),
            tests=len(accuracy.tests),
            free_run=accuracy.free_run(),
            one_step=accuracy.models[GREYBOX].one_step,
            horizons=dict(zip(horizons.steps, errors, strict=True)),
            standing=standing,
            p_value=p_value,
        )

    return tuple(row(label, accuracy) for label, accuracy in ordered)


def _sort_key(accuracy: Accuracy) -> float:
    """Return the RMSE in free run, infinite where the model diverged."""
    rmse = accuracy.free_run().rmse
    return float("inf") if rmse is None else rmse
