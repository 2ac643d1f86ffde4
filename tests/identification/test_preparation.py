"""From tests to what the phases work on: direction, end stop, dead zone, validation."""

from dataclasses import replace

import numpy as np
import pytest

from hitchid._support.records import Notice
from hitchid.errors import InputError
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.preparation import mixed_dead_zones, prepare
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING
from truth import STEP_S, held, levels

SAMPLES = 300
GIVEN = DeadZone(0.35, None, 0, "given")


@pytest.fixture
def tests_of(make_record):
    """Return a function that makes moving tests of one mode."""

    def make(count, mode=LIFTING, *, direction=1, samples=SAMPLES, seed=0):
        rng = np.random.default_rng(seed)
        records = []
        for number in range(count):
            command = levels(rng, samples, low=0.2)
            travel = held([30.0], [1.0, 0.0], np.maximum(command - 0.35, 0.0))
            displacement = 80.0 + direction * travel + 0.02 * rng.standard_normal(samples)
            commands = (command, 0 * command) if mode == LIFTING else (0 * command, command)
            records.append(make_record(displacement, *commands, name=f"{mode}-{number:02d}"))
        return records

    return make


def everything(records):
    """Return a campaign that holds one test more back than is asked about."""
    return Campaign.of(records, test_patterns=[records[-1].name])


def notices_with(notices, words):
    return [notice for notice in notices if words in notice]


@pytest.mark.parametrize("mode", [LIFTING, LOWERING])
@pytest.mark.parametrize(("direction", "change"), [(1, "increases"), (-1, "decreases")])
def test_the_direction_is_found_and_an_unusual_one_told(tests_of, mode, direction, change):
    prepared = prepare(everything(tests_of(4, mode, direction=direction)), mode, GIVEN)
    assert prepared.sign == prepared.all_tests.sign == direction
    usual = direction == (1 if mode == LIFTING else -1)
    notice = f"the displacement {change} in {mode}; the direction is identified as measured"
    assert bool(notices_with(prepared.notices, notice)) != usual
    # Whichever way the sensor counts, travel is positive where the command drives.
    assert np.all(np.asarray(prepared.all_tests.travel)[:, SAMPLES - 1] > 0)


def stopping(make_record, stops, *, direction=1):
    """Return tests that run at 30 mm/s to their stops, in mm, and stand there under command, and one more."""
    records = []
    for number, stop in enumerate([*stops, 1.0]):
        command = np.where(np.arange(SAMPLES) < 5, 0.0, 0.8)
        way = np.minimum(30.0 * STEP_S * np.arange(SAMPLES), stop)
        records.append(make_record(20.0 + direction * way, command, 0 * command, name=f"test-{number}"))
    return records


@pytest.mark.parametrize("direction", [1, -1])
def test_an_end_stop_is_where_tests_agree_to_stand(make_record, direction):
    records = stopping(make_record, [50.0, 50.1, 50.0], direction=direction)
    prepared = prepare(everything(records), LIFTING, GIVEN)
    assert prepared.end_stop == pytest.approx(20.0 + direction * 50.0)
    assert notices_with(prepared.notices, "end stop at")
    assert notices_with(prepared.notices, "reached in 3 of 3 tests")
    counted = np.asarray(prepared.all_tests.loss_mask)
    # The stop is met after 50 mm / 30 mm/s = 1.67 s; what counts ends 1 % of the way before.
    np.testing.assert_array_equal(counted.sum(axis=1), [165, 165, 165])


@pytest.mark.parametrize(
    "stops",
    [[50.0, 1e3, 1e3], [30.0, 50.0, 70.0], [50.0, 50.0, 1e3], [1e3, 1e3, 1e3]],
    ids=["one stands", "no two stand in one place", "two stand, a third passes", "none stands"],
)
def test_there_is_no_end_stop_where_tests_do_not_agree(make_record, stops):
    prepared = prepare(everything(stopping(make_record, stops)), LIFTING, GIVEN)
    assert prepared.end_stop is None
    assert not notices_with(prepared.notices, "end stop")
    assert np.asarray(prepared.all_tests.loss_mask).sum() == 3 * SAMPLES


@pytest.mark.parametrize(("count", "validating"), [(2, [1]), (4, [3]), (7, [3]), (9, [3, 7])])
def test_whole_tests_are_set_aside_to_stop_the_training(tests_of, count, validating):
    records = tests_of(count + 1, samples=100)
    prepared = prepare(everything(records), LIFTING, GIVEN)
    names = [record.name for record in records]
    assert prepared.validation_names == tuple(names[row] for row in validating)
    parts = {
        "all_tests": range(count),
        "training": [row for row in range(count) if row not in validating],
        "validation": validating,
    }
    for part, rows in parts.items():
        batch = getattr(prepared, part)
        measured = np.stack([records[row].displacement for row in rows])
        np.testing.assert_array_equal(np.asarray(batch.displacement)[:, :100], measured)
        assert np.asarray(batch.loss_mask).sum() == 100 * len(measured)


def test_the_last_quarter_of_a_single_test_stops_its_training(tests_of):
    prepared = prepare(everything(tests_of(2)), LIFTING, GIVEN)
    assert notices_with(prepared.notices, "only one test: its last quarter is used for early stopping")
    sample = np.arange(prepared.all_tests.loss_mask.shape[1])
    np.testing.assert_array_equal(prepared.training.loss_mask[0], sample < 225)
    np.testing.assert_array_equal(prepared.validation.loss_mask[0], (sample >= 225) & (sample < 300))
    assert prepared.validation_names == ("lifting-00",)


def ramps(make_record, zones):
    time_s = STEP_S * np.arange(1000)
    command = time_s / time_s[-1]
    return [
        make_record(15.0 * np.maximum(command - zone, 0) ** 2, command, 0 * command, name=f"ramp-{number}")
        for number, zone in enumerate(zones)
    ]


def test_ramps_give_the_dead_zone_or_else_tests(make_record, tests_of):
    records = tests_of(5)
    with_ramps = prepare(everything([*ramps(make_record, [0.3, 0.32]), *records]), LIFTING, None).dead_zone
    assert (with_ramps.origin, with_ramps.count) == ("ramps", 2)
    # Half a candidate spacing; see test_dead_zone.
    assert with_ramps.value == pytest.approx(0.31, abs=0.0012)
    without = prepare(everything(records), LIFTING, None).dead_zone
    assert (without.origin, without.count) == ("tests", 4)
    assert without.value == pytest.approx(0.35, abs=0.0024)


def test_a_given_dead_zone_is_taken_and_applied(make_record, tests_of):
    records = [*ramps(make_record, [0.3]), *tests_of(3)]
    prepared = prepare(everything(records), LIFTING, DeadZone(0.5, None, 0, "given"))
    assert prepared.dead_zone == DeadZone(0.5, None, 0, "given")
    commands = np.stack([record.command(LIFTING) for record in records[1:3]])
    beyond = np.maximum(commands - 0.5, 0)
    np.testing.assert_allclose(np.asarray(prepared.all_tests.command)[:, :SAMPLES], beyond, atol=1e-15)


def test_an_unknown_dead_zone_is_zero_with_a_notice(make_record):
    rng = np.random.default_rng(0)
    records = []
    for number in range(3):
        command = np.where(np.arange(SAMPLES) < 5, 0.0, 0.8)
        displacement = 13.5 * STEP_S * np.arange(SAMPLES) + 0.02 * rng.standard_normal(SAMPLES)
        records.append(make_record(displacement, command, 0 * command, name=f"test-{number}"))
    prepared = prepare(everything(records), LIFTING, None)
    assert (prepared.dead_zone.value, prepared.dead_zone.origin) == (0.0, "none")
    assert notices_with(prepared.notices, "cannot be identified from one level of command; zero is used")


def test_what_was_done_to_a_log_is_passed_on(tests_of):
    records = tests_of(3)
    records[1] = replace(records[1], notices=(Notice("clock-resampled", "resampled: the clock jitters"),))
    prepared = prepare(everything(records), LIFTING, GIVEN)
    assert notices_with(prepared.notices, "lifting-01: resampled: the clock jitters")


def test_one_test_must_be_left_to_identify_from(tests_of):
    with pytest.raises(InputError, match=r"4 lifting tests"):
        prepare(Campaign.of(tests_of(4), test_patterns=["lifting-*"]), LIFTING, None)


def cycle(make_record, rng, name):
    """Return one stroke up and one down over dead zones of 0.35 and 0.25, each led in by a second of rest."""
    up, down = (np.concatenate([np.zeros(100), levels(rng, SAMPLES, low=0.4)]) for _ in range(2))
    lifting, lowering = np.concatenate([up, 0 * down]), np.concatenate([0 * up, down])
    speed = np.maximum(lifting - 0.35, 0) - np.maximum(lowering - 0.25, 0)
    return make_record(80.0 + held([30.0], [1.0, 0.0], speed), lifting, lowering, name=name)


def test_cycles_alone_give_a_first_dead_zone_each_way(make_record):
    rng = np.random.default_rng(0)
    records = [cycle(make_record, rng, f"cycle-{number}") for number in range(4)]
    prepared = mixed_dead_zones(everything(records))
    assert set(prepared) == {LIFTING, LOWERING}
    assert prepared[LIFTING].value == pytest.approx(0.35, abs=0.0024)
    assert prepared[LOWERING].value == pytest.approx(0.25, abs=0.0024)
    spoilt = records[-1].displacement[::-1] * 7.0
    records[-1] = replace(records[-1], signals={**records[-1].signals, "displacement": spoilt})
    assert mixed_dead_zones(everything(records)) == prepared
