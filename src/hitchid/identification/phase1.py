"""Phase 1: the benchmark's parameters by a global search and a least-squares polish."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from hitchid._support.checkpoints import NOWHERE, Checkpoints
from hitchid._support.progress import Heard
from hitchid.estimation import Found, Misfit, Search, best_polished, polish, searchable
from hitchid.identification.optional import attempt
from hitchid.structures import Batch, Benchmark, Form
from hitchid.structures.nonlinear import NonlinearStructure
from hitchid.uncertainty import KNOWN, DeadZoneError, Estimate, Estimates, Moves, assess, unassessed

LEVELLINGS = 3
SEARCHED, COARSE = 8192, 2048
ROUGH, ROUGH_STEPS, STEPS = 1e-9, 60, 60


@dataclass(frozen=True)
class Fit:
    """The best parameters of a form, and how they were found.

    Attributes:
        misfit: the tests and the form.
        position: the parameters, in the unit cube, shape [D].
        found: the search and its trace.
    """

    misfit: Misfit
    position: np.ndarray
    found: Found

    @property
    def values(self) -> np.ndarray:
        """The parameters, shape [D]."""
        return self.misfit.values(self.position)


@dataclass(frozen=True)
class Phase1:
    """The benchmark of one direction, how it was found, and how well it is known.

    Attributes:
        benchmark: structure with values.
        fit: the parameters, and the search for them.
        known: what the tests say of each, and of what follows from them.
        moved: by how much each test moves each of them.
        rmse: root mean square error over the identification tests, free run, in the displacement's unit.
        search_rmse: the same before the polish.
    """

    benchmark: Benchmark
    fit: Fit
    known: Estimates
    moved: Moves
    rmse: float
    search_rmse: float

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Each parameter."""
        return self.known.parameters


def identify_benchmark(
    batch: Batch,
    form: Form,
    search: Search,
    seed: int,
    *,
    units: Mapping[str, str],
    start: np.ndarray | None = None,
    dead_zone: DeadZoneError = KNOWN,
    heard: Heard | None = None,
    kept: Checkpoints = NOWHERE,
) -> Phase1:
    """Find the parameters that minimise the free-run error over all tests, and say how well they are known.

    Args:
        batch, form, search, seed, start, heard, kept: see `find_parameters`.
        units: `x` and `u` to the units of displacement and command.
        dead_zone: how well it is known.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    fit = find_parameters(batch, form, search, seed, start=start, heard=heard, kept=kept)
    return assessed(fit, units=units, dead_zone=dead_zone, seed=seed)


def find_parameters(
    batch: Batch,
    form: Form,
    search: Search,
    seed: int,
    *,
    start: np.ndarray | None = None,
    heard: Heard | None = None,
    kept: Checkpoints = NOWHERE,
) -> Fit:
    """Find the parameters that minimise the free-run error over all tests.

    J(θ) = √(Σ (y − y_tf(θ))² / N) over the samples that count, Sun et al. 2025, sec. 2.4.1 and 2.4.2 phase 1
    (ê = 0), where each test weighs the same however long it is. The search runs in the unit cube, over
    logarithms of what is positive.

    Args:
        batch: identification tests.
        form: structure, dead time, bounds.
        search: global search; least squares follows it whatever it is.
        seed: every random draw comes from it.
        start: values of the form's parameters from which least squares starts too, shape [D].
        heard: told how the search goes.
        kept: where what was found is kept and found again.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    misfit = Misfit.of(batch, form)
    searched = searchable(misfit.over(batch.thinned(SEARCHED)))
    found = kept.piece("search", Found, lambda: search.minimise(searched, seed, heard))
    starts = [found.best, *_restarts(form, seed), *([] if start is None else [misfit.position(start)])]
    position = kept.arrays("least squares", lambda: {"position": _descended(misfit, starts)})["position"]
    return Fit(misfit, position, found)


def _descended(misfit: Misfit, starts: Sequence[np.ndarray]) -> np.ndarray:
    """Return where least squares ends from the best of several starts, the first of them the search's."""
    coarse = misfit.over(misfit.batch.thinned(COARSE)).problem()
    rough = best_polished(coarse, starts, limit=ROUGH_STEPS, tolerance=ROUGH)
    problem = misfit.problem()
    best = polish(problem, rough.position, limit=STEPS)
    # The rough descent is over thinned samples: over all of them the end of the search may be better.
    before = misfit.error(starts[0])
    return _levelled(misfit, best.position if best.fitness <= before else starts[0])


def assessed(fit: Fit, *, units: Mapping[str, str], dead_zone: DeadZoneError, seed: int) -> Phase1:
    """Return a fit as a benchmark, with what the tests say of its parameters; see `assess`.

    Where that cannot be computed every interval is open, and the verdict says why.
    """
    failures: list[str] = []
    found = attempt(
        "intervals of the parameters",
        lambda: assess(fit.misfit, fit.position, units=units, dead_zone=dead_zone, seed=seed),
        failures,
    )
    known, moved = found or unassessed(fit.misfit, fit.position, units=units, cause=" ".join(failures))
    return Phase1(
        benchmark=fit.misfit.form.benchmark(jnp.asarray(fit.values), fit.misfit.scales),
        fit=fit,
        known=known,
        moved=moved,
        rmse=fit.misfit.pooled().error(fit.position),
        search_rmse=fit.misfit.pooled().error(fit.found.best),
    )


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


def _restarts(form: Form, seed: int) -> list[np.ndarray]:
    """Return further positions to start least squares from, for a structure with more than one valley."""
    if not isinstance(form.structure, NonlinearStructure):
        return []
    return list(np.random.default_rng(seed).random((form.structure.restarts, len(form.parameters))))
