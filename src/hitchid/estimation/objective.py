"""The objective of an estimation: residuals of a form over tests at positions in the unit cube."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hitchid._support.metrics import independent_observations
from hitchid._support.records import short_repr
from hitchid.errors import FitError
from hitchid.estimation.least_squares import LeastSquaresResult, best_refined
from hitchid.estimation.search_problem import NormalEquations, SearchProblem
from hitchid.structures import Batch, CovariateScales, ModelSpec, Parameter, Scales
from hitchid.structures.structure import Scale

# Bounds of parameters, and the map between values and positions in the unit cube.


class Bounds(eqx.Module):
    """Bounds of d parameters, searched as positions in the unit cube.

    Attributes:
        lower, upper: in the parameters' units, shape [d].
        linear: which of them are searched as they are; of the others the logarithm is, shape [d].
    """

    lower: Float[Array, " d"]
    upper: Float[Array, " d"]
    linear: Bool[Array, " d"]

    @classmethod
    def of(cls, parameters: Sequence[Parameter], limits: Sequence[tuple[float, float]]) -> "Bounds":
        """Return the bounds of parameters from their limits, lower and upper."""
        lower, upper = np.array(limits).T
        linear = np.array([parameter.linear for parameter in parameters])
        return cls(*jax.device_put((lower, upper, linear)))

    def values(self, position: Float[Array, "*p d"]) -> Float[Array, "*p d"]:
        """Return the parameters at a position."""
        width, span = self._spans()
        logarithmic = jnp.where(self.linear, 1.0, self.lower) * jnp.exp(position * span)
        return jnp.where(self.linear, self.lower + position * width, logarithmic)

    def slopes(self, position: Float[Array, " d"]) -> Float[Array, " d"]:
        """Return the derivatives of the parameters with respect to their positions."""
        width, span = self._spans()
        return jnp.where(self.linear, width, self.values(position) * span)

    def position(self, values: np.ndarray) -> np.ndarray:
        """Return the position of values, clipped to the bounds."""
        return np.clip(self.unclipped_position(values), 0.0, 1.0)

    def unclipped_position(self, values: np.ndarray) -> np.ndarray:
        """Return the position of values, outside the unit cube where they lie beyond a bound."""
        bounds = zip(np.asarray(self.lower), np.asarray(self.upper), np.asarray(self.linear), strict=True)
        positions = [
            (value - lower) / (upper - lower) if linear else np.log(value / lower) / np.log(upper / lower)
            for value, (lower, upper, linear) in zip(values, bounds, strict=True)
        ]
        return np.array(positions)

    def _spans(self) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
        """Return the widths between the bounds, and between their logarithms."""
        return self.upper - self.lower, jnp.log(self.upper / jnp.where(self.linear, self.upper, self.lower))


_values, _slopes = eqx.filter_jit(Bounds.values), eqx.filter_jit(Bounds.slopes)
_Fitness = TypeVar("_Fitness", bound=eqx.Module)

# ρ, share of a test's energy: a factor of its own 10 % from one costs 1 % of its rms travel.
GAIN_RIDGE = 0.01
RIDGE_FLOOR = 1e-9  # share of the mean energy, which holds the factor of a test without motion at one
MIN_SPARE_TESTS = 4  # tests beyond the number of parameters; see `allows_per_test_gain`
TOLERANCE = 1e-6  # relative change of fitness or position at which least squares stops


@short_repr
class Objective(eqx.Module):
    """Residuals over all tests at a position in the unit cube, zero where samples do not count.

    Attributes:
        batch: tests.
        spec: model specification.
        scales: of the nonlinearities.
        bounds: of its parameters.
        per_test_gain: whether each test has a factor on its speed; see `allows_per_test_gain`.
    """

    batch: Batch
    spec: ModelSpec = eqx.field(static=True)
    scales: Scales
    bounds: Bounds
    per_test_gain: bool = False

    @classmethod
    def of(cls, batch: Batch, spec: ModelSpec) -> "Objective":
        """Set up the objective of a form over tests.

        Raises:
            FitError: nothing moves.
        """
        scales, bounds = scales_of(batch, spec.covariate_names), _bounds(spec, batch)
        return cls(batch, spec, scales, bounds, per_test_gain=allows_per_test_gain(batch, spec))

    def with_data(self, batch: Batch) -> "Objective":
        """Return the objective over other tests, its bounds and scales kept."""
        return replace(self, batch=batch)

    def over(self, tests: Bool[np.ndarray, " t"]) -> "Objective":
        """Return the objective over some of its tests; shapes stay the same, so nothing is recompiled."""
        mask = np.broadcast_to(tests[:, None], self.batch.loss_mask.shape)
        return self.with_data(self.batch.masked(jnp.asarray(mask)))

    def pooled(self) -> "Objective":
        """Return the objective without a factor on each test."""
        return replace(self, per_test_gain=False)

    def values(self, position: np.ndarray) -> np.ndarray:
        """Return the parameters at a position, or at each of several, shape [D] or [P, D]."""
        return np.asarray(_values(self.bounds, jax.device_put(position)))

    def slopes(self, position: np.ndarray) -> np.ndarray:
        """Return the parameters' derivatives by their positions."""
        return np.asarray(_slopes(self.bounds, jax.device_put(position)))

    def position(self, values: np.ndarray) -> np.ndarray:
        """Return the position of values; the inverse of `values`."""
        return self.bounds.position(values)

    def residuals(self, position: Float[Array, " d"]) -> Float[Array, "t n"]:
        """Return the residuals at a position; see `residuals_of_values`."""
        return self.residuals_of_values(self.bounds.values(position))

    def residuals_of_values(self, values: Float[Array, " d"]) -> Float[Array, "t n"]:
        """Return residuals weighted so that every test weighs the same: their mean square is J².

        With a factor s on each test the residuals are s ŷ − y with s = (ŷ·y + ρ y·y)/(ŷ·ŷ + ρ y·y), which
        minimises (s ŷ − y)² + ρ y·y (s − 1)²: the smaller ρ, the freer the factors. The last term stands at
        the test's first sample, where nothing has moved.
        """
        measured = jnp.where(self.batch.loss_mask, self.batch.travel, 0.0)
        travel = self.spec.physical_model(values, self.scales).travel(self.batch)
        travel = jnp.where(self.batch.loss_mask, travel, 0.0)
        residuals = jnp.where(
            self.per_test_gain, _per_test_gain_residuals(travel, measured), travel - measured
        )
        counts = jnp.sum(self.batch.loss_mask, axis=1, keepdims=True)
        tests = jnp.sum(counts > 0)
        weight = jnp.sqrt(jnp.sum(counts) / (tests * jnp.maximum(counts, 1)))
        return jnp.where(self.batch.loss_mask, residuals * weight, 0.0)

    def __call__(self, positions: Float[Array, "p d"]) -> Float[Array, " p"]:
        """Return J at each of p positions."""
        squares = jax.vmap(lambda position: jnp.sum(self.residuals(position) ** 2))(positions)
        return jnp.sqrt(squares / jnp.sum(self.batch.loss_mask))

    def cost(self, position: np.ndarray) -> float:
        """Return the sum of the squared residuals at one position."""
        return float(self.equations_by_test(position).costs.sum())

    def error(self, position: np.ndarray) -> float:
        """Return J at one position."""
        return float(np.sqrt(self.cost(position) / np.sum(np.asarray(self.batch.loss_mask))))

    def rmse_by_test(self, position: np.ndarray) -> np.ndarray:
        """Return the root mean square error of each test, shape [T]."""
        return self.rmse_of(self.equations_by_test(position).costs)

    def rmse_of(self, costs: Float[np.ndarray, " t"]) -> np.ndarray:
        """Return the root mean square error of each test from its squared residuals, shape [T]."""
        counts = np.asarray(self.batch.loss_mask).sum(axis=1)
        return np.sqrt(costs * np.count_nonzero(counts) / counts.sum())

    def equations_by_test(self, position: np.ndarray) -> "TestEquations":
        """Return the squared residuals of each test at a position, to second order."""
        return self._compiled().equations_by_test(position).take(np.arange(self.batch.command.shape[0]))

    def problem(self) -> SearchProblem:
        """Return the search problem over the samples that count."""
        padded = self.with_data(self.batch.pad_batch())
        return SearchProblem(
            dimensions=len(self.spec.parameters),
            fitness=traced(padded),
            samples=int(np.sum(np.asarray(self.batch.loss_mask))),
            normal_equations=CompiledObjective.of(padded).normal_equations,
        )

    def equations_by_segment(self, position: np.ndarray, n_segments: int) -> "TestEquations":
        """Return the squared residuals of as many segments of each test, weighted as in the whole.

        A segment without samples that count is left out.
        """
        loss_mask = np.asarray(self.batch.loss_mask)
        counts, weights = loss_mask.sum(axis=1), self._weights()
        segment_index = (np.cumsum(loss_mask, axis=1) - 1) * n_segments // np.maximum(counts, 1)[:, None]
        equations = []
        for segment in range(n_segments):
            segment_objective = self.with_data(self.batch.masked(jnp.asarray(segment_index == segment)))
            test_indices = np.flatnonzero(np.asarray(segment_objective.batch.loss_mask).any(axis=1))
            if test_indices.size:
                ratio = weights[test_indices] / segment_objective._weights()[test_indices]
                of_tests = segment_objective.equations_by_test(position).take(test_indices)
                equations.append(of_tests.weighted(ratio))
        return TestEquations(*(np.concatenate(rows) for rows in zip(*equations, strict=True)))

    def errors(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted residuals of the samples that count, and the test of each, shape [M]."""
        loss_mask = np.asarray(self.batch.loss_mask)
        residuals = self._compiled().residuals(position)[: len(loss_mask)]
        return residuals[loss_mask], np.repeat(np.arange(len(loss_mask)), loss_mask.sum(axis=1))

    def independent_observations(self, position: np.ndarray) -> float:
        """Return the number of independent errors among the residuals at a position."""
        mask = np.asarray(self.batch.loss_mask)
        residuals = np.where(mask, self._compiled().residuals(position)[: len(mask)], 0.0)
        # At its first sample nothing has moved: there stands what holds the gain of the test.
        return independent_observations(residuals[:, 1:])

    def travel(self, position: np.ndarray) -> Float[np.ndarray, "t n"]:
        """Return the simulated travel at a position where samples count, without a factor on each test."""
        loss_mask = np.asarray(self.batch.loss_mask)
        residuals = self.pooled()._compiled().residuals(position)[: len(loss_mask)]
        travel = residuals / np.sqrt(self._weights())[:, None] + np.asarray(self.batch.travel)
        return np.where(loss_mask, travel, 0.0)

    def _weights(self) -> Float[np.ndarray, " t"]:
        """Return the factors on the squares of each test; see `residuals_of_values`."""
        counts = np.asarray(self.batch.loss_mask).sum(axis=1)
        return counts.sum() / (np.count_nonzero(counts) * np.maximum(counts, 1))

    def _compiled(self) -> "CompiledObjective":
        return CompiledObjective.of(self.with_data(self.batch.pad_batch()))


def allows_per_test_gain(batch: Batch, spec: ModelSpec) -> bool:
    """Return whether each test of a form with a gain along the stroke may have a factor on its speed.

    Only where there are four tests more than parameters: of fewer, each at a level of its own, the factors
    absorb the curve of the valve.
    """
    tests = int(np.sum(np.asarray(batch.loss_mask).any(axis=1)))
    return spec.stroke_gain_linear and tests >= len(spec.parameters) + MIN_SPARE_TESTS


def _per_test_gain_residuals(
    travel: Float[Array, "t n"], measured: Float[Array, "t n"]
) -> Float[Array, "t n"]:
    """Return residuals with a factor on each test; see `Objective.residuals_of_values`."""
    energy = jnp.sum(measured**2, axis=1)
    # A test in which nothing moves determines no factor: a share of the others' energy holds it at one.
    ridge = GAIN_RIDGE * (energy + RIDGE_FLOOR * jnp.mean(energy))
    correlation = jnp.sum(travel * measured, axis=1) + ridge
    gain = correlation / (jnp.sum(travel**2, axis=1) + ridge)
    ridge_residual = jnp.sqrt(ridge) * (gain - 1)
    return (gain[:, None] * travel - measured).at[:, 0].set(ridge_residual)


def traced(fitness: _Fitness) -> _Fitness:
    """Return a module whose numbers are arrays, so that a program compiled for one clock serves all."""
    return jax.tree.map(jnp.asarray, fitness)


class TestEquations(NamedTuple):
    """‖r‖², Jᵀ r and Jᵀ J of each test at a position: squares to second order, as Gauss and Newton do."""

    costs: Float[np.ndarray, " t"]
    gradients: Float[np.ndarray, "t d"]
    curvatures: Float[np.ndarray, "t d d"]

    def take(self, tests: np.ndarray) -> "TestEquations":
        """Return those of some tests, by their numbers."""
        return TestEquations(*(array[tests] for array in self))

    def weighted(self, weights: Float[np.ndarray, " t"]) -> "TestEquations":
        """Return them with each test's squares multiplied by a weight."""
        costs, gradients, curvatures = self
        return TestEquations(
            weights * costs, weights[:, None] * gradients, weights[:, None, None] * curvatures
        )


class CompiledObjective(NamedTuple):
    """Residuals of one objective and their derivatives, compiled; flattened once for thousands of calls."""

    treedef: Any
    leaves: list[Array]

    @classmethod
    def of(cls, objective: Objective) -> "CompiledObjective":
        """Flatten an objective."""
        leaves, treedef = jax.tree.flatten(objective)
        return cls(treedef, leaves)

    def residuals(self, position: np.ndarray) -> np.ndarray:
        """Return the residuals at a position, shape [T, N]."""
        return np.asarray(_equations_by_test(self.treedef, self.leaves, position)[0])

    def equations_by_test(self, position: np.ndarray) -> TestEquations:
        """Return the squared residuals of each test at a position, to second order."""
        return TestEquations(*map(np.asarray, _equations_by_test(self.treedef, self.leaves, position)[1:]))

    def normal_equations(self, position: np.ndarray) -> NormalEquations:
        """Return ‖r‖², Jᵀr and JᵀJ at the position."""
        costs, gradients, curvatures = self.equations_by_test(position)
        return NormalEquations(float(costs.sum()), gradients.sum(axis=0), curvatures.sum(axis=0))


# One program for all functions of an objective: compiling takes longer than most fits.
@partial(jax.jit, static_argnums=0)
def _equations_by_test(
    treedef: Any, leaves: list[Array], position: Float[Array, " d"]
) -> tuple[Float[Array, "t n"], Float[Array, " t"], Float[Array, "t d"], Float[Array, "t d d"]]:
    objective = jax.tree.unflatten(treedef, leaves)

    def directional_derivative(tangent: Float[Array, " d"]) -> tuple[Array, Array]:
        return jax.jvp(objective.residuals, (position,), (tangent,))

    residuals, columns = jax.vmap(directional_derivative, out_axes=(None, 1))(jnp.eye(position.size))
    gradients = jnp.einsum("tdn,tn->td", columns, residuals)
    curvatures = jnp.einsum("tdn,ten->tde", columns, columns)
    return residuals, jnp.sum(residuals**2, axis=1), gradients, curvatures


def scales_of(batch: Batch, covariates: Sequence[str] = ()) -> Scales:
    """Return the scales of the nonlinearities, from the samples of tests that count."""
    loss_mask = np.asarray(batch.loss_mask)
    displacement = np.asarray(batch.displacement)[loss_mask]
    lowest, highest = float(displacement.min()), float(displacement.max())
    covariate_scales = CovariateScales.none()
    if covariates:
        loads = np.asarray(batch.load(covariates))[loss_mask.any(axis=1)]
        spread = loads.std(axis=0)
        covariate_scales = CovariateScales(
            jnp.asarray(loads.mean(axis=0)), jnp.asarray(np.where(spread > 0, spread, 1.0))
        )
    return Scales(
        command=jnp.asarray(float(np.abs(np.asarray(batch.command)[loss_mask]).max()) or 1.0),
        centre=jnp.asarray(0.5 * (lowest + highest)),
        span=jnp.asarray(0.5 * (highest - lowest) or 1.0),
        covariates=covariate_scales,
    )


def _bounds(spec: ModelSpec, batch: Batch) -> Bounds:
    loss_mask = np.asarray(batch.loss_mask)
    displacement = np.asarray(batch.displacement)[loss_mask]
    largest_command = float(np.abs(np.asarray(batch.raw_command)[loss_mask]).max())
    travel = float(np.ptp(displacement))
    sizes = {
        Scale.NONE: 1.0,
        Scale.SPEED: _speed_per_command(batch),
        Scale.COMMAND: largest_command,
        Scale.TRAVEL: travel,
        Scale.COMMAND_PER_TRAVEL: largest_command / travel,
        Scale.HIGHEST: float(displacement.max()),
    }
    limits = [
        spec.bounds.get(p.name, (p.lower * sizes[p.scale], p.upper * sizes[p.scale])) for p in spec.parameters
    ]
    return Bounds.of(spec.parameters, limits)


def _speed_per_command(batch: Batch) -> float:
    """Return distance travelled over the integral of the command: the order of magnitude of every gain."""
    loss_mask = np.asarray(batch.loss_mask)
    tests = zip(np.asarray(batch.travel), loss_mask, strict=True)
    distance = sum(float(np.ptp(travel[mask])) for travel, mask in tests if mask.any())
    command_integral = batch.step_s * float(np.sum(np.abs(np.asarray(batch.command)) * loss_mask))
    if command_integral == 0:
        raise FitError("the command never exceeds the dead zone in the identification tests")
    if distance == 0:
        raise FitError("the piston does not move in the identification tests")
    return distance / command_integral


def refine_subset(
    objective: Objective,
    free: Sequence[int],
    starts: Sequence[np.ndarray],
    limit: int,
    tolerance: float = TOLERANCE,
) -> LeastSquaresResult:
    """Descend over some of the parameters by least squares, the others staying where they start.

    Args:
        objective: the tests.
        free: numbers of the parameters that move.
        starts: positions of all parameters, each of shape [D]; the others stay where they are in the first.
        limit: largest number of positions, the start included.
        tolerance: relative change of fitness or position below which to stop.

    Returns:
        The best outcome; its position is of the free parameters alone.

    Raises:
        FitError: none of the starts can be simulated.
    """
    full_problem, columns = objective.problem(), np.asarray(free)

    def subset_equations(position: np.ndarray) -> NormalEquations:
        full_position = starts[0].copy()
        full_position[columns] = position
        return full_problem.normal_equations(full_position).subset(columns)

    problem = replace(full_problem, dimensions=len(columns), normal_equations=subset_equations)
    return best_refined(problem, [start[columns] for start in starts], limit=limit, tolerance=tolerance)
