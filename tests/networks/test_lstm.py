"""A whole sequence read at once is what is read input by input, and so is its derivative."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.networks.lstm import Lstm

INPUTS, HIDDEN, SAMPLES, SEQUENCES = 3, 5, 40, 7
SINGLE = float(np.finfo(np.float32).eps)


@pytest.fixture
def network():
    rng = np.random.default_rng(1)
    fresh = Lstm.init(jax.random.key(0), INPUTS, HIDDEN)
    return jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), jnp.float32), fresh)


@pytest.fixture
def inputs():
    return jnp.asarray(np.random.default_rng(2).normal(size=(SAMPLES, SEQUENCES, INPUTS)), jnp.float32)


@pytest.fixture(params=["all", "some", "none"])
def exist(request):
    """Return which inputs exist: one sequence begins late, one ends early, one has holes, one is empty."""
    exist = np.ones((SAMPLES, SEQUENCES), dtype=bool)
    if request.param == "some":
        exist[:9, 0] = exist[30:, 1] = exist[::3, 2] = exist[:, 3] = False
    return jnp.asarray(exist & (request.param != "none"))


def one_by_one(network, inputs, exist):
    """Return what the network says after each input that it reads, shape [N, B]."""

    def advance(hidden, given):
        row, exists = given
        read = network.step(hidden, row)
        hidden = jax.tree.map(lambda new, old: jnp.where(exists[:, None], new, old), read, hidden)
        return hidden, network.output(hidden)

    return jax.lax.scan(advance, network.zero_state((inputs.shape[1],)), (inputs, exist))[1]


def by_the_book(network, inputs, exist):
    """Return the same by the textbook's equations, in the precision of the arrays given."""
    cell, head = network.cell, network.head

    def advance(hidden, given):
        (output, memory), (row, exists) = hidden, given
        total = row @ cell.weight_ih.T + output @ cell.weight_hh.T + cell.bias
        enter, forget, candidate, leave = jnp.split(total, 4, axis=1)
        fresh = jax.nn.sigmoid(forget) * memory + jax.nn.sigmoid(enter) * jnp.tanh(candidate)
        said = jax.nn.sigmoid(leave) * jnp.tanh(fresh)
        there = exists[:, None]
        hidden = jnp.where(there, said, output), jnp.where(there, fresh, memory)
        return hidden, hidden[0] @ head.weight[0] + head.bias[0]

    zeros = jnp.zeros((inputs.shape[1], HIDDEN), inputs.dtype)
    return jax.lax.scan(advance, (zeros, zeros), (inputs, exist))[1]


def doubled(tree):
    return jax.tree.map(lambda leaf: leaf.astype(jnp.float64), tree)


def slopes(outputs, network, inputs, exist, weights):
    """Return the derivatives of a weighted sum of what the network says."""

    def weighted(network, inputs):
        return jnp.sum(weights * outputs(network, inputs, exist))

    return jax.jit(jax.grad(weighted, argnums=(0, 1)))(network, inputs)


def test_a_sequence_read_at_once_is_that_read_input_by_input(network, inputs, exist):
    expected = np.asarray(by_the_book(*doubled((network, inputs)), exist))
    # As near the truth as what is read input by input in single precision.
    rounding = 4 * np.abs(one_by_one(network, inputs, exist) - expected).max() + 16 * SINGLE
    np.testing.assert_allclose(network.unroll(inputs, exist), expected, rtol=0, atol=rounding)
    assert rounding < 1e-3


def test_its_derivatives_are_those_of_double_precision(network, inputs, exist):
    weights = jnp.asarray(np.random.default_rng(3).normal(size=(SAMPLES, SEQUENCES)))
    given = network, inputs
    mine, theirs = (slopes(read, *given, exist, weights) for read in (Lstm.unroll, one_by_one))
    exact = slopes(by_the_book, *doubled(given), exist, weights)
    for found, stepwise, expected in zip(*map(jax.tree.leaves, (mine, theirs, exact)), strict=True):
        # As near the truth as JAX's own derivative of the loop, in the largest of each array.
        size = np.abs(expected).max()
        rounding = 4 * np.abs(stepwise - expected).max() + 16 * SINGLE * size
        np.testing.assert_allclose(found, expected, rtol=0, atol=rounding)
        assert rounding <= 1e-4 * size


def test_sequences_that_do_not_exist_change_no_derivative(network, inputs):
    exist = jnp.asarray(np.arange(SEQUENCES) < 4)[None].repeat(SAMPLES, axis=0)

    def loss(network, inputs, exist):
        return jnp.sum(jnp.where(exist, network.unroll(inputs, exist), 0.0) ** 2)

    alone = eqx.filter_grad(loss)(network, inputs[:, :4], exist[:, :4])
    beside = eqx.filter_grad(loss)(network, 1e3 * inputs.at[:, :4].divide(1e3), exist)
    for one, other in zip(jax.tree.leaves(alone), jax.tree.leaves(beside), strict=True):
        np.testing.assert_allclose(other, one, rtol=0, atol=SAMPLES * SINGLE * np.abs(one).max())
