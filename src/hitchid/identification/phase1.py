"""Phase 1: the benchmark's parameters by a global search and a least-squares polish."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

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


@dataclass(frozen=True)
class Estimate:
    """One parameter as found.

    Attributes:
        name, unit: as in the structure, the unit in the log's units.
        value: the estimate.
        error: standard error, assuming white residuals; infinite where the data do not determine it.
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
        InputError: bounds for a parameter that does not exist, or not lower < upper, positive.
        FitError: nothing moves, or no parameters give a finite error.
    """
    parameters = searched_parameters(form.structure, dead_time=form.dead_time)
    lower, upper = _bounds(parameters, form.bounds, batch)
    low = jnp.log(jnp.asarray(lower))
    span = jnp.log(jnp.asarray(upper)) - low
    residuals = partial(_residuals, batch, form.structure, form.dead_time, low, span)
    count = int(np.sum(np.asarray(batch.counted)))
    present = np.asarray(batch.counted).ravel()
    compiled = eqx.filter_jit(residuals)
    slope = eqx.filter_jit(jax.jacfwd(residuals))

    def fitness(positions: Float[Array, "p d"]) -> Float[Array, " p"]:
        return jax.vmap(lambda position: jnp.sqrt(jnp.sum(residuals(position) ** 2) / count))(positions)

    problem = Problem(
        dimensions=len(parameters),
        fitness=fitness,
        residuals=lambda position: np.asarray(compiled(jnp.asarray(position)))[present],
        jacobian=lambda position: np.asarray(slope(jnp.asarray(position)))[present],
    )
    found = search.minimise(problem, seed)
    best = polish(problem, found.best)
    position, rmse = (
        (best.position, best.fitness)
        if best.fitness <= found.best_fitness
        else (found.best, found.best_fitness)
    )
    values = np.exp(np.asarray(low) + position * np.asarray(span))
    errors = values * np.asarray(span) * _standard_errors(best.jacobian, rmse)
    estimates = tuple(
        Estimate(
            name=parameter.name,
            unit=parameter.unit.format(**units),
            value=float(value),
            error=float(error),
            lower=float(least),
            upper=float(most),
            verdict=_verdict(float(place), float(error / value)),
        )
        for parameter, value, error, least, most, place in zip(
            parameters, values, errors, lower, upper, position, strict=True
        )
    )
    benchmark = Benchmark.of(form.structure, jnp.asarray(values), dead_time=form.dead_time)
    derived = {
        name: (value, unit.format(**units))
        for name, (value, unit) in form.structure.derived(
            tuple(map(float, values[: len(form.structure.parameters)]))
        ).items()
    }
    return Phase1(benchmark, estimates, derived, rmse, found.best_fitness, found)


def _residuals(
    batch: Batch,
    structure: Structure,
    dead_time: bool,
    low: Float[Array, " d"],
    span: Float[Array, " d"],
    position: Float[Array, " d"],
) -> Float[Array, " m"]:
    benchmark = Benchmark.of(structure, jnp.exp(low + position * span), dead_time=dead_time)
    misses = benchmark.response(batch.command, batch.step_s) - batch.travel
    return jnp.where(batch.counted, misses, 0.0).ravel()


def _bounds(
    parameters: tuple[Parameter, ...], asked: Mapping[str, tuple[float, float]], batch: Batch
) -> tuple[np.ndarray, np.ndarray]:
    names = [parameter.name for parameter in parameters]
    for name, (least, most) in asked.items():
        if name not in names:
            raise InputError(f"bounds: there is no parameter '{name}'; required one of {', '.join(names)}")
        if not 0 < least < most < np.inf:
            raise InputError(f"bounds of '{name}': required 0 < lower < upper, came {least:g} and {most:g}")
    scale = _speed_per_command(batch)
    bounds = [
        asked.get(p.name, (p.lower * scale, p.upper * scale) if p.relative else (p.lower, p.upper))
        for p in parameters
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


def _standard_errors(jacobian: np.ndarray, rmse: float) -> np.ndarray:
    """Return each coordinate's Gauss-Newton standard error, √diag(s² (JᵀJ)⁻¹), infinite where singular."""
    singular = np.linalg.svd(jacobian, full_matrices=False)
    _, values, vectors = singular
    keep = values > values[0] * 1e-12
    with np.errstate(divide="ignore"):
        inverse = np.where(keep, 1.0 / np.where(keep, values, 1.0), np.inf)
    spread = np.abs(vectors.T) * inverse
    spread = np.where(np.isnan(spread), 0.0, spread)
    return rmse * np.sqrt(np.sum(spread**2, axis=1))


def _verdict(place: float, relative_error: float) -> str:
    if place < AT_BOUND:
        return "at its lower bound"
    if place > 1 - AT_BOUND:
        return "at its upper bound"
    return "not determined" if relative_error > VAGUE else "determined"
