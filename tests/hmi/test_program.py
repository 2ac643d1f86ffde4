"""Moves, tests, campaigns and closed loops on a plant whose dead zones, gains and stops are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_bench import DEAD_ZONES, GAINS, LIMITS, STEP_S, STROKE, Plant
from hitchid.errors import InputError
from hitchid.hmi import programs as campaigns
from hitchid.hmi.plans import MARGIN, CampaignPlan
from hitchid.hmi.programs import (
    COAST_S,
    MOVE_STROKES_PER_S,
    RISE_S,
    SETTLE_S,
    STALLED_S,
    START,
    Target,
    apply,
    campaign,
    check_clock_and_units,
    drive,
    move,
)
from hitchid.logs.record import DIRECTIONS

UNITS = ("A", "mm")
SPEED = MOVE_STROKES_PER_S * STROKE  # mm/s, wanted speed of a move


def carried_out(program, plant, *, measured=None, longest=200_000):
    """Run a program on a plant; return steps, displacement at each, and what it returns."""
    steps, displacements = [], []
    try:
        step = next(program)
        for sample in range(longest):
            steps.append(step)
            displacements.append(plant.displacement)
            plant.advance(step.commands)
            step = program.send(measured(sample) if measured else plant.displacement)
    except StopIteration as end:
        return steps, np.array(displacements), end.value
    raise AssertionError("the program does not end")


@given(st.floats(10.0, 240.0), st.floats(10.0, 240.0), st.floats(0.0, 0.3))
def test_a_move_comes_to_rest_at_its_target(start, target, lag_s):
    plant = Plant(start, lag_s=lag_s)
    _, _, reached = carried_out(move(start, target, LIMITS, STEP_S), plant)
    assert reached == plant.displacement
    # While the speed is still found (0.1 s) and follows its command (lag), the command rises on.
    rise = max(gain * top / RISE_S for gain, top in zip(GAINS, LIMITS.commands, strict=True))
    fastest = SPEED + rise * (0.1 + lag_s + STEP_S)
    wrong_coast_s = abs(COAST_S - lag_s) + 0.1 + 2 * STEP_S
    assert abs(reached - target) <= fastest * wrong_coast_s


@pytest.mark.parametrize("target", [20.0, 230.0])
def test_a_plant_that_coasts_as_expected_ends_within_a_millimetre(target):
    plant = Plant(lag_s=COAST_S)
    _, _, reached = carried_out(move(100.0, target, LIMITS, STEP_S), plant)
    # The distance of two samples at the speed of the move.
    assert reached == pytest.approx(target, abs=2 * 1.2 * SPEED * STEP_S)


@given(st.floats(0.0, STROKE), st.floats(0.0, STROKE))
def test_a_move_drives_one_valve_and_settles_with_both_closed(start, target):
    steps, _, _ = carried_out(move(start, target, LIMITS, STEP_S), Plant(start))
    commands = np.array([step.commands for step in steps])
    driven = 0 if target > start else 1
    assert commands[:, driven].max() <= LIMITS.commands[driven]
    assert not commands[:, 1 - driven].any()
    assert not commands[-round(SETTLE_S / STEP_S) :].any()


def test_a_blocked_move_ends_and_says_what_to_raise():
    blocked = {"dead_zones": (2.0, 2.0)}
    steps, _, reached = carried_out(move(100.0, 200.0, LIMITS, STEP_S), Plant(100.0, **blocked))
    assert reached == 100.0
    assert len(steps) * STEP_S == pytest.approx(RISE_S + STALLED_S + SETTLE_S, abs=0.1)
    plan = CampaignPlan(name="a", ramps=1, ramp_s=5, tests=1)
    with pytest.raises(InputError, match="raise the largest command in the limits file, or make ramps lon"):
        carried_out(campaign(plan, 20.0, LIMITS, STEP_S, UNITS), Plant(20.0, **blocked))


def test_a_move_goes_on_over_samples_that_are_missing():
    program, plant = move(100.0, 100.0 + SPEED, LIMITS, STEP_S), Plant(100.0)
    _, _, reached = carried_out(program, plant, measured=lambda k: plant.displacement if k % 3 else np.nan)
    assert reached == plant.displacement
    assert reached == pytest.approx(100.0 + SPEED, abs=1.5 * SPEED * COAST_S)


def test_apply_returns_the_displacement_at_each_command():
    plant = Plant(dead_zones=(0.0, 0.0))
    commands = np.column_stack([np.linspace(0.0, 0.5, 40), np.zeros(40)])
    steps, displacements, measured = carried_out(apply(100.0, commands, "log", LIMITS, STEP_S), plant)
    np.testing.assert_array_equal([step.commands for step in steps], commands)
    np.testing.assert_array_equal(measured, displacements)
    np.testing.assert_allclose(np.diff(measured), STEP_S * GAINS[0] * commands[:-1, 0], rtol=1e-9)
    assert {step.log for step in steps} == {"log"}
    assert steps[0].left_s == pytest.approx(0.4)


@pytest.mark.parametrize(("channel", "start"), [(0, 200.0), (1, 50.0)])
def test_a_test_ends_near_the_end_of_its_travel(channel, start):
    plant, commands = Plant(start), np.zeros((5000, 2))
    commands[:, channel] = LIMITS.commands[channel]
    steps, displacements, _ = carried_out(apply(start, commands, "log", LIMITS, STEP_S), plant)
    assert len(steps) < 5000
    fastest = STEP_S * GAINS[channel] * LIMITS.commands[channel]
    assert displacements.min() >= MARGIN * STROKE - fastest
    assert displacements.max() <= STROKE - MARGIN * STROKE + fastest
    assert 0.0 < plant.displacement < STROKE


def test_a_test_may_leave_an_end_but_no_further():
    away = np.tile([0.6, 0.0], (50, 1))
    steps, _, _ = carried_out(apply(0.0, away, "log", LIMITS, STEP_S), Plant(0.0))
    assert len(steps) == 50
    ramp = np.column_stack([np.linspace(0.0, 0.9, 2000), np.zeros(2000)])
    _, displacements, _ = carried_out(apply(100.0, ramp, "log", LIMITS, STEP_S, 20.0), Plant())
    assert 19.0 < displacements[-1] - 100.0 <= 20.0  # the travel that ends it


@pytest.fixture(scope="module", params=[0.0, 0.1])
def done(request):
    """Return a campaign that was carried out: plan, steps, displacements, results of its ramps, lag."""
    ramps, evaluate = {}, campaigns.evaluate_ramps

    def remembered(records, direction):
        return ramps.setdefault(direction, evaluate(records, direction))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaigns, "evaluate_ramps", remembered)
        plan = CampaignPlan(name="monday", ramps=2, ramp_s=20, tests=3, test_s=8, cycles=1, cycle_s=30)
        plant = Plant(20.0, lag_s=request.param)
        steps, displacements, _ = carried_out(campaign(plan, 20.0, LIMITS, STEP_S, UNITS), plant)
    return plan, steps, displacements, ramps, request.param


def logs_of(steps):
    """Return the samples of each log, in their order."""
    logs = {}
    for sample, step in enumerate(steps):
        if step.log:
            logs.setdefault(step.log, []).append(sample)
    return logs


def test_a_campaign_makes_each_of_its_logs_in_one_piece(done):
    plan, steps, *_ = done
    logs = logs_of(steps)
    assert len(logs) == plan.total
    for samples in logs.values():
        assert samples == list(range(samples[0], samples[-1] + 1))
    assert list(logs)[:4] == [f"ramp-{direction}-{n:02d}" for direction in DIRECTIONS for n in (1, 2)]
    assert set(list(logs)[4:10]) == {f"{direction}-{n:02d}" for direction in DIRECTIONS for n in (1, 2, 3)}
    assert list(logs)[10:] == ["cycle-01"]


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_campaign_finds_the_dead_zones_and_speeds(done, direction):
    _, _, _, ramps, lag_s = done
    channel = DIRECTIONS.index(direction)
    slope = LIMITS.commands[channel] / 20.0  # A/s
    # The lag delays motion by about itself, and motion is seen a few tenths of a second after it began.
    assert ramps[direction].dead_zone == pytest.approx(DEAD_ZONES[channel], abs=slope * (lag_s + 0.3))
    assert ramps[direction].speed_per_command == pytest.approx(GAINS[channel], rel=0.15)


def test_a_campaign_stays_inside_the_travel_and_the_limits(done):
    _, steps, displacements, *_ = done
    commands = np.array([step.commands for step in steps])
    assert np.all(commands >= 0)
    assert np.all(commands.max(axis=0) <= LIMITS.commands)
    assert not np.any(np.all(commands > 0, axis=1))
    assert displacements.min() > 0.0
    assert displacements.max() < STROKE


def test_each_test_begins_at_rest_at_its_end_of_travel(done):
    _, steps, displacements, _, lag_s = done
    rise = GAINS[0] * LIMITS.commands[0] / RISE_S
    near = (SPEED + rise * (0.1 + lag_s + STEP_S)) * (abs(COAST_S - lag_s) + 0.1)
    for name, samples in logs_of(steps).items():
        begin = samples[0]
        assert displacements[begin] == pytest.approx(displacements[begin - 10], abs=1e-3)
        assert not steps[begin - 1].commands.any()
        if "cycle" not in name:
            wanted = START * STROKE if "lifting" in name else (1 - START) * STROKE
            assert displacements[begin] == pytest.approx(wanted, abs=near)


def test_levels_of_tests_are_above_the_dead_zone_or_zero(done):
    _, steps, _, ramps, _ = done
    for name, samples in logs_of(steps).items():
        direction = name.split("-")[0]
        if direction in DIRECTIONS:
            channel = DIRECTIONS.index(direction)
            driven = np.array([steps[k].commands[channel] for k in samples])
            assert driven[driven > 0].min() > ramps[direction].dead_zone
            assert np.ptp(driven) > 0


def test_a_campaign_depends_on_its_seed_alone():
    def commands(seed):
        plan = CampaignPlan(name="a", ramps=1, ramp_s=10, tests=1, test_s=3, seed=seed)
        steps, *_ = carried_out(campaign(plan, 20.0, LIMITS, STEP_S, UNITS), Plant(20.0))
        return [tuple(step.commands) for step in steps]

    assert commands(1) == commands(1) != commands(2)


@pytest.mark.parametrize("step_s", [0.005, 0.02])
def test_a_test_takes_its_time_at_any_sampling_time(step_s):
    plan = CampaignPlan(name="a", ramps=1, ramp_s=5, tests=1, test_s=4, directions=("lifting",))
    steps, *_ = carried_out(campaign(plan, 20.0, LIMITS, step_s, UNITS), Plant(20.0))
    assert len(logs_of(steps)["lifting-01"]) * step_s == pytest.approx(4.0, abs=2 * step_s)


# --- closed loops -------------------------------------------------------------------------------------------


class Proportional:
    """A controller whose state counts the samples, and that commands 0.01 A for each millimetre."""

    def initial_state(self, displacement):
        return 0

    def step(self, state, reference, displacement):
        error = 0.01 * (reference - displacement)
        return state + 1, [max(error, 0.0), max(-error, 0.0)]


def test_a_closed_loop_holds_until_the_target_moves():
    target = Target(100.0)
    program = drive(Proportional(), "evening", 100.0, target, LIMITS)
    first = next(program)
    assert (first.log, first.phase) == ("evening", "driving")
    np.testing.assert_array_equal(first.commands, [0.0, 0.0])
    target.displacement = 150.0
    np.testing.assert_allclose(program.send(110.0).commands, [0.4, 0.0])
    np.testing.assert_allclose(program.send(170.0).commands, [0.0, 0.2])


@pytest.mark.parametrize(("target_mm", "reached_mm"), [(1e6, 210.0), (-1e6, 10.0)])
def test_a_target_outside_the_travel_is_its_end(target_mm, reached_mm):
    limits = LIMITS.model_copy(update={"lowest_displacement": 10.0, "highest_displacement": 210.0})
    program = drive(Proportional(), "evening", 100.0, Target(target_mm), limits)
    commands = next(program).commands
    assert commands[0] - commands[1] == pytest.approx(0.01 * (reached_mm - 100.0))


@pytest.mark.parametrize(
    ("step_s", "changed", "problem"),
    [
        (0.02, {}, "sampling time of 0.01 s, the source of 0.02 s"),
        (0.01, {"displacement": "m"}, "expected displacement in mm, the source has m"),
        (0.01, {"lowering_command": "mA"}, "expected lowering_command in A, the source has mA"),
    ],
)
def test_a_source_with_another_clock_or_units_is_not_driven(step_s, changed, problem):
    units = {"lifting_command": "A", "lowering_command": "A", "displacement": "mm"}
    check_clock_and_units(0.01, units, 0.01, units)
    with pytest.raises(InputError) as error:
        check_clock_and_units(0.01, units, step_s, {**units, **changed})
    assert problem in str(error.value)
