"""Exact zero-order-hold discretisation, with a dead time that need not be whole samples."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hitchid.structures.structure import LinearStructure

Scalar = Float[Array, ""] | float
TERMS = 18
MOST_HALVINGS = 32


class Discrete(NamedTuple):
    """x[k+1] = Φ x[k] + Γ₀ u[k−m] + Γ₁ u[k−m−1], y[k] = x₁[k].

    Attributes:
        transition: Φ, shape [n, n].
        now, before: Γ₀ and Γ₁, shape [n].
        whole: m, the whole samples of the dead time.
    """

    transition: Float[Array, "n n"]
    now: Float[Array, " n"]
    before: Float[Array, " n"]
    whole: Int[Array, ""]


def zero_order_hold(
    a: Float[Array, "n n"], b: Float[Array, " n"], duration_s: Scalar
) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
    """Return Φ = exp(A h) and Γ = ∫₀ʰ exp(A s) ds B for a command held over the duration h.

    Both stand in the exponential of the block matrix [[A, B], [0, 0]] h (Van Loan 1978), with B
    scaled to size one, for that is a matter of units.
    """
    n = b.shape[0]
    size = jax.lax.stop_gradient(jnp.max(jnp.abs(b)))
    scale = jnp.where(size > 0, size, 1.0)
    block = jnp.zeros((n + 1, n + 1), b.dtype).at[:n, :n].set(a).at[:n, n].set(b / scale)
    whole = exponential(block * duration_s)
    return whole[:n, :n], scale * whole[:n, n]


def exponential(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return exp(M) = (exp(M/2ˢ))^(2ˢ), the inner one by its series, with ‖M/2ˢ‖₁ ≤ ½.

    Eighteen terms leave less than ½¹⁹/19! ≈ 2e-23. Fixed loops of products: a Padé approximant's linear solve
    takes a compiler longer than everything else in a benchmark.

    Args:
        matrix: M with ‖M‖₁ ≤ 2³¹, shape [n, n].
    """
    size = jax.lax.stop_gradient(jnp.max(jnp.sum(jnp.abs(matrix), axis=0)))
    _, exponent = jnp.frexp(size)
    halvings = jnp.clip(exponent + 1, 0, MOST_HALVINGS)
    inner = jnp.ldexp(matrix, -halvings)
    one = jnp.eye(matrix.shape[0], dtype=matrix.dtype)

    def term(index: Array, total: Array) -> Array:
        return one + _product(inner, total) / (TERMS - index)

    def square(index: Array, power: Array) -> Array:
        return jnp.where(index < halvings, _product(power, power), power)

    series = jax.lax.fori_loop(0, TERMS, term, one)
    return jax.lax.fori_loop(0, MOST_HALVINGS, square, series)


def _product(left: Float[Array, "n n"], right: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return the product of two small matrices: summed, it fuses with its surroundings, a call would not."""
    return jnp.sum(left[:, :, None] * right[None, :, :], axis=1)


def discretise(
    structure: LinearStructure, values: Float[Array, " p"], dead_time_s: Scalar, step_s: Scalar
) -> Discrete:
    """Discretise a structure exactly for a command held between samples and delayed by any dead time.

    With the dead time (m + f) h, 0 ≤ f < 1, the interval [k h, (k+1) h) sees u[k−m−1] for its first f h and
    u[k−m] for the rest: Γ₀ = Γ((1−f) h), Γ₁ = exp(A (1−f) h) Γ(f h).

    Args:
        structure: the benchmark structure.
        values: its parameters.
        dead_time_s: dead time ≥ 0, s.
        step_s: sampling time h, s.
    """
    a, b = structure.state_space(values)
    samples = jnp.asarray(dead_time_s) / step_s
    # A dead time of n samples computed as (n h)/h may fall short of n by rounding.
    whole = jnp.floor(samples + 1e-9)
    fraction = jnp.clip(samples - whole, 0.0, 1.0)
    parts = jnp.stack([fraction, 1 - fraction]) * step_s
    (early, late), (before, now) = jax.vmap(lambda part: zero_order_hold(a, b, part))(parts)
    return Discrete(late @ early, now, late @ before, whole.astype(jnp.int32))


@jax.jit
def driven(model: Discrete, command: Float[Array, "t n"]) -> Float[Array, "t n"]:
    """Return y of a discrete model from rest, its command zero before the first sample.

    Args:
        model: the discrete model.
        command: u, shape [T, N].
    """
    tests, count = command.shape
    padded = jnp.pad(command, ((0, 0), (count, 0)))

    def late(samples: Array) -> Float[Array, "n t"]:
        return jax.lax.dynamic_slice_in_dim(padded, count - samples, count, axis=1).T

    def advance(state: Float[Array, "m t"], commands: tuple[Array, Array]) -> tuple[Array, Array]:
        now, before = commands
        # Sums over few states, not a matrix product: the whole step is one loop over the tests.
        onward = jnp.sum(model.transition[:, :, None] * state[None, :, :], axis=1)
        return onward + model.now[:, None] * now + model.before[:, None] * before, state[0]

    rest = jnp.zeros((model.now.shape[0], tests), command.dtype)
    return jax.lax.scan(advance, rest, (late(model.whole), late(model.whole + 1)))[1].T


def pulse_response(model: Discrete, samples: int) -> Float[Array, " n"]:
    """Return y of a discrete model whose command is one for one sample: y(0) = 0, y(1), …

    Some √N powers of Φ and as many of Φ^√N give all: C Φ^(a m + b) Γ = (C Φ^(a m)) (Φ^b Γ), m = √N.

    Args:
        model: the discrete model.
        samples: N.
    """
    width = int(np.ceil(np.sqrt(samples)))
    one = jnp.eye(model.now.size, dtype=model.now.dtype)
    far, near = jax.lax.scan(lambda power, _: (model.transition @ power, power), one, length=width)
    rows = jax.lax.scan(lambda row, _: (row @ far, row), one[0], length=width)[1]
    now, before = ((rows @ (near @ gamma).T).reshape(-1) for gamma in (model.now, model.before))
    prompt = jnp.pad(now, (1, 1)) + jnp.pad(before, (2, 0))
    padded = jnp.pad(prompt[:samples], (samples, 0))
    return jax.lax.dynamic_slice_in_dim(padded, samples - model.whole, samples)
