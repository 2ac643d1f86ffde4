"""The planner of a campaign, asked with what a folder of logs holds."""

from dataclasses import asdict

import numpy as np
import pytest

from fake_bench import LIMITS, STEP_S
from hitchid.control.sequential_design import upper_bound
from hitchid.hmi.adaptive import Start
from hitchid.hmi.planner import MOST_RAMPS, CampaignPlanner
from hitchid.hmi.planner import START as FROM_END

START = Start((1, -1), (0.35, 0.25), (100.0, 80.0), 0.05, 0.0)
HEADER = "time_s,lifting_command_A,lowering_command_A,displacement_mm\n"
SIGNALS = """\
[signals]
time = "time_s"
lifting_command = "lifting_command_A"
lowering_command = "lowering_command_A"
displacement = "displacement_mm"
"""


@pytest.fixture
def planner(tmp_path):
    """Return a planner of a campaign without a log."""
    (tmp_path / "campaign").mkdir()
    (tmp_path / "campaign" / "campaign.toml").write_text(SIGNALS)
    plan = {"kind": "adaptive", "name": "campaign", "minutes": 10.0}
    settings = {"root": str(tmp_path), "folder": "campaign", "plan": plan, "limits": LIMITS.model_dump()}
    return CampaignPlanner({**settings, "interval_s": STEP_S, "is_virtual": True})


def asked(planner, minutes=1.0, displacement=100.0, start=START):
    return planner.answer({"minutes": minutes, "displacement": displacement, "start": asdict(start)})


def write_ramp(folder, name, displacement):
    """Write a log of a lifting ramp to 0.9 A in 20 s."""
    rows = [f"{STEP_S * n:.2f},{0.9 * STEP_S * n / 20:.5f},0,{x:.4f}\n" for n, x in enumerate(displacement)]
    (folder / f"{name}.csv").write_text(HEADER + "".join(rows))


def moved(samples):
    """Return the displacement of a ramp behind a dead zone of 0.35 A, 100 mm/s an ampere beyond it."""
    command = 0.9 * STEP_S * np.arange(samples) / 20
    noise = 0.02 * np.random.default_rng(0).standard_normal(samples)
    return 10 + STEP_S * np.cumsum(100 * np.maximum(command - 0.35, 0)) + noise


def test_first_come_ramps_from_the_end_that_a_direction_leads_away_from(planner):
    test = asked(planner, displacement=100.0)
    assert test["log"] == "ramp-lifting-01"
    assert test["begin"] == pytest.approx(FROM_END * LIMITS.travel)
    assert max(test["command"]) == LIMITS.lifting_command


def test_after_its_ramp_a_direction_has_a_test_of_many_levels(planner, tmp_path):
    write_ramp(tmp_path / "campaign", "ramp-lifting-01", moved(1000))
    test = asked(planner, displacement=30.0)
    assert test["direction"] == "lifting"
    assert test["log"] == "lifting-01"
    # From below the dead zone that the ramp has, not the one of the careful start.
    assert 0.8 * 0.35 < min(value for value in test["command"] if value) < 0.35
    assert max(test["command"]) <= LIMITS.lifting_command


def test_ramp_that_was_stopped_before_anything_moved_is_run_again(planner, tmp_path):
    for number in range(1, MOST_RAMPS + 1):
        # A sensor without noise: the log by itself would be refused.
        write_ramp(tmp_path / "campaign", f"ramp-lifting-{number:02d}", np.full(100 + number, 10.0))
        test = asked(planner, displacement=10.0)
        again = f"ramp-lifting-{number + 1:02d}"
        assert test["log"] == (again if number < MOST_RAMPS else "lifting-01")


def test_only_direction_ends_with_the_travel(planner):
    start = Start((1, 0), (0.35, 0.0), (100.0, 0.0), 0.05, 0.0)
    test = asked(planner, displacement=20.0, start=start)
    assert test["direction"] == "lifting"
    assert test["begin"] is None
    end = asked(planner, displacement=235.0, start=start)
    assert end["stop"].startswith("the travel is used up and only lifting moves")


def test_time_is_over_before_a_test_that_would_not_end_in_time(planner):
    end = asked(planner, minutes=9.99)
    assert end["stop"] == "the time is over: 10 minutes"
    assert end["result"]["reason"] == end["stop"]


def test_bound_of_a_mean_needs_two_tests_and_lies_above_it():
    assert upper_bound([0.1]) == np.inf
    # By hand: the mean 0.2, deviation 0.1414, t(0.9, 1) = 3.078.
    assert upper_bound([0.1, 0.3]) == pytest.approx(0.2 + 3.0777 * 0.1414214 / np.sqrt(2), rel=1e-4)
