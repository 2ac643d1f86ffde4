"""Errors of strokes in free run, standardised by the load filter: squares, gradient and curvature."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.special import ndtri

from hitchid._support.precision import double_precision
from hitchid._support.short_repr import short_repr
from hitchid.adaptation.parameters import DEAD_ZONE, Changes, changed_benchmark
from hitchid.adaptation.strokes import LONGEST_S, Stroke
from hitchid.data.record import DIRECTIONS
from hitchid.model import Channel
from hitchid.model.bands import Bands
from hitchid.model.ensemble import perturbed_channel
from hitchid.structures import Batch

SAMPLES = 1024  # of a stroke on the clock of these errors; a power of two as in identification; chosen


@short_repr
class StrokeFit(NamedTuple):
    """Standardised errors r of one stroke to second order in the changes θ.

    Attributes:
        at: θ, shape [3].
        squares: rᵀr; that of errors as the model expects is `samples`.
        gradient: −Jᵀr, J = ∂r/∂θ: the direction of descent, shape [3].
        information: JᵀJ, shape [3, 3].
        samples: that count.
    """

    at: Float[np.ndarray, "3"]
    squares: float
    gradient: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]
    samples: int

    @property
    def speed_error(self) -> float:
        """How much faster the stroke is than the model, in standard deviations of strokes as identified."""
        return float(self.gradient[0] / np.sqrt(max(self.information[0, 0], np.finfo(float).tiny)))


class StrokeErrors:
    """Errors of the strokes of one channel.

    Strokes are on a clock on which the longest has 1024 samples, a command being the mean over each of its
    intervals; missing samples do not count.

    Args:
        channel: as identified.
        step_s: sampling time of the strokes, s.
        load: covariates, in the order of the benchmark's.
        window: number of strokes that are fitted at once; each number is compiled once.
        bands: of the channel as identified; None where it has none.
    """

    def __init__(
        self,
        channel: Channel,
        step_s: float,
        load: Float[np.ndarray, " c"],
        window: int,
        bands: Bands | None = None,
    ) -> None:
        self.channel = channel
        self._load, self._window = load, window
        self._factor = max(1, -(-round(LONGEST_S / step_s) // SAMPLES))
        self._step_s = self._factor * step_s
        self._column = DIRECTIONS.index(channel.direction)
        self._bands = bands
        self._members = None if bands is None else _stacked_members(channel, bands)

    def batch(self, strokes: Sequence[Stroke]) -> Batch:
        """Return strokes as a batch of as many tests as `window`; those that are missing have no weight."""
        rows = [self._on_clock(stroke) for stroke in strokes]
        rows += [self._empty()] * (self._window - len(rows))
        command, displacement, measured, valid = map(np.stack, zip(*(row[:4] for row in rows), strict=True))
        initial = np.array([row[4] for row in rows])
        dead_zone = np.full(len(rows), self.channel.dead_zone)
        excess = np.maximum(np.abs(command) - dead_zone[:, None], 0.0)
        arrays = (np.sign(command) * excess, command, dead_zone, displacement, valid, measured, initial)
        loads = np.broadcast_to(self._load, (len(rows), len(self._load)))
        return Batch(
            *(jnp.asarray(array) for array in arrays),
            covariates=jnp.asarray(loads),
            step_s=self._step_s,
            sign=self.channel.sign,
            covariate_names=self.channel.benchmark.covariates,
        )

    @double_precision
    def prepare(self, runs: int, coverage: float) -> None:
        """Compile all of this for a number of free runs, with a stroke in which nothing moves."""
        rest = np.full(2, self._empty()[4])
        stroke = Stroke(self.channel.direction, 1, 1, np.zeros((2, 2)), rest)
        self.fits([stroke], Changes())
        self.runs(stroke, [Changes()] * runs)
        self.half_width(stroke, Changes(), coverage)

    @double_precision
    def fits(self, strokes: Sequence[Stroke], changes: Changes) -> list[StrokeFit]:
        """Return the standardised errors of strokes at changes of the parameters, to second order."""
        at = np.asarray(changes, float)
        rows = _fits(self.channel, self.batch(strokes), jnp.asarray(at))
        squares, gradients, information, counts = map(np.asarray, rows)
        return [
            StrokeFit(at, float(squares[n]), gradients[n], information[n], int(counts[n]))
            for n in range(len(strokes))
        ]

    @double_precision
    def runs(self, stroke: Stroke, changes: Sequence[Changes]) -> "StrokeRuns":
        """Return the free runs of one stroke at several changes of the parameters."""
        at = np.array(changes, float)
        batch = self.batch([stroke]).take([0])
        return StrokeRuns(at, *map(np.asarray, _runs(self.channel, batch, jnp.asarray(at))))

    @double_precision
    def half_width(
        self, stroke: Stroke, changes: Changes, coverage: float
    ) -> Callable[[float], Float[np.ndarray, " n"]] | None:
        """Return the function from a factor to the half width of the band of a free run; None without bands.

        Args:
            stroke: whose free run it is.
            changes: of the parameters.
            coverage: share of samples within the band.
        """
        if self._bands is None or self._members is None:
            return None
        batch = self.batch([stroke]).take([0])
        deviations = np.asarray(_deviations(self._members, self.channel, batch, jnp.asarray(changes, float)))
        weights = np.array([member.weight for member in self._bands.ensemble])
        spread = np.sqrt(np.sum((weights[:, None] * deviations) ** 2, axis=0))
        floor = float(ndtri(0.5 + coverage / 2)) * self._bands.noise
        multiplier = self._bands.multiplier(coverage)
        return lambda factor: np.hypot(floor, factor * multiplier * spread)

    def _on_clock(self, stroke: Stroke) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        """Return command, displacement, which of it is measured, which samples exist, and the initial one."""
        command = np.nan_to_num(stroke.commands[:, self._column])
        kept = command[: SAMPLES * self._factor]
        blocks = -(-len(kept) // self._factor)
        mean = (
            np.pad(kept, (0, blocks * self._factor - len(kept)), mode="edge").reshape(blocks, -1).mean(axis=1)
        )
        displacement = stroke.displacement[: len(kept) : self._factor]
        measured = np.isfinite(displacement)
        initial = float(np.nanmean(stroke.displacement[: stroke.rest + 1]))
        padding = (0, SAMPLES - blocks)
        return (
            np.pad(mean, padding),
            np.pad(np.where(measured, displacement, initial), padding, constant_values=initial),
            np.pad(measured, padding),
            np.pad(np.ones(blocks, bool), padding),
            initial,
        )

    def _empty(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        none = np.zeros(SAMPLES, bool)
        middle = self.channel.operating_range.displacement
        initial = 0.5 * (float(middle.lowest) + float(middle.highest))
        return np.zeros(SAMPLES), np.full(SAMPLES, initial), none, none, initial


@short_repr
class StrokeRuns(NamedTuple):
    """Free runs of one stroke at M changes of the parameters, standardised as the first of them is.

    Attributes:
        changes: of the parameters, shape [M, 3].
        displacement: simulated, in the model's unit, shape [M, N].
        errors: measured less simulated; zero where nothing is measured, shape [M, N].
        squares, gradients: as in `StrokeFit`, of each run, shapes [M] and [M, 3].
        information: as in `StrokeFit`, at the first changes, shape [3, 3].
        measured: which samples count, shape [N].
    """

    changes: Float[np.ndarray, "m 3"]
    displacement: Float[np.ndarray, "m n"]
    errors: Float[np.ndarray, "m n"]
    squares: Float[np.ndarray, " m"]
    gradients: Float[np.ndarray, "m 3"]
    information: Float[np.ndarray, "3 3"]
    measured: Bool[np.ndarray, " n"]

    @property
    def mean_squares(self) -> Float[np.ndarray, " m"]:
        """Mean square error of each run, shape [M]."""
        return np.sum(self.errors**2, axis=1) / max(int(self.measured.sum()), 1)

    def fit(self, number: int) -> StrokeFit:
        """Return the standardised errors of one run, with the slopes of the first."""
        return StrokeFit(
            self.changes[number],
            float(self.squares[number]),
            self.gradients[number],
            self.information,
            int(self.measured.sum()),
        )


def _stacked_members(channel: Channel, bands: Bands) -> Channel:
    """Return the perturbed channels of an ensemble as one, whose arrays have them along the first axis."""
    members = [perturbed_channel(channel, member) for member in bands.ensemble]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *members)


def _simulated(channel: Channel, batch: Batch, changes: Float[Array, "3"]) -> Float[Array, "t n"]:
    """Return the free run at changes of the parameters, shape [T, N]."""
    benchmark = changed_benchmark(channel.benchmark, changes)
    changed = eqx.tree_at(lambda tree: tree.benchmark, channel, benchmark)
    return changed.simulate(batch.with_dead_zones(batch.dead_zone + changes[DEAD_ZONE]))


class _Sums(NamedTuple):
    """Squares, gradients and information of T strokes, and the number of samples of each."""

    squares: Float[Array, " t"]
    gradients: Float[Array, "t 3"]
    information: Float[Array, "t 3 3"]
    samples: Int[Array, " t"]


@eqx.filter_jit
def _fits(channel: Channel, batch: Batch, changes: Float[Array, "3"]) -> _Sums:
    simulate = partial(_simulated, channel, batch)
    simulated, slopes = simulate(changes), jax.jacfwd(simulate)(changes)
    errors = batch.displacement - simulated
    error, slope = _standardised(channel, batch, simulated, errors[None], slopes)
    return _Sums(
        jnp.sum(error[0] ** 2, axis=0),
        jnp.einsum("knt,nt->tk", slope, error[0]),
        jnp.einsum("knt,lnt->tkl", slope, slope),
        jnp.sum(batch.loss_mask, axis=1),
    )


@eqx.filter_jit
def _runs(channel: Channel, batch: Batch, changes: Float[Array, "m 3"]) -> tuple[Array, ...]:
    simulate = partial(_simulated, channel, batch)
    simulated, slopes = jax.vmap(simulate)(changes), jax.jacfwd(simulate)(changes[0])
    errors = jnp.where(batch.loss_mask, batch.displacement - simulated, 0.0)
    error, slope = (rows[..., 0] for rows in _standardised(channel, batch, simulated[0], errors, slopes))
    return (
        simulated[:, 0],
        errors[:, 0],
        jnp.sum(error**2, axis=1),
        error @ slope.T,
        slope @ slope.T,
        batch.loss_mask[0],
    )


def _standardised(
    channel: Channel,
    batch: Batch,
    simulated: Float[Array, "t n"],
    errors: Float[Array, "m t n"],
    slopes: Float[Array, "t n 3"],
) -> tuple[Float[Array, "m n t"], Float[Array, "3 n t"]]:
    """Return errors and slopes as innovations of the load filter."""
    sets = jnp.concatenate([errors, jnp.moveaxis(slopes, -1, 0)])
    innovations = channel.load_filter.innovations(
        simulated.T, jnp.swapaxes(sets, 1, 2), batch.loss_mask.T, batch.step_s
    )
    return innovations[: len(errors)], innovations[len(errors) :]


@eqx.filter_jit
def _deviations(
    members: Channel, channel: Channel, batch: Batch, changes: Float[Array, "3"]
) -> Float[Array, "a n"]:
    """Return the free runs of an ensemble less that of the channel, shape [A, N]."""
    runs = jax.vmap(lambda member: _simulated(member, batch, changes)[0])(members)
    return runs - _simulated(channel, batch, changes)[0]
