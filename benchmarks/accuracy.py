"""Accuracy of default models on unseen tests, the best rival in the same row: the table of README.md.

    python -m benchmarks.accuracy [SET ...]

Free run of a default identification beside the best of all baselines on the same tests, both with the
standard error over tests (jackknife), and whether they differ significantly (5 %, two-sided). R² has
the fit beside it, 100 (1 − √(1 − R²)), since R² of a stroke is near 1 for any model that follows it.
"""

import argparse
import sys

import numpy as np

import hitchid
from hitchid._support import numbers
from hitchid.validation import Accuracy
from hitchid.validation.results import model_name

from .free_run import SETS
from .gauntlet.rivals import best_rival, difference

HEADER = ("data", "unseen tests", "RMSE", "fit / %", "R²", "best rival", "its RMSE", "difference")


def row(name: str, accuracy: Accuracy, unit: str) -> tuple[str, ...]:
    """Return one line of the table."""
    ours, rival = accuracy.free_run(), best_rival(accuracy)
    figures = (
        name,
        str(len(accuracy.tests)),
        f"{numbers.with_error(ours.rmse, ours.rmse_error)} {unit}",
        "" if ours.fit is None else numbers.with_error(ours.fit, ours.fit_error),
        "" if ours.r2 is None else f"{ours.r2:.4f}",
    )
    if rival is None:
        return (*figures, "none", "", "")
    theirs = accuracy.free_run(rival)
    text = f"{numbers.with_error(theirs.rmse, theirs.rmse_error)} {unit}"
    return (*figures, model_name(rival), text, difference(accuracy, rival))


def rows(name: str) -> list[tuple[str, ...]]:
    """Identify one set with every baseline; return a line for each direction."""
    chosen = SETS[name]
    campaign = chosen.campaign()
    options = {} if chosen.forms is None else {"structure": chosen.forms}
    result = hitchid.validate(hitchid.identify(campaign, rivals=True, **options).model, campaign)
    lines = [row(f"{name}, {part}", accuracy, result.unit) for part, accuracy in result.accuracy.items()]
    if chosen.skipped:
        (record,) = campaign.held_out("lifting")
        error = (result.model.simulate(record).displacement - record.displacement)[chosen.skipped :]
        official = f"{np.sqrt(np.mean(error**2)):.3g} {result.unit}"
        label = f"{name}, without {chosen.skipped} samples"
        lines.append((label, "1", official, *[""] * (len(HEADER) - 3)))
    return lines


def main() -> None:
    """Print the table, set by set."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="*", default=[], choices=[*SETS, []])
    names = parser.parse_args().sets or list(SETS)
    sys.stdout.write(f"| {' | '.join(HEADER)} |\n| {' | '.join(['---'] * len(HEADER))} |\n")
    for name in names:
        for line in rows(name):
            sys.stdout.write(f"| {' | '.join(line)} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
