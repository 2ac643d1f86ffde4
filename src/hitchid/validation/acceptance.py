"""Acceptance: whether the figures of a validation are within limits."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from decimal import Context
from fractions import Fraction
from itertools import count
from math import inf, isfinite
from typing import NamedTuple, TypeGuard

from hitchid._support.records import short_repr
from hitchid._support.tables import DataTable, csv_files
from hitchid.logs.units import UNITS
from hitchid.validation.channels import COVERAGE
from hitchid.validation.limits import AcceptanceLimits, DirectionLimits, FigureLimits
from hitchid.validation.results import GREYBOX, RUNS, Accuracy, ModelFigures, RunFigures

NO_TEST = "missing: no unseen test"


@short_repr
@dataclass(frozen=True)
class Check:
    """One limit and the figure it applies to.

    Attributes:
        direction: `lifting`, `lowering` or `cycles`.
        name: of the figure, unique among the checks of a file.
        limit: the limit with its unit.
        figure: the figure with its unit, or why there is none.
        passed: whether the figure is within the limit.
    """

    direction: str
    name: str
    limit: str
    figure: str
    passed: bool


@short_repr
@dataclass(frozen=True)
class Acceptance:
    """All limits of a file and the figures they apply to."""

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every figure is within its limit."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    def table(self) -> DataTable:
        """Return every check as data."""
        return DataTable.of_rows("limits", map(asdict, self.checks))

    def files(self) -> dict[str, bytes]:
        """Return `tables/limits.csv` with its content."""
        return csv_files([self.table()])

    def describe(self) -> dict[str, object]:
        """Return the verdict and every check as JSON content."""
        return {
            "passed": self.passed,
            "checks": [
                {
                    "mode": check.direction,
                    "name": check.name,
                    "limit": check.limit,
                    "found": check.figure,
                    "passed": check.passed,
                }
                for check in self.checks
            ],
        }


def check_limits(unit: str, accuracy: Mapping[str, Accuracy], limits: AcceptanceLimits) -> Acceptance:
    """Compare the figures of a validation with limits.

    A figure that is missing or diverged fails its limit.

    Args:
        unit: of the errors.
        accuracy: direction, or `cycles`, to its figures.
        limits: of `read_limits`.

    Raises:
        SettingsError: the limits cannot be converted to the unit of the figures.
    """
    limits.check_convertible(unit)
    error = _FigureKind("RMSE", limits.unit, _exact(UNITS[unit].factor) / _exact(UNITS[limits.unit].factor))
    checks: list[Check] = []
    for direction, direction_limits in limits.by_direction.items():
        section = _DirectionFigures.of(direction, accuracy.get(direction))
        checks += _direction_checks(section, direction_limits, error)
    return Acceptance(tuple(checks))


class _FigureKind(NamedTuple):
    """Name of a figure, the unit of its limit, and the factor from the figure's unit to the limit's."""

    title: str
    unit: str
    scale: Fraction = Fraction(1)
    at_least: bool = False

    def allowed_range(self, limit: float) -> "_AllowedRange":
        return _AllowedRange(minimum=limit) if self.at_least else _AllowedRange(maximum=limit)

    def severity(self, figure: float | None) -> float:
        """Return what grows with the error; infinite where a run diverged."""
        if not _finite(figure):
            return inf
        return -figure if self.at_least else figure

    def format(self, number: str) -> str:
        symbol = {"percent": "%", "1": ""}.get(self.unit, self.unit)
        return f"{number} {symbol}".rstrip()


class _AllowedRange(NamedTuple):
    minimum: float = -inf
    maximum: float = inf

    def contains(self, value: Fraction) -> bool:
        minimum, maximum = (limit if limit in (-inf, inf) else _exact(limit) for limit in self)
        return minimum <= value <= maximum

    @property
    def text(self) -> str:
        if self.minimum == -inf:
            return f"at most {_number_text(self.maximum)}"
        if self.maximum == inf:
            return f"at least {_number_text(self.minimum)}"
        return f"{_number_text(self.minimum)} to {_number_text(self.maximum)}"


class _DirectionFigures(NamedTuple):
    """Figures of one direction or of the cycles; empty without an unseen test."""

    direction: str
    tests: int = 0
    models: Mapping[str, ModelFigures] = {}
    per_test: Mapping[str, RunFigures] = {}
    horizon: Mapping[int, float | None] = {}
    covered: float | None = None

    @staticmethod
    def of(direction: str, accuracy: Accuracy | None) -> "_DirectionFigures":
        if accuracy is None:
            return _DirectionFigures(direction)
        horizons = accuracy.horizons
        return _DirectionFigures(
            direction=direction,
            tests=len(accuracy.tests),
            models=accuracy.models,
            per_test=accuracy.per_test,
            horizon=dict(zip(horizons.steps, horizons.rmse[GREYBOX], strict=True)),
            covered=accuracy.bands and accuracy.bands.covered,
        )

    def run(self, name: str, model: str = GREYBOX) -> RunFigures | None:
        return self.models[model].run(name) if model in self.models else None


def _direction_checks(
    section: _DirectionFigures, direction_limits: DirectionLimits, error: _FigureKind
) -> Iterator[Check]:
    if direction_limits.tests is not None:
        at_least = _AllowedRange(minimum=float(direction_limits.tests))
        yield _check(section, "unseen tests", float(section.tests), _FigureKind("", "1"), at_least)
    for run, label in RUNS.items():
        figures = section.run(run)
        for key, kind, limit in _given_limits(direction_limits.run(run), error):
            figure = f"missing: no {label}" if figures is None else figures.value(key)
            yield _check(section, f"{label}, {kind.title}", figure, kind, kind.allowed_range(limit))
    for key, kind, limit in _given_limits(direction_limits.worst_test, error):
        by_test = {test: figures.value(key) for test, figures in section.per_test.items()}
        worst = max(by_test, key=lambda test: kind.severity(by_test[test]), default="")
        figure, allowed = by_test.get(worst, NO_TEST), kind.allowed_range(limit)
        yield _check(section, f"worst test, {kind.title}", figure, kind, allowed, f" in {worst}")
    for steps, limit in (direction_limits.horizon or {}).items():
        name = f"{steps} sample{'s' if steps > 1 else ''} ahead, RMSE"
        longest = max(section.horizon, default=0)
        short = f"missing: the tests are too short; the longest horizon they allow is {longest} samples"
        figure = section.horizon.get(steps, short)
        yield _check(section, name, figure, error, error.allowed_range(limit))
    if direction_limits.coverage is not None:
        kind = _FigureKind("", "percent", Fraction(100))
        covered = "missing: no bands" if section.covered is None else section.covered
        name = f"inside the {100 * COVERAGE:.0f} % band"
        yield _check(section, name, covered, kind, _AllowedRange(*direction_limits.coverage))
    for baseline in direction_limits.better_than or ():
        yield from _baseline_checks(section, baseline, error)


def _given_limits(limits: FigureLimits | None, error: _FigureKind) -> list[tuple[str, _FigureKind, float]]:
    """Return key, kind and limit of each figure that has one; `error` has the unit of errors."""
    kinds = {
        "rmse": error,
        "mae": error._replace(title="MAE"),
        "max_abs": error._replace(title="max abs"),
        "r2": _FigureKind("R²", "1", at_least=True),
        "fit": _FigureKind("fit", "percent", at_least=True),
        # `check_convertible` rejects this limit if the unit of the limits is not that of the logs.
        "within_1": _FigureKind(error.format("within 1"), "percent", Fraction(100), at_least=True),
    }
    given = () if limits is None else limits
    return [(key, kinds[key], limit) for key, limit in given if limit is not None]


def _baseline_checks(section: _DirectionFigures, baseline: str, error: _FigureKind) -> Iterator[Check]:
    """Compare the RMSE of the grey box with a baseline's, in each run of both."""
    pairs = {run: (section.run(run), section.run(run, baseline)) for run in RUNS}
    common = {run: (figures, other) for run, (figures, other) in pairs.items() if figures and other}
    requirement = "below the baseline's"
    if not common:
        absent = (
            "no run (one step or free run) that the grey box and the baseline have in common"
            if baseline in section.models
            else "no such baseline"
        )
        result = f"missing: {absent}" if section.tests else NO_TEST
        yield Check(section.direction, f"{section.direction}: RMSE vs {baseline}", requirement, result, False)
    for run, (figures, other) in common.items():
        name = f"{section.direction}: {RUNS[run]} vs {baseline}, RMSE"
        own_rmse, baseline_rmse = figures.rmse, other.rmse
        if not _finite(own_rmse):
            yield Check(section.direction, name, requirement, "diverged", False)
        elif not _finite(baseline_rmse):
            yield Check(
                section.direction, name, requirement, f"nothing to compare: {baseline} diverged", False
            )
        else:
            exact, exact_limit = _exact(own_rmse) * error.scale, _exact(baseline_rmse) * error.scale
            passed = exact < exact_limit
            result, limit = next(
                pair
                for pair in zip(_decimal_texts(exact), _decimal_texts(exact_limit), strict=True)
                if (Fraction(pair[0]) < Fraction(pair[1])) == passed
            )
            yield Check(section.direction, name, f"below {error.format(limit)}", error.format(result), passed)


def _check(
    section: _DirectionFigures,
    name: str,
    figure: float | str | None,
    kind: _FigureKind,
    allowed: _AllowedRange,
    location: str = "",
) -> Check:
    """Compare one figure with its limits.

    The figure is None where it diverged, text where it is missing; its limits are in the unit of its kind.
    """
    passed = False
    if isinstance(figure, str):
        result = figure if section.tests else NO_TEST
    elif not _finite(figure):
        result = f"diverged{location}"
    else:
        value = _exact(figure) * kind.scale
        passed = allowed.contains(value)
        # The shortest text, from three digits, that is within the limits if the number is.
        texts = _decimal_texts(value)
        shortest = next(text for text in texts if allowed.contains(Fraction(text)) == passed)
        result = kind.format(shortest) + location
    return Check(section.direction, f"{section.direction}: {name}", kind.format(allowed.text), result, passed)


def _finite(figure: float | None) -> TypeGuard[float]:
    return figure is not None and isfinite(figure)


def _exact(number: float) -> Fraction:
    """Return a number at its decimal value, so that 57 % of the samples meet a limit of 57 exactly."""
    return Fraction(repr(float(number)))


def _number_text(number: float) -> str:
    return repr(float(number)).removesuffix(".0")


def _decimal_texts(value: Fraction) -> Iterator[str]:
    """Yield a number with three, four, … significant digits."""
    for digits in count(3):
        yield str(Context(prec=digits).divide(value.numerator, value.denominator))
