"""The benchmark of the adaptation judges its figures: all parts run, and those that miss a bar are named."""

import math

import numpy as np
import pytest
from benchmarks.adaptation.__main__ import main
from benchmarks.adaptation.constant import error_over
from benchmarks.adaptation.faults import FAULTS, share_refused, with_fault
from benchmarks.adaptation.figure import Figure
from benchmarks.adaptation.measured import judged

import machine
from hitchid.live import AdaptationSettings, Adapter, Changes


@pytest.mark.parametrize(
    ("figure", "holds"),
    [
        (Figure("share", 0.99, least=0.99), True),
        (Figure("share", 0.989, least=0.99), False),
        (Figure("ratio", 1.1, most=1.1), True),
        (Figure("ratio", 1.101, most=1.1), False),
        (Figure("inside", 90.0, 87.0, 93.0), True),
        (Figure("inside", 93.1, 87.0, 93.0), False),
        (Figure("none", math.nan, least=0.0), False),
    ],
)
def test_a_figure_holds_within_its_bar_alone(figure, holds):
    assert figure.holds == holds


def test_default_parts_run_and_each_miss_is_named(capsys):
    parts = {
        "first": lambda: [Figure("share refused", 0.5, least=0.99), Figure("ratio", 1.0, most=1.1)],
        "second": lambda: [Figure("inside", 95.0, 87.0, 93.0)],
        "good": lambda: [Figure("ratio", 1.0, most=1.1)],
        "slow": lambda: pytest.fail("it is not among those that run by default"),
    }
    with pytest.raises(SystemExit) as ended:
        main([], parts, ["first", "second"])
    assert "share refused: got 0.5, expected at least 0.99" in ended.value.code
    assert "inside: got 95, expected 87 to 93" in ended.value.code
    assert "ratio" not in ended.value.code
    assert "ratio: got 1, expected at most 1.1" in capsys.readouterr().out
    main(["good"], parts)
    with pytest.raises(SystemExit, match="got fault, expected names out of faults"):
        main(["fault"], {"faults": list})


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_changes_the_strokes_it_names_and_no_other(fault):
    strokes = machine.strokes(24, seed=3, samples=60)
    displacement = machine.stream(strokes)[1]
    faulty, affected = with_fault(fault, displacement, strokes)
    changed = ~((faulty == displacement) | (np.isnan(faulty) & np.isnan(displacement)))
    for stroke in strokes:
        assert changed[stroke.begin : stroke.end].any() == (stroke.begin in affected)


def test_a_stroke_that_is_learned_from_lowers_the_share(monkeypatch):
    adapter = Adapter(machine.MODEL, AdaptationSettings())
    strokes = machine.strokes(2, seed=3, samples=60)
    faulty = strokes[1]._replace(displacement=np.full_like(strokes[1].displacement, np.nan))
    both = {stroke.begin for stroke in strokes}
    assert share_refused("none", adapter, [strokes[0], faulty], both).value == 0.5
    assert math.isnan(share_refused("none", adapter, strokes, set()).value)


@pytest.mark.parametrize(
    ("squares", "ratio"),
    [
        ({"cycle": [(1.0, 4.0, 10)], "lifting": [(9.0, 1.0, 10)]}, 0.5),
        ({"lifting": [(1.0, 8.0, 10), (3.0, 8.0, 10)], "lowering": [(0.0, 0.0, 20)]}, 0.5),
    ],
)
def test_measured_logs_are_judged_whole(squares, ratio):
    figure = judged("machine", machine.MODEL, squares)
    assert figure.value == pytest.approx(ratio)
    assert figure.most == 1.0


def test_changes_are_judged_on_strokes_that_no_adaptation_saw():
    strokes = machine.strokes(6, seed=5, samples=60, gain=1.1)
    error = error_over(machine.MODEL, strokes)
    right, wrong = Changes(gain=float(np.log(1.1))), Changes(gain=-0.1)
    for direction in machine.DIRECTIONS:
        # Noise alone is left: of three strokes of a hundred samples its mean square is known within a tenth.
        assert error(direction, right) < 1.2 * machine.NOISE < error(direction, Changes())
        assert error(direction, Changes()) < error(direction, wrong)
