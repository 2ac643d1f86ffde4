"""From positions in the unit cube to the misses of a form over tests: what searches minimise."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.errors import FitError
from hitchid.estimation.bounds import Bounds
from hitchid.estimation.least_squares import NormalEquations
from hitchid.estimation.search import Polished, Problem, best_polished
from hitchid.structures import Batch, Form, Scales
from hitchid.structures.structure import Scale

_Fitness = TypeVar("_Fitness", bound=eqx.Module)

TIED = 0.01
TRACE = 1e-9
FREE_TESTS = 4
TOLERANCE = 1e-6


class Misfit(eqx.Module):
    """From a position in the unit cube to residuals over all tests, zero where samples do not count.

    Attributes:
        batch: tests.
        form: what is searched.
        scales: what the form's curves are measured in.
        bounds: of its parameters.
        apart: whether each test may be faster or slower by a factor of its own; see `free_speeds`.
    """

    batch: Batch
    form: Form = eqx.field(static=True)
    scales: Scales
    bounds: Bounds
    apart: bool = False

    @classmethod
    def of(cls, batch: Batch, form: Form) -> "Misfit":
        """Set up the misfit of a form over tests.

        Raises:
            FitError: nothing moves.
        """
        return cls(batch, form, scales_of(batch), _bounds(form, batch), apart=free_speeds(batch, form))

    def over(self, batch: Batch) -> "Misfit":
        """Return the misfit over other tests, its bounds and scales kept."""
        return replace(self, batch=batch)

    def pooled(self) -> "Misfit":
        """Return the misfit without factors of the tests' own."""
        return replace(self, apart=False)

    def values(self, position: np.ndarray) -> np.ndarray:
        """Return the parameters at a position, or at each of several, shape [D] or [P, D]."""
        return np.asarray(_values(self.bounds, jnp.asarray(position)))

    def slopes(self, position: np.ndarray) -> np.ndarray:
        """Return the parameters' derivatives by their place between the bounds."""
        return np.asarray(self.bounds.slopes(jnp.asarray(position)))

    def position(self, values: np.ndarray) -> np.ndarray:
        """Return where between their bounds values lie; the inverse of `values`."""
        return self.bounds.position(values)

    def residuals(self, position: Float[Array, " d"]) -> Float[Array, "t n"]:
        """Return the misses at a position; see `misses`."""
        return self.misses(self.bounds.values(position))

    def misses(self, values: Float[Array, " d"]) -> Float[Array, "t n"]:
        """Return misses weighted so that every test weighs the same: their mean square is J².

        With a factor s of each test's own the misses are s ŷ − y with s = (ŷ·y + ρ y·y)/(ŷ·ŷ + ρ y·y), which
        minimises (s ŷ − y)² + ρ y·y (s − 1)²: the smaller ρ, the freer the factors. The last term stands at
        the test's first sample, where nothing has moved.
        """
        measured = jnp.where(self.batch.counted, self.batch.travel, 0.0)
        travel = self.form.benchmark(values, self.scales).travel(self.batch)
        travel = jnp.where(self.batch.counted, travel, 0.0)
        misses = jnp.where(self.apart, _apart(travel, measured), travel - measured)
        counts = jnp.sum(self.batch.counted, axis=1, keepdims=True)
        tests = jnp.sum(counts > 0)
        weight = jnp.sqrt(jnp.sum(counts) / (tests * jnp.maximum(counts, 1)))
        return jnp.where(self.batch.counted, misses * weight, 0.0)

    def __call__(self, positions: Float[Array, "p d"]) -> Float[Array, " p"]:
        """Return J at each of p positions."""
        squares = jax.vmap(lambda position: jnp.sum(self.residuals(position) ** 2))(positions)
        return jnp.sqrt(squares / jnp.sum(self.batch.counted))

    def cost(self, position: np.ndarray) -> float:
        """Return the sum of the squared residuals at one position."""
        return float(self.equations_by_test(position).costs.sum())

    def error(self, position: np.ndarray) -> float:
        """Return J at one position."""
        return float(np.sqrt(self.cost(position) / np.sum(np.asarray(self.batch.counted))))

    def by_test(self, position: np.ndarray) -> np.ndarray:
        """Return the root mean square error of each test, shape [T]."""
        counts = np.asarray(self.batch.counted).sum(axis=1)
        costs = self.equations_by_test(position).costs
        return np.sqrt(costs * np.count_nonzero(counts) / counts.sum())

    def equations_by_test(self, position: np.ndarray) -> "TestEquations":
        """Return the squared residuals of each test at a position, to second order."""
        return self._compiled().by_test(position).take(np.arange(self.batch.command.shape[0]))

    def problem(self) -> Problem:
        """Return the search problem over the samples that count."""
        whole = self.over(self.batch.filled_up())
        return Problem(
            dimensions=len(self.form.parameters),
            fitness=traced(whole),
            samples=int(np.sum(np.asarray(self.batch.counted))),
            normal_equations=Compiled.of(whole).normal_equations,
        )

    def equations_by_stretch(self, position: np.ndarray, pieces: int) -> "TestEquations":
        """Return the squared residuals of as many stretches of each test, weighted as in the whole.

        A stretch without samples that count is left out.
        """
        counted = np.asarray(self.batch.counted)
        counts, weights = counted.sum(axis=1), self._weights()
        place = (np.cumsum(counted, axis=1) - 1) * pieces // np.maximum(counts, 1)[:, None]
        found = []
        for piece in range(pieces):
            part = self.over(self.batch.counting(jnp.asarray(place == piece)))
            there = np.flatnonzero(np.asarray(part.batch.counted).any(axis=1))
            if there.size:
                ratio = weights[there] / part._weights()[there]
                found.append(part.equations_by_test(position).take(there).times(ratio))
        return TestEquations(*(np.concatenate(rows) for rows in zip(*found, strict=True)))

    def errors(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted misses of the samples that count, and which test each belongs to, shape [M]."""
        counted = np.asarray(self.batch.counted)
        misses = self._compiled().misses(position)[: len(counted)]
        return misses[counted], np.repeat(np.arange(len(counted)), counted.sum(axis=1))

    def _weights(self) -> Float[np.ndarray, " t"]:
        """Return by what the squares of each test are multiplied; see `misses`."""
        counts = np.asarray(self.batch.counted).sum(axis=1)
        return counts.sum() / (np.count_nonzero(counts) * np.maximum(counts, 1))

    def _compiled(self) -> "Compiled":
        return Compiled.of(self.over(self.batch.filled_up()))


def free_speeds(batch: Batch, form: Form) -> bool:
    """Tell whether the tests of a form with a gain along the stroke may each have a speed of their own.

    Only where there are four tests more than parameters: of fewer, each at a level of its own, the factors
    take up the curve of the valve.
    """
    tests = int(np.sum(np.asarray(batch.counted).any(axis=1)))
    return form.slope and tests >= len(form.parameters) + FREE_TESTS


def _apart(travel: Float[Array, "t n"], measured: Float[Array, "t n"]) -> Float[Array, "t n"]:
    """Return misses apart from a factor of each test's own; see `Misfit.misses`."""
    moved = jnp.sum(measured**2, axis=1)
    # A test in which nothing moves has no factor of its own: a trace of the others' motion ties it to one.
    held = TIED * (moved + TRACE * jnp.mean(moved))
    along = jnp.sum(travel * measured, axis=1) + held
    own = along / (jnp.sum(travel**2, axis=1) + held)
    tie = jnp.sqrt(held) * (own - 1)
    return (own[:, None] * travel - measured).at[:, 0].set(tie)


def traced(fitness: _Fitness) -> _Fitness:
    """Return a module whose numbers are arrays, so that a program compiled for one clock serves all."""
    return jax.tree.map(jnp.asarray, fitness)


class TestEquations(NamedTuple):
    """The sum of squared residuals of each test at a position, to second order as Gauss and Newton have it.

    Attributes:
        costs: ‖r‖², shape [T].
        slopes: Jᵀ r, shape [T, D].
        curvatures: Jᵀ J, shape [T, D, D].
    """

    costs: Float[np.ndarray, " t"]
    slopes: Float[np.ndarray, "t d"]
    curvatures: Float[np.ndarray, "t d d"]

    def take(self, tests: np.ndarray) -> "TestEquations":
        """Return those of some tests, by their numbers."""
        return TestEquations(*(each[tests] for each in self))

    def times(self, weights: Float[np.ndarray, " t"]) -> "TestEquations":
        """Return them with each test's squares multiplied by a weight."""
        costs, slopes, curvatures = self
        return TestEquations(weights * costs, weights[:, None] * slopes, weights[:, None, None] * curvatures)


class Compiled(NamedTuple):
    """Misses of one misfit and their derivative, compiled; taken apart once for thousands of calls."""

    structure: Any
    leaves: list[Array]

    @classmethod
    def of(cls, misfit: Misfit) -> "Compiled":
        """Take a misfit apart."""
        leaves, structure = jax.tree.flatten(misfit)
        return cls(structure, leaves)

    def misses(self, position: np.ndarray) -> np.ndarray:
        """Return the misses at a position, shape [T, N]."""
        return np.asarray(_by_test(self.structure, self.leaves, position)[0])

    def by_test(self, position: np.ndarray) -> TestEquations:
        """Return the squared misses of each test at a position, to second order."""
        return TestEquations(*map(np.asarray, _by_test(self.structure, self.leaves, position)[1:]))

    def normal_equations(self, position: np.ndarray) -> NormalEquations:
        """Return ‖r‖², Jᵀr and JᵀJ at the position."""
        costs, slopes, curvatures = self.by_test(position)
        return NormalEquations(float(costs.sum()), slopes.sum(axis=0), curvatures.sum(axis=0))


# One program for all that is asked of a misfit: compiling takes longer than most fits.
@partial(jax.jit, static_argnums=0)
def _by_test(
    structure: Any, leaves: list[Array], position: Float[Array, " d"]
) -> tuple[Float[Array, "t n"], Float[Array, " t"], Float[Array, "t d"], Float[Array, "t d d"]]:
    misfit = jax.tree.unflatten(structure, leaves)

    def along(tangent: Float[Array, " d"]) -> tuple[Array, Array]:
        return jax.jvp(misfit.residuals, (position,), (tangent,))

    residuals, columns = jax.vmap(along, out_axes=(None, 1))(jnp.eye(position.size))
    slopes = jnp.einsum("tdn,tn->td", columns, residuals)
    curvatures = jnp.einsum("tdn,ten->tde", columns, columns)
    return residuals, jnp.sum(residuals**2, axis=1), slopes, curvatures


@eqx.filter_jit
def _values(bounds: Bounds, position: Float[Array, "*p d"]) -> Float[Array, "*p d"]:
    return bounds.values(position)


def scales_of(batch: Batch) -> Scales:
    """Return what a form's curves are measured in, from the samples of tests that count."""
    counted = np.asarray(batch.counted)
    displacement, load = np.asarray(batch.displacement)[counted], np.asarray(batch.load)
    lowest, highest = float(displacement.min()), float(displacement.max())
    return Scales(
        command=jnp.asarray(float(np.abs(np.asarray(batch.command)[counted]).max()) or 1.0),
        centre=jnp.asarray(0.5 * (lowest + highest)),
        span=jnp.asarray(0.5 * (highest - lowest) or 1.0),
        load_centre=jnp.asarray(float(load.mean())),
        load_spread=jnp.asarray(float(load.std()) or 1.0),
    )


def _bounds(form: Form, batch: Batch) -> Bounds:
    counted = np.asarray(batch.counted)
    displacement = np.asarray(batch.displacement)[counted]
    sizes = {
        Scale.NONE: 1.0,
        Scale.SPEED: _speed_per_command(batch),
        Scale.COMMAND: float(np.abs(np.asarray(batch.logged)[counted]).max()),
        Scale.TRAVEL: float(np.ptp(displacement)),
        Scale.HIGHEST: float(displacement.max()),
    }
    limits = [
        form.bounds.get(p.name, (p.lower * sizes[p.scale], p.upper * sizes[p.scale])) for p in form.parameters
    ]
    return Bounds.of(form.parameters, limits)


def _speed_per_command(batch: Batch) -> float:
    """Return distance travelled over the integral of the command: the order of magnitude of every gain."""
    counted = np.asarray(batch.counted)
    tests = zip(np.asarray(batch.travel), counted, strict=True)
    distance = sum(float(np.ptp(travel[counts])) for travel, counts in tests if counts.any())
    driven = batch.step_s * float(np.sum(np.abs(np.asarray(batch.command)) * counted))
    if driven == 0:
        raise FitError("the command never leaves the dead zone in the identification tests")
    if distance == 0:
        raise FitError("the piston does not move in the identification tests")
    return distance / driven


def polish_some(
    misfit: Misfit,
    free: Sequence[int],
    starts: Sequence[np.ndarray],
    limit: int,
    tolerance: float = TOLERANCE,
) -> Polished:
    """Descend over some of the parameters by least squares, the others staying where they start.

    Args:
        misfit: the tests.
        free: numbers of the parameters that move.
        starts: positions of all parameters, each of shape [D]; the others stay where they are in the first.
        limit: largest number of positions, the start included.
        tolerance: relative change of fitness or position below which to stop.

    Returns:
        The best outcome; its position is of the free parameters alone.

    Raises:
        FitError: none of the starts can be simulated.
    """
    whole, columns = misfit.problem(), np.asarray(free)

    def some(position: np.ndarray) -> NormalEquations:
        moved = starts[0].copy()
        moved[columns] = position
        return whole.normal_equations(moved).over(columns)

    problem = replace(whole, dimensions=len(columns), normal_equations=some)
    return best_polished(problem, [start[columns] for start in starts], limit=limit, tolerance=tolerance)
