"""Kalman filter of a benchmark's error: among its causes a load that nobody measures."""

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr

OFFSET, LOAD, TRANSIENT = range(3)  # order of the filter's states
UPPER = tuple((i, j) for i in range(3) for j in range(i, 3))  # entries of a symmetric matrix
LOAD_JUMP = 6.0  # standard deviations; chosen: normal errors are beyond it in two of 10⁹ samples
LOAD_TINY = jnp.finfo(jnp.float64).tiny  # smallest variance divided by, in the displacement's unit squared
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
        # Without noise and load any drift makes the gain one: the offset is the last error, whatever it was.
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
        # At rest the displacement is known to the sensor's noise, the load is not; there is no transient yet.
        covariance = [
            [zero + offset_variance, zero, zero],
            [zero, zero + self.load_scatter**2, zero],
            [zero, zero, zero],
        ]
        return ErrorEstimate(mean, jnp.stack([jnp.stack(row) for row in covariance]), mean)

    def correct(self, estimate: ErrorEstimate, error: Float[Array, "*b"]) -> ErrorEstimate:
        """Return the estimate with a measured error.

        An error that is farther from the expected one than `LOAD_JUMP` standard deviations is not due to the
        load: the sensor or the implement was moved. The offset then takes it at once, and the load stays.

        The covariance is updated in Joseph form, (I − K h) P (I − K h)ᵀ + K r² Kᵀ, which stays symmetric and
        non-negative with rounding (Bucy & Joseph 1968, Filtering for Stochastic Processes, sec. 16.3).
        """
        return self._corrected(_Entries.of(estimate), error).stacked()

    def _corrected(self, entries: "_Entries", error: Float[Array, "*b"]) -> "_Entries":
        """Return the estimate with a measured error; see `correct`."""
        rows = entries.matrix
        seen = [row[OFFSET] + row[TRANSIENT] for row in rows]
        variance = jnp.maximum(seen[OFFSET] + seen[TRANSIENT] + self.noise**2, LOAD_TINY)
        expected = entries.mean[OFFSET] + entries.mean[TRANSIENT]
        is_jump = (error - expected) ** 2 > LOAD_JUMP**2 * variance
        # The offset takes all of a jump, load and transient nothing.
        at_jump = (1.0, 0.0, 0.0)
        offset, load, transient = gain = tuple(
            jnp.where(is_jump, jump, part / variance) for jump, part in zip(at_jump, seen, strict=True)
        )
        kept = [[1 - offset, 0.0, -offset], [-load, 1.0, -load], [-transient, 0.0, 1 - transient]]
        added = [[self.noise**2 * row * column for column in gain] for row in gain]
        mean = tuple(
            part + gain_of_part * error
            for part, gain_of_part in zip(_product(kept, entries.mean), gain, strict=True)
        )
        return _Entries(mean, _transformed(rows, kept, added), gain)

    def advance(self, estimate: ErrorEstimate, increment: Float[Array, "*b"], step_s: Time) -> ErrorEstimate:
        """Return the estimate at the next sample.

        Args:
            estimate: at this sample.
            increment: Δy_b, in the displacement's unit.
            step_s: sampling time, s.
        """
        load_kept = self._load_kept(increment)
        return self._advanced(_Entries.of(estimate), increment, load_kept, step_s).stacked()

    def _load_kept(self, increments: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return c, the share of the load that is left after each movement."""
        return jnp.exp(-jnp.abs(increments) / self.load_length)

    def _advanced(
        self, entries: "_Entries", increment: Float[Array, "*b"], load_kept: Float[Array, "*b"], step_s: Time
    ) -> "_Entries":
        """Return the estimate at the next sample; see `advance`."""
        transient_kept = jnp.exp(-step_s / self.transient_time)
        transition = [[1.0, increment, 0.0], [0.0, load_kept, 0.0], [0.0, 0.0, transient_kept]]
        # What load and transient forget their disturbances add again: the scatter of each stays as it is.
        disturbances = [
            self.drift**2 * step_s,
            (1 - load_kept**2) * self.load_scatter**2,
            (1 - transient_kept**2) * self.transient_scatter**2,
        ]
        added = [[variance if i == j else 0.0 for j in range(3)] for i, variance in enumerate(disturbances)]
        mean = tuple(_product(transition, entries.mean))
        return _Entries(mean, _transformed(entries.matrix, transition, added), entries.gain)

    def estimates(
        self,
        benchmark: Float[Array, "n *t"],
        displacement: Float[Array, "n *t"],
        step_s: Time,
        every: int = 1,
    ) -> tuple[ErrorEstimate, ErrorEstimate]:
        """Return the estimates at every m-th sample, before and after its measurement, [3, ⌈N/m⌉, …].

        Args:
            benchmark: simulated displacement, in its unit; time runs along the first axis.
            displacement: measured displacement, of the same shape.
            step_s: sampling time, s.
            every: m; the fewer estimates are kept, the less time is spent writing them.
        """
        increments = jnp.diff(benchmark, axis=0, append=benchmark[-1:])

        # Estimates are kept at the first sample of each block; what pads the last one comes after that.
        def in_blocks(rows: Array) -> Array:
            padded = jnp.pad(rows, ((0, -len(rows) % every), *((0, 0),) * (rows.ndim - 1)))
            return padded.reshape(-1, every, *rows.shape[1:])

        def advance(entries: _Entries, sample: tuple[Array, Array, Array]) -> tuple[_Entries, None]:
            error, increment, load_kept = sample
            return self._advanced(self._corrected(entries, error), increment, load_kept, step_s), None

        def advance_block(entries: _Entries, block: tuple[Array, Array, Array]) -> tuple[_Entries, tuple]:
            before_and_after = entries, self._corrected(entries, block[0][0])
            return jax.lax.scan(advance, entries, block)[0], before_and_after

        errors = in_blocks(displacement - benchmark)
        blocks = errors, in_blocks(increments), in_blocks(self._load_kept(increments))
        first = _Entries.of(self.init_estimate(benchmark[0], step_s))
        _, (before, after) = jax.lax.scan(advance_block, first, blocks)
        return before.stacked(), after.stacked()

    def ahead(
        self,
        estimates: ErrorEstimate,
        increments: Float[Array, "h *b"],
        horizons: Int[np.ndarray, " k"],
        step_s: Time,
    ) -> tuple[Float[Array, "k *b"], Float[Array, "k *b"]]:
        """Return the predicted errors after some numbers of samples, and the variances of those measured.

        After h samples the error is o + S b + aʰ d with S = Σⱼ Δy_b(j) Cⱼ, Cⱼ = Πᵢ c(i) over i < j. What the
        disturbances of the load add to it has the variance ω² q, q' = q + 2 Δy_b r + Δy_b² (1 − C²), and with
        the load the covariance ω² r, r' = c (r + Δy_b (1 − C²)). This is `advance` sample by sample, in less
        time.

        Args:
            estimates: after the measurement at the origins, states of shape [3, ...].
            increments: Δy_b of each of the samples after them, shape [h, ...].
            horizons: numbers of samples, 1 … h.
            step_s: sampling time, s.
        """

        def advance(state: tuple, movement: tuple[Array, Array]) -> tuple[tuple, tuple[Array, Array]]:
            (total, kept, added, cross), (increment, kept_now) = state, movement
            to_cross = increment * (1 - kept**2)
            added = added + increment * (2 * cross + to_cross)
            total, kept, cross = total + increment * kept, kept_now * kept, kept_now * (cross + to_cross)
            return (total, kept, added, cross), (total, added)

        zeros = jnp.zeros_like(increments[0])
        movements = increments, self._load_kept(increments)
        _, by_sample = jax.lax.scan(advance, (zeros, zeros + 1, zeros, zeros), movements)
        total, added = (rows[horizons - 1] for rows in by_sample)
        samples = jnp.asarray(horizons, zeros.dtype).reshape(-1, *[1] * zeros.ndim)
        transient = jnp.exp(-samples * step_s / self.transient_time)
        weights = [jnp.ones_like(transient), total, transient]
        entries = _Entries.of(estimates)
        (error,) = _product([weights], entries.mean)
        (variance,) = _product([weights], _product(entries.matrix, weights))
        disturbances = (
            self.load_scatter**2 * added
            + self.drift**2 * step_s * samples
            + self.transient_scatter**2 * (1 - transient**2)
        )
        return error, variance + disturbances + self.noise**2


class _Entries(NamedTuple):
    """An `ErrorEstimate` by entries: XLA vectorises loops over their arrays, and not over stacked ones.

    Attributes:
        mean, gain: three entries each.
        covariance: the upper triangle, row by row.
    """

    mean: tuple[Array, ...]
    covariance: tuple[Array, ...]
    gain: tuple[Array, ...]

    @classmethod
    def of(cls, estimate: ErrorEstimate) -> "_Entries":
        """Return the entries of an estimate."""
        upper = tuple(estimate.covariance[i, j] for i, j in UPPER)
        return cls(tuple(estimate.mean), upper, tuple(estimate.gain))

    @property
    def matrix(self) -> list[list[Array]]:
        """The covariance, all nine entries."""
        entries = dict(zip(UPPER, self.covariance, strict=True))
        return [[entries[min(i, j), max(i, j)] for j in range(3)] for i in range(3)]

    def stacked(self) -> ErrorEstimate:
        """Return the estimate."""
        covariance = jnp.stack([jnp.stack(row) for row in self.matrix])
        return ErrorEstimate(jnp.stack(self.mean), covariance, jnp.stack(self.gain))


def _product(matrix: Matrix, vector: Iterable[Array]) -> list[Float[Array, "*b"]]:
    """Return A x, without the zeros of A."""
    return [
        reduce(
            add,
            (a * x for a, x in zip(row, vector, strict=True) if not (isinstance(a, float) and a == 0.0)),
        )
        for row in matrix
    ]


def _transformed(covariance: Sequence[Sequence[Array]], matrix: Matrix, added: Matrix) -> tuple[Array, ...]:
    """Return the upper triangle of A P Aᵀ + Q.

    Its entries are written out: XLA fuses them, and calls a library for each product of small matrices.
    """
    half = [_product(matrix, [row[j] for row in covariance]) for j in range(3)]
    return tuple(_product([matrix[j]], [half[k][i] for k in range(3)])[0] + added[i][j] for i, j in UPPER)
