"""The baselines against recursions written out by hand."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.baselines.arx import Arx
from hitchid.baselines.autoregression import predict_ahead
from hitchid.baselines.black_box import BlackBox, accumulated
from hitchid.baselines.narx import Narx
from hitchid.networks.lstm import Lstm

PAST, COMMAND = np.array([1.5, -0.3, -0.25]), np.array([0.2, -0.1, 0.4])
SAMPLES = 120


def recursion(command, past=PAST, weights=COMMAND):
    """Return w(k) = Σ aᵢ w(k−i) + Σ bᵢ u(k−i) from rest, shape [N]."""
    travel = []
    for k in range(len(command)):
        known = sum(past[i] * travel[k - 1 - i] for i in range(len(past)) if k - 1 - i >= 0)
        driven = sum(weights[i] * command[k - 1 - i] for i in range(len(weights)) if k - 1 - i >= 0)
        travel.append(known + driven)
    return np.array(travel)


@pytest.fixture
def tests():
    rng = np.random.default_rng(0)
    commands = [rng.normal(size=size) for size in (SAMPLES, SAMPLES // 2)]
    return [(command, recursion(command), np.ones(command.size, dtype=bool)) for command in commands]


def test_arx_is_found_again_from_tests_without_noise(tests):
    found = Arx.fit(tests, 3)
    np.testing.assert_allclose(found.past, PAST, rtol=1e-10)
    np.testing.assert_allclose(found.command, COMMAND, rtol=1e-10)


def test_arx_is_not_fitted_to_samples_that_do_not_count(tests):
    spoilt = []
    for command, travel, counted in tests:
        late = np.arange(travel.size) >= 40
        spoilt.append((command, np.where(late, 1e3, travel), counted & ~late))
    found = Arx.fit(spoilt, 3)
    np.testing.assert_allclose(found.past, PAST, rtol=1e-10)
    np.testing.assert_allclose(found.command, COMMAND, rtol=1e-10)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_free_run_of_arx_is_the_recursion(tests, order):
    model = Arx(PAST[:order] / 2, COMMAND[:order])
    command = tests[0][0]
    expected = recursion(command, PAST[:order] / 2, COMMAND[:order])
    # A stable recursion adds at most six rounded products a step.
    np.testing.assert_allclose(model.simulate(command), expected, atol=1e-13)


def test_one_step_of_arx_uses_what_was_measured_up_to_the_sample_before(tests):
    model = Arx(PAST, COMMAND)
    command, travel, _ = tests[0]
    measured = travel + np.random.default_rng(1).normal(size=travel.size)
    found = model.one_step(command, measured)
    assert found[0] == 0.0
    for k in (1, 2, 3, 50):
        before = [j for j in range(k - 3, k) if j >= 0][::-1]
        expected = PAST[: len(before)] @ measured[before] + COMMAND[: len(before)] @ command[before]
        assert found[k] == pytest.approx(expected, abs=1e-13)
    np.testing.assert_allclose(model.one_step(command, travel), travel, atol=1e-12)


AUTOREGRESSIONS = {
    "arx": Arx(PAST, COMMAND),
    "narx": Narx(
        np.array([[1, 0], [2, 0], [-1, 0], [-2, -2], [-2, 1]]),
        np.array([1.2, -0.3, 0.5, 0.1, -0.05]),
        np.array(2.0),
        np.array(0.5),
    ),
}

every_autoregression = pytest.mark.parametrize("model", AUTOREGRESSIONS.values(), ids=AUTOREGRESSIONS.keys())


@pytest.fixture
def measured():
    """Return a command and a travel that no model gives, from rest, shape [N] each."""
    rng = np.random.default_rng(4)
    command = np.concatenate([np.zeros(4), rng.uniform(-1.0, 1.0, SAMPLES - 4)])
    return command, np.concatenate([np.zeros(4), np.cumsum(0.1 * rng.normal(size=SAMPLES - 4))])


@every_autoregression
def test_one_sample_ahead_is_one_step(model, measured):
    command, travel = measured
    (found,) = predict_ahead(model, command, travel, [1])
    assert found[0] == 0.0
    np.testing.assert_allclose(found[1:], model.one_step(command, travel)[1:], rtol=0, atol=1e-13)


@every_autoregression
def test_from_the_first_sample_any_horizon_is_the_free_run(model, measured):
    command, travel = measured
    horizons = [1, 5, 30, SAMPLES - 1]
    rows = predict_ahead(model, command, travel, horizons)
    free = model.simulate(command)
    for horizon, row in zip(horizons, rows, strict=True):
        np.testing.assert_array_equal(row[:horizon], 0.0)
        assert row[horizon] == pytest.approx(free[horizon], abs=1e-12)
    assert abs(free[30]) > 0.01


@every_autoregression
def test_between_them_it_is_the_recursion_from_what_was_measured_up_to_the_horizon_before(model, measured):
    command, travel = measured
    rows = predict_ahead(model, command, travel, [2, 7])
    for horizon, row in zip((2, 7), rows, strict=True):
        for k in (10, 60, SAMPLES - 1):
            known = list(travel[: k - horizon + 1])
            for _ in range(horizon):
                last = slice(len(known) - model.lag, len(known))
                columns = command[last][::-1, None], np.array(known)[last][::-1, None]
                known.append(float(model.predict_next(*columns)[0]))
            assert len(known) == k + 1
            assert row[k] == pytest.approx(known[-1], abs=1e-13)
    # What was measured later than that does not count.
    later = np.where(np.arange(SAMPLES) > 60 - 7, 99.0, travel)
    assert predict_ahead(model, command, later, [7])[0, 60] == rows[1, 60]
    assert predict_ahead(model, command, later, [2])[0, 60] != rows[0, 60]


@pytest.fixture(scope="module")
def black_box():
    rng = np.random.default_rng(2)
    network = eqx.tree_at(
        lambda n: (n.head.weight, n.head.bias),
        Lstm.init(jax.random.key(0), 2, 4),
        (jnp.asarray(rng.normal(size=(1, 4)), jnp.float32), jnp.asarray([0.3], jnp.float32)),
    )
    return BlackBox(network, jnp.asarray(2.0), jnp.asarray(50.0), jnp.asarray(30.0), jnp.asarray(0.1))


run = eqx.filter_jit(BlackBox.travel)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def summed_by_hand(black_box, command, initial):
    """Return the sum of the network's outputs at all samples before each, σ times, shape [N]."""
    cell, head = black_box.network.cell, black_box.network.head
    output, memory, total, travel = np.zeros(4), np.zeros(4), 0.0, []
    for u in command:
        travel.append(total)
        inputs = np.array([u / 2.0, (initial - 50.0) / 30.0])
        gates = (
            np.asarray(cell.weight_ih) @ inputs + np.asarray(cell.weight_hh) @ output + np.asarray(cell.bias)
        )
        enter, forget, candidate, leave = np.split(gates, 4)
        memory = sigmoid(forget) * memory + sigmoid(enter) * np.tanh(candidate)
        output = sigmoid(leave) * np.tanh(memory)
        total += 0.1 * float(np.asarray(head.weight)[0] @ output + np.asarray(head.bias)[0])
    return np.array(travel)


def test_free_run_of_the_black_box_is_the_sum_of_the_networks_outputs(black_box):
    commands = np.random.default_rng(3).uniform(0, 2, (2, 80))
    found = np.asarray(run(black_box, jnp.asarray(commands), jnp.array([20.0, 95.0])))
    assert found.shape == (2, 80)
    assert np.all(found[:, 0] == 0.0)
    for row, initial in enumerate((20.0, 95.0)):
        expected = summed_by_hand(black_box, commands[row], initial)
        # Single precision in each of 80 steps, sums of six products of order 1, then summed.
        np.testing.assert_allclose(found[row], expected, atol=80 * 0.1 * 6 * 1.2e-7 * 10)


def test_the_black_box_neither_sees_ahead_nor_forgets_where_it_started(black_box):
    commands = np.random.default_rng(3).uniform(0, 2, (2, 80))
    later = np.where(np.arange(80) >= 50, 0.0, commands)
    start = jnp.array([20.0, 95.0])
    one, other = run(black_box, jnp.asarray(commands), start), run(black_box, jnp.asarray(later), start)
    np.testing.assert_array_equal(one[:, :51], other[:, :51])
    assert np.all(np.asarray(one[:, 51:]) != np.asarray(other[:, 51:]))
    swapped = run(black_box, jnp.asarray(commands), start[::-1])
    assert np.all(np.asarray(one[:, 1:]) != np.asarray(swapped[:, 1:]))


def test_accumulated_adds_up_all_changes_before_a_sample():
    changes = jnp.array([[1.0, 2.0, 4.0, 8.0]])
    np.testing.assert_array_equal(accumulated(changes), [[0.0, 1.0, 3.0, 7.0]])
