"""One direction: its two compensators apart, what hears itself, and where a simulation leaves the tests."""

from dataclasses import replace

import numpy as np
import pytest

from handmade import DEAD_ZONES, ERROR_STEP, WINDOW, channel, envelope, hitch, hitch_of
from hitchid.logs.record import LIFTING
from hitchid.networks.error_compensator import MAX_HORIZON
from truth import levels

SAMPLES = 200
SINGLE = float(np.finfo(np.float32).eps)
# One computation in two programs: single precision in each of 40 steps of sums of 14 products.
ALIKE_MM = 40 * WINDOW * 14 * SINGLE * ERROR_STEP


@pytest.fixture
def record(make_record):
    rng = np.random.default_rng(0)
    command = levels(rng, SAMPLES, low=0.3)
    return make_record(100.0 + np.cumsum(0.2 * rng.uniform(size=SAMPLES)), command, 0 * command)


def run(rows):
    return np.asarray(rows)[0, :SAMPLES]


def test_a_measured_echo_is_what_one_step_ahead_predicts(record):
    """Where the model is right there is no difference between hearing itself and hearing what is measured."""
    model = channel(LIFTING, "integrator-first-order", compensated=True)
    echo = run(model.simulate_closed_loop(model.batch([record], [100.0])))
    measured = model.batch([replace(record, signals={**record.signals, "displacement": echo})], [100.0])
    predicted = run(model.predict(measured, (1,))[0])
    # A prediction reads the last L features, the echo all of them: up to there they are the same, but for
    # single precision in L steps of sums of 14 products.
    same = slice(0, WINDOW)
    rounding = WINDOW**2 * 14 * SINGLE * ERROR_STEP
    np.testing.assert_allclose(predicted[same], echo[same], rtol=0, atol=rounding)
    assert np.abs(echo - run(model.simulate_benchmark(measured)))[same].max() > 100 * rounding


@pytest.mark.parametrize("largest", [1, 7, 100])
def test_tests_and_samples_are_predicted_alike_beyond_the_largest_horizon(record, largest):
    model = channel(LIFTING, "integrator-first-order", compensated=True, filtered=True)
    model = replace(model, compensator=replace(model.compensator, max_horizon=largest))
    horizons = (1, 5, 12, 40)
    batch = model.batch([record])
    stepped = hitch_of(model).predictions(record, horizons)
    predicted = [run(rows) for rows in model.predict(batch, horizons)]
    np.testing.assert_allclose(predicted, stepped, rtol=0, atol=ALIKE_MM)
    whole = replace(model, compensator=replace(model.compensator, max_horizon=MAX_HORIZON))
    changed = np.abs(np.asarray(whole.predict(batch, horizons)) - np.asarray(model.predict(batch, horizons)))
    assert [bool(np.any(rows > ALIKE_MM)) for rows in changed] == [horizon > largest for horizon in horizons]


def test_each_compensator_leaves_what_the_other_is_for_alone(record):
    both = channel(LIFTING, "integrator-first-order", compensated=True, free_run=True)
    free_run, predictions = replace(both, compensator=None), replace(both, speed_compensator=None)
    batch = both.batch([record])
    np.testing.assert_array_equal(both.simulate(batch), free_run.simulate(batch))
    np.testing.assert_array_equal(both.predict(batch, (1, 5)), predictions.predict(batch, (1, 5)))
    benchmark = both.simulate_benchmark(batch)
    np.testing.assert_array_equal(predictions.simulate(batch), benchmark)
    assert np.any(both.simulate_closed_loop(batch) != both.simulate(batch))
    assert np.any(both.simulate(batch) != benchmark)
    # Without anything learnt the echo is the benchmark.
    for compensated in (None, False):
        silent = channel(LIFTING, "integrator-first-order", compensated=compensated)
        np.testing.assert_array_equal(silent.simulate_closed_loop(batch), benchmark)


def test_the_compensator_for_free_run_keeps_to_the_end_stop(record):
    model = channel(LIFTING, "integrator-first-order", free_run=True, end_stop=105.0)
    computed = run(model.simulate(model.batch([record], [100.0])))
    assert computed.max() == 105.0
    free = replace(model, end_stop=None)
    unbounded = run(free.simulate(free.batch([record], [100.0])))
    np.testing.assert_allclose(computed, np.minimum(unbounded, 105.0), rtol=0, atol=1e-12)


def test_outside_is_where_a_range_is_left_not_in_padding(record):
    covered = envelope(command=(0.0, 0.3), displacement=(100.0, 103.0))
    model = channel(LIFTING, free_run=False, covered=covered)
    batch = model.batch([record], [100.0])
    displacement = model.simulate(batch)
    computed = model.out_of_range(batch, displacement)
    effective = np.maximum(record.command(LIFTING) - DEAD_ZONES[LIFTING], 0)
    np.testing.assert_array_equal(computed["command"][0, :SAMPLES], effective > 0.3)
    np.testing.assert_array_equal(computed["displacement"][0, :SAMPLES], run(displacement) > 103.0)
    assert not computed["load"].any()
    for rows in computed.values():
        assert not rows[0, SAMPLES:].any()
    assert computed["command"].any()
    assert computed["displacement"].any()
    unbounded = channel(LIFTING).out_of_range(batch, displacement)
    assert not any(rows.any() for rows in unbounded.values())


def test_extrapolation_is_told_in_words_for_each_direction(make_record):
    covered = envelope(command=(0.0, 0.3), displacement=(90.0, 103.0))
    model = hitch(free_run=False, covered=covered)
    up, down = (np.concatenate([np.zeros(10), np.full(60, level), np.zeros(30)]) for level in (0.8, 0.45))
    lifting, lowering = np.concatenate([up, 0 * down]), np.concatenate([0 * up, down])
    record = make_record(np.full(SAMPLES, 100.0), lifting, lowering)
    simulation = model.simulate(record)
    # The channel that lowers takes over where its command begins; lifting has none before its own.
    mine = np.arange(SAMPLES) < 110
    high = simulation.displacement > 103.0
    assert simulation.flags == (
        "lifting: the command is outside the identified range, 0 to 0.3 A beyond the dead zone, in 60 of 200 "
        "samples",
        f"lifting: the displacement is outside the identified range, 90 to 103 mm, in "
        f"{np.count_nonzero(high & mine)} of 200 samples",
        f"lowering: the displacement is outside the identified range, 90 to 103 mm, in "
        f"{np.count_nonzero(high & ~mine)} of 200 samples",
    )
    within = make_record(np.full(SAMPLES, 100.0), 0 * lifting, 0 * lowering)
    assert model.simulate(within).flags == ()
    assert hitch().simulate(record).flags == ()


def test_extrapolation_tells_of_the_second_input_by_its_unit(make_record):
    model = hitch(shape=True, free_run=False, covered=envelope(load=(100.0, 110.0)))
    model = replace(model, units={**model.units, "pressure": "bar"})
    # No channel is in charge, and asked, before its valve opens. Spools lag by 0.02 s: in the third sample
    # of the command its mean, 0.8 (1 − 2 (1 − e^−½) e^−1) A, first passes dead zone and opening, 0.47 A.
    command = np.where(np.arange(SAMPLES) < 10, 0.0, 0.8)
    record = make_record(np.full(SAMPLES, 100.0), command, 0 * command)
    outside = "lifting: the load is outside the identified range, 100 to 110 bar, in 188 of 200 samples"
    for pressure, flags in ((105.0, ()), (111.0, (outside,))):
        signals = {**record.signals, "pressure": np.full(SAMPLES, pressure)}
        loaded = replace(record, signals=signals, units={**record.units, "pressure": "bar"})
        assert model.simulate(loaded).flags == flags


@pytest.mark.parametrize("compensated", [None, True])
def test_predictions_from_every_third_sample_are_those_from_every_sample(record, compensated):
    model = channel(LIFTING, "integrator", compensated=compensated, filtered=True)
    batch, horizons = model.batch([record]), (1, 2, 5)
    whole = np.asarray(model.predict(batch, horizons))
    some = np.asarray(model.predict(batch, horizons, 3))
    samples = np.arange(whole.shape[2])
    for horizon, all_rows, rows in zip(horizons, whole, some, strict=True):
        from_origins = (np.maximum(samples - horizon, 0) % 3 == 0) | (samples == 0)
        np.testing.assert_allclose(rows[:, from_origins], all_rows[:, from_origins], rtol=1e-12)
        assert np.all(np.isnan(rows[:, ~from_origins]))
