"""Errors of strokes in free run: squares, gradient and curvature in the changes of the parameters."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.special import ndtri

from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.live.parameters import DEAD_ZONE, Changes, changed_benchmark
from hitchid.live.strokes import LONGEST_S, Stroke
from hitchid.logs import DIRECTIONS
from hitchid.model import Bands, Channel, perturbed_channel
from hitchid.structures import Batch

PIECES = 10  # of a stroke, whose errors are taken as independent of each other; chosen
STOP_SHARE = 0.01  # share of the range of the tests before an end stop that does not count; chosen
SAMPLES = 1024  # of a stroke on the clock of these errors; a power of two as in identification; chosen


@short_repr
class StrokeFit(NamedTuple):
    """Errors of one stroke in free run to second order in the changes θ, summed over independent pieces.

    With errors e(k), slopes J = ∂ŷ/∂θ and n samples that count the sums are (m/n) Σ e², (m/n) Jᵀe and
    (m/n) JᵀJ: errors of neighbouring samples are alike, so that a stroke counts as m = 10 pieces.

    Attributes:
        at: θ, shape [3].
        squares: sum of the squared errors, in the displacement's unit squared.
        gradient: direction of descent, shape [3].
        information: curvature, shape [3, 3].
        travel: of the simulated displacement, in its unit.
    """

    at: Float[np.ndarray, "3"]
    squares: float
    gradient: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]
    travel: float

    def over(self, variance: float) -> "StrokeFit":
        """Return the sums of errors in standard deviations: over their variance."""
        return self._replace(
            squares=self.squares / variance,
            gradient=self.gradient / variance,
            information=self.information / variance,
        )

    @property
    def speed_error(self) -> float:
        """How much faster the stroke is than the model, in standard deviations, of standardised sums."""
        return float(self.gradient[0] / np.sqrt(max(self.information[0, 0], np.finfo(float).tiny)))


def range_of_tests(channel: Channel) -> float:
    """Return the range of the displacement in the identification tests, in the model's unit."""
    covered = channel.operating_range.displacement
    return float(covered.highest) - float(covered.lowest)


class StrokeErrors:
    """Errors of the strokes of one channel.

    Strokes are on a clock on which the longest has 1024 samples, a command being the mean over each of its
    intervals; missing samples do not count. As many strokes are fitted at once as `window` says, which is
    compiled once; covariates (`load`) are in the order of the benchmark's.
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
        covered = channel.operating_range.displacement
        # Where strokes that fill up a window stand still: a displacement of the tests.
        self._still = float(np.clip(0.0, covered.lowest, covered.highest))
        # The stop ahead: that of the identification, else one that logs reached; a limit alone ends nothing.
        self._stop, limits = channel.end_stop, channel.limits
        if self._stop is None and limits is not None:
            upper, lower = (limits.upper, limits.upper_stop), (limits.lower, limits.lower_stop)
            end, is_stop = upper if channel.sign > 0 else lower
            self._stop = end if is_stop else None
        self._bands = bands
        self._members = None
        if bands is not None:  # the perturbed channels as one, whose arrays have them along the first axis
            members = [perturbed_channel(channel, member) for member in bands.ensemble]
            self._members = jax.tree.map(lambda *leaves: jnp.stack(leaves), *members)

    def batch(self, strokes: Sequence[Stroke]) -> Batch:
        """Return strokes as a batch of as many tests as `window`; those that are missing have no weight."""
        tests = max(self._window, len(strokes))
        shape = tests, SAMPLES  # as a rule the same, so that one program fits all windows
        initial = np.full(tests, self._still)
        command, displacement = np.zeros(shape), np.full(shape, self._still)
        measured, valid = np.zeros(shape, bool), np.zeros(shape, bool)
        for row, stroke in enumerate(strokes):
            own_command, own_displacement, own_measured = self._on_clock(stroke)
            used = len(own_command)
            initial[row] = float(np.nanmean(stroke.displacement[: stroke.rest + 1]))
            displacement[row] = initial[row]
            command[row, :used], measured[row, :used], valid[row, :used] = own_command, own_measured, True
            # A gap has a number as well: one that is none would spoil the sums, though it has no weight.
            displacement[row, :used] = np.where(own_measured, own_displacement, initial[row])
        dead_zone = np.full(tests, self.channel.dead_zone)
        excess = np.maximum(np.abs(command) - dead_zone[:, None], 0.0)
        arrays = (np.sign(command) * excess, command, dead_zone, displacement, valid, measured, initial)
        loads = np.broadcast_to(self._load, (tests, len(self._load)))
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
        stroke = Stroke(self.channel.direction, 1, 1, np.zeros((2, 2)), np.full(2, self._still))
        self.fits([stroke], Changes())
        self.runs(stroke, [Changes()] * runs)
        self.half_width(stroke, Changes(), coverage)

    @double_precision
    def fits(self, strokes: Sequence[Stroke], changes: Changes) -> list[StrokeFit]:
        """Return the errors of strokes at changes of the parameters, to second order."""
        at = np.asarray(changes, float)
        rows = _fits(self.channel, self.batch(strokes), jnp.asarray(at))
        squares, gradients, information, travels = map(np.asarray, rows)
        return [
            StrokeFit(at, float(squares[n]), gradients[n], information[n], float(travels[n]))
            for n in range(len(strokes))
        ]

    @double_precision
    def runs(self, stroke: Stroke, changes: Sequence[Changes]) -> "StrokeRuns":
        """Return the free runs of one stroke at several changes of the parameters."""
        at = np.array(changes, float)
        batch = self.batch([stroke]).take([0])
        rows = _runs(self.channel, batch, jnp.asarray(at))
        return StrokeRuns(self._step_s, at, *map(np.asarray, rows))

    @double_precision
    def half_width(
        self, stroke: Stroke, changes: Changes, coverage: float
    ) -> Callable[[float], Float[np.ndarray, " n"]] | None:
        """Return the half width of the band of a free run over a factor on it; None without bands."""
        if self._bands is None or self._members is None:
            return None
        batch = self.batch([stroke]).take([0])
        deviations = np.asarray(_deviations(self._members, self.channel, batch, jnp.asarray(changes, float)))
        weights = np.array([member.weight for member in self._bands.ensemble])
        spread = np.sqrt(np.sum((weights[:, None] * deviations) ** 2, axis=0))
        floor = float(ndtri(0.5 + coverage / 2)) * self._bands.noise
        multiplier = self._bands.multiplier(coverage)
        # The noise of the sensor stays as it is; only what the ensemble spreads is made wider.
        return lambda factor: np.hypot(floor, factor * multiplier * spread)

    def _on_clock(self, stroke: Stroke) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return command, displacement, and which of it is measured, before padding."""
        command = np.nan_to_num(stroke.commands[:, self._column])
        kept = command[: SAMPLES * self._factor]
        blocks = -(-len(kept) // self._factor)
        # The mean, not every second command: the travel is that of all of them.
        whole = np.pad(kept, (0, blocks * self._factor - len(kept)), mode="edge")
        mean = whole.reshape(blocks, -1).mean(axis=1)
        displacement = stroke.displacement[: len(kept) : self._factor]
        measured = np.isfinite(displacement)
        if self._stop is not None:  # from which on the model says nothing of the speed
            margin = STOP_SHARE * range_of_tests(self.channel)
            reached = np.nan_to_num(self.channel.sign * (self._stop - displacement), nan=np.inf) <= margin
            measured &= ~np.maximum.accumulate(reached)
        return mean, displacement, measured


@short_repr
class StrokeRuns(NamedTuple):
    """Free runs of one stroke at M changes of the parameters.

    Attributes:
        step_s: sampling time, s.
        changes: of the parameters, shape [M, 3].
        displacement: simulated, in the model's unit, shape [M, N].
        errors: measured less simulated; zero where nothing is measured, shape [M, N].
        squares, gradients: as in `StrokeFit`, of each run, shapes [M] and [M, 3].
        information: as in `StrokeFit`, at the first changes, shape [3, 3].
        measured: which samples count, shape [N].
    """

    step_s: float
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

    def share_left(self, number: int) -> float:
        """Return the root mean square error of one run, over its travel."""
        travel = float(np.ptp(self.displacement[number][self.measured]))
        return float(np.sqrt(self.mean_squares[number])) / max(travel, np.finfo(float).tiny)

    def fit(self, number: int) -> StrokeFit:
        """Return the errors of one run, with the slopes of the first."""
        travel = float(np.ptp(self.displacement[0][self.measured]))
        squares, gradient = float(self.squares[number]), self.gradients[number]
        return StrokeFit(self.changes[number], squares, gradient, self.information, travel)


def _simulated(channel: Channel, batch: Batch, changes: Float[Array, "3"]) -> Float[Array, "t n"]:
    """Return the free run at changes of the parameters, shape [T, N]."""
    benchmark = changed_benchmark(channel.benchmark, changes)
    changed = eqx.tree_at(lambda tree: tree.benchmark, channel, benchmark)
    return changed.simulate(batch.with_dead_zones(batch.dead_zone + changes[DEAD_ZONE]))


@eqx.filter_jit
def _fits(channel: Channel, batch: Batch, changes: Float[Array, "3"]) -> tuple[Array, Array, Array, Array]:
    """Return squares, gradients, curvatures and travels of T strokes, as in `StrokeFit`."""
    simulate = partial(_simulated, channel, batch)
    simulated, mask = simulate(changes), batch.loss_mask
    slopes = jnp.where(mask[..., None], jax.jacfwd(simulate)(changes), 0.0)
    errors = jnp.where(mask, batch.displacement - simulated, 0.0)
    weight = PIECES / jnp.maximum(jnp.sum(mask, axis=1), 1)
    moved = jnp.where(mask, simulated - batch.initial[:, None], 0.0)
    return (
        weight * jnp.sum(errors**2, axis=1),
        weight[:, None] * jnp.einsum("tnk,tn->tk", slopes, errors),
        weight[:, None, None] * jnp.einsum("tnk,tnl->tkl", slopes, slopes),
        jnp.max(moved, axis=1) - jnp.min(moved, axis=1),
    )


@eqx.filter_jit
def _runs(channel: Channel, batch: Batch, changes: Float[Array, "m 3"]) -> tuple[Array, ...]:
    """Return displacements, errors, squares, gradients, curvature and mask; see `StrokeRuns`."""
    simulate = partial(_simulated, channel, batch)
    simulated, mask = jax.vmap(simulate)(changes)[:, 0], batch.loss_mask[0]
    # Of the first changes alone: errors are almost linear in them.
    slopes = jnp.where(mask[:, None], jax.jacfwd(simulate)(changes[0])[0], 0.0)
    errors = jnp.where(mask, batch.displacement[0] - simulated, 0.0)
    weight = PIECES / jnp.maximum(jnp.sum(mask), 1)
    squares = weight * jnp.sum(errors**2, axis=1)
    return simulated, errors, squares, weight * errors @ slopes, weight * slopes.T @ slopes, mask


@eqx.filter_jit
def _deviations(
    members: Channel, channel: Channel, batch: Batch, changes: Float[Array, "3"]
) -> Float[Array, "a n"]:
    """Return the free runs of an ensemble less that of the channel, shape [A, N]."""
    runs = jax.vmap(lambda member: _simulated(member, batch, changes)[0])(members)
    return runs - _simulated(channel, batch, changes)[0]


# A speed that does not follow the command: of a pump that cannot deliver, or behind a flow divider.

LIMITS = np.linspace(0.3, 0.9, 25)  # of the fastest simulated speed, that are tried; chosen
LEAST_EVIDENCE = 100.0  # likelihood ratio in favour of a limit at which a stroke is refused; chosen


def speed_limit(runs: StrokeRuns, run: int, gain_run: int, variance: float) -> float:
    """Return the limit of speed that explains a stroke better than another gain does; 1 where none does.

    Both have one parameter: the free run y (of number `run`) with its increments within ±c max|Δy|, and that
    with the stroke's own gain (`gain_run`). A pump that cannot deliver gives the same speed at each command
    that requires more. The limit c is over the fastest simulated speed, the variance that of an error.
    """
    simulated = runs.displacement[run]
    measured = simulated + runs.errors[run]
    speed = np.diff(simulated, prepend=simulated[0])
    highest = LIMITS[:, None] * np.abs(speed).max()
    limited = simulated[0] + np.cumsum(np.clip(speed, -highest, highest), axis=1)
    squares = np.mean((measured - limited)[:, runs.measured] ** 2, axis=1)
    best = int(np.argmin(squares))
    evidence = PIECES / 2 * float(runs.mean_squares[gain_run] - squares[best]) / variance
    return float(LIMITS[best]) if evidence > np.log(LEAST_EVIDENCE) else 1.0
