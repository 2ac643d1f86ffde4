"""What stands around a linear benchmark: free run on operating points held out in turn decides."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.metrics import proven_better
from hitchid._support.progress import (
    IterationCallback,
    ProgressCallback,
    ProgressUpdate,
    iteration_progress,
    silent,
)
from hitchid.errors import FitError
from hitchid.estimation import Objective, Search, allows_per_test_gain, refine_subset
from hitchid.identification.phase1 import Phase1, assess_fit, find_parameters
from hitchid.structures import Batch, ModelSpec, structure_named
from hitchid.structures.static_nonlinearity import SPOOL_DYNAMICS, VALVE_CURVE
from hitchid.uncertainty import NO_ERROR, DeadZoneError

FOLDS = 4
LEVEL_TOLERANCE = 0.01
STEPS = 40
REFIT_STEPS = 4
SAMPLES = 2048
RAMP_OPENING_BOUNDS = (-0.1, 0.1)
MIN_GAIN_TESTS = 6
# Shares of a dead zone that is tried again with a valve curve; the first decides whether the others are.
DEAD_ZONE_SHARES = (0.5, 0.25, 0.75, 0.0)
NEUTRAL_POSITIONS = {
    "opening": 0.4,
    "exponent": 0.5,
    "saturation": 1.0,
    "hysteresis": 0.0,
    "spool_lag": 0.0,
    "dead_time": 0.0,
}
SECOND_ORDER_STARTS = (
    {"natural_frequency": 0.4, "damping_ratio": 0.45},
    {"natural_frequency": 0.7, "damping_ratio": 0.7},
)
CURVE_STARTS = (
    {"opening": 0.4, "exponent": 0.5, "saturation": 0.4},
    {"opening": 0.25, "exponent": 0.75, "saturation": 0.3},
    {"opening": 0.5, "exponent": 0.6, "saturation": 0.3},
)
HYSTERESIS_STARTS = (0.05, 0.1, 0.2)


@dataclass(frozen=True)
class AutoStructure:
    """In place of a form: the form is chosen, from a plain transfer function up.

    Attributes:
        baseline_spec: the form a choice starts from and must beat.
        covariate: name of the second measured input that may be used; None for the campaign's first, if any.
    """

    baseline_spec: ModelSpec
    covariate: str | None = None


@dataclass(frozen=True)
class Candidate:
    """One form that was tried.

    Attributes:
        name: what it has that the ones before have not.
        spec: the form.
        rmse: free run over all identification tests, each weighing the same.
        dead_zone: that it was fitted behind, in the command's unit.
        held_out: the same of each test whose operating point was held out in turn, shape [H].
        held_out_per_test_gain: likewise, apart from a factor on each test's speed, shape [H].
        chosen: whether it is the one that was taken.
    """

    name: str
    spec: ModelSpec
    rmse: float
    dead_zone: float
    held_out: np.ndarray
    held_out_per_test_gain: np.ndarray
    chosen: bool = False

    @property
    def held_out_rmse(self) -> float:
        """Free run over operating points held out in turn, each test weighing the same."""
        return float(np.sqrt(np.mean(self.held_out**2)))


def choose_spec(
    batch: Batch,
    auto_structure: AutoStructure,
    search: Search,
    seed: int,
    *,
    units: Mapping[str, str],
    opening_known: bool = False,
    revised: bool = False,
    dead_zone: DeadZoneError = NO_ERROR,
    progress: ProgressCallback = silent,
    checkpoints: Checkpoints = DISABLED,
) -> tuple[Phase1, tuple[Candidate, ...]]:
    """Identify the form that predicts operating points it was not fitted to best in free run.

    Tests are grouped by the level of their command and groups held out in turn, never samples; the lowest and
    the highest stay in, for what lies beyond the tests is not to be asked of a model. Forms nest: each starts
    its least squares from the optimum of the one before, its new curves from a few shapes. A larger form
    takes the place of a smaller one where held-out tests prove it better; a gain that grows along the stroke,
    where six or more of them do apart from a factor on the speed of each test, for a load that nobody
    measures differs from test to test and weighs more than the gain; see `allows_per_test_gain`. The one
    taken is identified as any other, by global search and least squares.

    Args:
        batch: identification tests.
        auto_structure: the plain form, and a second input.
        search: of the plain form and of the one chosen.
        seed: every random draw comes from it.
        units: see `identify_benchmark`.
        opening_known: whether the dead zone is where a ramp showed the valve to open: tests at a few levels
            of command say little about flow below the lowest.
        revised: whether the dead zone may be found anew with a valve curve; see `_with_smaller_dead_zone`.
        dead_zone: how well it is known.
        progress: called with what is being done and the fraction that is done.
        checkpoints: where what was found is kept and found again.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """

    def make_callback(spec_name: str, start: float) -> IterationCallback:
        return iteration_progress(
            progress, f"phase 1, {search.name}, {spec_name}", start, 0.3, f"RMSE / {units['x']}"
        )

    callback = make_callback("transfer function", 0.0)
    baseline_fit = find_parameters(
        batch,
        auto_structure.baseline_spec,
        search,
        seed,
        callback=callback,
        checkpoints=checkpoints.child("plain"),
    )
    folds = _folds(batch, separate_tests=auto_structure.covariate is not None)
    if not folds:
        return assess_fit(baseline_fit, units=units, dead_zone=dead_zone, seed=seed), ()
    coarse = batch.decimate(SAMPLES)
    objective = Objective.of(coarse, auto_structure.baseline_spec)
    all_indices = range(baseline_fit.position.size)
    evaluation = checkpoints.cached(
        "form", _Evaluation, lambda: _evaluate(objective, all_indices, baseline_fit.position, folds)
    )
    candidates = [evaluation.candidate("transfer function", auto_structure.baseline_spec, objective)]
    largest_spec = replace(
        auto_structure.baseline_spec,
        structure=structure_named("integrator-second-order"),
        dead_time=True,
        bounds={"opening": RAMP_OPENING_BOUNDS} if opening_known else {},
        valve_curve=True,
        spool_dynamics=True,
        stroke_gain_quadratic=True,
        covariate=auto_structure.covariate,
    )
    objective = Objective.of(coarse, largest_spec)
    names = [parameter.name for parameter in largest_spec.parameters]
    positions = np.array([NEUTRAL_POSITIONS.get(name, 0.5) for name in names])
    values = objective.values(positions).copy()
    values[names.index("gain")] = baseline_fit.values[0]
    positions = objective.position(values)
    optima: list[np.ndarray] = [np.array([])]
    for name, spec in _nested_specs(largest_spec):
        free = [names.index(parameter.name) for parameter in spec.parameters]
        objective = replace(objective, per_test_gain=allows_per_test_gain(coarse, spec))
        new_starts = _starts(spec, [] if len(candidates) == 1 else list(candidates[-1].spec.parameters))
        starts = [_with_positions(positions, names, start) for start in ({}, *new_starts)]
        try:
            evaluation = checkpoints.cached(
                f"form {name}", _Evaluation, partial(_fit_and_evaluate, objective, free, starts, folds)
            )
        except FitError:
            continue  # a larger form that cannot be fitted is none to choose
        positions = evaluation.positions
        if spec.valve_curve and not candidates[-1].spec.valve_curve and revised:
            objective, evaluation = _with_smaller_dead_zone(objective, evaluation, free, folds, checkpoints)
            positions = evaluation.positions
        candidates.append(evaluation.candidate(name, spec, objective))
        figures = {f"RMSE on levels held out / {units['x']}": candidates[-1].held_out_rmse}
        progress(ProgressUpdate("phase 1, structures", 0.3 + 0.05 * len(candidates), name, figures))
        optima.append(objective.values(positions)[free])
    chosen = 0
    for number, candidate in enumerate(candidates):
        incumbent = candidates[chosen]
        is_better = (
            candidate.held_out_per_test_gain.size >= MIN_GAIN_TESTS
            and proven_better(candidate.held_out_per_test_gain, incumbent.held_out_per_test_gain)
            if allows_per_test_gain(coarse, candidate.spec)
            else proven_better(candidate.held_out, incumbent.held_out)
        )
        chosen = number if is_better else chosen
    candidates[chosen] = replace(candidates[chosen], chosen=True)
    if chosen == 0:
        return assess_fit(baseline_fit, units=units, dead_zone=dead_zone, seed=seed), tuple(candidates)
    callback = make_callback(candidates[chosen].name, 0.7)
    selected = candidates[chosen]
    selected_batch = (
        batch if selected.dead_zone == candidates[0].dead_zone else batch.with_dead_zone(selected.dead_zone)
    )
    fit = find_parameters(
        selected_batch,
        selected.spec,
        search,
        seed,
        start=optima[chosen],
        callback=callback,
        checkpoints=checkpoints.child("chosen"),
    )
    return assess_fit(fit, units=units, dead_zone=dead_zone, seed=seed), tuple(candidates)


@dataclass(frozen=True)
class _Evaluation:
    """A form's best positions, shape [D], and what `Candidate` tells of it."""

    positions: np.ndarray
    rmse: float
    held_out: np.ndarray
    held_out_per_test_gain: np.ndarray

    def candidate(self, name: str, spec: ModelSpec, objective: Objective) -> Candidate:
        dead_zone = float(objective.batch.dead_zone[0])
        return Candidate(name, spec, self.rmse, dead_zone, self.held_out, self.held_out_per_test_gain)


def _nested_specs(largest_spec: ModelSpec) -> list[tuple[str, ModelSpec]]:
    """Return names and forms from a dead time up to everything."""
    delayed = replace(
        largest_spec,
        bounds={},
        valve_curve=False,
        spool_dynamics=False,
        stroke_gain_quadratic=False,
        covariate=None,
    )
    with_curve = replace(delayed, bounds=largest_spec.bounds, valve_curve=True)
    with_spool = replace(with_curve, spool_dynamics=True)
    with_slope = replace(with_spool, stroke_gain_linear=True)
    with_position = replace(with_spool, stroke_gain_quadratic=True)
    named_specs = [
        ("second order, dead time", delayed),
        ("with valve curve", with_curve),
        ("with lag and hysteresis of the spool", with_spool),
        ("with gain growing along the stroke", with_slope),
        ("with any gain along the stroke", with_position),
        (f"with {largest_spec.covariate}", largest_spec),
    ]
    return named_specs[:1] + [
        current for previous, current in pairwise(named_specs) if current[1] != previous[1]
    ]


def _starts(spec: ModelSpec, previous_parameters: Sequence) -> Sequence[Mapping[str, float]]:
    """Return where to start what a form has and the one before it has not: name to place in the cube."""
    names = {parameter.name for parameter in previous_parameters}
    if not names:
        return [{**first, "dead_time": 0.6} for first in SECOND_ORDER_STARTS]
    if spec.valve_curve and VALVE_CURVE[0].name not in names:
        return CURVE_STARTS
    if spec.spool_dynamics and SPOOL_DYNAMICS[0].name not in names:
        return [
            {"hysteresis": width, "spool_lag": 0.5, **curve}
            for width in HYSTERESIS_STARTS
            for curve in ({}, CURVE_STARTS[0])
        ]
    return ({},)


def _with_positions(positions: np.ndarray, names: Sequence[str], start: Mapping[str, float]) -> np.ndarray:
    changed = positions.copy()
    for name, value in start.items():
        changed[names.index(name)] = value
    return changed


def _fit_and_evaluate(
    objective: Objective, free: Sequence[int], starts: Sequence[np.ndarray], folds: Sequence[np.ndarray]
) -> _Evaluation:
    """Fit the free parameters from several starts, and judge the best."""
    best = refine_subset(objective, free, starts, STEPS)
    positions = starts[0].copy()
    positions[list(free)] = best.position
    return _evaluate(objective, free, positions, folds)


def _with_smaller_dead_zone(
    objective: Objective,
    evaluation: _Evaluation,
    free: Sequence[int],
    folds: Sequence[np.ndarray],
    checkpoints: Checkpoints,
) -> tuple[Objective, _Evaluation]:
    """Return a form with a valve curve behind a smaller dead zone where held-out tests prove that better.

    A dead zone found from tests is that of a valve that is linear beyond it: one that opens slowly seems to
    open late. Its curve makes up for a dead zone that is too small, not for one that is too large: where half
    of it is no better, nothing else is tried.
    """
    names = [parameter.name for parameter in objective.spec.parameters]
    initial_dead_zone, best = float(objective.batch.dead_zone[0]), (objective, evaluation)
    for share in DEAD_ZONE_SHARES:
        other_objective = Objective.of(
            objective.batch.with_dead_zone(share * initial_dead_zone), objective.spec
        )
        start = other_objective.position(objective.values(evaluation.positions))
        starts = [start, *(_with_positions(start, names, curve) for curve in CURVE_STARTS)]
        try:
            other_evaluation = checkpoints.cached(
                f"form behind {share:g}",
                _Evaluation,
                partial(_fit_and_evaluate, other_objective, free, starts, folds),
            )
        except FitError:
            continue
        if proven_better(other_evaluation.held_out, best[1].held_out):
            best = other_objective, other_evaluation
        elif best[0] is objective:
            break
    return best


def _evaluate(
    objective: Objective, free: Sequence[int], positions: np.ndarray, folds: Sequence[np.ndarray]
) -> _Evaluation:
    """Judge a form by tests held out in turn.

    The others refit it from its best position by three damped steps: those reach what the tests determine.
    What they hardly determine keeps the value that all tests gave it, where a full descent would take it
    anywhere; so the figure is a little too good for large forms.
    """
    pooled, per_test_gain = objective.pooled(), replace(objective, per_test_gain=True)
    rmse = pooled.error(positions)
    held_out, held_out_per_test_gain = [], []
    for held_tests in folds:
        training_objective = _with_tests(objective, ~held_tests)
        refitted = positions.copy()
        refitted[list(free)] = refine_subset(training_objective, free, [positions], REFIT_STEPS).position
        held_out += list(pooled.rmse_by_test(refitted)[held_tests])
        held_out_per_test_gain += list(per_test_gain.rmse_by_test(refitted)[held_tests])
    return _Evaluation(positions, rmse, np.array(held_out), np.array(held_out_per_test_gain))


def _with_tests(objective: Objective, tests: np.ndarray) -> Objective:
    """Return the misfit over some of its tests; shapes stay, so that no program is compiled anew."""
    batch = objective.batch.masked(
        jnp.asarray(np.broadcast_to(tests[:, None], objective.batch.loss_mask.shape))
    )
    return objective.with_data(batch)


def _folds(batch: Batch, *, separate_tests: bool) -> list[np.ndarray]:
    """Return which tests are held out together, boolean arrays of shape [T].

    Every fourth operating point between the lowest and the highest level, so that a fold's neighbours stay
    in. Tests of one level are one operating point; with a second input every test is one of its own.
    """
    command, loss_mask = np.abs(np.asarray(batch.command)), np.asarray(batch.loss_mask)
    active = loss_mask & (command > 0)
    levels = np.array(
        [row[mask].mean() if mask.any() else 0.0 for row, mask in zip(command, active, strict=True)]
    )
    order = np.argsort(levels)
    is_new_level = separate_tests | (np.diff(levels[order]) > LEVEL_TOLERANCE * float(np.ptp(levels)))
    level_index = np.concatenate([[0], np.cumsum(is_new_level)])
    is_interior = (level_index > 0) & (level_index < level_index[-1])
    fold = np.full(levels.size, -1)
    fold[order] = np.where(is_interior, (level_index - 1) % FOLDS, -1)
    return [fold == index for index in range(min(FOLDS, int(level_index[-1]) - 1))]
