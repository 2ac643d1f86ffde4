"""The compensator for free run: what it may do, what it never does, and its rollout by a plain loop."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handmade import envelope, speed_compensator
from hitchid.networks.speed_compensator import AUTHORITY, compute_block_inputs, simulate_compensated

EPS = np.finfo(np.float64).eps
SAMPLES, TESTS = 200, 3
# Exact in binary, so that sums of differences are too.
FINE = 2.0**-10


def made_up(seed=0, *, samples=SAMPLES):
    """Return travel, growing in each sample, and command, shape [T, N], initial and load, shape [T]."""
    rng = np.random.default_rng(seed)
    steps = FINE * rng.integers(1, 400, (TESTS, samples))
    travel = np.cumsum(steps, axis=1) - steps
    command = rng.uniform(0.0, 0.5, (TESTS, samples))
    return tuple(map(jnp.asarray, (travel, command, rng.uniform(60.0, 90.0, TESTS), np.zeros(TESTS))))


@pytest.mark.parametrize("every", [1, 3, 7, 64, 1000])
def test_untrained_it_is_the_benchmark_whatever_the_blocks(every):
    travel, *heard = made_up()
    found = simulate_compensated(speed_compensator(trained=False, every=every), travel, *heard)
    np.testing.assert_array_equal(found, travel)


def test_a_standing_benchmark_stands_for_a_minute_whatever_was_learnt():
    travel, command, initial, load = made_up(samples=600)
    pause = np.full((TESTS, 6000), np.asarray(travel)[:, -1:])
    paused = jnp.asarray(np.concatenate([travel, pause], axis=1))
    silent = jnp.asarray(np.concatenate([command, np.zeros((TESTS, 6000))], axis=1))
    found = np.asarray(simulate_compensated(speed_compensator(size=5.0), paused, silent, initial, load))
    assert np.all(found[:, 599] != np.asarray(travel)[:, 599])
    np.testing.assert_array_equal(np.ptp(found[:, 600:], axis=1), 0.0)
    # Nor does a command move it where the benchmark takes no notice of one.
    pushed = jnp.full_like(silent, 0.4)
    moved = np.asarray(simulate_compensated(speed_compensator(size=5.0), 0 * paused, pushed, initial, load))
    np.testing.assert_array_equal(moved, 0.0)


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 2**16),
    size=st.sampled_from([0.0, 0.1, 1.0, 10.0, 1e6]),
    direction=st.sampled_from([1, -1]),
)
def test_its_speed_is_within_half_of_the_benchmarks_for_any_weights(seed, size, direction):
    travel, *heard = made_up(seed)
    model = speed_compensator(seed, size=size, direction=direction)
    found = np.asarray(simulate_compensated(model, travel, *heard))
    ratio = np.diff(found, axis=1) / np.diff(np.asarray(travel), axis=1)
    # Travel up to 100 mm in steps of 1/1024 mm at least: what rounding makes of their ratio.
    rounding = 8 * EPS * float(travel.max()) / FINE
    assert ratio.max() <= 1 + AUTHORITY + rounding
    assert ratio.min() >= 1 - AUTHORITY - rounding
    assert AUTHORITY == 0.5


@pytest.mark.parametrize("beyond", ["command", "displacement", "load"])
def test_where_the_tests_have_not_been_it_moves_as_the_benchmark_does(beyond):
    ranges = {"command": (0.6, 0.7), "displacement": (900.0, 950.0), "load": (5.0, 6.0)}
    travel, *heard = made_up()
    outside = speed_compensator(size=5.0, covered=envelope(**{beyond: ranges[beyond]}))
    np.testing.assert_array_equal(simulate_compensated(outside, travel, *heard), travel)
    inside = np.asarray(simulate_compensated(speed_compensator(size=5.0), travel, *heard))
    assert np.all(inside[:, 10:] != np.asarray(travel)[:, 10:])


def test_it_fades_out_where_it_leaves_the_tests_behind():
    """Beyond a tenth of the range the increments are the benchmark's, whatever came before."""
    travel, *heard = made_up(samples=500)
    highest = 100.0
    model = speed_compensator(size=5.0, covered=envelope(displacement=(50.0, highest)))
    found = np.asarray(simulate_compensated(model, travel, *heard))
    ratio = np.diff(found, axis=1) / np.diff(np.asarray(travel), axis=1)
    block = 3 * (np.arange(499) // 3)
    place = np.asarray(heard[1])[:, None] + found[:, block]
    far = place > highest + 0.1 * (highest - 50.0)
    assert far.any(axis=1).all()
    np.testing.assert_allclose(ratio[far], 1.0, rtol=0, atol=8 * EPS * 200.0 / FINE)
    assert np.abs(ratio[place < highest] - 1.0).max() > 0.05


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def by_hand(model, drive):
    """Return travel at the start of each block and the factor in it, test by test, by the equations."""
    network, count = model.networks, model.networks.head.weight.shape[0]
    ih, hh, bias = (np.asarray(getattr(network.cell, n)) for n in ("weight_ih", "weight_hh", "bias"))
    head, offset = np.asarray(network.head.weight)[:, 0], np.asarray(network.head.bias)[:, 0]
    covered = model.operating_range.displacement
    lowest, highest = float(covered.lowest), float(covered.highest)
    travels, factors = np.zeros(drive.command.shape), np.zeros(drive.command.shape)
    for test in range(drive.command.shape[1]):
        output, memory, travel = np.zeros((count, 4)), np.zeros((count, 4)), 0.0
        for block in range(drive.command.shape[0]):
            travels[block, test] = travel
            place = float(drive.initial[test]) + model.sign * travel
            inputs = [
                float(drive.command[block, test]) / float(model.command_scale),
                float(drive.previous_increment[block, test]) / float(model.increment_scale),
                2 * (place - lowest) / (highest - lowest) - 1,
                2 * float(drive.load[test]) - 1,
            ]
            said = []
            for i in range(count):
                gates = ih[i] @ inputs + hh[i] @ output[i] + bias[i]
                enter, forget, candidate, leave = np.split(gates, 4)
                memory[i] = sigmoid(forget) * memory[i] + sigmoid(enter) * np.tanh(candidate)
                output[i] = sigmoid(leave) * np.tanh(memory[i])
                said.append(np.tanh(head[i] @ output[i] + offset[i]))
            factors[block, test] = 1 + 0.5 * np.mean(said)
            travel += factors[block, test] * float(drive.travel_increment[block, test])
    return travels, factors


@pytest.mark.parametrize("joined", [False, True])
@pytest.mark.parametrize("direction", [1, -1])
def test_its_rollout_is_that_of_its_equations(direction, joined):
    travel, *heard = made_up(samples=60)
    model = speed_compensator(direction=direction)
    drive = compute_block_inputs(travel, *heard, model.block_size)
    found = eqx.filter_jit(type(model).rollout)(model, model.networks, drive, fused=joined)
    expected = by_hand(model, drive)
    # Single precision in 20 steps, each sums of nine products of order 1; travel is the sum of them.
    single = 20 * 9 * float(np.finfo(np.float32).eps)
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=single)
    np.testing.assert_allclose(found[0], expected[0], rtol=0, atol=single * float(travel.max()))
    assert np.ptp(expected[1]) > 0.05


@pytest.mark.parametrize("every", [1, 3, 8])
def test_what_it_hears_are_means_and_sums_over_the_block_before(every):
    travel, *heard = made_up()
    drive = compute_block_inputs(travel, *heard, every)
    blocks = -(-SAMPLES // every)
    assert (
        drive.command.shape
        == drive.previous_increment.shape
        == drive.travel_increment.shape
        == (blocks, TESTS)
    )
    np.testing.assert_array_equal(drive.travel_increment.sum(axis=0), travel[:, -1])
    np.testing.assert_array_equal(drive.previous_increment[1:], drive.travel_increment[:-1])
    assert not np.any(drive.previous_increment[0])
    assert not np.any(drive.command[0])
    for block in range(blocks):
        start, stop = block * every, min((block + 1) * every, SAMPLES - 1)
        np.testing.assert_array_equal(drive.travel_increment[block], (travel[:, stop] - travel[:, start]))
        if block:
            mean = np.asarray(heard[0])[:, start - every : start].mean(axis=1)
            np.testing.assert_allclose(drive.command[block], mean, rtol=4 * EPS)


def changed_within(start, stop):
    """Return travel and command, and those of a command that differs in samples `start:stop` alone."""
    travel, command, *rest = made_up()
    other = np.array(command)
    other[:, start:stop] = 0.05
    steps = np.diff(np.asarray(travel), axis=1)
    steps[:, start:stop] = FINE
    moved = np.concatenate([np.zeros((TESTS, 1)), np.cumsum(steps, axis=1)], axis=1)
    return (travel, command, *rest), (jnp.asarray(moved), jnp.asarray(other), *rest)


@pytest.mark.parametrize("every", [1, 3, 8])
def test_within_a_block_a_command_changes_only_what_the_benchmark_does(every):
    start, stop = 6 * every, 7 * every
    model = speed_compensator(size=5.0, every=every)
    one, other = changed_within(start, stop)
    factors = [
        np.asarray(model.rollout(model.networks, compute_block_inputs(*each, every))[1])
        for each in (one, other)
    ]
    np.testing.assert_array_equal(factors[0][:7], factors[1][:7])
    assert np.all(factors[0][7] != factors[1][7])
    found, changed = (np.asarray(simulate_compensated(model, *each)) for each in (one, other))
    np.testing.assert_array_equal(found[:, : start + 1], changed[:, : start + 1])
    ratio = np.diff(changed[:, start : stop + 1], axis=1) / FINE
    # Steps of 1/1024 mm of a travel of up to 100 mm, rounded twice.
    rounding = 8 * EPS * float(one[0].max()) / FINE
    np.testing.assert_allclose(ratio, np.repeat(factors[0][6][:, None], every, axis=1), rtol=0, atol=rounding)


@pytest.mark.parametrize("anchored_every", [1, 4, 10])
def test_it_starts_anew_from_what_was_measured_where_it_is_asked_to(anchored_every):
    travel, *heard = made_up()
    model = speed_compensator(size=5.0, every=5)
    drive = compute_block_inputs(travel, *heard, model.block_size)
    measured = jnp.asarray(np.random.default_rng(1).uniform(0.0, 30.0, drive.travel_increment.shape))
    found, factor = (
        np.asarray(each)
        for each in model.rollout(model.networks, drive, measured=measured, anchor_interval=anchored_every)
    )
    block = np.arange(len(found))
    anchored = block % anchored_every == 0
    np.testing.assert_array_equal(found[anchored], np.asarray(measured)[anchored])
    after = found + factor * np.asarray(drive.travel_increment)
    gone_on = np.flatnonzero(~anchored)
    np.testing.assert_allclose(found[gone_on], after[gone_on - 1], rtol=4 * EPS)
    free = model.rollout(model.networks, drive)[0]
    once = model.rollout(model.networks, drive, measured=0 * measured, anchor_interval=len(found))[0]
    np.testing.assert_array_equal(once, free)


def test_what_comes_later_changes_nothing_before():
    travel, command, initial, load = made_up()
    model = replace(speed_compensator(size=5.0), block_size=1)
    late = np.arange(SAMPLES) >= 120
    changed = jnp.asarray(np.where(late, 0.0, np.asarray(command)))
    stopped = jnp.asarray(np.where(late, np.asarray(travel)[:, 120:121], np.asarray(travel)))
    one = np.asarray(simulate_compensated(model, travel, command, initial, load))
    other = np.asarray(simulate_compensated(model, stopped, changed, initial, load))
    np.testing.assert_array_equal(one[:, :120], other[:, :120])
    assert np.all(one[:, 125:] != other[:, 125:])
