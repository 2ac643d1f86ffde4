"""Exact zero-order-hold discretisation, with a dead time that need not be whole samples."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hitchid.structures.limited import limited
from hitchid.structures.structure import LinearStructure

Scalar = Float[Array, ""] | float
SERIES_TERMS = 18  # leaves less than 2e-23 of the exponential; see `matrix_exponential`
MAX_HALVINGS = 32  # of a matrix of norm up to 2³¹
STROKE_NODES = 33  # places on the stroke at which dynamics are discretised; chosen: see tests/structures
STROKE_RANGE = 1.5  # half ranges of displacement from its middle: half as far as was measured


class DiscreteFriction(NamedTuple):
    """Dry friction of a discrete model.

    Attributes:
        gains: ∫₀ʰ exp(A s) ds E, shape [n].
        start: state at rest, shape [n].
    """

    gains: Float[Array, " n"]
    start: Float[Array, " n"]


class DiscreteStateSpace(NamedTuple):
    """x[k+1] = Φ x[k] + Γ₀ u[k−m] + Γ₁ u[k−m−1], y[k] = x₁[k].

    With dry friction Γ_f φ[k] is added; see `advance`.

    Attributes:
        transition: Φ, shape [n, n].
        gamma0, gamma1: Γ₀ and Γ₁, shape [n].
        delay_samples: m, the whole samples of the dead time.
        friction: dry friction; None without.
    """

    transition: Float[Array, "n n"]
    gamma0: Float[Array, " n"]
    gamma1: Float[Array, " n"]
    delay_samples: Int[Array, ""]
    friction: DiscreteFriction | None = None

    @property
    def start(self) -> Float[Array, "n *t"]:
        """State at rest."""
        return jnp.zeros_like(self.gamma0) if self.friction is None else self.friction.start

    def at(self, position: Float[Array, "*t"]) -> "DiscreteStateSpace":
        """Return the model, which is the same everywhere on the stroke; see `StrokeModel.at`."""
        del position
        return self

    def advance(
        self, state: Float[Array, "n *t"], current: Float[Array, "*t"], previous: Float[Array, "*t"]
    ) -> Float[Array, "n *t"]:
        """Return the next state.

        Friction φ is constant over a sample and such that the speed at its end is zero where −1 ≤ φ ≤ 1
        suffices for that, else ±1 against the motion (implicit time stepping, Moreau 1988): that is stable
        at any step.

        Args:
            state: x[k]; its further axes are those of the model's numbers, or the model is one for all.
            current, previous: u[k−m] and u[k−m−1].
        """
        further = (1,) * (state.ndim - self.gamma0.ndim)
        transition, gamma0, gamma1 = (
            array.reshape(array.shape + further) for array in (self.transition, self.gamma0, self.gamma1)
        )
        # Sums over few states, not a matrix product: the whole step is one loop over the tests.
        next_state = jnp.sum(transition * state[None], axis=1) + gamma0 * current + gamma1 * previous
        if self.friction is None:
            return next_state
        gains = self.friction.gains.reshape(gamma0.shape)
        share = -next_state[1] / gains[1]
        next_state = next_state + gains * limited(share, -1.0, 1.0)
        # Exactly at rest: rounding must not decide what a load at rest is taken to have come from.
        return next_state.at[1].set(jnp.where(jnp.abs(share) < 1, 0.0, next_state[1]))


class StrokeModel(NamedTuple):
    """Discrete models at places along the stroke; between these their numbers are interpolated linearly.

    Attributes:
        models: at `STROKE_NODES` places from −`STROKE_RANGE` to `STROKE_RANGE`, the first axis of all arrays.
    """

    models: DiscreteStateSpace

    @property
    def delay_samples(self) -> Int[Array, ""]:
        """The whole samples of the dead time."""
        return self.models.delay_samples[0]

    def at(self, position: Float[Array, "*t"]) -> DiscreteStateSpace:
        """Return the models at places on the stroke, each array with the axes of `position` behind its own.

        Args:
            position: half ranges of displacement from the middle; beyond `STROKE_RANGE` the model stays.
        """
        node = limited((position / STROKE_RANGE + 1) * 0.5 * (STROKE_NODES - 1), 0.0, STROKE_NODES - 1.0)
        lower = jnp.minimum(jnp.floor(jax.lax.stop_gradient(node)), STROKE_NODES - 2.0)
        index, share = lower.astype(jnp.int32), node - lower

        def interpolated(array: Array) -> Array:
            rows = jnp.moveaxis(array, 0, -1)
            return rows[..., index] * (1 - share) + rows[..., index + 1] * share

        parts = self.models._replace(delay_samples=jnp.zeros(STROKE_NODES))
        return jax.tree.map(interpolated, parts)._replace(delay_samples=self.delay_samples)


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
    block_exponential = matrix_exponential(block * duration_s)
    return block_exponential[:n, :n], scale * block_exponential[:n, n]


def matrix_exponential(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return exp(M) = (exp(M/2ˢ))^(2ˢ), the inner one by its series, with ‖M/2ˢ‖₁ ≤ ½.

    Eighteen terms leave less than ½¹⁹/19! ≈ 2e-23. Fixed loops of products: a Padé approximant's linear solve
    takes a compiler longer than everything else in a benchmark.
    """
    norm = jax.lax.stop_gradient(jnp.max(jnp.sum(jnp.abs(matrix), axis=0)))
    _, exponent = jnp.frexp(norm)
    halvings = jnp.clip(exponent + 1, 0, MAX_HALVINGS)
    scaled_matrix = jnp.ldexp(matrix, -halvings)
    identity = jnp.eye(matrix.shape[0], dtype=matrix.dtype)

    def term(index: Array, total: Array) -> Array:
        return identity + _product(scaled_matrix, total) / (SERIES_TERMS - index)

    def square(index: Array, power: Array) -> Array:
        return jnp.where(index < halvings, _product(power, power), power)

    series = jax.lax.fori_loop(0, SERIES_TERMS, term, identity)
    return jax.lax.fori_loop(0, MAX_HALVINGS, square, series)


def _product(left: Float[Array, "n n"], right: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return the product of two small matrices: summed, it fuses with its surroundings, a call would not."""
    return jnp.sum(left[:, :, None] * right[None, :, :], axis=1)


def discretise(
    structure: LinearStructure, values: Float[Array, " p"], dead_time_s: Scalar, step_s: Scalar
) -> DiscreteStateSpace:
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
    discrete = discretise_delayed(a, b, dead_time_s, step_s)
    return discrete._replace(friction=_discrete_friction(structure, values, step_s))


def discretise_delayed(
    a: Float[Array, "n n"], b: Float[Array, " n"], dead_time_s: Scalar, step_s: Scalar
) -> DiscreteStateSpace:
    """Discretise ẋ = A x + B u(t − T) exactly for a held command; see `discretise`."""
    dead_time_samples = jnp.asarray(dead_time_s) / step_s
    # A dead time of n samples computed as (n h)/h may fall short of n by rounding.
    delay_samples = jnp.floor(dead_time_samples + 1e-9)
    fraction = jnp.clip(dead_time_samples - delay_samples, 0.0, 1.0)
    durations = jnp.stack([fraction, 1 - fraction]) * step_s
    (delayed_transition, current_transition), (delayed_gamma, gamma0) = jax.vmap(
        lambda duration: zero_order_hold(a, b, duration)
    )(durations)
    return DiscreteStateSpace(
        current_transition @ delayed_transition,
        gamma0,
        current_transition @ delayed_gamma,
        delay_samples.astype(jnp.int32),
    )


def discretise_along_stroke(
    structure: LinearStructure, values: Float[Array, " p"], dead_time_s: Scalar, step_s: Scalar
) -> StrokeModel:
    """Discretise a structure at places along the stroke; see `discretise` for the arguments."""
    positions = jnp.linspace(-STROKE_RANGE, STROKE_RANGE, STROKE_NODES)
    return StrokeModel(
        jax.vmap(
            lambda position: discretise(structure, structure.values_at(values, position), dead_time_s, step_s)
        )(positions)
    )


def _discrete_friction(
    structure: LinearStructure, values: Float[Array, " p"], step_s: Scalar
) -> DiscreteFriction | None:
    friction = structure.dry_friction(values)
    if friction is None:
        return None
    _, gains = zero_order_hold(structure.state_space(values)[0], friction.gains, step_s)
    return DiscreteFriction(gains, structure.state_at_speed(values, jnp.zeros_like(values[0])))


@jax.jit
def simulate_linear(model: DiscreteStateSpace, command: Float[Array, "t n"]) -> Float[Array, "t n"]:
    """Return y of a discrete model from rest, its command zero before the first sample."""

    def advance(state: Float[Array, "m t"], commands: tuple[Array, Array]) -> tuple[Array, Array]:
        return model.advance(state, *commands), state[0]

    start = jnp.broadcast_to(model.start[:, None], (model.start.size, command.shape[0]))
    commands = delayed(command, model.delay_samples), delayed(command, model.delay_samples + 1)
    return jax.lax.scan(advance, start.astype(command.dtype), commands)[1].T


def delayed(command: Float[Array, "t n"], samples: Int[Array, ""]) -> Float[Array, "n t"]:
    """Return u[k−m] of commands that are zero before their first sample; time runs first."""
    count = command.shape[1]
    padded = jnp.pad(command, ((0, 0), (count, 0)))
    return jax.lax.dynamic_slice_in_dim(padded, count - samples, count, axis=1).T


def pulse_response(model: DiscreteStateSpace, samples: int) -> Float[Array, " n"]:
    """Return y of a discrete model whose command is one for one sample: y(0) = 0, y(1), …

    Some √N powers of Φ and as many of Φ^√N give all: C Φ^(a m + b) Γ = (C Φ^(a m)) (Φ^b Γ), m = √N.

    Args:
        model: the discrete model.
        samples: N.
    """
    width = int(np.ceil(np.sqrt(samples)))
    identity = jnp.eye(model.gamma0.size, dtype=model.gamma0.dtype)
    stride_power, powers = jax.lax.scan(
        lambda power, _: (model.transition @ power, power), identity, length=width
    )
    rows = jax.lax.scan(lambda row, _: (row @ stride_power, row), identity[0], length=width)[1]
    response0, response1 = ((rows @ (powers @ gamma).T).reshape(-1) for gamma in (model.gamma0, model.gamma1))
    undelayed = jnp.pad(response0, (1, 1)) + jnp.pad(response1, (2, 0))
    padded = jnp.pad(undelayed[:samples], (samples, 0))
    return jax.lax.dynamic_slice_in_dim(padded, samples - model.delay_samples, samples)
