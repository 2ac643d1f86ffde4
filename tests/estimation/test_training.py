"""Gradient descent on problems whose answer is known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.estimation.training import TrainingStopReason, pad_to_batches, train
from hitchid.identification import AdamConfig

RNG = np.random.default_rng(0)
INPUTS = RNG.normal(size=(64, 3))
WEIGHTS = np.array([0.7, -0.4, 0.2])
KEY = jax.random.key(0)


class Linear(eqx.Module):
    """y = x · w, with a label that no training may touch."""

    weights: jax.Array
    label: int = 7


def squares(network, data):
    inputs, target = data
    return jnp.sum((inputs @ network.weights - target) ** 2), jnp.asarray(target.size)


def regression(weights, inputs=INPUTS):
    return jnp.asarray(inputs), jnp.asarray(inputs @ np.asarray(weights))


def trained(training, validation, *, start=(0.0, 0.0, 0.0), key=KEY, progress=None, **settings):
    settings = AdamConfig(**{"epochs": 30, "patience": 30, "batch": 16, "learning_rate": 0.03, **settings})
    return train(Linear(jnp.array(start)), squares, training, validation, settings, key, progress)


def test_linear_regression_converges_to_least_squares():
    noisy = INPUTS @ WEIGHTS + 0.1 * RNG.normal(size=64)
    data = (jnp.asarray(INPUTS), jnp.asarray(noisy))
    network, trace = trained(data, data, epochs=100, patience=100)
    exact, (rest,), *_ = np.linalg.lstsq(INPUTS, noisy, rcond=None)
    # At the end Adam steps by a tenth of the learning rate at most.
    assert np.abs(network.weights - exact).max() <= 0.1 * 0.03
    assert trace.validation.min() == pytest.approx(np.sqrt(rest / 64), rel=1e-3)
    assert network.label == 7


def test_the_weights_of_the_best_epoch_come_back():
    # The validation tests lie half way, so their loss falls, then rises again.
    held = regression(0.5 * WEIGHTS)
    network, trace = trained(regression(WEIGHTS), held, epochs=60, patience=5)
    loss, count = squares(network, held)
    assert trace.best_epoch == np.argmin(trace.validation) + 1
    # The same sum in another compiled program.
    assert float(jnp.sqrt(loss / count)) == pytest.approx(trace.validation.min(), rel=1e-12)
    assert trace.stop_reason is TrainingStopReason.PATIENCE
    assert len(trace.training) == len(trace.validation) == trace.best_epoch + 5 < 60


def test_an_untrained_network_that_is_best_comes_back():
    start = tuple((-0.5 * WEIGHTS).tolist())
    network, trace = trained(regression(WEIGHTS), regression(start), start=start, patience=4)
    np.testing.assert_array_equal(network.weights, start)
    assert trace.best_epoch == 0
    assert trace.stop_reason is TrainingStopReason.PATIENCE
    assert len(trace.training) == len(trace.validation) == 4


def test_all_epochs_are_run_where_the_loss_goes_on_falling():
    rows, data = [], regression(WEIGHTS)
    _, trace = trained(data, data, epochs=6, patience=6, progress=lambda *row: rows.append(row))
    numbers, losses, validation = zip(*rows, strict=True)
    assert trace.stop_reason is TrainingStopReason.EPOCHS
    assert len(trace.training) == len(trace.validation) == trace.best_epoch == 6
    assert numbers == (1, 2, 3, 4, 5, 6)
    np.testing.assert_array_equal(losses, trace.training)
    np.testing.assert_array_equal(validation, trace.validation)


def test_losses_are_root_mean_squares():
    training, held = regression(WEIGHTS), regression(2 * WEIGHTS, INPUTS[:40])
    _, trace = trained(training, held, epochs=1, learning_rate=1e-14)
    # The weights stay zero, so what is missed is the target itself.
    assert trace.training[0] == pytest.approx(np.sqrt(np.mean(np.square(training[1]))), rel=1e-9)
    assert trace.validation[0] == pytest.approx(np.sqrt(np.mean(np.square(held[1]))), rel=1e-9)


def test_an_infinite_loss_ends_with_the_best_weights_before():
    inputs, target = regression(WEIGHTS)
    network, trace = trained((inputs, target.at[3].set(jnp.nan)), (inputs, target))
    np.testing.assert_array_equal(network.weights, np.zeros(3))
    assert trace.stop_reason is TrainingStopReason.FAILED
    assert len(trace.training) == 1
    assert trace.best_epoch == 0


def weighted_squares(network, data):
    inputs, target, weight = data
    return jnp.sum(weight * (inputs @ network.weights - target) ** 2), jnp.sum(weight)


def test_every_sequence_counts_once_in_filled_batches():
    inputs, target = regression(WEIGHTS, INPUTS[:40])
    data = (inputs, target, jnp.ones(40))
    full = pad_to_batches(data, 16)
    assert [each.shape[0] for each in full] == [48, 48, 48]
    for mine, theirs in zip(full, data, strict=True):
        np.testing.assert_array_equal(mine[:40], theirs)
        assert not np.any(mine[40:])
    settings = AdamConfig(epochs=1, batch=16, learning_rate=1e-14)
    _, trace = train(Linear(jnp.zeros(3)), weighted_squares, full, full, settings, KEY)
    # The weights stay zero, so what is missed is the target of all forty.
    expected = np.sqrt(np.mean(np.square(target)))
    assert trace.training[0] == pytest.approx(expected, rel=1e-9)
    assert trace.validation[0] == pytest.approx(expected, rel=1e-9)
    assert pad_to_batches(full, 16)[0].shape == full[0].shape


def test_one_key_gives_one_training_and_another_key_another():
    data = regression(WEIGHTS)
    one, again, other = (trained(data, data, epochs=3, key=jax.random.key(seed))[1] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.training, again.training)
    assert np.all(one.training != other.training)
