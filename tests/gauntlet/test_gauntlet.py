"""The gauntlet's own rules: bars, refusals, runs that hang or die."""

import os
import signal

import pytest
from benchmarks.gauntlet.bars import compare, holds, read_bars, zoo_total
from benchmarks.gauntlet.measured import SETS, WARM_SETS
from benchmarks.gauntlet.outcome import HUNG, MODEL, REFUSED, TRACEBACK, Outcome, run_guarded
from benchmarks.gauntlet.page import page
from benchmarks.gauntlet.workers import Job, run_jobs

from hitchid.errors import InputError


@pytest.mark.parametrize(
    ("bar", "good", "bad"),
    [
        ({"most": 5.0}, 5.2, 5.3),
        ({"least": 0.88}, 0.84, 0.83),
        ({"r2": 0.99}, 0.9896, 0.9894),
        ({"most": 5.0}, 0.0, None),
        ({"most": 5.0}, -1.0, float("nan")),
    ],
)
def test_a_figure_a_twentieth_worse_than_its_bar_fails(bar, good, bad):
    assert holds(bar, good)
    assert not holds(bar, bad)


def test_every_bar_belongs_to_a_run():
    assert set(read_bars()) <= {*SETS, *(f"{name}, warm" for name in WARM_SETS), "zoo"}


def test_a_missing_figure_fails_and_stands_on_the_page():
    outcome = Outcome("rig-a", figures={"a": 1.0})
    bars = {"rig-a": {"a": {"most": 1.0}, "b": {"most": 1.0}}}
    compare([outcome], bars)
    assert outcome.failures == ["b: missing, expected ≤ 1"]
    text = page([outcome, zoo_total([])], bars, left_out=["emps"], seed=9)
    assert "| rig-a | a | 1 | ≤ 1 |" in text
    assert "- rig-a: b: missing" in text
    assert "emps" in text


def test_errors_become_outcomes():
    def refuse(_):
        raise InputError("no test; expected one")

    def fall(outcome):
        with outcome.timed("identify"):
            raise OverflowError("far out")

    refused, fallen = run_guarded(Outcome("a"), refuse), run_guarded(Outcome("b"), fall)
    assert (refused.result, refused.message, refused.failures) == (REFUSED, "no test; expected one", [])
    assert fallen.result == TRACEBACK
    assert fallen.failures == ["identify: OverflowError: far out"]
    assert "identify" in fallen.seconds


def test_a_run_that_hangs_takes_no_other_along():
    jobs = [
        Job("hangs", signal.pause, timeout_s=2.0),
        Job("dies", os._exit, {"status": 3}),
        Job("well", Outcome, {"name": "well"}),
    ]
    outcomes = []
    run_jobs(jobs, outcomes.append, together=1)
    assert [outcome.result for outcome in outcomes] == [HUNG, TRACEBACK, MODEL]
    assert "code 3" in outcomes[1].message
