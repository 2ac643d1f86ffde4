"""The model beside the machine: in the units of the source, and never a free run over samples it lacks."""

import numpy as np
import pytest

import handmade
from handmade import DEAD_ZONES, GAINS, STEP_S
from hitchid.errors import InputError
from hitchid.hmi.monitor_loop import AHEAD, FREE_RUN, HORIZON_S, MonitorLoop

MODEL = handmade.hitch()
LIFT, START = 0.5, 100.0
SPEED = GAINS["lifting"] * (LIFT - DEAD_ZONES["lifting"])  # mm/s
A_MM = ("A", "mm")


def samples(count, begin=0, displacement=None, command=LIFT):
    """Return samples of a lift that the model knows exactly, or at a given displacement."""
    time_s = STEP_S * np.arange(begin, begin + count)
    measured = START + SPEED * time_s if displacement is None else np.full(count, displacement)
    return np.column_stack([time_s, np.full(count, command), np.zeros(count), measured])


def predicted(loop, rows, kind=FREE_RUN):
    found = [part for number, part in loop.advance(rows) if number == kind]
    return np.concatenate(found) if found else np.empty((0, 4))


@pytest.fixture
def loop():
    return MonitorLoop(MODEL, A_MM, STEP_S)


def test_the_free_run_is_the_model_s_and_nan_where_it_has_no_band(loop):
    rows = samples(40)
    free_run = predicted(loop, rows)
    np.testing.assert_array_equal(free_run[:, 0], rows[:, 0])
    np.testing.assert_allclose(free_run[:, 1], rows[:, 3], rtol=1e-9)
    assert np.isnan(free_run[:, 2:]).all()


def test_the_prediction_ahead_is_for_a_second_later(loop):
    ahead = predicted(loop, samples(8), AHEAD)
    np.testing.assert_allclose(ahead[:, 0], np.array([3, 7]) * STEP_S + HORIZON_S)
    # Its last command is held, so that the lift goes on.
    np.testing.assert_allclose(ahead[:, 1], START + SPEED * ahead[:, 0], atol=SPEED * STEP_S * 1.01)


def test_other_units_of_the_source_give_the_same_in_those_units(loop):
    rows = samples(40)
    other = MonitorLoop(MODEL, ("mA", "cm"), STEP_S)
    found = predicted(other, rows * np.array([1.0, 1e3, 1e3, 0.1]))
    np.testing.assert_allclose(found[:, 1], 0.1 * predicted(loop, rows)[:, 1], rtol=1e-9)


def test_blocks_of_any_length_give_the_same(loop):
    rows = samples(40)
    pieces = np.split(rows, [1, 4, 9, 10, 25])
    found = np.concatenate([predicted(loop, piece) for piece in pieces])
    whole = predicted(MonitorLoop(MODEL, A_MM, STEP_S), rows)
    np.testing.assert_allclose(found, whole, rtol=1e-12)


@pytest.mark.parametrize("before", [8, 10])
def test_after_a_gap_the_free_run_starts_anew_at_the_measurement(loop, before):
    predicted(loop, samples(before))
    again = predicted(loop, samples(8, begin=before + 50, displacement=30.0))
    assert again[0, 0] == pytest.approx(STEP_S * (before + 50))
    assert again[0, 1] == pytest.approx(30.0)


def test_a_gap_inside_a_block_is_one_too(loop):
    rows = np.concatenate([samples(6), samples(6, begin=100, displacement=30.0)])
    found = predicted(loop, rows)
    np.testing.assert_allclose(found[:, 0], STEP_S * np.array([0, 1, 2, 3, 100, 101, 102, 103]))
    assert found[4, 1] == pytest.approx(30.0)


def test_no_gap_no_restart(loop):
    predicted(loop, samples(8))
    found = predicted(loop, samples(8, begin=8, displacement=30.0))
    assert found[0, 1] == pytest.approx(START + 8 * STEP_S * SPEED)


def test_a_restart_begins_at_the_present_displacement(loop):
    predicted(loop, samples(8))
    loop.restart()
    assert predicted(loop, samples(4, begin=8, displacement=30.0))[0, 1] == pytest.approx(30.0)


def test_it_waits_for_a_displacement(loop):
    assert len(predicted(loop, samples(8, displacement=np.nan))) == 0
    assert len(predicted(loop, samples(4, begin=8))) == 4


def test_a_sampling_time_that_is_not_the_model_s_is_refused():
    with pytest.raises(
        InputError, match=r"sampling time of 0\.01 s, the source of 0\.02 s; identify a model"
    ):
        MonitorLoop(MODEL, A_MM, 2 * STEP_S)


@pytest.mark.parametrize("units", [("bar", "mm"), ("A", "V"), ("A", "nonsense")])
def test_units_that_cannot_be_converted_are_refused(units):
    with pytest.raises(InputError):
        MonitorLoop(MODEL, units, STEP_S)


def test_a_band_lies_around_the_free_run_and_scales_with_the_unit():
    model = handmade.with_bands(MODEL, "lifting", "lowering")
    in_mm, in_cm = MonitorLoop(model, A_MM, STEP_S), MonitorLoop(model, ("A", "cm"), STEP_S)
    rows = samples(8)
    found = predicted(in_mm, rows)
    assert np.all(found[1:, 2] < found[1:, 1])
    assert np.all(found[1:, 3] > found[1:, 1])
    scaled = predicted(in_cm, rows * np.array([1.0, 1.0, 1.0, 0.1]))
    np.testing.assert_allclose(scaled[:, 1:], 0.1 * found[:, 1:], rtol=1e-6)
