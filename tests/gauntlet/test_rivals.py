"""A model beside the best of its rivals: who is best, and whether the difference is more than chance."""

import numpy as np
import pytest
from benchmarks.accuracy import HEADER, row
from benchmarks.gauntlet.rivals import ALIKE, BETTER, SINGLE, WORSE, best_rival, difference

from hitchid.validation import Accuracy, ModelFigures, Predictions, RunFigures
from hitchid.validation.results import Horizons

SAMPLES = 50


def accuracy(ours, **rivals):
    """Return the results of models whose error is constant in each test, mm."""
    count, wave = len(ours), np.sin(np.arange(SAMPLES))
    actual = tuple(10.0 * wave for _ in ours)

    def runs(errors):
        return tuple(10.0 * wave + error for error in errors)

    errors = {"free_run": ours, "benchmark": ours, **rivals}
    tests = Predictions(
        names=tuple(f"test-{number}" for number in range(count)),
        time_s=tuple(np.arange(SAMPLES) for _ in ours),
        actual=actual,
        models={name: runs(values) for name, values in errors.items()},
    )
    figures = {
        name: ModelFigures(free_run=RunFigures.of(actual, runs(values))) for name, values in rivals.items()
    }
    figures |= {
        name: ModelFigures(free_run=RunFigures.of(actual, runs(ours))) for name in ("benchmark", "greybox")
    }
    return Accuracy(figures, Horizons((), {}), {}, tests)


OURS = (1.0, 1.1, 0.9, 1.05)


@pytest.mark.parametrize(
    ("rival", "verdict"),
    [
        (tuple(2.0 * error for error in (1.0, 1.05, 0.95, 1.0)), BETTER),
        (tuple(0.5 * error for error in (1.0, 1.05, 0.95, 1.0)), WORSE),
        ((0.6, 1.6, 0.5, 1.7), ALIKE),
    ],
)
def test_a_difference_is_told_by_the_scatter_over_tests(rival, verdict):
    assert difference(accuracy(OURS, arx=rival), "arx") == verdict


def test_one_test_tells_no_difference():
    assert difference(accuracy((1.0,), arx=(9.0,)), "arx") == SINGLE


def test_the_best_rival_is_neither_the_model_nor_its_benchmark():
    assert best_rival(accuracy(OURS, arx=(3.0,) * 4, narx=(2.0,) * 4)) == "narx"
    assert best_rival(accuracy(OURS)) is None


def test_a_row_has_the_rival_and_a_standard_error():
    cells = row("rig, lifting", accuracy(OURS, arx=(2.0, 2.2, 1.8, 2.1)), "mm")
    assert len(cells) == len(HEADER)
    assert "±" in cells[2]
    assert cells[5:] == ("ARX", cells[6], BETTER)
