"""The black-box LSTM against a recursion written out by hand, and trained on an integrator."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plants import batch_of, context

from handmade import black_box
from hitchid.baselines.black_box import (
    SCALINGS,
    STEPS,
    BlackBoxBaseline,
    block_signals,
    step_samples,
    travel_at_samples,
)
from hitchid.errors import FitError

SAMPLES, SPEED = 128, 0.4


@pytest.fixture
def commands():
    rng = np.random.default_rng(3)
    return [np.repeat(rng.integers(0, 3, 16), 8) / 2.0 for _ in range(8)]


def integrated(commands, factors=None):
    """Return the travel of an integrator with a gain for each test."""
    factors = np.ones(len(commands)) if factors is None else factors
    return [SPEED * f * (np.cumsum(u) - u) for f, u in zip(factors, commands, strict=True)]


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def by_hand(model, command, load, initial, sign):
    """Return displacement at the ends of steps, the members' mean."""
    totals = []
    for member in range(model.networks.head.shape[0]):
        wi, wh, bias, head, head_bias = (
            np.asarray(a[member], float) for a in jax.tree.leaves(model.networks)
        )
        start = (sign * initial - model.position_centre) / model.position_scale
        h, c, position, positions = np.zeros(head.shape[0]), np.zeros(head.shape[0]), float(start), []
        for block in command.reshape(-1, STEPS, int(model.samples)).mean(axis=2) / model.command_scale:
            load_input = (load - model.load_centre) / model.load_scale
            inputs = np.array([value for u in block for value in (u, u)] + [*load_input])
            gates = inputs @ wi + bias + np.append(h, position) @ wh
            i, f, g, o = np.split(gates, 4)
            # Half the argument is part of the weights: the sigmoid is of twice the sum.
            c = sigmoid(2 * f) * c + sigmoid(2 * i) * np.tanh(g)
            h = sigmoid(2 * o) * np.tanh(c)
            for increment in h @ head + head_bias:
                position += float(model.increment_scale) * increment
                positions.append(position)
        totals.append(model.position_scale * (np.array(positions) - start))
    return initial + sign * np.mean(totals, axis=0)


@pytest.mark.parametrize("sign", [1, -1])
def test_free_run_is_the_recursion(commands, sign):
    model = black_box()
    batch = batch_of(commands[:1], integrated(commands[:1]), loads=[0.3], start=60.0, sign=sign)
    computed = model.free_run(batch)[0]
    step = int(model.samples)
    expected = by_hand(model, commands[0], 0.3, 60.0, sign)
    # Single precision in 64 steps of order 1, times the scale of 20 mm.
    np.testing.assert_allclose(
        computed[step::step], expected[: computed[step::step].size], atol=64 * 20 * 1.2e-7
    )
    assert computed[0] == 60.0
    np.testing.assert_allclose(computed[1], (computed[0] + computed[2]) / 2, atol=1e-9)


def test_blocks_keep_the_commands_integral_and_the_travel(commands):
    batch = batch_of(commands, integrated(commands))
    signals = block_signals(batch, 2, np.asarray(batch.loss_mask))
    assert signals.commands.shape == (SAMPLES // (2 * STEPS), 8, STEPS, 2)
    total = 2 * signals.commands[..., 1].sum(axis=(0, 2))
    np.testing.assert_allclose(total, np.sum(np.asarray(batch.command), axis=1), rtol=1e-12)
    rows = travel_at_samples(signals.travel, 2, SAMPLES)
    np.testing.assert_allclose(rows[:, : SAMPLES - 2], np.asarray(batch.travel)[:, : SAMPLES - 2], atol=1e-12)
    assert not signals.mask[-1, :, -1].any()  # beyond the last sample
    command = np.zeros(3000)
    assert step_samples(batch_of([command], [command])) == 6  # 3000 / (64 · 8) = 5.9


def test_an_integrator_is_learnt_and_its_load_heard(commands):
    loads = np.linspace(-1, 1, len(commands))
    travels = integrated(commands, 1 + 0.7 * loads)
    tests = batch_of(commands, travels, loads=loads, start=50.0)
    model = BlackBoxBaseline().fit(tests, context(gradient_steps=400))
    command = commands[0][::-1].copy()
    errors, scale = [], np.abs(travels).max()
    travels = integrated([command], [1 + 0.7 * 0.6])
    for load in (0.6, -0.6):
        batch = batch_of([command], travels, loads=[load], start=50.0)
        errors.append(np.sqrt(np.mean((model.free_run(batch) - np.asarray(batch.displacement)) ** 2)))
    # A load of ±0.6 changes the travel by ±42 %: heard wrongly it costs more than a training leaves.
    assert errors[0] < 0.15 * scale
    assert errors[1] > 1.5 * errors[0]


def test_a_training_without_success_is_no_baseline(commands):
    # Training tests rise, validation tests fall with the same command.
    factors = np.where(np.arange(8) % 4 == 3, -1.0, 1.0)
    tests = batch_of(commands, integrated(commands, factors), start=50.0)
    with pytest.raises(FitError, match="never became better"):
        BlackBoxBaseline().fit(tests, context(gradient_steps=50))


def test_one_seed_gives_one_ensemble_another_another(commands):
    # A test alone is learnt from its first three quarters.
    tests = batch_of(commands[:1], integrated(commands[:1]), start=50.0)
    one, same, other = (
        np.asarray(BlackBoxBaseline().fit(tests, context(seed, gradient_steps=50)).networks.head)
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(one, same)
    assert np.all(np.isfinite(one))
    assert np.all(one != other)


def test_restored_from_its_shapes_it_is_of_the_same_form():
    model = black_box()
    shapes = {
        f"networks/{f.name}": getattr(model.networks, f.name).shape
        for f in dataclasses.fields(model.networks)
    }
    shapes |= {name: np.shape(getattr(model, name)) for name in SCALINGS}
    restored = BlackBoxBaseline().skeleton(shapes)
    for one, other in zip(jax.tree.leaves(model), jax.tree.leaves(restored), strict=True):
        assert jnp.shape(one) == jnp.shape(other)
