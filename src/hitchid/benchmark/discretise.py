"""Exact zero-order-hold discretisation, with a dead time that need not be whole samples."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from hitchid.benchmark.structure import LinearStructure

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

    Both stand in the exponential of the block matrix [[A, B], [0, 0]] h (Van Loan 1978).
    """
    n = b.shape[0]
    block = jnp.zeros((n + 1, n + 1), b.dtype).at[:n, :n].set(a).at[:n, n].set(b)
    whole = exponential(block * duration_s)
    return whole[:n, :n], whole[:n, n]


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
        return one + inner @ total / (TERMS - index)

    def square(index: Array, power: Array) -> Array:
        return jnp.where(index < halvings, power @ power, power)

    series = jax.lax.fori_loop(0, TERMS, term, one)
    return jax.lax.fori_loop(0, MOST_HALVINGS, square, series)


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

    def advance(state: Array, commands: tuple[Array, Array]) -> tuple[Array, Array]:
        now, before = (each[:, None] for each in commands)
        return state @ model.transition.T + now * model.now + before * model.before, state[:, 0]

    rest = jnp.zeros((tests, model.now.shape[0]), command.dtype)
    commands = late(model.whole), late(model.whole + 1)
    return jax.lax.scan(advance, rest, commands, unroll=4)[1].T
