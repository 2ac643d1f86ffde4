"""Sequential design of tests: what is known of a direction, and the test that helps it most for its time.

Θ ~ N(θ̂, P⁻¹) in the unit cube of the search, P = H/s² + I/σ₀², H = Σ JᵀJ over the tests so far. A test is
judged by how much it reduces two things for each second that it takes: the mean variance of free runs that a
user will ask for (I-optimality), and the variances of the parameters (D-optimality). Atkinson, Donev & Tobias
2007, Optimum Experimental Designs, ch. 10 and 17.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import t as student_t

from hitchid._support.precision import double_precision
from hitchid.bench.excitation import binary_command
from hitchid.control.next_test import free_run_batch
from hitchid.estimation import Objective, best_refined, refine
from hitchid.structures import Batch, ModelSpec, structure_named

# Rich enough to ask for every level, both dynamics and the whole stroke; what ships is chosen by `identify`.
FIRST_FORM = ModelSpec(
    structure_named("integrator-first-order"),
    dead_time=True,
    valve_curve=True,
    spool_dynamics=True,
    stroke_gain_quadratic=True,
)
# Standard deviation σ₀ of what is known of a parameter before any test, share of its search; chosen: such
# bounds span the machines of the trade, and most lie in the middle.
PRIOR = 0.3
LEAST_NOISE = 1e-4  # of the travel: no model of a machine is better than that; chosen
# Starts of the first fit; a later one begins where the last one ended.
STARTS, STEPS, TOLERANCE = 6, 40, 1e-6
SEARCH_STEPS = 25  # of each start before the best is refined; chosen
CANDIDATES = 40  # tests judged for each direction; chosen: a second's work
CHUNK = 8  # free runs at once, so that any number of them uses one compiled program
DUTIES, DUTY_SEED = 16, 1  # free runs that a user may ask for, always the same ones; chosen
CLOCK_S = (0.15, 1.2)  # s, mean hold of a level of many: from the lag of a valve to steady speed; chosen
DUTY_TRAVEL = 0.75  # of the way from end to end, that a test at its highest level would use; chosen
HYSTERESIS = 0.15  # of the dead zone, below it, in which a valve may still be open; chosen
REST_S = 0.05  # s, closed at the begin of a test, as in the paper's
CLOSED_SHARE = 0.1  # of the holds have a closed valve, from which motion starts again; chosen
END_SHARE = 0.9  # of the travel ahead that a test may use as predicted; chosen
LEAST_S = 2.0  # s, shortest test; chosen
CONFIDENCE = 0.9  # one-sided, that the mean error of tests meets a goal; chosen
PARAMETER_WEIGHT = 0.25  # of the parameters beside free runs; chosen


@dataclass(frozen=True)
class Posterior:
    """What the tests so far say of one direction.

    Attributes:
        objective: form and tests.
        position: the best parameters, in the unit cube, shape [D].
        noise: s², variance of an error that counts as independent, in the displacement's unit squared.
        precision: P, shape [D, D].
        tests: as they were measured.
        rmse: root mean square error in free run over them, in the displacement's unit.
    """

    objective: Objective
    position: Float[np.ndarray, " d"]
    noise: float
    precision: Float[np.ndarray, "d d"]
    tests: Batch
    rmse: float

    @property
    def dead_zone(self) -> float:
        """Dead zone of the command, in its unit."""
        return float(np.asarray(self.tests.dead_zone)[0])


@dataclass(frozen=True)
class Choice:
    """A test of one direction.

    Attributes:
        commands: of its direction as logged, shape [N].
        gain_per_s: expected reduction of the logarithm of the error, for a second of bench time.
        levels: lowest and highest command, as logged.
        travel: as predicted, in the displacement's unit.
        variance: expected mean variance of free runs after it, in the displacement's unit squared.
    """

    commands: Float[np.ndarray, " n"]
    gain_per_s: float
    levels: tuple[float, float]
    travel: float
    variance: float


@double_precision
def learn(
    tests: Batch, form: ModelSpec = FIRST_FORM, last: Posterior | None = None, *, seed: int = 0
) -> Posterior:
    """Return what tests say of their direction, from where the last fit ended.

    Raises:
        FitError: nothing moves, or no start gives finite errors.
    """
    objective = Objective.of(tests.coarse(), form)
    problem = objective.problem()
    dimensions = len(form.parameters)
    starts = [np.full(dimensions, 0.5)]
    if last is not None and last.objective.spec.parameters == form.parameters:
        starts.append(objective.position(last.objective.values(last.position)))
    else:
        starts.extend(0.2 + 0.6 * np.random.default_rng(seed).random((STARTS - 1, dimensions)))
    rough = best_refined(problem, starts, limit=SEARCH_STEPS, tolerance=TOLERANCE)
    position = refine(problem, rough.position, limit=STEPS, tolerance=TOLERANCE).position
    travel = float(np.max(np.abs(np.asarray(tests.travel)) * np.asarray(tests.loss_mask)))
    equations = objective.equations_by_test(position)
    # What counts is how many errors are independent: neighbours of a drifting free run say the same.
    independent = max(objective.independent_observations(position), 1.0)
    noise = max(float(equations.costs.sum()) / independent, (LEAST_NOISE * travel) ** 2)
    precision = equations.curvatures.sum(axis=0) / noise + np.eye(dimensions) / PRIOR**2
    return Posterior(objective, position, noise, precision, tests, objective.pooled().error(position))


def staircase(
    lowest: float, highest: float, duration_s: float, step_s: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Return the command of a test of many levels, shape [N]: the first one, before there is a model.

    Each level from the lowest to the highest comes once, in random order: a valve's curve, its hysteresis on
    the way up and down, and the dynamics are then in one test of ten seconds.
    """
    clock_s = float(np.exp(rng.uniform(*np.log(CLOCK_S))))
    count, rest = round(duration_s / step_s), round(REST_S / step_s) + 1
    holds = max(2, round(duration_s / clock_s))
    levels = lowest + (highest - lowest) * (rng.permutation(holds) + rng.random(holds)) / holds
    levels[rng.random(holds) < CLOSED_SHARE] = 0.0
    ends = np.cumsum(np.maximum(1, np.round(clock_s * rng.uniform(0.5, 1.5, holds) / step_s))).astype(int)
    held = levels[np.minimum(np.searchsorted(ends, np.arange(count), side="right"), holds - 1)]
    return np.concatenate([np.zeros(rest), held])[:count]


def lowest_level(dead_zone: float) -> float:
    """Return the lowest command of a test: below the dead zone, where a valve that was open still is."""
    return (1 - HYSTERESIS) * dead_zone


def practice_tests(duration_s: float, step_s: float) -> Batch:
    """Return tests of an integrator with unit travel, by which programs are compiled before there are any."""
    rng = np.random.default_rng(0)
    commands = np.stack([staircase(0.2, 1.0, duration_s, step_s, rng) for _ in range(4)])
    batch = free_run_batch(commands, dead_zone=0.2, start=0.0, sign=1, step_s=step_s)
    travel = np.cumsum(np.asarray(batch.command), axis=1) / commands.shape[1]
    return eqx.tree_at(lambda batch: batch.displacement, batch, jnp.asarray(travel))


def draw_tests(
    posterior: Posterior, count: int, longest_s: float, highest: float, seed: int
) -> Float[np.ndarray, "t n"]:
    """Return commands of tests of two levels up to a highest one, as logged, shape [T, N]: as the paper's."""
    rng, step_s, zone = np.random.default_rng(seed), posterior.tests.step_s, posterior.dead_zone
    return np.stack([binary_command(highest - zone, zone, longest_s, rng, step_s) for _ in range(count)])


@double_precision
def free_run_slopes(
    posterior: Posterior, commands: Float[np.ndarray, "t n"], start: float
) -> tuple[Float[np.ndarray, "t n"], Float[np.ndarray, "t n d"]]:
    """Return travel of free runs, and its derivatives by the parameters in the unit cube."""
    tests, count = posterior.tests, len(commands)
    batch = free_run_batch(
        np.resize(commands, (-(-count // CHUNK) * CHUNK, commands.shape[1])),
        dead_zone=posterior.dead_zone,
        start=start,
        sign=tests.sign,
        step_s=tests.step_s,
    )
    form = posterior.objective.with_data(batch.take([0]))  # of one shape, whatever the number of tests
    chunks = [batch.take(range(first, first + CHUNK)) for first in range(0, count, CHUNK)]
    rows = [_travel_and_slopes(form, chunk, jnp.asarray(posterior.position)) for chunk in chunks]
    travel, slopes = (
        np.concatenate([np.asarray(part) for part in parts]) for parts in zip(*rows, strict=True)
    )
    return travel[:count, : commands.shape[1]], slopes[:count, : commands.shape[1]]


@eqx.filter_jit
def _travel_and_slopes(
    objective: Objective, batch: Batch, position: Float[Array, " d"]
) -> tuple[Float[Array, "t n"], Float[Array, "t n d"]]:
    def travel(position: Float[Array, " d"]) -> Float[Array, "t n"]:
        values = objective.bounds.values(position)
        return objective.spec.physical_model(values, objective.scales).travel(batch)

    return travel(position), jax.jacfwd(travel)(position)


def within(travel: Float[np.ndarray, " n"], available: float) -> int:
    """Return the number of samples until a travel uses its share of what is available."""
    beyond = np.flatnonzero(travel > END_SHARE * available)
    return int(beyond[0]) if beyond.size else len(travel)


def information(posterior: Posterior, slopes: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "d d"]:
    """Return what one more test adds to the precision: JᵀJ/s², on the clock of the fit."""
    share = posterior.tests.step_s / posterior.objective.batch.step_s
    return share * slopes.T @ slopes / posterior.noise


class Duties:
    """Free runs that a user may ask for, by their derivatives: tests as the paper's, from end to end."""

    def __init__(
        self, posterior: Posterior, start: float, available: float, highest: float, duration_s: float
    ) -> None:
        zone = posterior.dead_zone
        self._levels = zone + (highest - zone) * np.arange(1, CHUNK + 1) / CHUNK
        samples = round(duration_s / posterior.tests.step_s) + 1  # as the tests below: one compiled program
        constant = np.repeat(self._levels[:, None], samples, axis=1)
        self._speeds = (
            np.maximum.accumulate(free_run_slopes(posterior, constant, start)[0][:, -1]) / duration_s
        )
        self.highest = self.command_for(DUTY_TRAVEL * available / duration_s)
        commands = draw_tests(posterior, DUTIES, duration_s, self.highest, DUTY_SEED)
        travel, slopes = free_run_slopes(posterior, commands, start)
        rows = np.concatenate(
            [own[: within(row, available)] for row, own in zip(travel, slopes, strict=True)]
        )
        self._moment = rows.T @ rows / len(rows)

    def command_for(self, speed: float) -> float:
        """Return the command, as logged, of a speed in the displacement's unit a second."""
        return float(np.interp(speed, self._speeds, self._levels))

    def variance(self, precision: Float[np.ndarray, "d d"]) -> float:
        """Return the expected mean variance of these free runs, in the displacement's unit squared."""
        return float(np.trace(np.linalg.solve(precision, self._moment)))


@double_precision
def best_test(
    posterior: Posterior,
    duties: Duties,
    *,
    start: float,
    available: float,
    longest_s: float,
    overhead_s: float,
    seed: int,
) -> Choice | None:
    """Return the test with the largest expected gain for a second of bench time; None where none fits.

    Args:
        posterior: of its direction.
        duties: free runs that a user may ask for.
        start: displacement at which it begins.
        available: travel ahead, in the displacement's unit.
        longest_s: longest test, s.
        overhead_s: time of the move to its start and of the rest there, s.
        seed: of the candidates.
    """
    commands = draw_tests(posterior, CANDIDATES, longest_s, duties.highest, seed)
    travel, slopes = free_run_slopes(posterior, commands, start)
    before, log_before = duties.variance(posterior.precision), np.linalg.slogdet(posterior.precision)[1]
    best: Choice | None = None
    for command, row, jacobian in zip(commands, travel, slopes, strict=True):
        samples = within(row, available)
        duration_s = samples * posterior.tests.step_s
        if duration_s < LEAST_S or not np.any(command[:samples] > 0):
            continue
        precision = posterior.precision + information(posterior, jacobian[:samples])
        after = duties.variance(precision)
        determinant = np.linalg.slogdet(precision)[1] - log_before
        gain = np.log(before / after) + PARAMETER_WEIGHT * determinant / len(precision)
        gain_per_s = float(gain / (duration_s + overhead_s))
        if best is None or gain_per_s > best.gain_per_s:
            moving = command[:samples][command[:samples] > 0]
            best = Choice(
                commands=command[:samples],
                gain_per_s=gain_per_s,
                levels=(float(moving.min()), float(moving.max())),
                travel=float(row[samples - 1]),
                variance=after,
            )
    return best


def upper_bound(errors: Sequence[float]) -> float:
    """Return the upper bound of the mean of errors of tests, one-sided; infinite for fewer than two."""
    if len(errors) < 2:
        return float("inf")
    quantile = float(student_t.ppf(CONFIDENCE, len(errors) - 1))
    return float(np.mean(errors) + quantile * np.std(errors, ddof=1) / len(errors) ** 0.5)
