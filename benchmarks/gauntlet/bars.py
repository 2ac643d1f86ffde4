"""Figures against committed bars."""

import tomllib
from collections.abc import Iterable
from pathlib import Path

from .outcome import Outcome

SLACK = 1.05
GOAL = "goal"
BARS = Path(__file__).with_name("bars.toml")
ZOO, TRUTH_COVERAGE = "zoo", "share of determined parameters that hold the truth"
Bars = dict[str, dict[str, dict[str, float]]]


def read_bars(path: Path = BARS) -> Bars:
    """Return run to figure to its bar."""
    return tomllib.loads(path.read_text(encoding="utf-8"))


def holds(bar: dict[str, float], value: float | None) -> bool:
    """Tell whether a figure is at most 5 % worse than its bar; one that is missing or not finite never is."""
    if value is None or not abs(value) < float("inf"):
        return False
    kind, limit = _limit(bar)
    if kind == "most":
        return value <= SLACK * limit
    if kind == "least":
        return value >= limit / SLACK
    return 1 - value <= SLACK * (1 - limit)


def format_bar(bar: dict[str, float]) -> str:
    """Return a bar as a table has it, with the goal where that is not reached yet."""
    kind, limit = _limit(bar)
    sign = "≤" if kind == "most" else "≥"
    return f"{sign} {limit:g}" + (f", goal {sign} {bar[GOAL]:g}" if GOAL in bar else "")


def _limit(bar: dict[str, float]) -> tuple[str, float]:
    """Return the kind of a bar, `most`, `least` or `r2`, and its limit."""
    ((kind, limit),) = ((key, value) for key, value in bar.items() if key != GOAL)
    return kind, limit


def compare(outcomes: Iterable[Outcome], bars: Bars) -> None:
    """Add a failure to each outcome for every figure that misses its bar."""
    for outcome in outcomes:
        for figure, bar in bars.get(outcome.name, {}).items():
            value = outcome.figures.get(figure)
            if not holds(bar, value):
                value_text = "missing" if value is None else f"{value:.4g}"
                outcome.failures.append(f"{figure}: {value_text}, expected {format_bar(bar)}")


def zoo_total(outcomes: Iterable[Outcome]) -> Outcome:
    """Return what all campaigns of the zoo say together."""
    zoo_outcomes = [outcome for outcome in outcomes if outcome.name.startswith("zoo ")]
    determined = sum(outcome.determined for outcome in zoo_outcomes)
    total = Outcome(
        ZOO, f"{len(zoo_outcomes)} campaigns, {determined} determined parameters with a known truth"
    )
    if determined:
        total.figures[TRUTH_COVERAGE] = sum(outcome.covered for outcome in zoo_outcomes) / determined
    return total
