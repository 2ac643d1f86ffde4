"""Exact zero-order-hold discretisation, with a dead time that need not be whole samples."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.linalg import expm
from jaxtyping import Array, Float, Int

from hitchid.benchmark.structure import Structure

Scalar = Float[Array, ""] | float


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
    exponential = expm(block * duration_s)
    return exponential[:n, :n], exponential[:n, n]


def discretise(
    structure: Structure, values: Float[Array, " p"], dead_time_s: Scalar, step_s: Scalar
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
    early, before = zero_order_hold(a, b, fraction * step_s)
    late, now = zero_order_hold(a, b, (1 - fraction) * step_s)
    return Discrete(late @ early, now, late @ before, whole.astype(jnp.int32))
