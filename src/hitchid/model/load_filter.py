"""Kalman filter of a benchmark's error: among its causes a load that nobody measures."""

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.precision import double_precision
from hitchid._support.short_repr import short_repr

OFFSET, LOAD, TRANSIENT = range(3)  # order of the filter's states
JUMP = 6.0  # standard deviations; chosen: normal errors are beyond it in two of 10⁹ samples
TINY = jnp.finfo(jnp.float64).tiny  # smallest variance divided by, in the displacement's unit squared
Matrix = Sequence[Sequence[Array | float]]  # 3 × 3, entries of the shape of the estimates or numbers
Time = Float[Array, ""] | float  # s


@short_repr
class ErrorEstimate(NamedTuple):
    """Estimate of the error of a benchmark at one sample.

    Attributes:
        mean: offset o, in the displacement's unit, load b, relative, and transient d, in the displacement's
            unit, shape [3, ...].
        covariance: of the errors of these estimates, shape [3, 3, ...].
        gain: Kalman gain of the last measurement, shape [3, ...].
    """

    mean: Float[Array, "3 *b"]
    covariance: Float[Array, "3 3 *b"]
    gain: Float[Array, "3 *b"]

    @property
    def error(self) -> Float[Array, "*b"]:
        """Displacement minus the benchmark's, o + d, in the displacement's unit."""
        return self.mean[OFFSET] + self.mean[TRANSIENT]

    @property
    def seen(self) -> Float[Array, "3 *b"]:
        """Covariance of the states with the error, P h, h = (1, 0, 1)."""
        return self.covariance[OFFSET] + self.covariance[TRANSIENT]

    @property
    def variance(self) -> Float[Array, "*b"]:
        """Variance of `error`, in the square of the displacement's unit."""
        return self.seen[OFFSET] + self.seen[TRANSIENT]

    def with_innovation(self, innovation: Float[Array, "*b"]) -> "ErrorEstimate":
        """Return the estimate after a predicted innovation, at the gain of the last measurement."""
        return self._replace(mean=self.mean + self.gain * innovation)


@short_repr
class LoadFilter(eqx.Module):
    """Kalman filter of the error e = y − y_b of a benchmark y_b that is simulated from the commands alone.

    It is the filter of these equations::

        o(k+1) = o(k) + b(k) Δy_b(k) + w_o,   var w_o = p² Ts
        b(k+1) = c b(k) + w_b,                var w_b = (1 − c²) ω²,   c = exp(−|Δy_b|/ℓ)
        d(k+1) = a d(k) + w_d,                var w_d = (1 − a²) σ²,   a = exp(−Ts/τ)
        e(k)   = o(k) + d(k) + v,             var v = r²

    The load b makes one stroke faster than another, and what the benchmark misses makes parts of a stroke
    faster than others, alike over a length ℓ; its mean is 0, its standard deviation ω. The transient d is the
    error that dynamics leave which are not in the benchmark. Between samples the benchmark moves by Δy_b; a
    piston that stands still tells nothing of its load. The filter is linear for any structure of the
    benchmark, because its input is what the benchmark simulates.

    Attributes:
        noise: r, of the sensor, in the displacement's unit.
        load_scatter: ω, relative.
        load_length: ℓ, in the displacement's unit.
        transient_scatter: σ, in the displacement's unit.
        transient_time: τ, s.
        drift: p, in the displacement's unit and 1/√s.
    """

    noise: Float[Array, ""]
    load_scatter: Float[Array, ""]
    load_length: Float[Array, ""]
    transient_scatter: Float[Array, ""]
    transient_time: Float[Array, ""]
    drift: Float[Array, ""]

    @classmethod
    @double_precision
    def none(cls) -> "LoadFilter":
        """Return the filter whose estimate is the last measured error, which stays."""
        zero, one, never = jnp.zeros(()), jnp.ones(()), jnp.asarray(jnp.inf)
        return cls(zero, zero, never, zero, never, one)

    def init_estimate(self, like: Float[Array, "*b"], step_s: Time) -> ErrorEstimate:
        """Return the estimate before a stroke that starts at a displacement measured at rest.

        Args:
            like: any array of the shape [...] of the estimate.
            step_s: sampling time, s.
        """
        zero = jnp.zeros_like(like)
        offset_variance = self.noise**2 + self.drift**2 * step_s
        mean = jnp.stack([zero, zero, zero])
        covariance = [
            [zero + offset_variance, zero, zero],
            [zero, zero + self.load_scatter**2, zero],
            [zero, zero, zero],
        ]
        return ErrorEstimate(mean, jnp.stack([jnp.stack(row) for row in covariance]), mean)

    def correct(self, estimate: ErrorEstimate, error: Float[Array, "*b"]) -> ErrorEstimate:
        """Return the estimate with a measured error.

        An error that is farther from the expected one than `JUMP` standard deviations is not due to the load:
        the sensor or the implement was moved. The offset then takes it at once, and the load stays.

        The covariance is updated in Joseph form, (I − K h) P (I − K h)ᵀ + K r² Kᵀ, which stays symmetric and
        non-negative with rounding (Bucy & Joseph 1968, Filtering for Stochastic Processes, sec. 16.3).
        """
        variance = jnp.maximum(estimate.variance + self.noise**2, TINY)
        is_jump = (error - estimate.error) ** 2 > JUMP**2 * variance
        offset, load, transient = estimate.seen / variance
        gain = jnp.stack(
            [
                jnp.where(is_jump, 1.0, offset),
                jnp.where(is_jump, 0.0, load),
                jnp.where(is_jump, 0.0, transient),
            ]
        )
        offset, load, transient = gain
        kept = [[1 - offset, 0.0, -offset], [-load, 1.0, -load], [-transient, 0.0, 1 - transient]]
        added = [[self.noise**2 * row * column for column in gain] for row in gain]
        mean = [
            part + gain_of_part * error
            for part, gain_of_part in zip(_product(kept, estimate.mean), gain, strict=True)
        ]
        return ErrorEstimate(jnp.stack(mean), _transformed(estimate.covariance, kept, added), gain)

    def advance(self, estimate: ErrorEstimate, increment: Float[Array, "*b"], step_s: Time) -> ErrorEstimate:
        """Return the estimate at the next sample.

        Args:
            estimate: at this sample.
            increment: Δy_b, in the displacement's unit.
            step_s: sampling time, s.
        """
        load_kept = jnp.exp(-jnp.abs(increment) / self.load_length)
        transient_kept = jnp.exp(-step_s / self.transient_time)
        transition = [[1.0, increment, 0.0], [0.0, load_kept, 0.0], [0.0, 0.0, transient_kept]]
        disturbances = [
            self.drift**2 * step_s,
            (1 - load_kept**2) * self.load_scatter**2,
            (1 - transient_kept**2) * self.transient_scatter**2,
        ]
        added = [[variance if i == j else 0.0 for j in range(3)] for i, variance in enumerate(disturbances)]
        return estimate._replace(
            mean=jnp.stack(_product(transition, estimate.mean)),
            covariance=_transformed(estimate.covariance, transition, added),
        )

    def estimates(
        self, benchmark: Float[Array, "n *t"], displacement: Float[Array, "n *t"], step_s: Time
    ) -> tuple[ErrorEstimate, ErrorEstimate]:
        """Return the estimates at every sample, states of shape [3, N, …], before and after its measurement.

        Args:
            benchmark: simulated displacement, in its unit; time runs along the first axis.
            displacement: measured displacement, of the same shape.
            step_s: sampling time, s.
        """
        increments = jnp.diff(benchmark, axis=0, append=benchmark[-1:])

        def advance(estimate: ErrorEstimate, samples: tuple[Array, Array]) -> tuple[ErrorEstimate, tuple]:
            error, increment = samples
            corrected = self.correct(estimate, error)
            return self.advance(corrected, increment, step_s), (estimate, corrected)

        first = self.init_estimate(benchmark[0], step_s)
        _, (before, after) = jax.lax.scan(advance, first, (displacement - benchmark, increments))
        return _states_first(before), _states_first(after)

    def ahead(
        self, estimates: ErrorEstimate, increments: Float[Array, "h *b"], step_s: Time
    ) -> tuple[Float[Array, "h *b"], Float[Array, "h *b"]]:
        """Return the predicted errors after 1 … h samples, and the variances of those measured errors.

        Args:
            estimates: after the measurement at the origins, states of shape [3, ...].
            increments: Δy_b of each of the samples after them, shape [h, ...].
            step_s: sampling time, s.
        """

        def advance(estimate: ErrorEstimate, increment: Array) -> tuple[ErrorEstimate, tuple[Array, Array]]:
            estimate = self.advance(estimate, increment, step_s)
            return estimate, (estimate.error, estimate.variance + self.noise**2)

        return jax.lax.scan(advance, estimates, increments)[1]


def _states_first(estimates: ErrorEstimate) -> ErrorEstimate:
    """Return estimates of which time is the first axis with the axes of the states first."""
    mean, covariance, gain = estimates
    return ErrorEstimate(jnp.moveaxis(mean, 0, 1), jnp.moveaxis(covariance, 0, 2), jnp.moveaxis(gain, 0, 1))


def _is_zero(entry: Array | float) -> bool:
    return isinstance(entry, float) and entry == 0.0


def _product(matrix: Matrix, vector: Iterable[Array]) -> list[Float[Array, "*b"]]:
    """Return A x, without the zeros of A."""
    return [
        reduce(add, (a * x for a, x in zip(row, vector, strict=True) if not _is_zero(a))) for row in matrix
    ]


def _transformed(covariance: Float[Array, "3 3 *b"], matrix: Matrix, added: Matrix) -> Float[Array, "3 3 *b"]:
    """Return A P Aᵀ + Q, symmetric to the last digit.

    Its entries are written out: XLA fuses them, and calls a library for each product of small matrices.
    """
    half = [_product(matrix, covariance[:, j]) for j in range(3)]
    entries = {
        (i, j): _product([matrix[j]], [half[k][i] for k in range(3)])[0] + added[i][j]
        for i in range(3)
        for j in range(i, 3)
    }
    return jnp.stack([jnp.stack([entries[min(i, j), max(i, j)] for j in range(3)]) for i in range(3)])
