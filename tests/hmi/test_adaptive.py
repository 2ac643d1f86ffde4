"""The program of a campaign that chooses its own tests, on plants that are known."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_bench import LIMITS, STEP_S, STROKE, Plant
from hitchid.errors import InputError
from hitchid.hmi.adaptive import GUARD_S, LEAST_MOTION, Start, adaptive, guarded
from hitchid.hmi.campaign_files import FEW_TESTS, PROGRESS, SETTINGS, CampaignFiles, read_progress
from hitchid.hmi.plans import MARGIN, read_goal, read_plan
from hitchid.hmi.programs import RAMP_TRAVEL, Machine
from hitchid.identification.settings_file import read_settings

MACHINE = Machine(Plant.signals, STEP_S, STEP_S, LIMITS)


class Script:
    """A planner that has its tests ready, and keeps what it was asked."""

    def __init__(self, *tests):
        self.tests, self.asked = list(tests), []

    def ask(self, state):
        self.asked.append(state)

    def answer(self):
        if not self.tests:
            return {"stop": "the script is over", "seconds": 0.0}
        return {"stop": "", "seconds": 0.0, "begin": None, "move": "moves/move-01", **self.tests.pop(0)}


def carried_out(plant, planner, machine=MACHINE, **options):
    """Run a campaign on a plant; return its steps and the displacement at each."""
    program = adaptive(plant.displacement, machine, planner, **options)
    steps, displacements = [], []
    step = next(program)
    while True:
        steps.append(step)
        displacements.append(plant.displacement)
        plant.advance(step.commands)
        try:
            step = program.send(plant.displacement)
        except StopIteration:
            return steps, np.array(displacements)


@pytest.mark.parametrize("begin_mm", [0.0, 20.0, 125.0, 240.0, STROKE])
def test_careful_start_finds_both_dead_zones_from_anywhere(begin_mm):
    plant, planner = Plant(begin_mm, lag_s=0.05), Script()
    steps, displacements = carried_out(plant, planner)
    start = planner.asked[0]["start"]
    assert start["signs"] == (1, -1)
    # Seen late by what the threshold of motion and the lag take: a twentieth of the ramp's time.
    assert np.allclose(start["onsets"], plant.dead_zones, atol=0.1)
    assert np.ptp(displacements) < 0.12 * STROKE
    assert {step.log for step in steps} >= {"start/rest-01", "start/lifting-01", "start/lowering-01"}


def test_commands_grow_slowly_from_zero_until_something_moves():
    steps, _ = carried_out(Plant(100.0), Script())
    for channel in range(2):
        commands = np.array([step.commands[channel] for step in steps if step.phase == "ramp"])
        driven = commands[commands > 0]
        assert driven[0] <= LIMITS.commands[channel] * 0.01
        assert np.diff(driven).max() <= LIMITS.commands[channel] * 0.001


def test_turned_sign_is_found_and_moves_go_the_right_way():
    class Turned(Plant):
        def advance(self, commands):
            super().advance(np.asarray(commands)[::-1])

    plant = Turned(100.0, dead_zones=(0.3, 0.3))
    planner = Script({"direction": "lifting", "begin": 200.0, "command": [0.6] * 50, "log": "lifting-01"})
    steps, displacements = carried_out(plant, planner)
    assert planner.asked[0]["start"]["signs"] == (-1, 1)
    test = displacements[[step.log == "lifting-01" for step in steps]]
    assert abs(test[0] - 200.0) < 0.1 * STROKE
    assert test[-1] < test[0]


def test_direction_that_does_not_move_is_told_and_never_tested():
    planner = Script()
    carried_out(Plant(100.0, dead_zones=(0.35, 5.0)), planner)
    assert planner.asked[0]["start"]["signs"] == (1, 0)
    assert Start.of(planner.asked[0]["start"]).directions == ("lifting",)


def test_nothing_moves_is_a_sentence_with_both_limits():
    with pytest.raises(InputError, match=r"nothing moved up to the limits of the commands, 0\.9 and 0\.8 A"):
        carried_out(Plant(100.0, dead_zones=(5.0, 5.0)), Script())


def test_machine_that_drifts_at_rest_is_not_tested():
    class Leaking(Plant):
        def advance(self, commands):
            super().advance(commands)
            self.displacement -= 0.03  # 3 mm/s

    with pytest.raises(InputError, match=r"moves at -3 mm/s without a command"):
        carried_out(Leaking(100.0), Script())


def test_both_commands_the_same_way_is_refused():
    class Crossed(Plant):
        def advance(self, commands):
            super().advance((max(commands), 0.0))

    with pytest.raises(InputError, match="both commands move the displacement up"):
        carried_out(Crossed(100.0), Script())


@given(
    begin=st.floats(0.0, STROKE),
    channel=st.integers(0, 1),
    command=st.floats(0.0, 0.9),
    lag_s=st.floats(0.0, GUARD_S),
)
def test_no_test_hits_a_stop(begin, channel, command, lag_s):
    plant = Plant(begin, lag_s=lag_s)
    rows = np.zeros((3000, 2))
    rows[:, channel] = min(command, LIMITS.commands[channel])
    program = guarded(begin, rows, "test", MACHINE, 0.1)
    step = next(program)
    has_left = [begin]
    try:
        while True:
            plant.advance(step.commands)
            has_left.append(plant.displacement)
            step = program.send(plant.displacement)
    except StopIteration:
        pass
    for _ in range(500):  # the valves are closed, and the piston coasts
        plant.advance((0.0, 0.0))
    low, high = LIMITS.displacement
    # One that began in the margin before the end that it was driven to is stopped as soon as it moves.
    room = LEAST_MOTION * STROKE + (0.6 if channel == 0 else 0.5) * 100.0 * (STEP_S + lag_s)
    begins_free = low + MARGIN * STROKE + room < begin < high - MARGIN * STROKE - room
    if begins_free:
        assert low < plant.displacement < high


def test_test_ends_at_its_travel():
    plant, planner = Plant(50.0), Script()
    planner.tests = [
        {
            "direction": "lifting",
            "command": [0.6] * 2000,
            "log": "ramp-lifting-01",
            "travel": RAMP_TRAVEL * STROKE,
        }
    ]
    steps, displacements = carried_out(plant, planner)
    test = displacements[[step.log == "ramp-lifting-01" for step in steps]]
    assert np.ptp(test) == pytest.approx(RAMP_TRAVEL * STROKE, rel=0.1)


def test_planner_is_asked_after_the_log_of_a_test_is_closed():
    planner = Script({"direction": "lifting", "command": [0.5] * 100, "log": "lifting-01"})
    steps, _ = carried_out(Plant(50.0), planner)
    last = max(number for number, step in enumerate(steps) if step.log == "lifting-01")
    assert steps[last + 1].phase == "planning"
    assert steps[last + 1].log == ""


def test_bench_time_goes_on_from_what_was_spent():
    first, second = Script(), Script()
    carried_out(Plant(100.0), first)
    progress = {"minutes": 4.0, "start": first.asked[0]["start"], "rounds": []}
    steps, _ = carried_out(Plant(100.0), second, progress=json.loads(json.dumps(progress)))
    assert second.asked[0]["minutes"] == pytest.approx(4.0, abs=0.01)
    assert {step.phase for step in steps} == {"planning"}  # no second careful start


def test_careful_start_of_a_resumed_campaign_has_names_of_its_own():
    steps, _ = carried_out(Plant(100.0), Script(), taken={"start/rest-01", "start/lifting-01"})
    assert {step.log for step in steps} - {""} == {"start/rest-02", "start/lifting-02", "start/lowering-01"}


def test_slow_machine_gets_each_command_for_a_whole_sample():
    slow = Machine(Plant.signals, STEP_S, 10 * STEP_S, LIMITS)
    planner = Script({"direction": "lifting", "command": [0.5, 0.6, 0.7], "log": "lifting-01"})
    steps, _ = carried_out(Plant(50.0), planner, slow)
    commands = [step.commands[0] for step in steps if step.log == "lifting-01"]
    assert commands == [0.5] * 10 + [0.6] * 10 + [0.7] * 10


START = Start((1, -1), (0.35, 0.25), (100.0, 80.0), 0.05, 0.0)


def test_progress_is_read_as_it_was_written(tmp_path):
    CampaignFiles(tmp_path).save(2.5, START, [{"minutes": 1.0, "tests": 3, "directions": {}}])
    progress = read_progress(tmp_path)
    assert Start.of(progress["start"]) == START
    assert progress["minutes"] == 2.5
    assert progress["rounds"] == [{"minutes": 1.0, "tests": 3, "directions": {}}]


WRONG = {"signs": [1, 1], "onsets": [0, 0], "speeds": [0, 0], "noise": 0, "drift": 0}
ENDLESS = {**WRONG, "signs": [1, -1], "noise": float("nan")}


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        "{}",
        "[" * 5000,
        '{"minutes": 1}',
        '{"minutes": "x", "start": {}, "rounds": []}',
        json.dumps({"minutes": 1, "rounds": [], "start": WRONG}),
        json.dumps({"minutes": 1, "rounds": [], "start": ENDLESS}),
    ],
)
def test_progress_that_no_campaign_wrote_is_refused(tmp_path, content):
    (tmp_path / PROGRESS).write_text(content)
    with pytest.raises(InputError, match="is not what a campaign wrote; delete it to start anew"):
        read_progress(tmp_path)


def test_campaign_to_resume_must_exist(tmp_path):
    with pytest.raises(InputError, match="there is no such campaign to resume"):
        read_progress(tmp_path / "missing")


def test_validations_are_held_out_once_there_is_one(tmp_path):
    files = CampaignFiles(tmp_path)
    (tmp_path / "campaign.toml").write_text("[signals]\n")
    files.hold_out_validations()
    assert "[split]" not in (tmp_path / "campaign.toml").read_text()
    (tmp_path / "validation-lifting-01.csv").touch()
    files.hold_out_validations()
    files.hold_out_validations()
    assert (tmp_path / "campaign.toml").read_text().count('test = ["validation-*"]') == 1
    assert files.fresh("validation-lifting") == "validation-lifting-02"


@pytest.mark.parametrize("text", ["free run 0.2 mm in 10 s", "0.2 mm in 10s", "free run 0.2mm in 10 s"])
def test_goal_is_read(text):
    assert read_goal(text) == (0.2, "mm", 10.0)


@pytest.mark.parametrize(
    "text", ["", "good", "free run 0 mm in 10 s", "free run 0.2 mm", "0.2 mm in 1 s", "-1 mm in 9 s"]
)
def test_goal_that_says_nothing_is_refused(text):
    with pytest.raises(InputError, match=r"expected a goal like 'free run 0\.2 mm in 10 s'"):
        read_plan({"kind": "adaptive", "name": "a", "goal": text})


def test_few_tests_are_identified_by_a_given_form_more_choose_it(tmp_path):
    files = CampaignFiles(tmp_path)
    for number in range(FEW_TESTS):
        files.settle_form(("lifting", "lowering"))
        structure = read_settings(tmp_path / SETTINGS)["structure"]
        assert {spec.structure.name for spec in structure.values()} == {"integrator-second-order-stroke"}
        for direction in structure:
            (tmp_path / f"{direction}-{number:02d}.csv").touch()
    files.settle_form(("lifting", "lowering"))
    assert not (tmp_path / SETTINGS).exists()
