"""Candidate structures of one direction, cross-validated in free run by operating point."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.stats import chi2

from hitchid._support.checkpoints import Cube, Shapes
from hitchid._support.metrics import ERROR_FLOOR, MIN_IMPROVEMENT, better_on_held_out_tests, log_ratio_p_value
from hitchid._support.records import short_repr
from hitchid.estimation import Objective, refine_subset
from hitchid.structures import Batch, CovariateEffects, ModelSpec, Parameter, structure_named
from hitchid.structures.nonlinearity import SPOOL_DYNAMICS, VALVE_CURVE

# Positions between the bounds, 0 to 1, at which an option has no effect, or as little as the bounds allow.
NEUTRAL_POSITIONS = {
    "opening": 0.4,
    "exponent": 0.5,
    "saturation": 1.0,
    "hysteresis": 0.0,
    "spool_lag": 0.0,
    "dead_time": 0.0,
}
MIDDLE = 0.5  # position of the other parameters
# Opening beside a dead zone from ramps, share of the largest effective command. A ramp shows the opening but
# for its spread and the plant's delay; the bounds leave room for a rounded onset.
RAMP_OPENING_BOUNDS = (-0.1, 0.1)
# Positions between the bounds: a soft, little damped and a stiff, more damped plant; valve curves that are
# even, rise slowly or saturate early; narrow to wide hysteresis.
SECOND_ORDER_STARTS = (
    {"natural_frequency": 0.4, "damping_ratio": 0.45},
    {"natural_frequency": 0.7, "damping_ratio": 0.7},
)
DEAD_TIME_START = 0.6
CURVE_STARTS = (
    {"opening": 0.4, "exponent": 0.5, "saturation": 0.4},
    {"opening": 0.25, "exponent": 0.75, "saturation": 0.3},
    {"opening": 0.5, "exponent": 0.6, "saturation": 0.3},
)
# Friction that compresses the oil by a thousandth of the range of displacement; the load came to rest against
# the direction of travel, or along it.
FRICTION_STARTS = (
    {"friction_travel": 0.6, "friction_at_rest": 0.15},
    {"friction_travel": 0.6, "friction_at_rest": 0.85},
)
# Half and one and a half times the frequency at an end of the range, in either sense.
FREQUENCY_STARTS = ({"frequency_slope": 0.3}, {"frequency_slope": 0.7})
# What follows the best form of a structure: name of the next structure, what it adds, and its starts.
NEXT_STRUCTURES = {
    "integrator-second-order": ("integrator-second-order-friction", "dry friction", FRICTION_STARTS),
    "integrator-second-order-friction": (
        "integrator-second-order-stroke",
        "a natural frequency that varies along the stroke",
        FREQUENCY_STARTS,
    ),
}
HYSTERESIS_STARTS = (0.05, 0.1, 0.2)
SPOOL_LAG_START = 0.5


def largest_spec(baseline: ModelSpec, *, opening_known: bool) -> ModelSpec:
    """Return the largest candidate without covariates."""
    return replace(
        baseline,
        structure=structure_named("integrator-second-order"),
        dead_time=True,
        bounds={"opening": RAMP_OPENING_BOUNDS} if opening_known else {},
        valve_curve=True,
        spool_dynamics=True,
        stroke_gain_quadratic=True,
        covariates=(),
    )


def nested_specs(largest: ModelSpec) -> list[tuple[str, ModelSpec]]:
    """Return names and specifications of the candidates, from a dead time alone to all options."""
    delayed = replace(
        largest, bounds={}, valve_curve=False, spool_dynamics=False, stroke_gain_quadratic=False
    )
    with_curve = replace(delayed, bounds=largest.bounds, valve_curve=True)
    with_spool = replace(with_curve, spool_dynamics=True)
    with_slope = replace(with_spool, stroke_gain_linear=True)
    named_specs = [
        ("second order, dead time", delayed),
        ("with valve curve", with_curve),
        ("with spool lag and hysteresis", with_spool),
        ("with a gain linear along the stroke", with_slope),
        ("with a gain quadratic along the stroke", largest),
    ]
    return named_specs[:1] + [
        current for previous, current in pairwise(named_specs) if current[1] != previous[1]
    ]


def covariate_specs(spec: ModelSpec, covariate: str) -> list[tuple[str, ModelSpec]]:
    """Return names and specifications of a form with more effects of a covariate than it has, few to many."""
    steps = (
        (f"with {covariate} on speed and opening", CovariateEffects(covariate)),
        (f"with {covariate} on dynamics, too", CovariateEffects(covariate, dynamics=True)),
        (f"with {covariate} and its square", CovariateEffects(covariate, dynamics=True, quadratic=True)),
    )
    others = tuple(effects for effects in spec.covariates if effects.covariate != covariate)
    first = next((number for number, (_, effects) in enumerate(steps, 1) if effects in spec.covariates), 0)
    return [(name, replace(spec, covariates=(*others, effects))) for name, effects in steps[first:]]


# Left without a command a piston stays, or comes to rest a little farther on. One that goes back in nine
# stretches of ten, three at least, and by a twentieth of its travel on average, has no integrator; chosen.
LEAST_RETURN, LEAST_SHARE, FEWEST_STRETCHES, FEWEST_SAMPLES = 0.05, 0.9, 3, 10


def goes_back(batch: Batch) -> bool:
    """Return whether the piston goes back wherever it is left without a command after a motion.

    Over the stretches with no effective command, x₀ and x₁ the mean travel in the first and the last tenth of
    each: −Σ (x₁ − x₀) x₀ / Σ x₀² is the share of the travel that it goes back.
    """
    before, change = [], []
    usable = np.asarray(batch.valid) & np.asarray(batch.loss_mask)
    for command, travel, is_usable in zip(
        np.asarray(batch.command), np.asarray(batch.travel), usable, strict=True
    ):
        is_left = (command == 0) & is_usable & (np.cumsum(command != 0) > 0)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_left, [False]]).astype(np.int64)))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start >= FEWEST_SAMPLES:
                tenth = (stop - start) // FEWEST_SAMPLES
                first, last = travel[start : start + tenth].mean(), travel[stop - tenth : stop].mean()
                before.append(first)
                change.append(last - first)
    products = np.array(before) * np.array(change)
    return (
        len(before) >= FEWEST_STRETCHES
        and bool(np.mean(products < 0) >= LEAST_SHARE)
        and bool(-products.sum() >= LEAST_RETURN * np.square(before).sum())
    )


def starts(spec: ModelSpec, previous: Sequence[Parameter]) -> Sequence[Mapping[str, float]]:
    """Return starting positions, by name, of the parameters that a candidate adds to the one before it."""
    names = {parameter.name for parameter in previous}
    if not names:
        return [{**first, "dead_time": DEAD_TIME_START} for first in SECOND_ORDER_STARTS]
    if spec.valve_curve and VALVE_CURVE[0].name not in names:
        return CURVE_STARTS
    if spec.spool_dynamics and SPOOL_DYNAMICS[0].name not in names:
        return [
            {"hysteresis": width, "spool_lag": SPOOL_LAG_START, **curve}
            for width in HYSTERESIS_STARTS
            for curve in ({}, CURVE_STARTS[0])
        ]
    return ({},)


FOLDS = 4  # chosen: every fourth operating point is held out together
LEVEL_TOLERANCE = 0.01  # share of the range of levels within which tests are at one operating point
STEPS = 40  # largest number of least-squares iterations from each start; chosen
REFIT_STEPS = 4  # iterations of the refit without a fold: the start and three damped steps
FIGURES = 2  # compared of each candidate: free run as it is, and with a gain for each test
WORSE_LEVEL = 0.05  # level of the tests that a candidate is worse in a figure, or misses a parameter; chosen
SAME_FIT = 1.001  # ratio of RMSE up to which two forms are the same; chosen
CLEAR_RATIO = 1.1  # of RMSE on held-out tests, that counts without significance from test to test; chosen
MIN_GAIN_TESTS = 6  # fewest held-out tests for comparing structures with a gain per test; chosen


@short_repr
@dataclass(frozen=True)
class Candidate:
    """One candidate structure with its fit and its cross-validation errors.

    Attributes:
        name: the option it adds to the candidate before it.
        spec: its model specification.
        values: its parameters at the optimum, shape [D].
        rmse: free-run RMSE over all identification tests with equal weights.
        rmse_per_test_gain: the same with a gain fitted to each test.
        observations: number of independent errors of either, shape [2]; see `independent_observations`.
        dead_zone: dead zone at which it was fitted, in the command's unit.
        held_out: free-run RMSE of each test whose operating point was held out in turn, shape [H].
        held_out_per_test_gain: the same with a gain fitted to each test, shape [H].
        fold: index of the fold that each of these tests was held out with, shape [H].
        chosen: whether it was chosen.
        base: name of the larger candidate of which it is a part; empty for one that adds something.
    """

    name: str
    spec: ModelSpec
    values: np.ndarray
    rmse: float
    rmse_per_test_gain: float
    observations: np.ndarray
    dead_zone: float
    held_out: np.ndarray
    held_out_per_test_gain: np.ndarray
    fold: np.ndarray
    chosen: bool = False
    base: str = ""

    @property
    def named_values(self) -> dict[str, float]:
        """Parameter name to value at the optimum."""
        names = [parameter.name for parameter in self.spec.parameters]
        return dict(zip(names, self.values.tolist(), strict=True))

    @property
    def held_out_rmse(self) -> float:
        """Free-run RMSE over operating points held out in turn, with equal weights of the tests."""
        return float(np.sqrt(np.mean(self.held_out**2)))

    @property
    def held_out_rmse_per_test_gain(self) -> float:
        """The same with a gain fitted to each test."""
        return float(np.sqrt(np.mean(self.held_out_per_test_gain**2)))

    def is_better(self, other: "Candidate", comparisons: int, tests: np.ndarray) -> bool:
        """Return whether it predicts held-out tests better than another candidate, and not by chance.

        In free run as it is, or, over six tests or more, with a gain fitted to each test: the unmeasured load
        of a test changes its speed from the first sample to the last and may hide what a form adds. By 2 %
        where that holds from test to test, see `better_on_held_out_tests`, or by 10 % where the fits prove
        it, see `proved_by_all_tests`. In the other figure it must not be significantly worse (5 %).
        """
        free_run = self.held_out[tests], other.held_out[tests]
        per_test_gain = self.held_out_per_test_gain[tests], other.held_out_per_test_gain[tests]
        counts = (bool(np.any(tests)), int(np.count_nonzero(tests)) >= MIN_GAIN_TESTS)
        is_proved_in = proved_by_all_tests(other, self, WORSE_LEVEL / comparisons)
        for figure, beside, is_proved, is_counted in zip(
            (free_run, per_test_gain), (per_test_gain, free_run), is_proved_in, counts, strict=True
        ):
            is_better = better_on_held_out_tests(*figure, comparisons=comparisons) or (
                is_proved and _growth(*figure) * CLEAR_RATIO < 1
            )
            if is_counted and is_better and not _significantly_worse(*beside):
                return True
        return False


def _growth(errors: np.ndarray, other_errors: np.ndarray) -> float:
    return float(np.sqrt(np.sum(errors**2) / max(float(np.sum(other_errors**2)), ERROR_FLOOR)))


def _fit_ratios(candidate: Candidate, other: Candidate) -> np.ndarray:
    """Return the ratios of the errors of two fits to all tests, in both figures."""
    errors = np.array([[each.rmse, each.rmse_per_test_gain] for each in (candidate, other)])
    return np.divide(*np.maximum(errors, ERROR_FLOOR))


def proved_by_all_tests(smaller: Candidate, larger: Candidate, level: float) -> np.ndarray:
    """Return in which figures all tests together prove a larger form, shape [2].

    N ln(J²/J₀²) > χ² of the parameters that it has more, N independent errors of the smaller form (Wilks
    1938, Annals of Mathematical Statistics 9, 60): exact in the figure that the fits minimise, a guide in the
    other. Few tests vary too much to show what samples prove.
    """
    more = len(larger.spec.parameters) - len(smaller.spec.parameters)
    ratios = _fit_ratios(smaller, larger)
    return (2 * smaller.observations * np.log(ratios) > chi2.ppf(1 - level, max(more, 1))) & (more > 0)


def _significantly_worse(errors: np.ndarray, other_errors: np.ndarray) -> bool:
    return log_ratio_p_value(other_errors, errors) < WORSE_LEVEL


@dataclass(frozen=True)
class Evaluation:
    """Optimum of a candidate, free and fixed positions in the unit cube, and its errors; see `Candidate`."""

    positions: np.ndarray
    rmse: float
    rmse_per_test_gain: float
    observations: np.ndarray
    held_out: np.ndarray
    held_out_per_test_gain: np.ndarray
    fold: np.ndarray

    def candidate(self, name: str, spec: ModelSpec, objective: Objective, free: Sequence[int]) -> Candidate:
        """Return the candidate; `free` are the indices of its parameters in the objective."""
        return Candidate(
            name=name,
            spec=spec,
            values=objective.values(self.positions)[list(free)],
            rmse=self.rmse,
            rmse_per_test_gain=self.rmse_per_test_gain,
            observations=self.observations,
            dead_zone=float(objective.batch.dead_zone[0]),
            held_out=self.held_out,
            held_out_per_test_gain=self.held_out_per_test_gain,
            fold=self.fold,
        )


def best_candidate(candidates: Sequence[Candidate], tests: np.ndarray | None = None) -> int:
    """Return the index of the best candidate: a later one replaces an earlier one where it is better.

    Each later candidate is compared with the best one before it in two figures; see `Candidate.is_better`.
    Significance is judged for all of these comparisons together: where none of the later candidates is better
    than the first, the probability that the choice leaves it is 10 % at most.
    The smallest comes first, all over the same held-out tests.
    """
    counted = np.ones(candidates[0].fold.size, bool) if tests is None else tests
    best = grown = 0
    comparisons = FIGURES * sum(not candidate.base for candidate in candidates[1:])
    for number, candidate in enumerate(candidates[1:], 1):
        if candidate.base:
            larger = (candidates[best], candidates[grown])
            if candidate.base == larger[0].name and not is_missed(candidate, larger, counted):
                best = number
        elif candidate.is_better(candidates[best], comparisons, counted):
            best = grown = number
    return best


def is_missed(smaller: Candidate, larger: Sequence[Candidate], tests: np.ndarray | None = None) -> bool:
    """Return whether what forms have more than a smaller one is missed, in free run or with a gain per test.

    It is where the fits prove the larger form (5 %), see `proved_by_all_tests`, or where the smaller one is
    worse on held-out tests, by 10 % or significantly (5 %) by 2 %. A form that fits as well to a thousandth
    is the same: its parameters had no effect, and moved held-out tests by chance.

    Args:
        smaller: the form that may do.
        larger: those it is a part of: the one before it, and that which the choice had grown.
        tests: which held-out tests count; None for all.
    """
    counted = np.ones(smaller.fold.size, bool) if tests is None else tests
    return any(_misses(smaller, other, counted) for other in larger)


def _misses(smaller: Candidate, other: Candidate, counted: np.ndarray) -> bool:
    if np.all(_fit_ratios(smaller, other) <= SAME_FIT):
        return False
    if np.any(proved_by_all_tests(smaller, other, WORSE_LEVEL)):
        return True
    figures = [(smaller.held_out[counted], other.held_out[counted])]
    if np.count_nonzero(counted) >= MIN_GAIN_TESTS:
        figures.append((smaller.held_out_per_test_gain[counted], other.held_out_per_test_gain[counted]))
    return any(
        _growth(*figure) > CLEAR_RATIO
        or (_growth(*figure) > MIN_IMPROVEMENT and _significantly_worse(*figure))
        for figure in figures
    )


def held_out_errors_of_choice(candidates: Sequence[Candidate]) -> np.ndarray:
    """Return the free-run RMSE of each held-out test by the candidate chosen without its fold, shape [H].

    The error of the chosen candidate is too small, for these tests chose it. Here the choice is repeated from
    the other folds' tests, and the candidate it takes, fitted without the fold, is judged on the fold (Varma
    & Simon 2006, BMC Bioinformatics 7, 91). Beside the fits to the other folds only the proof by all tests
    and the order in which parameters were tried have seen it.
    """
    fold = candidates[0].fold
    errors = np.empty(fold.size)
    for held_fold in np.unique(fold):
        is_held = fold == held_fold
        errors[is_held] = candidates[best_candidate(candidates, ~is_held)].held_out[is_held]
    return errors


def with_positions(positions: np.ndarray, names: Sequence[str], start: Mapping[str, float]) -> np.ndarray:
    """Return positions with those of the named parameters replaced."""
    changed = positions.copy()
    for name, value in start.items():
        changed[names.index(name)] = value
    return changed


def fit_and_evaluate(
    objective: Objective, free: Sequence[int], starts: Sequence[np.ndarray], folds: Sequence[np.ndarray]
) -> Evaluation:
    """Fit the free parameters from several starts, and cross-validate the best fit.

    Raises:
        FitError: none of the starts can be simulated.
    """
    best = refine_subset(objective, free, starts, STEPS)
    positions = starts[0].copy()
    positions[list(free)] = best.position
    return evaluate(objective, free, positions, folds)


def evaluate(
    objective: Objective, free: Sequence[int], positions: np.ndarray, folds: Sequence[np.ndarray]
) -> Evaluation:
    """Return the errors of a candidate on tests held out in turn.

    For each fold the candidate is refitted to the other tests by three damped steps from its optimum. This
    suffices for the parameters that the tests determine; the others stay near the fit to all tests, where a
    full least-squares run is ill-conditioned. The error is therefore slightly too small for large candidates.
    """
    pooled, per_test_gain = objective.pooled(), replace(objective, per_test_gain=True)
    observations = [figure.independent_observations(positions) for figure in (pooled, per_test_gain)]
    held_out, held_out_per_test_gain = [], []
    for held_tests in folds:
        training_objective = objective.over(~held_tests)
        refitted = positions.copy()
        refitted[list(free)] = refine_subset(training_objective, free, [positions], REFIT_STEPS).position
        held_out += list(pooled.rmse_by_test(refitted)[held_tests])
        held_out_per_test_gain += list(per_test_gain.rmse_by_test(refitted)[held_tests])
    fold = np.repeat(np.arange(len(folds)), [int(held_tests.sum()) for held_tests in folds])
    return Evaluation(
        positions,
        pooled.error(positions),
        per_test_gain.error(positions),
        np.array(observations),
        np.array(held_out),
        np.array(held_out_per_test_gain),
        fold,
    )


def evaluation_shapes(objective: Objective, folds: Sequence[np.ndarray]) -> Shapes:
    """Return the shapes of the arrays of an `Evaluation`."""
    held_out = (int(sum(held_tests.sum() for held_tests in folds)),)
    errors = dict.fromkeys(("held_out", "held_out_per_test_gain", "fold"), held_out)
    positions = Cube((len(objective.spec.parameters),))
    return {"positions": positions, "observations": (FIGURES,), **errors}


def operating_point_folds(batch: Batch, *, separate_tests: bool) -> list[np.ndarray]:
    """Return the folds of the cross-validation, boolean arrays of shape [T].

    A fold is every fourth operating point between the lowest and the highest level, so that neighbouring
    levels stay in the training set. Tests at one level share an operating point unless `separate_tests`.
    """
    command, loss_mask = np.abs(np.asarray(batch.command)), np.asarray(batch.loss_mask)
    active = loss_mask & (command > 0)
    levels = np.array(
        [row[mask].mean() if mask.any() else 0.0 for row, mask in zip(command, active, strict=True)]
    )
    point = operating_points(levels, separate_tests=separate_tests)
    last = int(point.max())
    fold = np.where((point > 0) & (point < last), (point - 1) % FOLDS, -1)
    return [fold == index for index in range(min(FOLDS, last - 1))]


def operating_points(levels: np.ndarray, *, separate_tests: bool) -> np.ndarray:
    """Return the index of the operating point of each test, in the order of the levels, shape [T].

    Levels are mean commands where a test is active; where tests at one level differ in another input, each is
    a point.
    """
    order = np.argsort(levels)
    is_new_point = separate_tests | (np.diff(levels[order]) > LEVEL_TOLERANCE * float(np.ptp(levels)))
    points = np.empty(levels.size, int)
    points[order] = np.concatenate([[0], np.cumsum(is_new_point)])
    return points
