"""Which curves a benchmark needs: free run on operating points held out in turn decides."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from hitchid.benchmark import SHAPE, Batch, Form, structure_named
from hitchid.identification.phase1 import Misfit, Phase1, identify_benchmark
from hitchid.identification.search import Polished, Problem, Search, polish

FOLDS = 4
SAME_LEVEL = 0.01
PARSIMONY = 1.02
TOLERANCE = 1e-6
STEPS = 40
NEUTRAL = {"opening": 0.4, "exponent": 0.5, "saturation": 1.0, "dead_time": 0.0}
FIRST = ({"natural_frequency": 0.4, "damping_ratio": 0.45}, {"natural_frequency": 0.7, "damping_ratio": 0.7})
CURVES = (
    {"opening": 0.4, "exponent": 0.5, "saturation": 0.4},
    {"opening": 0.25, "exponent": 0.75, "saturation": 0.3},
    {"opening": 0.5, "exponent": 0.6, "saturation": 0.3},
)


@dataclass(frozen=True)
class Automatic:
    """In place of a form: the form is chosen, from a plain transfer function up.

    Attributes:
        plain: the form a choice starts from and must beat.
        load: name of the second measured input that may be used; None for none.
    """

    plain: Form
    load: str | None = None


@dataclass(frozen=True)
class Candidate:
    """One form that was tried.

    Attributes:
        name: what it has that the ones before have not.
        form: the form.
        rmse: free run over all identification tests, each weighing the same.
        held_out: the same over operating points held out in turn.
    """

    name: str
    form: Form
    rmse: float
    held_out: float


def choose_form(
    batch: Batch, asked: Automatic, search: Search, seed: int, *, units: Mapping[str, str]
) -> tuple[Phase1, tuple[Candidate, ...]]:
    """Identify the form that predicts operating points it was not fitted to best in free run.

    Tests are grouped by the level of their command and groups held out in turn, never samples; the lowest and
    the highest stay in, for what lies beyond the tests is not to be asked of a model. Forms nest: each starts
    its least squares from the optimum of the one before, its new curves from a few shapes. The smallest
    within 2 % of the best is taken and identified as any other, by global search and least squares.

    Args:
        batch: identification tests.
        asked: the plain form, and a second input.
        search: of the plain form and of the one chosen.
        seed: every random draw comes from it.
        units: see `identify_benchmark`.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    plain = identify_benchmark(batch, asked.plain, search, seed, units=units)
    folds = _folds(batch, alone=asked.load is not None)
    if not folds:
        return plain, ()
    misfit = Misfit.of(batch, asked.plain)
    position = np.array([_place(misfit, i, e.value) for i, e in enumerate(plain.estimates)])
    tried = [_tried("transfer function", misfit, range(position.size), position, folds, asked.plain)]
    widest = replace(
        asked.plain,
        structure=structure_named("integrator-second-order"),
        dead_time=True,
        bounds={},
        curve=True,
        position=True,
        load=asked.load,
    )
    misfit = Misfit.of(batch, widest)
    names = [parameter.name for parameter in widest.parameters]
    positions = np.array([NEUTRAL.get(name, 0.5) for name in names])
    positions[names.index("gain")] = _place(misfit, names.index("gain"), plain.estimates[0].value)
    found: list[np.ndarray] = [position]
    for name, form in _larger(widest):
        free = [names.index(parameter.name) for parameter in form.parameters]
        fresh = _starts(form, [] if len(tried) == 1 else list(tried[-1].form.parameters))
        starts = [_with(positions, names, start) for start in fresh]
        best = min((_fitted(misfit, free, start) for start in starts), key=lambda each: each.fitness)
        positions = positions.copy()
        positions[free] = best.position
        tried.append(_tried(name, misfit, free, positions, folds, form))
        found.append(positions[free])
    least = min(candidate.held_out for candidate in tried)
    chosen = next(i for i, candidate in enumerate(tried) if candidate.held_out <= PARSIMONY * least)
    if chosen == 0:
        return plain, tuple(tried)
    form = tried[chosen].form
    return identify_benchmark(batch, form, search, seed, units=units, start=found[chosen]), tuple(tried)


def _larger(widest: Form) -> list[tuple[str, Form]]:
    """Return names and forms from a dead time up to everything."""
    late = replace(widest, curve=False, position=False, load=None)
    curved = replace(late, curve=True)
    placed = replace(curved, position=True)
    forms = [
        ("second order, dead time", late),
        ("with valve curve", curved),
        ("with gain along the stroke", placed),
    ]
    return forms if widest.load is None else [*forms, (f"with {widest.load}", widest)]


def _starts(form: Form, before: Sequence) -> Sequence[Mapping[str, float]]:
    """Return where to start what a form has and the one before it has not: name to place in the cube."""
    names = {parameter.name for parameter in before}
    if not names:
        return [{**first, "dead_time": 0.6} for first in FIRST]
    if form.curve and SHAPE[0].name not in names:
        return CURVES
    return ({},)


def _with(positions: np.ndarray, names: Sequence[str], start: Mapping[str, float]) -> np.ndarray:
    moved = positions.copy()
    for name, place in start.items():
        moved[names.index(name)] = place
    return moved


def _tried(
    name: str,
    misfit: Misfit,
    free: Sequence[int],
    positions: np.ndarray,
    folds: Sequence[np.ndarray],
    form: Form,
) -> Candidate:
    whole = float(misfit(jnp.asarray(positions)[None])[0])
    squares, tests = 0.0, 0
    for held in folds:
        kept = _over(misfit, ~held)
        moved = positions.copy()
        moved[list(free)] = _fitted(kept, free, positions).position
        squares += float(_over(misfit, held)(jnp.asarray(moved)[None])[0]) ** 2 * int(held.sum())
        tests += int(held.sum())
    return Candidate(name, form, whole, float(np.sqrt(squares / tests)))


def _over(misfit: Misfit, tests: np.ndarray) -> Misfit:
    """Return the misfit over some of its tests; shapes stay, so that no program is compiled anew."""
    batch = misfit.batch.counting(jnp.asarray(np.broadcast_to(tests[:, None], misfit.batch.counted.shape)))
    return Misfit(batch, misfit.form, misfit.scales, misfit.lower, misfit.upper, misfit.linear)


def _fitted(misfit: Misfit, free: Sequence[int], start: np.ndarray) -> Polished:
    """Return the least squares over some of the parameters, the others staying where they start."""
    whole, _ = misfit.problem()
    columns = list(free)

    def filled(position: np.ndarray) -> np.ndarray:
        moved = start.copy()
        moved[columns] = position
        return moved

    problem = Problem(
        dimensions=len(columns),
        fitness=whole.fitness,
        residuals=lambda position: whole.residuals(filled(position)),
        jacobian=lambda position: whole.jacobian(filled(position))[:, columns],
    )
    return polish(problem, start[columns], limit=STEPS, tolerance=TOLERANCE)


def _place(misfit: Misfit, index: int, value: float) -> float:
    """Return where between its bounds a value lies."""
    lower, upper = float(misfit.lower[index]), float(misfit.upper[index])
    if bool(misfit.linear[index]):
        return (value - lower) / (upper - lower)
    return float(np.log(value / lower) / np.log(upper / lower))


def _folds(batch: Batch, *, alone: bool) -> list[np.ndarray]:
    """Return which tests are held out together, boolean arrays of shape [T].

    Every fourth operating point between the lowest and the highest level, so that a fold's neighbours stay
    in. Tests of one level are one operating point; with a second input every test is one of its own.
    """
    command, counted = np.abs(np.asarray(batch.command)), np.asarray(batch.counted)
    active = counted & (command > 0)
    levels = np.array([row[on].mean() if on.any() else 0.0 for row, on in zip(command, active, strict=True)])
    order = np.argsort(levels)
    apart = alone | (np.diff(levels[order]) > SAME_LEVEL * float(np.ptp(levels)))
    group = np.concatenate([[0], np.cumsum(apart)])
    inside = (group > 0) & (group < group[-1])
    number = np.full(levels.size, -1)
    number[order] = np.where(inside, (group - 1) % FOLDS, -1)
    return [number == each for each in range(min(FOLDS, int(group[-1]) - 1))]
