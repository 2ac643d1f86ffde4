"""The compensator against plain loops over the formulas of method.md sec. 3."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.compensator import (
    FEATURES,
    Compensator,
    Sample,
    free_run,
    measured_features,
    rolled_out,
    warmed_up,
)
from hitchid.lstm import Lstm

STEP_S = 0.01
SAMPLES, WINDOW, HIDDEN = 60, 10, 4
# Single precision through one window: each of ten steps rounds sums of 14 products of order 1.
SINGLE = 10 * 14 * float(np.finfo(np.float32).eps)


@pytest.fixture(scope="module")
def made_up():
    """Return a made-up test of one compensator: arrays of shape [N]."""
    rng = np.random.default_rng(0)
    time_s = STEP_S * np.arange(SAMPLES)
    command = rng.uniform(0, 1, SAMPLES)
    benchmark = 80 + np.cumsum(0.2 * command)
    displacement = benchmark + np.cumsum(0.05 * rng.standard_normal(SAMPLES))
    return Sample(*(jnp.asarray(each) for each in (time_s, command, benchmark, displacement)))


def by_hand(made_up):
    """Return the ten features by a plain loop, shape [N, 10]."""
    t, u, y_tf, y = (np.asarray(each) for each in made_up)
    e = [float(measured - modelled) for measured, modelled in zip(y, y_tf, strict=True)]
    rows, total = [], 0.0
    for i in range(len(t)):
        last = max(i - 1, 0)
        one_before = e[i - 1] if i >= 1 else 0.0
        two_before = e[i - 2] if i >= 2 else 0.0
        total += STEP_S * e[i]
        rows.append(
            [
                t[i],
                u[i],
                u[i] - u[last],
                y_tf[i],
                y_tf[i] - y_tf[last],
                y[i],
                (y[i] - y[last]) / STEP_S,
                one_before,
                one_before - two_before,
                total,
            ]
        )
    return np.array(rows)


@pytest.fixture(scope="module")
def untrained(made_up):
    rows = by_hand(made_up)
    return Compensator(
        Lstm.fresh(jax.random.key(0), len(FEATURES), HIDDEN),
        jnp.asarray(rows.mean(axis=0)),
        jnp.asarray(rows.std(axis=0)),
        jnp.asarray(0.05),
        WINDOW,
    )


@pytest.fixture(scope="module")
def compensator(untrained):
    """Return a compensator that says something: its output layer is not zero."""
    rng = np.random.default_rng(1)
    return eqx.tree_at(
        lambda c: (c.network.head.weight, c.network.head.bias),
        untrained,
        (jnp.asarray(rng.normal(size=(1, HIDDEN)), jnp.float32), jnp.asarray([0.1], jnp.float32)),
    )


roll = eqx.filter_jit(rolled_out)
run_free = eqx.filter_jit(free_run)
warm = eqx.filter_jit(warmed_up)
features_of = eqx.filter_jit(measured_features)
EVERY = jnp.ones(SAMPLES, dtype=bool)


def test_features_are_the_ten_formulas_of_the_method(made_up):
    memory, features = features_of(made_up, STEP_S)
    expected = by_hand(made_up)
    np.testing.assert_allclose(features, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(memory.error, np.asarray(made_up.displacement - made_up.benchmark), atol=1e-12)
    assert len(FEATURES) == expected.shape[1]


def test_features_of_tests_side_by_side_are_those_of_each(made_up):
    other = jax.tree.map(lambda array: array[::-1], made_up)
    pair = jax.tree.map(lambda *each: jnp.stack(each, axis=1), made_up, other)
    _, both = features_of(pair, STEP_S)
    np.testing.assert_allclose(both[:, 0], by_hand(made_up), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(both[:, 1], by_hand(other), rtol=1e-12, atol=1e-12)


def test_an_untrained_compensator_is_persistence_at_every_horizon(untrained, made_up):
    ahead = roll(untrained, made_up, EVERY, 7, STEP_S)
    error = np.asarray(made_up.displacement - made_up.benchmark)
    np.testing.assert_array_equal(ahead, np.broadcast_to(error, (7, SAMPLES)))
    alone = run_free(untrained, *(each[:, None] for each in made_up[:3]), STEP_S)
    assert not np.any(alone)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def read_by_hand(compensator, rows):
    """Return output and cell of the LSTM after some rows of features, by its textbook equations."""
    cell = compensator.network.cell
    output, memory = np.zeros(HIDDEN), np.zeros(HIDDEN)
    for row in rows:
        scaled = (row - np.asarray(compensator.centre)) / np.asarray(compensator.spread)
        total = (
            np.asarray(cell.weight_ih) @ scaled + np.asarray(cell.weight_hh) @ output + np.asarray(cell.bias)
        )
        enter, forget, candidate, leave = np.split(total, 4)
        memory = sigmoid(forget) * memory + sigmoid(enter) * np.tanh(candidate)
        output = sigmoid(leave) * np.tanh(memory)
    return output, memory


def test_warming_up_reads_exactly_the_window_that_ends_at_each_sample(compensator, made_up):
    features = by_hand(made_up)
    hidden = warm(compensator, jnp.asarray(features), EVERY)
    for sample in (0, 1, WINDOW - 2, WINDOW - 1, WINDOW, 33, SAMPLES - 1):
        output, cell = read_by_hand(compensator, features[max(0, sample - WINDOW + 1) : sample + 1])
        np.testing.assert_allclose(hidden.output[sample], output, atol=SINGLE)
        np.testing.assert_allclose(hidden.cell[sample], cell, atol=SINGLE * max(1, np.abs(cell).max()))
    # Were the window one longer, it would show by far more than rounding.
    longer, _ = read_by_hand(compensator, features[33 - WINDOW : 34])
    assert np.abs(longer - np.asarray(hidden.output[33])).max() > 10 * SINGLE


def test_samples_that_do_not_exist_are_not_read(compensator, made_up):
    features = by_hand(made_up)
    valid = np.arange(SAMPLES) < 40
    hidden = warm(compensator, jnp.asarray(np.where(valid[:, None], features, 1e6)), jnp.asarray(valid))
    full = warm(compensator, jnp.asarray(features), EVERY)
    np.testing.assert_array_equal(hidden.output[:40], full.output[:40])
    # Five samples after the last, half of the window is left.
    output, _ = read_by_hand(compensator, features[44 - WINDOW + 1 : 40])
    np.testing.assert_allclose(hidden.output[44], output, atol=SINGLE)


def test_one_step_ahead_is_the_last_error_and_a_step_from_the_network(compensator, made_up):
    features = by_hand(made_up)
    ahead = np.asarray(roll(compensator, made_up, EVERY, 1, STEP_S))[0]
    head = compensator.network.head
    for origin in (0, 5, 33):
        output, _ = read_by_hand(compensator, features[max(0, origin - WINDOW + 1) : origin + 1])
        step = float(np.asarray(head.weight)[0] @ output + np.asarray(head.bias)[0])
        error = float(made_up.displacement[origin] - made_up.benchmark[origin])
        assert ahead[origin] == pytest.approx(error + 0.05 * step, abs=0.05 * 4 * SINGLE)
        assert abs(ahead[origin] - error) > 0.05 * 4 * SINGLE


def test_further_ahead_the_compensator_hears_itself(compensator, made_up):
    ahead = np.asarray(roll(compensator, made_up, EVERY, 4, STEP_S))
    origin = 20
    head = compensator.network.head
    known = by_hand(made_up)[: origin + 1]
    heard = np.array(made_up.displacement)
    for step in range(1, 5):
        rows = by_hand(Sample(*made_up[:3], jnp.asarray(heard)))[: origin + step]
        # Beyond the origin the window grows: what the LSTM has read it keeps.
        output, _ = read_by_hand(compensator, np.concatenate([known[-WINDOW:], rows[origin + 1 :]]))
        last = heard[origin + step - 1] - float(made_up.benchmark[origin + step - 1])
        error = last + 0.05 * float(np.asarray(head.weight)[0] @ output + np.asarray(head.bias)[0])
        assert ahead[step - 1, origin] == pytest.approx(error, abs=step * 0.05 * 4 * SINGLE)
        heard[origin + step] = float(made_up.benchmark[origin + step]) + error


def test_a_free_run_is_a_roll_out_from_a_start_without_error(compensator, made_up):
    rested = made_up._replace(displacement=made_up.displacement.at[0].set(made_up.benchmark[0]))
    ahead = np.asarray(roll(compensator, rested, EVERY, SAMPLES - 1, STEP_S))[:, 0]
    alone = np.asarray(run_free(compensator, *(each[:, None] for each in made_up[:3]), STEP_S))[:, 0]
    assert alone[0] == 0.0
    assert np.abs(alone).max() > 0.05
    # One computation in two programs: single precision at each of 60 steps, each step of size σ.
    np.testing.assert_allclose(alone[1:], ahead, atol=SAMPLES * 0.05 * SINGLE)


def test_the_scaling_travels_with_the_compensator(compensator, made_up):
    # Another unit of displacement, with the scaling in that unit: 1024 changes no digit of any number.
    unit = np.array([1.0, 1.0, 1.0, *[1024.0] * 7])
    other = eqx.tree_at(
        lambda c: (c.centre, c.spread, c.error_step),
        compensator,
        (compensator.centre * unit, compensator.spread * unit, compensator.error_step * 1024.0),
    )
    larger = made_up._replace(
        benchmark=1024.0 * made_up.benchmark, displacement=1024.0 * made_up.displacement
    )
    ours, theirs = roll(compensator, made_up, EVERY, 7, STEP_S), roll(other, larger, EVERY, 7, STEP_S)
    np.testing.assert_array_equal(1024.0 * ours, theirs)


def test_padding_changes_no_prediction(compensator, made_up):
    count = 40
    short = jax.tree.map(lambda array: array[:count], made_up)
    padded = jax.tree.map(lambda array: jnp.where(jnp.arange(SAMPLES) < count, array, 0.0), made_up)
    alone = np.asarray(roll(compensator, short, EVERY[:count], 7, STEP_S))
    beside = np.asarray(roll(compensator, padded, jnp.arange(SAMPLES) < count, 7, STEP_S))
    for horizon in range(1, 8):
        reached = count - horizon
        np.testing.assert_allclose(
            beside[horizon - 1, :reached], alone[horizon - 1, :reached], atol=horizon * 0.05 * SINGLE
        )
