"""The compensator against plain loops over the formulas of method.md sec. 3."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.identification.phase2 import _sequences
from hitchid.model.channel import multi_step_errors
from hitchid.model.load_filter import LoadFilter
from hitchid.networks.error_compensator import (
    COMPENSATOR_FEATURES,
    Compensator,
    Sample,
    free_run,
    measured_features,
)
from hitchid.networks.lstm import Lstm
from hitchid.structures import Batch

STEP_S = 0.01
SAMPLES, WINDOW, HIDDEN = 60, 10, 4
# Single precision through two windows: each of twenty steps rounds sums of 14 products of order 1.
SINGLE = 20 * 14 * float(np.finfo(np.float32).eps)
ERROR_STEP = 0.05


@pytest.fixture(scope="module")
def made_up():
    """Return a made-up test of one compensator: arrays of shape [N]."""
    rng = np.random.default_rng(0)
    time_s = STEP_S * np.arange(SAMPLES)
    command = rng.uniform(0, 1, SAMPLES)
    benchmark = 80 + np.cumsum(0.2 * command)
    displacement = benchmark + np.cumsum(0.05 * rng.standard_normal(SAMPLES))
    return Sample(*map(jnp.asarray, (time_s, command, benchmark, displacement)))


def by_hand(made_up):
    """Return the ten features by a plain loop, shape [N, 10]."""
    t, u, y_tf, y = map(np.asarray, made_up)
    e = [0.0, 0.0, *(y - y_tf)]  # of two samples before the first, too
    rows, total = [], 0.0
    for i in range(len(t)):
        last = max(i - 1, 0)
        total += STEP_S * e[i + 2]
        changes = u[i] - u[last], y_tf[i] - y_tf[last], (y[i] - y[last]) / STEP_S, e[i + 1] - e[i]
        rows.append(
            [t[i], u[i], changes[0], y_tf[i], changes[1], y[i], changes[2], e[i + 1], changes[3], total]
        )
    return np.array(rows)


@pytest.fixture(scope="module")
def untrained(made_up):
    rows = by_hand(made_up)
    return Compensator(
        Lstm.init(jax.random.key(0), len(COMPENSATOR_FEATURES), HIDDEN),
        jnp.asarray(rows.mean(axis=0)),
        jnp.asarray(rows.std(axis=0)),
        jnp.asarray(ERROR_STEP),
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


@eqx.filter_jit
def roll(compensator, test, trust, horizon, step_s):
    return multi_step_errors(LoadFilter.none(), compensator, test, trust, horizon, step_s)


run_free = eqx.filter_jit(free_run)
features_of = eqx.filter_jit(measured_features)
TRUSTED = jnp.ones(SAMPLES)


def test_features_are_the_ten_formulas_of_the_method(made_up):
    memory, features = features_of(made_up, STEP_S)
    expected = by_hand(made_up)
    np.testing.assert_allclose(features, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(memory.error, np.asarray(made_up.displacement - made_up.benchmark), atol=1e-12)
    assert len(COMPENSATOR_FEATURES) == expected.shape[1]
    # Those of tests side by side are those of each.
    other = jax.tree.map(lambda array: array[::-1], made_up)
    _, both = features_of(jax.tree.map(lambda *pair: jnp.stack(pair, axis=1), made_up, other), STEP_S)
    np.testing.assert_allclose(both[:, 0], expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(both[:, 1], by_hand(other), rtol=1e-12, atol=1e-12)


def test_an_untrained_compensator_is_persistence_at_every_horizon(untrained, made_up):
    ahead = roll(untrained, made_up, TRUSTED, 7, STEP_S)
    error = np.asarray(made_up.displacement - made_up.benchmark)
    np.testing.assert_array_equal(ahead, np.broadcast_to(error, (7, SAMPLES)))
    alone = run_free(untrained, *(signal[:, None] for signal in made_up[:3]), STEP_S)
    assert not np.any(alone)


def read_by_hand(compensator, rows):
    """Return the output of the LSTM after some rows of features, by its textbook equations."""

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    cell = jax.tree.map(np.asarray, compensator.network.cell)
    output, memory = np.zeros(HIDDEN), np.zeros(HIDDEN)
    for row in (rows - np.asarray(compensator.centre)) / np.asarray(compensator.spread):
        total = cell.weight_ih @ row + cell.weight_hh @ output + cell.bias
        enter, forget, candidate, leave = np.split(total, 4)
        memory = sigmoid(forget) * memory + sigmoid(enter) * np.tanh(candidate)
        output = sigmoid(leave) * np.tanh(memory)
    return output


def heard_from(position):
    """Return the sample from which the features are read that predict one at `position`."""
    return max(0, (position // WINDOW - 1) * WINDOW - 1)


def step_by_hand(compensator, rows, position):
    """Return the step of the error to the sample at `position`, all read anew from where it begins."""
    output = read_by_hand(compensator, rows[heard_from(position) : position])
    head = compensator.network.head
    return ERROR_STEP * float(np.asarray(head.weight)[0] @ output + np.asarray(head.bias)[0])


def test_a_step_reads_features_since_the_last_handover_but_one(compensator, made_up):
    rows = by_hand(made_up)
    ahead = np.asarray(roll(compensator, made_up, TRUSTED, 1, STEP_S))[0]
    error = np.asarray(made_up.displacement - made_up.benchmark)
    # Four outputs of order 1, weighted.
    rounding = ERROR_STEP * 4 * SINGLE
    read = []
    for origin in range(SAMPLES):
        step = step_by_hand(compensator, rows, origin + 1)
        assert ahead[origin] - error[origin] == pytest.approx(step, abs=rounding)
        read.append(origin + 1 - heard_from(origin + 1))
    assert (min(read[WINDOW:]), max(read)) == (WINDOW + 1, 2 * WINDOW)
    # Were one sample more or less read at the far end, it would show by more than what is allowed above.
    position = 4 * WINDOW
    start = heard_from(position)
    for other in (start - 1, start + 1):
        output = read_by_hand(compensator, rows[other:position])
        moved = ERROR_STEP * float(np.asarray(compensator.network.head.weight)[0] @ output + 0.1)
        assert abs(moved - (ahead - error)[position - 1]) > 2 * rounding


def test_training_reads_what_a_prediction_reads(compensator, made_up, make_record):
    features = by_hand(made_up)
    record = make_record(made_up.displacement, made_up.command)
    batch = Batch.of([record], "lifting", dead_zone=0.0, sign=1)
    wide = np.zeros((1, batch.command.shape[1], len(COMPENSATOR_FEATURES)))
    wide[0, :SAMPLES] = features
    innovations = np.random.default_rng(2).normal(size=wide.shape[:2])
    sequences = _sequences(compensator, wide, innovations, np.asarray(batch.loss_mask))
    scaled = np.asarray(compensator.scale(jnp.asarray(features)))
    for stretch in range(SAMPLES // WINDOW):
        for place in np.flatnonzero(sequences.loss_mask[stretch]):
            position = stretch * WINDOW + int(place)
            read = slice(0, WINDOW + int(place) + 1)
            valid = np.asarray(sequences.valid[stretch])[read]
            rows = np.asarray(sequences.features[stretch])[read][valid]
            np.testing.assert_array_equal(rows, scaled[heard_from(position) : position])
            expected = innovations[0, position] / ERROR_STEP
            assert float(sequences.target[stretch, place]) == pytest.approx(expected, rel=1e-6)
    assert int(sequences.loss_mask.sum()) == SAMPLES - 1


@pytest.mark.parametrize("origin", [0, 5, WINDOW - 2, 20, 33])
def test_further_ahead_the_compensator_hears_itself(compensator, made_up, origin):
    horizon = WINDOW + 3
    ahead = np.asarray(roll(compensator, made_up, TRUSTED, horizon, STEP_S))[:, origin]
    heard = np.array(made_up.displacement)
    for step in range(1, horizon + 1):
        position = origin + step
        rows = by_hand(Sample(*made_up[:3], jnp.asarray(heard)))
        last = heard[position - 1] - float(made_up.benchmark[position - 1])
        error = last + step_by_hand(compensator, rows, position)
        # What was rounded before is heard again: in ten features of spread near 1, weights below 1/2.
        assert ahead[step - 1] == pytest.approx(error, abs=step * ERROR_STEP * 4 * SINGLE)
        heard[position] = float(made_up.benchmark[position]) + error


@pytest.mark.parametrize("largest", [1, 4])
def test_beyond_its_largest_horizon_a_compensator_corrects_nothing(compensator, made_up, largest):
    limited = replace(compensator, max_horizon=largest)
    full, found = (np.asarray(roll(c, made_up, TRUSTED, 9, STEP_S)) for c in (compensator, limited))
    np.testing.assert_allclose(found[:largest], full[:largest], rtol=0, atol=1e-13)
    # Without a filter the error that was reached stays.
    np.testing.assert_allclose(
        found[largest:], np.broadcast_to(found[largest - 1], (9 - largest, SAMPLES)), rtol=0, atol=1e-12
    )
    assert np.abs(full[largest:] - found[largest:]).max() > 0.1 * ERROR_STEP


def test_trust_counts_in_proportion_at_the_sample_a_step_is_from(compensator, made_up):
    error = np.asarray(made_up.displacement - made_up.benchmark)
    none = roll(compensator, made_up, 0 * TRUSTED, 7, STEP_S)
    np.testing.assert_array_equal(none, np.broadcast_to(error, (7, SAMPLES)))
    full, half, without = (
        np.asarray(roll(compensator, made_up, trust, 3, STEP_S))
        for trust in (TRUSTED, 0.5 * TRUSTED, TRUSTED.at[30].set(0.0))
    )
    np.testing.assert_allclose(half[0] - error, 0.5 * (full[0] - error), rtol=0, atol=1e-13)
    assert np.abs(full[0] - error).max() > 0.1 * ERROR_STEP
    assert without[0, 30] == error[30]
    assert without[1, 29] == without[0, 29] == full[0, 29]
    assert np.all(full[[0, 1], [30, 29]] != without[[0, 1], [30, 29]])
    np.testing.assert_array_equal(without[:, 31:], full[:, 31:])


def test_no_later_measurement_or_command_changes_a_prediction(compensator, made_up):
    at, horizon = 30, 4
    later = jnp.arange(SAMPLES) >= at
    measured = made_up._replace(displacement=jnp.where(later, 500.0, made_up.displacement))
    commanded = made_up._replace(
        command=jnp.where(later, 5.0, made_up.command), benchmark=jnp.where(later, 0.0, made_up.benchmark)
    )
    one, other, moved = (
        np.asarray(roll(compensator, test, TRUSTED, horizon, STEP_S))
        for test in (made_up, measured, commanded)
    )
    np.testing.assert_array_equal(one[:, :at], other[:, :at])
    assert np.all(one[:, at:] != other[:, at:])
    for step in range(1, horizon + 1):
        # The sample 30 is predicted from the commands of those before it.
        first = at + 1 - step
        np.testing.assert_array_equal(one[step - 1, :first], moved[step - 1, :first])
        assert one[step - 1, first] != moved[step - 1, first]


def test_a_free_run_is_a_roll_out_without_initial_error(compensator, made_up):
    rested = made_up._replace(displacement=made_up.displacement.at[0].set(made_up.benchmark[0]))
    ahead = np.asarray(roll(compensator, rested, TRUSTED, SAMPLES - 1, STEP_S))[:, 0]
    alone = np.asarray(run_free(compensator, *(signal[:, None] for signal in made_up[:3]), STEP_S))[:, 0]
    assert alone[0] == 0.0
    assert np.abs(alone).max() > 0.05
    # One computation in two programs: single precision at each of 60 steps, each step of size σ.
    np.testing.assert_allclose(alone[1:], ahead, atol=SAMPLES * ERROR_STEP * SINGLE)


def test_the_scaling_travels_with_the_compensator(compensator, made_up):
    # Another unit of displacement, with the scaling in that unit: 1024 changes no digit of any number.
    unit = np.array([1.0, 1.0, 1.0, *[1024.0] * 7])
    other = eqx.tree_at(
        lambda c: (c.centre, c.spread, c.error_step),
        compensator,
        (compensator.centre * unit, compensator.spread * unit, compensator.error_step * 1024.0),
    )
    benchmark, displacement = 1024.0 * made_up.benchmark, 1024.0 * made_up.displacement
    larger = made_up._replace(benchmark=benchmark, displacement=displacement)
    ours, theirs = roll(compensator, made_up, TRUSTED, 7, STEP_S), roll(other, larger, TRUSTED, 7, STEP_S)
    np.testing.assert_array_equal(1024.0 * ours, theirs)


def test_padding_changes_no_prediction(compensator, made_up):
    count = 40
    short = jax.tree.map(lambda array: array[:count], made_up)
    padded = jax.tree.map(lambda array: jnp.where(jnp.arange(SAMPLES) < count, array, 0.0), made_up)
    alone = np.asarray(roll(compensator, short, TRUSTED[:count], 7, STEP_S))
    beside = np.asarray(roll(compensator, padded, TRUSTED, 7, STEP_S))
    for horizon in range(1, 8):
        reached = count - horizon
        np.testing.assert_allclose(
            beside[horizon - 1, :reached], alone[horizon - 1, :reached], atol=horizon * ERROR_STEP * SINGLE
        )
