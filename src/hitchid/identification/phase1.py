"""Phase 1: the physical model's parameters by a global search and least squares."""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from hitchid._support.checkpoints import DISABLED, Checkpoints, Cube
from hitchid._support.progress import (
    ProgressCallback,
    ProgressUpdate,
    attempt,
    iteration_progress,
    silent,
    split_progress,
)
from hitchid._support.records import short_repr
from hitchid.estimation import Objective, Search, SearchResult, best_refined, refine, search_problem
from hitchid.model import Estimate, Estimates
from hitchid.structures import Batch, ModelSpec, PhysicalModel
from hitchid.uncertainty import NO_ERROR, DeadZoneError, Influence, unassessed
from hitchid.uncertainty.intervals import assess

GAIN_ITERATIONS = 3  # of the gain, on which the travel depends weakly through the gain along the stroke
SEARCH_SAMPLES = 8192  # of a test, at most, in the search
FIT_SHARES = {"search": 0.6, "rough": 0.2, "least squares": 0.2}  # of the work of a fit (measured)
ROUGH_TOLERANCE, ROUGH_STEPS, STEPS = 1e-9, 60, 60  # of the first descents; positions of each descent
DEAD_TIME_STARTS = 3  # further random starts of a form with a dead time (chosen); see `_local_starts`


@short_repr
@dataclass(frozen=True)
class Fit:
    """The best parameters of a model specification, and the search that they come from.

    Attributes:
        objective: the tests and the form.
        position: the parameters, in the unit cube, shape [D].
        searched: what was searched globally: the same, or the plain form that this one was found from.
        search_result: the search and its trace.
    """

    objective: Objective
    position: np.ndarray
    searched: Objective
    search_result: SearchResult

    @property
    def values(self) -> np.ndarray:
        """The parameters, shape [D]."""
        return self.objective.values(self.position)

    @property
    def gain(self) -> float:
        """The gain; raises InputError where the structure has none."""
        return float(self.values[self.objective.spec.structure.gain_index])


@short_repr
@dataclass(frozen=True)
class Phase1:
    """The benchmark of one direction, its fit and its uncertainty.

    Attributes:
        benchmark: structure with values.
        fit: the parameters, and the search for them.
        assessment: estimates of the parameters and of derived quantities, with intervals.
        influence: of each test on each parameter.
        rmse: root mean square error over the identification tests, free run, in the displacement's unit.
        search_rmse: the same at the end of the search, before least squares.
    """

    benchmark: PhysicalModel
    fit: Fit
    assessment: Estimates
    influence: Influence
    rmse: float
    search_rmse: float

    @property
    def parameter_estimates(self) -> tuple[Estimate, ...]:
        """Each parameter."""
        return self.assessment.parameters


def identify_benchmark(
    batch: Batch,
    spec: ModelSpec,
    search: Search,
    seed: int,
    *,
    units: Mapping[str, str],
    dead_zone: DeadZoneError = NO_ERROR,
    progress: ProgressCallback = silent,
    checkpoints: Checkpoints = DISABLED,
) -> Phase1:
    """Find the parameters that minimise the free-run error over all tests, with their intervals.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    parts = split_progress(progress, {"fit": 0.6, "intervals": 0.4})
    fit = find_parameters(
        batch, spec, search, seed, unit=units["x"], progress=parts["fit"], checkpoints=checkpoints
    )
    return assess_fit(fit, units=units, dead_zone=dead_zone, seed=seed, progress=parts["intervals"])


def find_parameters(
    batch: Batch,
    spec: ModelSpec,
    search: Search,
    seed: int,
    *,
    unit: str = "",
    progress: ProgressCallback = silent,
    checkpoints: Checkpoints = DISABLED,
) -> Fit:
    """Find the parameters that minimise the free-run error over all tests.

    J(θ) = √(Σ (y − y_tf(θ))² / N) over the samples that count, Sun et al. 2025, sec. 2.4.1 and 2.4.2 phase 1
    (ê = 0), where each test weighs the same however long it is. The search runs in the unit cube, over
    logarithms of what is positive.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    objective = Objective.of(batch, spec)
    problem = search_problem(objective.with_data(batch.decimate(SEARCH_SAMPLES)))
    stage = "searching parameters"
    parts = split_progress(progress, FIT_SHARES)
    parts["search"](ProgressUpdate(stage, 0.0))
    size = len(spec.parameters)
    callback = iteration_progress(parts["search"], stage, f"RMSE / {unit}" if unit else "RMSE")
    search_result = checkpoints.cached(
        "search",
        SearchResult,
        lambda: search.minimise(problem, seed, callback),
        {"best": Cube((size,)), "fitness_trace": ("g",), "best_trace": Cube(("g", size))},
    )

    def refined() -> dict[str, np.ndarray]:
        parts["rough"](ProgressUpdate("refining parameters from several starts", 0.0))
        starts = [search_result.best, *_local_starts(spec, seed)]
        coarse = objective.with_data(batch.coarse()).problem()
        rough_result = best_refined(coarse, starts, limit=ROUGH_STEPS, tolerance=ROUGH_TOLERANCE)
        parts["least squares"](ProgressUpdate("refining parameters", 0.0))
        best = refine(objective.problem(), rough_result.position, limit=STEPS)
        # The first descents are over fewer samples: over all of them the first start may be better.
        is_better = best.fitness <= objective.error(starts[0])
        return {"position": with_calibrated_gain(objective, best.position if is_better else starts[0])}

    shapes = {"position": Cube((size,))}
    position = checkpoints.cached_arrays("least squares", refined, shapes)["position"]
    return Fit(objective, position, objective, search_result)


def continue_fit(
    batch: Batch,
    spec: ModelSpec,
    start: np.ndarray,
    plain: Fit,
    *,
    progress: ProgressCallback = silent,
    checkpoints: Checkpoints = DISABLED,
) -> Fit:
    """Find the parameters of a form from those that the choice of forms found, over all samples.

    No global search: the form grew from a plain one that was searched, through least squares from several
    starts, and a search of the larger form changed hardly any model (docs/performance.md).
    """
    objective = Objective.of(batch, spec)
    progress(ProgressUpdate("refining parameters", 0.0))

    def work() -> dict[str, np.ndarray]:
        refined = refine(objective.problem(), objective.position(start), limit=STEPS)
        return {"position": with_calibrated_gain(objective, refined.position)}

    shapes = {"position": Cube((len(spec.parameters),))}
    position = checkpoints.cached_arrays("least squares", work, shapes)["position"]
    return Fit(objective, position, plain.searched, plain.search_result)


def assess_fit(
    fit: Fit,
    *,
    units: Mapping[str, str],
    dead_zone: DeadZoneError,
    seed: int,
    progress: ProgressCallback = silent,
) -> Phase1:
    """Return a fit as a benchmark, with the intervals of its parameters; see `assess`.

    Where these cannot be computed every interval is open, and the verdict names the cause.
    """
    failures: list[str] = []
    result = attempt(
        "intervals of the parameters",
        lambda: assess(
            fit.objective, fit.position, units=units, dead_zone=dead_zone, seed=seed, progress=progress
        ),
        failures,
    )
    assessment, influence = result or unassessed(
        fit.objective, fit.position, units=units, cause=" ".join(failures)
    )
    return Phase1(
        benchmark=fit.objective.spec.physical_model(jnp.asarray(fit.values), fit.objective.scales),
        fit=fit,
        assessment=assessment,
        influence=influence,
        rmse=fit.objective.pooled().error(fit.position),
        search_rmse=fit.searched.pooled().error(fit.search_result.best),
    )


def with_calibrated_gain(objective: Objective, position: np.ndarray) -> np.ndarray:
    """Return a position with the gain that fits all tests together, where each had a factor on its speed."""
    if not objective.per_test_gain:
        return position
    measured = jnp.where(objective.batch.loss_mask, objective.batch.travel, 0.0)
    values = objective.values(position).copy()
    for _ in range(GAIN_ITERATIONS):
        travel = objective.spec.physical_model(jnp.asarray(values), objective.scales).travel(objective.batch)
        travel = jnp.where(objective.batch.loss_mask, travel, 0.0)
        values[objective.spec.structure.gain_index] *= float(jnp.sum(travel * measured) / jnp.sum(travel**2))
    return objective.position(values)


def _local_starts(spec: ModelSpec, seed: int) -> list[np.ndarray]:
    """Return further starting points of least squares, for a form with more than one minimum.

    A dead time makes another one: it can stand for the lag, too, where the other parameters leave none. Of
    two levels of command the wrong minimum had a dead time with a narrow interval; most starts avoid it.
    """
    starts = spec.structure.local_starts + (DEAD_TIME_STARTS if spec.dead_time else 0)
    return list(np.random.default_rng(seed).random((starts, len(spec.parameters))))
