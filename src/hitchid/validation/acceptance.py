"""Acceptance: whether the figures of a validation keep limits."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from decimal import Context
from fractions import Fraction
from itertools import count
from math import inf, isfinite
from typing import Any, NamedTuple, TypeGuard

from hitchid.data.units import UNITS
from hitchid.validation.limits import BASELINES, CYCLES, FigureLimits, Limits, ModeLimits
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


def check_limits(metrics: Mapping[str, Any], limits: Limits) -> Acceptance:
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
    error = _Kind("RMSE", limits.unit, _exact(UNITS[unit].factor) / _exact(UNITS[limits.unit].factor))
    checks: list[Check] = []
    for mode, demanded in limits.modes.items():
        checks += _mode_checks(_Section.of(metrics, mode), demanded, error)
    return Acceptance(tuple(checks))


def line(check: Check) -> str:
    """Return a check as one line for a terminal."""
    verdict = "pass" if check.passed else "fail"
    text = f"{verdict}  {check.name} {check.found}, required {check.limit}"
    # The name of a log may hold anything, a line break too.
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


class _Kind(NamedTuple):
    """What a figure is called, the unit it is told in, and the factor that takes it there."""

    title: str
    unit: str
    scale: Fraction = Fraction(1)
    at_least: bool = False

    def range(self, limit: float) -> "_Range":
        return _Range(least=limit) if self.at_least else _Range(most=limit)

    def told(self, number: str) -> str:
        symbol = {"percent": "%", "1": ""}.get(self.unit, self.unit)
        return f"{number} {symbol}".rstrip()


class _Range(NamedTuple):
    least: float = -inf
    most: float = inf

    def holds(self, value: Fraction) -> bool:
        least, most = (limit if limit in (-inf, inf) else _exact(limit) for limit in self)
        return least <= value <= most

    @property
    def text(self) -> str:
        if self.least == -inf:
            return f"at most {_plain(self.most)}"
        if self.most == inf:
            return f"at least {_plain(self.least)}"
        return f"{_plain(self.least)} to {_plain(self.most)}"


class _Section(NamedTuple):
    """One direction of `metrics.json`, or its cycles, in one layout."""

    mode: str
    tests: int
    runs: Mapping[str, Mapping[str, float | None]]
    per_test: Mapping[str, Mapping[str, float | None]]
    horizon: Mapping[int, float | None]
    covered: float | None
    baselines: Mapping[str, Mapping[str, Mapping[str, float | None]]]

    @staticmethod
    def of(metrics: Mapping[str, Any], mode: str) -> "_Section":
        found = metrics[CYCLES] if mode == CYCLES else metrics["channels"].get(mode, {})
        # Cycles hold their baselines beside the grey box, directions hold all but the benchmark apart.
        beside = {**found, **found.get("baselines", {})}
        horizons = found.get("horizons", {"steps": [], "greybox": []})
        return _Section(
            mode=mode,
            tests=len(found.get("tests", ())),
            runs=found.get("greybox", {}),
            per_test={name: test["free_run"] for name, test in found.get("per_test", {}).items()},
            horizon=dict(zip(horizons["steps"], horizons["greybox"], strict=True)),
            covered=found["bands"]["free_run"]["covered"] if "bands" in found else None,
            baselines={name: beside[name] for name in BASELINES if name in beside},
        )


def _mode_checks(section: _Section, demanded: ModeLimits, error: _Kind) -> Iterator[Check]:
    if demanded.tests is not None:
        at_least = _Range(least=float(demanded.tests))
        yield _check(section, "unseen tests", float(section.tests), _Kind("", "1"), at_least)
    for run, label in RUNS.items():
        yield from _run_checks(section, run, label, getattr(demanded, run), error)
    yield from _worst_checks(section, demanded.worst_test, error)
    for steps, limit in (demanded.horizon or {}).items():
        name = f"{steps} sample{'s' if steps > 1 else ''} ahead, RMSE"
        yield _check(section, name, _ahead(section, steps), error, error.range(limit))
    if demanded.coverage is not None:
        kind = _Kind("", "percent", Fraction(100))
        covered = "missing: no bands" if section.covered is None else section.covered
        name = f"inside the {100 * COVERAGE:.0f} % band"
        yield _check(section, name, covered, kind, _Range(*demanded.coverage))
    for rival in demanded.better_than or ():
        yield from _rival_checks(section, rival, error)


def _kinds(error: _Kind) -> dict[str, _Kind]:
    """Return how each figure is told; `error` tells the unit of errors."""
    return {
        "rmse": error,
        "mae": error._replace(title="MAE"),
        "max_abs": error._replace(title="max abs"),
        "r2": _Kind("R²", "1", at_least=True),
        "fit": _Kind("fit", "percent", at_least=True),
        # Limits in another unit than the logs' have no such limit, so the logs' unit is the errors' here.
        "within_1": _Kind(error.told("within 1"), "percent", Fraction(100), at_least=True),
    }


def _given(limits: FigureLimits | None) -> dict[str, float]:
    return {} if limits is None else {key: limit for key, limit in limits if limit is not None}


def _run_checks(
    section: _Section, run: str, label: str, limits: FigureLimits | None, error: _Kind
) -> Iterator[Check]:
    kinds = _kinds(error)
    for key, limit in _given(limits).items():
        figure = section.runs[run][key] if run in section.runs else f"missing: no {label}"
        kind = kinds[key]
        yield _check(section, f"{label}, {kind.title}", figure, kind, kind.range(limit))


def _worst_checks(section: _Section, limits: FigureLimits | None, error: _Kind) -> Iterator[Check]:
    kinds = _kinds(error)
    for key, limit in _given(limits).items():
        kind = kinds[key]
        found = {test: figures[key] for test, figures in section.per_test.items()}
        worst = max(found, key=lambda test: _badness(found[test], kind), default="")
        figure = found.get(worst, NO_TEST)
        yield _check(section, f"worst test, {kind.title}", figure, kind, kind.range(limit), f" in {worst}")


def _badness(figure: float | None, kind: _Kind) -> float:
    if not _finite(figure):
        return inf
    return -figure if kind.at_least else figure


def _ahead(section: _Section, steps: int) -> float | str | None:
    if steps in section.horizon:
        return section.horizon[steps]
    reached = max(section.horizon, default=0)
    return f"missing: tests reach {reached} ahead"


def _rival_checks(section: _Section, rival: str, error: _Kind) -> Iterator[Check]:
    """Compare the grey box with a baseline in each run that both have."""
    runs = section.baselines.get(rival, {})
    both = [run for run in RUNS if run in runs and run in section.runs]
    below = "below the baseline's"
    if not both:
        found = f"missing: {'no run of both' if runs else 'no such baseline'}" if section.tests else NO_TEST
        yield Check(section.mode, f"{section.mode}: RMSE vs {rival}", below, found, False)
    for run in both:
        name = f"{section.mode}: {RUNS[run]} vs {rival}, RMSE"
        ours, theirs = section.runs[run]["rmse"], runs[run]["rmse"]
        if not _finite(ours):
            yield Check(section.mode, name, below, "diverged", False)
        elif not _finite(theirs):
            yield Check(section.mode, name, below, f"nothing to compare: {rival} diverged", False)
        else:
            one, other = _exact(ours) * error.scale, _exact(theirs) * error.scale
            found, limit = next(
                pair
                for pair in zip(_spellings(one), _spellings(other), strict=True)
                if (Fraction(pair[0]) < Fraction(pair[1])) == (one < other)
            )
            yield Check(section.mode, name, f"below {error.told(limit)}", error.told(found), one < other)


def _check(
    section: _Section, name: str, figure: float | str | None, kind: _Kind, within: _Range, place: str = ""
) -> Check:
    """Hold one figure against its limits.

    Args:
        section: where the figure stands.
        name: what the figure is.
        figure: as `metrics.json` has it; None where it diverged, text where there is none.
        kind: how it is told.
        within: the limits, in the unit of `kind`.
        place: where the figure was found.
    """
    passed = False
    if isinstance(figure, str):
        found = figure if section.tests else NO_TEST
    elif not _finite(figure):
        found = f"diverged{place}"
    else:
        value = _exact(figure) * kind.scale
        passed = within.holds(value)
        found = kind.told(_agreeing(value, within.holds)) + place
    return Check(section.mode, f"{section.mode}: {name}", kind.told(within.text), found, passed)


def _finite(figure: float | None) -> TypeGuard[float]:
    return figure is not None and isfinite(figure)


def _exact(number: float) -> Fraction:
    """Return a number as it is written: 57 % of the samples must not miss a limit of 57 by rounding."""
    return Fraction(repr(float(number)))


def _plain(number: float) -> str:
    return repr(float(number)).removesuffix(".0")


def _spellings(value: Fraction) -> Iterator[str]:
    """Yield a number with three significant digits, and with more and more of them."""
    for digits in count(3):
        yield str(Context(prec=digits).divide(value.numerator, value.denominator))


def _agreeing(value: Fraction, holds: Callable[[Fraction], bool]) -> str:
    """Return the shortest spelling of a number that keeps the limits just when the number does."""
    return next(text for text in _spellings(value) if holds(Fraction(text)) == holds(value))
