"""Writes benchmarks/gauntlet.md: what came of every run, set by set."""

import os
import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import version

from .bars import TRUTH_COVERAGE, ZOO, Bars, format_bar
from .outcome import Outcome

HEAD = """# The gauntlet

Default `identify` and `validate` on measured data and on made-up campaigns: `make gauntlet`, single runs by
`python -m benchmarks.gauntlet --help`. A figure that is worse than its bar by more than 5 % fails, and so
does whatever ends in neither a model nor a refusal that is right. Errors are in the unit of the set.
"""
LONGEST = 160


def page(outcomes: Sequence[Outcome], bars: Bars, *, left_out: Sequence[str], seed: int) -> str:
    """Return the page as Markdown.

    Args:
        outcomes: of all runs, their failures found.
        bars: run to figure to its bar.
        left_out: measured sets whose folder is missing.
        seed: of the first campaign that was drawn anew.
    """
    sets = [outcome for outcome in outcomes if not outcome.name.startswith(ZOO)]
    zoo = sorted((o for o in outcomes if o.name.startswith("zoo ")), key=_order)
    (total,) = (outcome for outcome in outcomes if outcome.name == ZOO)
    failed = [outcome for outcome in outcomes if outcome.failures]
    text = [
        HEAD,
        f"\n{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, jax "
        f"{version('jax')}; {len(outcomes) - 1} runs, {len(failed)} of them with a failure. The ones drawn "
        f"from the commit began at seed {seed}.\n",
        *(f"\n**Left out:** {name}, its folder is missing.\n" for name in left_out),
        "\n## Measured sets\n\n| set | figure | here | bar |\n| --- | --- | ---: | ---: |\n",
        *(line for outcome in sets for line in _figures(outcome, bars)),
        "\n| set | result | seconds by stage |\n| --- | --- | --- |\n",
        *(f"| {outcome.name} | {outcome.result} | {_seconds(outcome)} |\n" for outcome in sets),
        "\n### Verdicts on parameters\n",
        *(_verdicts(outcome) for outcome in sets if outcome.verdicts),
        f"\n## Zoo\n\n{total.description}",
        f"; {total.figures[TRUTH_COVERAGE]:.1%} of them hold it.\n"
        if TRUTH_COVERAGE in total.figures
        else ".\n",
        "\n| run | plant and logs | result | R² unseen | s |\n| --- | --- | --- | --- | ---: |\n",
        *(_campaign(outcome) for outcome in zoo),
    ]
    missed = [outcome for outcome in zoo if outcome.verdicts]
    if missed:
        text += ["\n### Misses\n\n", *(line for o in missed for line in _listed(o.name, o.verdicts))]
    if failed:
        text += ["\n## Failures\n\n", *(line for o in failed for line in _listed(o.name, o.failures))]
    return "".join(text)


def _order(outcome: Outcome) -> tuple[str, int]:
    _, seed, kind = outcome.name.replace(",", "").split()
    return kind, int(seed)


def _figures(outcome: Outcome, bars: Bars) -> Iterable[str]:
    set_bars = bars.get(outcome.name, {})
    for name, value in outcome.figures.items():
        bar = format_bar(set_bars[name]) if name in set_bars else ""
        yield f"| {outcome.name} | {name} | {value:.4g} | {bar} |\n"


def _seconds(outcome: Outcome) -> str:
    return ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in outcome.seconds.items())


def _verdicts(outcome: Outcome) -> str:
    return f"\n{outcome.name}\n\n" + "".join(f"- {_line(sentence)}\n" for sentence in outcome.verdicts)


def _campaign(outcome: Outcome) -> str:
    fits = [f"{value:.3f}" for name, value in outcome.figures.items() if name.endswith("r2")]
    total_s = sum(seconds for stage, seconds in outcome.seconds.items() if stage != "draw")
    result = f"{outcome.result}{', failed' if outcome.failures else ''}"
    return f"| {outcome.name} | {outcome.description} | {result} | {', '.join(fits)} | {total_s:.1f} |\n"


def _listed(name: str, sentences: Iterable[str]) -> Iterable[str]:
    return (f"- {name}: {_line(sentence)}\n" for sentence in sentences)


def _line(sentence: str) -> str:
    text = " ".join(sentence.split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"
