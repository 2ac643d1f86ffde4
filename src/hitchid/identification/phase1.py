"""Phase 1: the benchmark's parameters by a global search and a least-squares polish."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.benchmark import Batch, Benchmark, Parameter, Structure, searched_parameters
from hitchid.errors import FitError, InputError
from hitchid.identification.search import Found, Problem, Search, polish

AT_BOUND = 1e-3
VAGUE = 0.5
SINGULAR = 1e-14


@dataclass(frozen=True)
class Form:
    """What is searched for one direction.

    Attributes:
        structure: the benchmark's form.
        dead_time: whether a dead time is searched too.
        bounds: parameter name to lower and upper bound, in its unit, where the default will not do.
    """

    structure: Structure
    dead_time: bool = False
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse bounds for a parameter that does not exist, or not 0 < lower < upper."""
        names = [parameter.name for parameter in self.parameters]
        for name, (least, most) in self.bounds.items():
            if name not in names:
                known = ", ".join(names)
                raise InputError(f"bounds: there is no parameter '{name}'; required one of {known}")
            if not 0 < least < most < np.inf:
                raise InputError(
                    f"bounds of '{name}': required 0 < lower < upper, came {least:g} and {most:g}"
                )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that are searched, in their order."""
        return searched_parameters(self.structure, dead_time=self.dead_time)


@dataclass(frozen=True)
class Estimate:
    """One parameter as found.

    Attributes:
        name, unit: as in the structure, the unit in the log's units.
        value: the estimate.
        error: standard error, residuals of one test taken as correlated; infinite where not determined.
        lower, upper: bounds of the search.
        verdict: `determined`, `at its lower bound`, `at its upper bound` or `not determined`.
    """

    name: str
    unit: str
    value: float
    error: float
    lower: float
    upper: float
    verdict: str


@dataclass(frozen=True)
class Phase1:
    """The benchmark of one direction, and how it was found.

    Attributes:
        benchmark: structure with values.
        estimates: each parameter with its standard error and a verdict.
        derived: quantities that follow from them, name to value and unit.
        rmse: root mean square error over the identification tests, free run, in the displacement's unit.
        search_rmse: the same before the polish.
        found: the search and its trace; positions are in the unit cube of `estimates`' bounds, logarithmic.
    """

    benchmark: Benchmark
    estimates: tuple[Estimate, ...]
    derived: Mapping[str, tuple[float, str]]
    rmse: float
    search_rmse: float
    found: Found


def identify_benchmark(
    batch: Batch, form: Form, search: Search, seed: int, *, units: Mapping[str, str]
) -> Phase1:
    """Find the parameters that minimise the free-run error over all tests.

    J(θ) = √(Σ (y − y_tf(θ))² / N) over the samples that count, Sun et al. 2025, sec. 2.4.1 and 2.4.2 phase 1
    (ê = 0). The search runs over logarithms, scaled to the unit cube.

    Args:
        batch: identification tests.
        form: structure, dead time, bounds.
        search: global search; least squares follows it whatever it is.
        seed: every random draw comes from it.
        units: `x` and `u` to the units of displacement and command.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    parameters = form.parameters
    lower, upper = _bounds(form, batch)
    low, span = np.log(lower), np.log(upper / lower)
    misfit = _Misfit(batch, form.structure, form.dead_time, jnp.asarray(low), jnp.asarray(span))
    problem, test = _problem(misfit, len(parameters))
    found = search.minimise(problem, seed)
    best = polish(problem, found.best)
    # Least squares starts strictly inside the bounds: a search that ended on one may be a trifle better.
    improved = best.fitness <= found.best_fitness
    position = best.position if improved else found.best
    values = np.exp(low + position * span)
    errors = values * span * _standard_errors(best.jacobian, best.residuals, test)
    estimates = tuple(
        Estimate(
            name=parameter.name,
            unit=parameter.unit.format(**units),
            value=float(values[i]),
            error=float(errors[i]),
            lower=float(lower[i]),
            upper=float(upper[i]),
            verdict=_verdict(float(position[i]), float(errors[i] / values[i])),
        )
        for i, parameter in enumerate(parameters)
    )
    count = len(form.structure.parameters)
    derived = form.structure.derived(tuple(map(float, values[:count])))
    return Phase1(
        benchmark=Benchmark.of(form.structure, jnp.asarray(values), dead_time=form.dead_time),
        estimates=estimates,
        derived={name: (value, unit.format(**units)) for name, (value, unit) in derived.items()},
        rmse=best.fitness if improved else found.best_fitness,
        search_rmse=found.best_fitness,
        found=found,
    )


class _Misfit(eqx.Module):
    """From a position in the unit cube to residuals over all tests, zero where samples do not count."""

    batch: Batch
    structure: Structure
    dead_time: bool = eqx.field(static=True)
    low: Float[Array, " d"]
    span: Float[Array, " d"]

    def residuals(self, position: Float[Array, " d"]) -> Float[Array, " m"]:
        values = jnp.exp(self.low + position * self.span)
        benchmark = Benchmark.of(self.structure, values, dead_time=self.dead_time)
        misses = benchmark.response(self.batch.command, self.batch.step_s) - self.batch.travel
        return jnp.where(self.batch.counted, misses, 0.0).ravel()

    def __call__(self, positions: Float[Array, "p d"]) -> Float[Array, " p"]:
        squares = jax.vmap(lambda position: jnp.sum(self.residuals(position) ** 2))(positions)
        return jnp.sqrt(squares / jnp.sum(self.batch.counted))


@eqx.filter_jit
def _residuals(misfit: _Misfit, position: Float[Array, " d"]) -> Float[Array, " m"]:
    return misfit.residuals(position)


@eqx.filter_jit
def _jacobian(misfit: _Misfit, position: Float[Array, " d"]) -> Float[Array, "m d"]:
    return jax.jacfwd(misfit.residuals)(position)


def _problem(misfit: _Misfit, dimensions: int) -> tuple[Problem, np.ndarray]:
    """Return the search problem over the samples that count, and which test each of them belongs to."""
    counted = np.asarray(misfit.batch.counted)
    present = counted.ravel()
    problem = Problem(
        dimensions=dimensions,
        fitness=misfit,
        residuals=lambda position: np.asarray(_residuals(misfit, jnp.asarray(position)))[present],
        jacobian=lambda position: np.asarray(_jacobian(misfit, jnp.asarray(position)))[present],
    )
    return problem, np.repeat(np.arange(len(counted)), counted.sum(axis=1))


def _bounds(form: Form, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
    scale = _speed_per_command(batch)
    bounds = [
        form.bounds.get(p.name, (p.lower * scale, p.upper * scale) if p.relative else (p.lower, p.upper))
        for p in form.parameters
    ]
    lower, upper = np.array(bounds).T
    return lower, upper


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


def _standard_errors(jacobian: np.ndarray, residuals: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Return each coordinate's standard error, infinite where the tests do not determine it.

    cov = H⁻¹ (Σ gₜ gₜᵀ) H⁻¹ · T/(T − D) with H = JᵀJ and gₜ = Jₜᵀ rₜ of each test: residuals of one test may
    be correlated in any way, tests are independent of each other. The textbook s² H⁻¹, which takes every
    sample for independent, stands in where there are no more tests than parameters, and is its floor.

    Args:
        jacobian: derivative of the residuals, shape [M, D].
        residuals: shape [M].
        test: which test each residual belongs to, shape [M].
    """
    samples, dimensions = jacobian.shape
    curvature = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(curvature))
    if not np.all(scale > 0):
        return np.full(dimensions, np.inf)
    values, vectors = np.linalg.eigh(curvature / np.outer(scale, scale))
    if values[0] <= SINGULAR * values[-1]:
        return np.full(dimensions, np.inf)
    inverse = (vectors / values) @ vectors.T / np.outer(scale, scale)
    white = float(residuals @ residuals) / max(1, samples - dimensions) * inverse
    slopes = np.stack([jacobian[test == each].T @ residuals[test == each] for each in np.unique(test)])
    tests = len(slopes)
    if tests <= dimensions:
        return np.sqrt(np.diag(white))
    clustered = inverse @ (slopes.T @ slopes) @ inverse * tests / (tests - dimensions)
    return np.sqrt(np.maximum(np.diag(white), np.diag(clustered)))


def _verdict(place: float, relative_error: float) -> str:
    if place < AT_BOUND:
        return "at its lower bound"
    if place > 1 - AT_BOUND:
        return "at its upper bound"
    return "not determined" if relative_error > VAGUE else "determined"
