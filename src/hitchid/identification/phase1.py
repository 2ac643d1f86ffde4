"""Phase 1: the benchmark's parameters by a global search and a least-squares polish."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hitchid.benchmark import Batch, Benchmark, Form, Scales
from hitchid.benchmark.nonlinear import NonlinearStructure
from hitchid.benchmark.structure import Scale
from hitchid.errors import FitError
from hitchid.identification.search import Found, Problem, Search, polish

AT_BOUND = 1e-3
VAGUE = 0.5
SINGULAR = 1e-14
TIED = 0.01
LEVELLINGS = 3
SEARCHED, COARSE = 8192, 2048
ROUGH, ROUGH_STEPS, STEPS = 1e-9, 60, 60


@dataclass(frozen=True)
class Estimate:
    """One parameter as found.

    Attributes:
        name, unit: as in the structure, the unit in the log's units.
        value: the estimate.
        error: standard error, residuals of one test taken as correlated; infinite where not determined.
        lower, upper: bounds of the search.
        verdict: `determined`, `at its lower bound`, `at its upper bound` or `not determined`.
        linear: whether the search runs between the bounds as they are, not their logarithms.
    """

    name: str
    unit: str
    value: float
    error: float
    lower: float
    upper: float
    verdict: str
    linear: bool = False

    def at(self, position: np.ndarray) -> np.ndarray:
        """Return the values at positions between the bounds, 0 the lower and 1 the upper one."""
        if self.linear:
            return self.lower + position * (self.upper - self.lower)
        return self.lower * (self.upper / self.lower) ** position


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
    batch: Batch,
    form: Form,
    search: Search,
    seed: int,
    *,
    units: Mapping[str, str],
    start: np.ndarray | None = None,
) -> Phase1:
    """Find the parameters that minimise the free-run error over all tests.

    J(θ) = √(Σ (y − y_tf(θ))² / N) over the samples that count, Sun et al. 2025, sec. 2.4.1 and 2.4.2 phase 1
    (ê = 0), where each test weighs the same however long it is. The search runs in the unit cube, over
    logarithms of what is positive.

    Args:
        batch: identification tests.
        form: structure, dead time, bounds.
        search: global search; least squares follows it whatever it is.
        seed: every random draw comes from it.
        units: `x` and `u` to the units of displacement and command.
        start: values of the form's parameters from which least squares starts too, shape [D].

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    misfit = Misfit.of(batch, form)
    searched, _ = misfit.over(batch.thinned(SEARCHED)).problem()
    found = search.minimise(searched, seed)
    starts = [found.best, *_restarts(form, seed), *([] if start is None else [misfit.position(start)])]
    coarse, _ = misfit.over(batch.thinned(COARSE)).problem()
    rough = [polish(coarse, each, limit=ROUGH_STEPS, tolerance=ROUGH) for each in starts]
    problem, test = misfit.problem()
    best = polish(problem, min(rough, key=lambda polished: polished.fitness).position, limit=STEPS)
    # Least squares starts strictly inside the bounds: a search that ended on one may be a trifle better.
    before = float(misfit(jnp.asarray(found.best)[None])[0])
    improved = best.fitness <= before
    position = _levelled(misfit, best.position if improved else found.best)
    values, slopes = misfit.values(position), misfit.slopes(position)
    errors = slopes * _standard_errors(best.jacobian, best.residuals, test)
    # A parameter around zero is vague against the room between its bounds, any other against itself.
    doubt = np.where(misfit.linear, 0.25 * slopes, values)
    estimates = tuple(
        Estimate(
            name=parameter.name,
            unit=parameter.unit.format(**units),
            value=float(values[i]),
            error=float(errors[i]),
            lower=float(misfit.lower[i]),
            upper=float(misfit.upper[i]),
            verdict=_verdict(float(position[i]), float(errors[i] / doubt[i])),
            linear=parameter.linear,
        )
        for i, parameter in enumerate(form.parameters)
    )
    count = len(form.structure.parameters)
    derived = form.structure.derived(tuple(map(float, values[:count])))
    if form.spool:
        share = {p.name: float(v) for p, v in zip(form.parameters, values, strict=True)}["hysteresis"]
        derived["width of the hysteresis"] = (share * float(batch.dead_zone[0]), "{u}")
    return Phase1(
        benchmark=form.benchmark(jnp.asarray(values), misfit.scales),
        estimates=estimates,
        derived={name: (value, unit.format(**units)) for name, (value, unit) in derived.items()},
        rmse=_pooled(misfit, position),
        search_rmse=_pooled(misfit, found.best),
        found=found,
    )


class Misfit(eqx.Module):
    """From a position in the unit cube to residuals over all tests, zero where samples do not count.

    Attributes:
        batch: tests.
        form: what is searched.
        scales: what the form's curves are measured in.
        lower, upper: bounds of its parameters, shape [d].
        linear: which of them are searched as they are, shape [d].
        apart: whether each test may be faster or slower by a factor of its own.
    """

    batch: Batch
    form: Form = eqx.field(static=True)
    scales: Scales
    lower: Float[Array, " d"]
    upper: Float[Array, " d"]
    linear: Bool[Array, " d"]
    apart: bool = eqx.field(static=True, default=False)

    @classmethod
    def of(cls, batch: Batch, form: Form) -> "Misfit":
        """Set up the misfit of a form over tests.

        Raises:
            FitError: nothing moves.
        """
        lower, upper = _bounds(form, batch)
        linear = np.array([parameter.linear for parameter in form.parameters])
        bounds = jnp.asarray(lower), jnp.asarray(upper), jnp.asarray(linear)
        return cls(batch, form, scales_of(batch), *bounds, apart=form.slope)

    def over(self, batch: Batch) -> "Misfit":
        """Return the misfit over other tests, its bounds and scales kept."""
        return replace(self, batch=batch)

    def pooled(self) -> "Misfit":
        """Return the misfit without factors of the tests' own."""
        return replace(self, apart=False)

    def _by_value(self, position: Float[Array, " d"]) -> tuple[Array, Array]:
        """Return the values at a position and their derivatives by it."""
        width = self.upper - self.lower
        span = jnp.log(self.upper / jnp.where(self.linear, self.upper, self.lower))
        logarithmic = jnp.where(self.linear, 1.0, self.lower) * jnp.exp(position * span)
        values = jnp.where(self.linear, self.lower + position * width, logarithmic)
        return values, jnp.where(self.linear, width, values * span)

    def values(self, position: np.ndarray) -> np.ndarray:
        """Return the parameters at a position."""
        return np.asarray(self._by_value(jnp.asarray(position))[0])

    def slopes(self, position: np.ndarray) -> np.ndarray:
        """Return the parameters' derivatives by their place between the bounds."""
        return np.asarray(self._by_value(jnp.asarray(position))[1])

    def residuals(self, position: Float[Array, " d"]) -> Float[Array, "t n"]:
        """Return misses weighted so that every test weighs the same: their mean square is J².

        With a factor s of each test's own the misses are s ŷ − y with s = (ŷ·y + ρ y·y)/(ŷ·ŷ + ρ y·y), which
        minimises (s ŷ − y)² + ρ y·y (s − 1)²: the smaller ρ, the freer the factors. The last term stands at
        the test's first sample, where nothing has moved.
        """
        values, _ = self._by_value(position)
        measured = jnp.where(self.batch.counted, self.batch.travel, 0.0)
        travel = self.form.benchmark(values, self.scales).travel(self.batch)
        travel = jnp.where(self.batch.counted, travel, 0.0)
        misses = _apart(travel, measured) if self.apart else travel - measured
        counts = jnp.sum(self.batch.counted, axis=1, keepdims=True)
        tests = jnp.sum(counts > 0)
        weight = jnp.sqrt(jnp.sum(counts) / (tests * jnp.maximum(counts, 1)))
        return jnp.where(self.batch.counted, misses * weight, 0.0)

    def __call__(self, positions: Float[Array, "p d"]) -> Float[Array, " p"]:
        """Return J at each of p positions."""
        squares = jax.vmap(lambda position: jnp.sum(self.residuals(position) ** 2))(positions)
        return jnp.sqrt(squares / jnp.sum(self.batch.counted))

    def position(self, values: np.ndarray) -> np.ndarray:
        """Return where between their bounds values lie; the inverse of `values`."""
        bounds = zip(np.asarray(self.lower), np.asarray(self.upper), np.asarray(self.linear), strict=True)
        places = [
            (value - lower) / (upper - lower) if linear else np.log(value / lower) / np.log(upper / lower)
            for value, (lower, upper, linear) in zip(values, bounds, strict=True)
        ]
        return np.clip(places, 0.0, 1.0)

    def by_test(self, position: np.ndarray) -> np.ndarray:
        """Return the root mean square error of each test, shape [T]."""
        squares = np.sum(np.asarray(_residuals(self, jnp.asarray(position))) ** 2, axis=1)
        counts = np.asarray(self.batch.counted).sum(axis=1)
        return np.sqrt(squares * np.count_nonzero(counts) / counts.sum())

    def problem(self) -> tuple[Problem, np.ndarray]:
        """Return the search problem over the samples that count, and which test each of them belongs to."""
        counted = np.asarray(self.batch.counted)
        problem = Problem(
            dimensions=len(self.form.parameters),
            fitness=self,
            residuals=lambda position: np.asarray(_residuals(self, jnp.asarray(position)))[counted],
            jacobian=lambda position: np.asarray(_jacobian(self, jnp.asarray(position)))[counted],
        )
        return problem, np.repeat(np.arange(len(counted)), counted.sum(axis=1))


def _apart(travel: Float[Array, "t n"], measured: Float[Array, "t n"]) -> Float[Array, "t n"]:
    """Return misses apart from a factor of each test's own; see `Misfit.residuals`."""
    held = TIED * jnp.sum(measured**2, axis=1)
    along = jnp.sum(travel * measured, axis=1) + held
    own = along / jnp.maximum(jnp.sum(travel**2, axis=1) + held, jnp.finfo(travel.dtype).tiny)
    tie = jnp.sqrt(held + jnp.finfo(travel.dtype).tiny) * (own - 1)
    return (own[:, None] * travel - measured).at[:, 0].set(tie)


def _levelled(misfit: Misfit, position: np.ndarray) -> np.ndarray:
    """Return a position with the gain that fits all tests together, where each had a factor of its own."""
    if not misfit.apart:
        return position
    measured = jnp.where(misfit.batch.counted, misfit.batch.travel, 0.0)
    values = misfit.values(position).copy()
    for _ in range(LEVELLINGS):
        travel = misfit.form.benchmark(jnp.asarray(values), misfit.scales).travel(misfit.batch)
        travel = jnp.where(misfit.batch.counted, travel, 0.0)
        values[0] *= float(jnp.sum(travel * measured) / jnp.sum(travel**2))
    return misfit.position(values)


def _pooled(misfit: Misfit, position: np.ndarray) -> float:
    return float(misfit.pooled()(jnp.asarray(position)[None])[0])


@eqx.filter_jit
def _residuals(misfit: Misfit, position: Float[Array, " d"]) -> Float[Array, "t n"]:
    return misfit.residuals(position)


@eqx.filter_jit
def _jacobian(misfit: Misfit, position: Float[Array, " d"]) -> Float[Array, "t n d"]:
    return jax.jacfwd(misfit.residuals)(position)


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


def _restarts(form: Form, seed: int) -> list[np.ndarray]:
    """Return further positions to start least squares from, for a structure with more than one valley."""
    if not isinstance(form.structure, NonlinearStructure):
        return []
    return list(np.random.default_rng(seed).random((form.structure.restarts, len(form.parameters))))


def _bounds(form: Form, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
    counted = np.asarray(batch.counted)
    displacement = np.asarray(batch.displacement)[counted]
    sizes = {
        Scale.NONE: 1.0,
        Scale.SPEED: _speed_per_command(batch),
        Scale.COMMAND: float(np.abs(np.asarray(batch.logged)[counted]).max()),
        Scale.TRAVEL: float(np.ptp(displacement)),
        Scale.HIGHEST: float(displacement.max()),
    }
    bounds = [
        form.bounds.get(p.name, (p.lower * sizes[p.scale], p.upper * sizes[p.scale])) for p in form.parameters
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
