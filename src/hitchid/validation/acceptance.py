"""Acceptance: whether the figures of a validation keep limits."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from decimal import Context
from fractions import Fraction
from itertools import count
from math import inf, isfinite
from typing import Any, NamedTuple, TypeGuard

from hitchid.data.units import UNITS
from hitchid.validation.limits import BASELINES, CYCLES, AcceptanceLimits, DirectionLimits, FigureLimits
from hitchid.validation.tables import RUNS
from hitchid.validation.uncertainty import COVERAGE

NO_TEST = "missing: no unseen test"


@dataclass(frozen=True)
class Check:
    """One limit and what was found.

    Attributes:
        mode: `lifting`, `lowering` or `cycles`.
        name: what is limited, unique among the checks of a file.
        limit: what was required, with its unit.
        found: what came, with its unit, or why there is no figure.
        passed: whether the limit is kept.
    """

    mode: str
    name: str
    limit: str
    found: str
    passed: bool


@dataclass(frozen=True)
class Acceptance:
    """All limits of a file and what was found."""

    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Tell whether every limit is kept."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    def describe(self) -> dict[str, object]:
        """Return the verdict and every check, as JSON can hold them."""
        return {"passed": self.passed, "checks": [asdict(check) for check in self.checks]}


def check_limits(metrics: Mapping[str, Any], limits: AcceptanceLimits) -> Acceptance:
    """Hold the figures of a validation against limits.

    A figure that is not there, or diverged, keeps no limit.

    Args:
        metrics: in the form of `metrics.json`: errors in the logs' unit, R², `within_1` and coverage as
            fractions, fit in percent.
        limits: of `read_limits`.

    Raises:
        SettingsError: the limits cannot be converted to the unit of the figures.
    """
    unit = metrics["unit"]
    limits.check_convertible(unit)
    error = _FigureKind("RMSE", limits.unit, _exact(UNITS[unit].factor) / _exact(UNITS[limits.unit].factor))
    checks: list[Check] = []
    for direction, direction_limits in limits.by_direction.items():
        checks += _mode_checks(_DirectionFigures.of(metrics, direction), direction_limits, error)
    return Acceptance(tuple(checks))


def line(check: Check) -> str:
    """Return a check as one line for a terminal."""
    verdict = "pass" if check.passed else "fail"
    text = f"{verdict}  {check.name} {check.found}, required {check.limit}"
    # The name of a log may hold anything, a line break too.
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


class _FigureKind(NamedTuple):
    """What a figure is called, the unit it is told in, and the factor that takes it there."""

    title: str
    unit: str
    scale: Fraction = Fraction(1)
    at_least: bool = False

    def allowed_range(self, limit: float) -> "_AllowedRange":
        return _AllowedRange(minimum=limit) if self.at_least else _AllowedRange(maximum=limit)

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
    """One direction of `metrics.json`, or its cycles, in one layout."""

    direction: str
    tests: int
    runs: Mapping[str, Mapping[str, float | None]]
    per_test: Mapping[str, Mapping[str, float | None]]
    horizon: Mapping[int, float | None]
    covered: float | None
    baselines: Mapping[str, Mapping[str, Mapping[str, float | None]]]

    @staticmethod
    def of(metrics: Mapping[str, Any], direction: str) -> "_DirectionFigures":
        section_metrics = metrics[CYCLES] if direction == CYCLES else metrics["channels"].get(direction, {})
        # Cycles hold their baselines beside the grey box, directions hold all but the benchmark apart.
        models = {**section_metrics, **section_metrics.get("baselines", {})}
        horizons = section_metrics.get("horizons", {"steps": [], "greybox": []})
        return _DirectionFigures(
            direction=direction,
            tests=len(section_metrics.get("tests", ())),
            runs=section_metrics.get("greybox", {}),
            per_test={name: test["free_run"] for name, test in section_metrics.get("per_test", {}).items()},
            horizon=dict(zip(horizons["steps"], horizons["greybox"], strict=True)),
            covered=section_metrics["bands"]["free_run"]["covered"] if "bands" in section_metrics else None,
            baselines={name: models[name] for name in BASELINES if name in models},
        )


def _mode_checks(
    section: _DirectionFigures, direction_limits: DirectionLimits, error: _FigureKind
) -> Iterator[Check]:
    if direction_limits.tests is not None:
        at_least = _AllowedRange(minimum=float(direction_limits.tests))
        yield _check(section, "unseen tests", float(section.tests), _FigureKind("", "1"), at_least)
    for run, label in RUNS.items():
        yield from _run_checks(section, run, label, getattr(direction_limits, run), error)
    yield from _worst_checks(section, direction_limits.worst_test, error)
    for steps, limit in (direction_limits.horizon or {}).items():
        name = f"{steps} sample{'s' if steps > 1 else ''} ahead, RMSE"
        yield _check(section, name, _horizon_figure(section, steps), error, error.allowed_range(limit))
    if direction_limits.coverage is not None:
        kind = _FigureKind("", "percent", Fraction(100))
        covered = "missing: no bands" if section.covered is None else section.covered
        name = f"inside the {100 * COVERAGE:.0f} % band"
        yield _check(section, name, covered, kind, _AllowedRange(*direction_limits.coverage))
    for baseline in direction_limits.better_than or ():
        yield from _baseline_checks(section, baseline, error)


def _kinds(error: _FigureKind) -> dict[str, _FigureKind]:
    """Return how each figure is told; `error` tells the unit of errors."""
    return {
        "rmse": error,
        "mae": error._replace(title="MAE"),
        "max_abs": error._replace(title="max abs"),
        "r2": _FigureKind("R²", "1", at_least=True),
        "fit": _FigureKind("fit", "percent", at_least=True),
        # Limits in another unit than the logs' have no such limit, so the logs' unit is the errors' here.
        "within_1": _FigureKind(error.format("within 1"), "percent", Fraction(100), at_least=True),
    }


def _given_limits(limits: FigureLimits | None) -> dict[str, float]:
    return {} if limits is None else {key: limit for key, limit in limits if limit is not None}


def _run_checks(
    section: _DirectionFigures, run: str, label: str, limits: FigureLimits | None, error: _FigureKind
) -> Iterator[Check]:
    kinds = _kinds(error)
    for key, limit in _given_limits(limits).items():
        figure = section.runs[run][key] if run in section.runs else f"missing: no {label}"
        kind = kinds[key]
        yield _check(section, f"{label}, {kind.title}", figure, kind, kind.allowed_range(limit))


def _worst_checks(
    section: _DirectionFigures, limits: FigureLimits | None, error: _FigureKind
) -> Iterator[Check]:
    kinds = _kinds(error)
    for key, limit in _given_limits(limits).items():
        kind = kinds[key]
        figures_by_test = {test: figures[key] for test, figures in section.per_test.items()}
        worst = max(figures_by_test, key=lambda test: _severity(figures_by_test[test], kind), default="")
        figure = figures_by_test.get(worst, NO_TEST)
        yield _check(
            section, f"worst test, {kind.title}", figure, kind, kind.allowed_range(limit), f" in {worst}"
        )


def _severity(figure: float | None, kind: _FigureKind) -> float:
    if not _finite(figure):
        return inf
    return -figure if kind.at_least else figure


def _horizon_figure(section: _DirectionFigures, steps: int) -> float | str | None:
    if steps in section.horizon:
        return section.horizon[steps]
    longest = max(section.horizon, default=0)
    return f"missing: tests reach {longest} ahead"


def _baseline_checks(section: _DirectionFigures, baseline: str, error: _FigureKind) -> Iterator[Check]:
    """Compare the grey box with a baseline in each run that both have."""
    runs = section.baselines.get(baseline, {})
    common_runs = [run for run in RUNS if run in runs and run in section.runs]
    requirement = "below the baseline's"
    if not common_runs:
        result = f"missing: {'no run of both' if runs else 'no such baseline'}" if section.tests else NO_TEST
        yield Check(section.direction, f"{section.direction}: RMSE vs {baseline}", requirement, result, False)
    for run in common_runs:
        name = f"{section.direction}: {RUNS[run]} vs {baseline}, RMSE"
        own_rmse, baseline_rmse = section.runs[run]["rmse"], runs[run]["rmse"]
        if not _finite(own_rmse):
            yield Check(section.direction, name, requirement, "diverged", False)
        elif not _finite(baseline_rmse):
            yield Check(
                section.direction, name, requirement, f"nothing to compare: {baseline} diverged", False
            )
        else:
            one, other = _exact(own_rmse) * error.scale, _exact(baseline_rmse) * error.scale
            result, limit = next(
                pair
                for pair in zip(_decimal_texts(one), _decimal_texts(other), strict=True)
                if (Fraction(pair[0]) < Fraction(pair[1])) == (one < other)
            )
            yield Check(
                section.direction, name, f"below {error.format(limit)}", error.format(result), one < other
            )


def _check(
    section: _DirectionFigures,
    name: str,
    figure: float | str | None,
    kind: _FigureKind,
    allowed: _AllowedRange,
    location: str = "",
) -> Check:
    """Hold one figure against its limits.

    Args:
        section: where the figure stands.
        name: what the figure is.
        figure: as `metrics.json` has it; None where it diverged, text where there is none.
        kind: how it is told.
        allowed: the limits, in the unit of `kind`.
        location: where the figure was found.
    """
    passed = False
    if isinstance(figure, str):
        result = figure if section.tests else NO_TEST
    elif not _finite(figure):
        result = f"diverged{location}"
    else:
        value = _exact(figure) * kind.scale
        passed = allowed.contains(value)
        result = kind.format(_shortest_consistent(value, allowed.contains)) + location
    return Check(section.direction, f"{section.direction}: {name}", kind.format(allowed.text), result, passed)


def _finite(figure: float | None) -> TypeGuard[float]:
    return figure is not None and isfinite(figure)


def _exact(number: float) -> Fraction:
    """Return a number as it is written: 57 % of the samples must not miss a limit of 57 by rounding."""
    return Fraction(repr(float(number)))


def _number_text(number: float) -> str:
    return repr(float(number)).removesuffix(".0")


def _decimal_texts(value: Fraction) -> Iterator[str]:
    """Yield a number with three significant digits, and with more and more of them."""
    for digits in count(3):
        yield str(Context(prec=digits).divide(value.numerator, value.denominator))


def _shortest_consistent(value: Fraction, predicate: Callable[[Fraction], bool]) -> str:
    """Return the shortest spelling of a number that keeps the limits just when the number does."""
    return next(text for text in _decimal_texts(value) if predicate(Fraction(text)) == predicate(value))
