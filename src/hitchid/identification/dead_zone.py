"""Dead zone of the command, from slow ramps or, without them, from dynamic tests."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize_scalar, nnls
from scipy.signal import lfilter

from hitchid._support.records import short_repr
from hitchid.errors import FitError, LogError
from hitchid.estimation import Objective, refine_subset
from hitchid.identification.candidates import MIDDLE, SECOND_ORDER_STARTS
from hitchid.logs.kinds import ACTIVE_FRACTION, effective_command
from hitchid.logs.record import Record
from hitchid.model import Quantity, make_quantity
from hitchid.structures import Batch, ModelSpec, structure_named
from hitchid.uncertainty import NO_ERROR, DeadZoneError
from hitchid.uncertainty.scores import t_quantile

CANDIDATES = 400  # grid points of the dead zone, 0.25 % of the largest command apart; chosen
LARGEST_SHARE = 0.95  # largest dead zone of tests, share of the largest command; chosen
FLAT_TOLERANCE = 1e-3  # share of the largest residual sum by which dead zones must differ; chosen
ROUNDING = 1e-6  # share of the travel's energy below which residual sums are rounding errors
MIN_RESIDUAL_REDUCTION = 0.2  # share of the drift's residual norm that motion must explain; chosen
UNKNOWN_SPREAD = 0.5  # standard error of an undetermined dead zone, share of the largest command; chosen
MIN_GROUPS, MAX_GROUPS = 6, 24  # number of jackknife groups; chosen
SAMPLES, MAX_ELEMENTS = 2048, 1_000_000  # of a test; elements of an array: limits of the memory
# Lags, s, at sampling times up to FAST_STEP_S, s; at longer ones multiplied by `slow_clock_factor`. Chosen to
# cover the lags of hydraulics.
LAGS_S, FAST_STEP_S = (0.03, 0.1, 0.3, 1.0), 0.1
# With which a dead zone of tests is found again, and where their dead time starts between its bounds.
DYNAMICS, DEAD_TIME_STARTS = ModelSpec(structure_named("integrator-second-order"), dead_time=True), (0.1, 0.6)
# Shares of the largest command: distances from the first dead zone at which it is looked for, and how finely
# between them; positions of the dynamics that are tried with the first one, and with each other one. Chosen.
SHARES, SEARCH_TOLERANCE = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25), 2e-4
FIRST_STEPS, STEPS = 40, 10
CLEAR_RATIO = 2.0  # by which another dead zone must reduce the error to be taken; chosen


@short_repr
@dataclass(frozen=True)
class DeadZone:
    """Dead zone of one command.

    Attributes:
        value: dead zone, in the command's unit.
        spread: standard deviation over repeated ramps, or the standard error over dynamic tests (the
            jackknife's, or what other dynamics move it by), in the command's unit; None where it is not
            available.
        count: number of ramps or tests.
        origin: `ramps`, `tests`, `given` or `none` (not determined by the data, taken as zero).
        delay_rise: rise of the ramps' command during the delay of the plant, in the command's unit.
    """

    value: float
    spread: float | None
    count: int
    origin: str
    delay_rise: float = 0.0

    @property
    def error(self) -> DeadZoneError:
        """Standard error: of the mean over ramps combined with their delay, or over dynamic tests."""
        if self.spread is None and not self.delay_rise:
            return NO_ERROR
        spread = self.spread or 0.0
        mean = spread / np.sqrt(self.count) if self.origin == "ramps" else spread
        return DeadZoneError(float(np.hypot(mean, self.delay_rise)), self.count)

    def to_quantity(self, unit: str) -> Quantity:
        """Return the dead zone with its 95 % interval, open where no standard error is available."""
        if self.origin == "given":
            return make_quantity("dead zone", unit, self.value, (self.value, self.value), 0.0)
        if not self.error.standard_error and self.spread is None:
            return make_quantity("dead zone", unit, self.value, (None, None), 0.0)
        half_width = t_quantile(float(self.error.degrees_of_freedom)) * self.error.standard_error
        interval = max(0.0, self.value - half_width), self.value + half_width
        return make_quantity("dead zone", unit, self.value, interval, 0.0)


def from_ramps(ramps: Sequence[Record], direction: str, sign: int) -> DeadZone:
    """Return the dead zone as mean and spread of the onsets of motion in slow ramps.

    Sun et al. 2025, sec. 2.3.1: one ramp from zero, repeated three times.

    Raises:
        LogError: a ramp ends before the piston moves.
    """
    return from_onsets([ramp_onset(record, direction, sign) for record in ramps])


def from_onsets(onsets: Sequence[float], delay_rise: float = 0.0) -> DeadZone:
    """Return the dead zone as mean and spread of onsets, in the command's unit."""
    values = np.array(onsets)
    spread = float(values.std(ddof=1)) if values.size > 1 else None
    return DeadZone(float(values.mean()), spread, values.size, "ramps", delay_rise)


def ramp_onset(record: Record, direction: str, sign: int) -> float:
    """Return the command d at the onset of motion in a ramp, by a least-squares fit of drift and motion.

    x(t) = x₀ + c t + Σ bₙ wⁿ, n = 2, 2.5, 3, w = max(u(t) − d, 0), b ≥ 0. A threshold on displacement would
    be biased: low with leakage before the valve opens, high where the speed of an opening valve grows from
    zero.

    Raises:
        LogError: the ramp ends before the piston moves.
    """
    command = record.command(direction)
    slope, offset, stop = _fit_ramp_line(record, direction)
    time_s = record.step_s * np.arange(stop)
    ramp = slope * time_s + offset
    travel = sign * (record.displacement[:stop] - record.displacement[0])

    drift, _ = np.linalg.qr(np.column_stack([np.ones(stop), time_s]))

    def without_drift(columns: np.ndarray) -> np.ndarray:
        return columns - drift @ (drift.T @ columns)

    target = without_drift(travel)
    # Below the part of the ramp that a line was laid through, too: a valve may have no dead zone.
    lowest = ramp.max() * ACTIVE_FRACTION
    step = (ramp.max() - lowest) / CANDIDATES
    candidates = lowest + step * np.arange(-int(lowest / step), CANDIDATES)

    def residual_norm(dead_zone: float) -> float:
        excess = np.maximum(ramp - dead_zone, 0.0) / ramp.max()
        return float(nnls(without_drift(np.column_stack([excess**2, excess**2.5, excess**3])), target)[1])

    residual_norms = np.array([residual_norm(candidate) for candidate in candidates])
    if residual_norms.min() >= (1 - MIN_RESIDUAL_REDUCTION) * float(np.linalg.norm(target)):
        raise LogError(
            record.source or record.name,
            f"the ramp reaches {command.max():.4g} {record.units[f'{direction}_command']} and the piston "
            "does not move; expected a ramp that continues until it moves",
        )
    return _parabola_minimum(candidates, residual_norms**2)


def ramp_rate(record: Record, direction: str) -> float:
    """Return the slope of a ramp's command, in its unit per second."""
    return _fit_ramp_line(record, direction)[0]


def _fit_ramp_line(record: Record, direction: str) -> tuple[float, float, int]:
    """Return slope and offset of the line through a ramp's command, and the number of its samples."""
    command = record.command(direction)
    stop = int(np.argmax(command)) + 1
    active = np.flatnonzero(command[:stop] > ACTIVE_FRACTION * command.max())
    slope, offset = np.polyfit(record.step_s * active, command[active], 1)
    return float(slope), float(offset), stop


def response_delay(
    tests: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], dead_zone: float, step_s: float
) -> float:
    """Return the response delay of dynamic tests, s.

    The median of the lags of `from_tests`, weighted by their gains at a given dead zone; half of the shortest
    where that is none, for the tests do not distinguish a shorter one.
    """
    products = [_normal_equations(*test, np.array([dead_zone]), step_s, 1) for test in tests]
    ((gains, _),) = _gains(np.concatenate(products).sum(axis=0))
    if not gains.any():
        return 0.0
    share = np.cumsum(gains) / gains.sum()
    lags_s = _lags_s(step_s)
    return (0.5 * lags_s[0], *lags_s)[int(np.searchsorted(share, 0.5))]


def from_tests(tests: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], step_s: float) -> DeadZone:
    """Return the dead zone with which integrators with lags fit dynamic tests best.

    w = Σ gᵢ ∫ uᵢ dt, where uᵢ is u = sign(c)·max(|c| − d, 0) filtered by a lag of 0, 0.03, 0.1, 0.3 and 1 s
    (scaled by `slow_clock_factor`). For each candidate d the gains gᵢ ≥ 0 follow by least squares over all
    tests; their sum approximates any short lag or dead time. The standard error is the jackknife's over at
    most 24 groups of tests, of fewer than six tests over their stretches. Where the jackknife gives zero, as
    at the ends of the grid, it is the distance within which the groups' fit worsens by no more than its
    standard error.

    Returns:
        The dead zone. Where all candidates fit the tests equally well, as with one constant command: zero,
        with origin `none` and half of the largest command as spread.
    """
    largest = max(float(np.abs(command).max()) for command, _, _ in tests)
    candidates = np.linspace(0.0, LARGEST_SHARE * largest, CANDIDATES)
    stretches = -(-MIN_GROUPS // len(tests))
    normal = np.concatenate([_normal_equations(*test, candidates, step_s, stretches) for test in tests])
    total = normal.sum(axis=0)
    residual_sums, energy = _residual_sums(total), float(total[0, -1, -1])
    flat = FLAT_TOLERANCE * max(residual_sums.max(), ROUNDING * energy)
    if residual_sums.max() - residual_sums.min() <= flat:
        return DeadZone(0.0, UNKNOWN_SPREAD * largest, len(tests), "none")
    best = _parabola_minimum(candidates, residual_sums)
    groups = np.array_split(normal, min(MAX_GROUPS, len(normal)))
    sums = np.stack([group.sum(axis=0) for group in groups])
    left_out = np.array([_parabola_minimum(candidates, _residual_sums(total - row)) for row in sums])
    error = np.sqrt((len(groups) - 1) / len(groups) * np.sum((left_out - left_out.mean()) ** 2))
    if not error:
        error = _half_width_without_jackknife(candidates, sums)
    return DeadZone(best, float(error), len(tests), "tests")


def with_dynamics(dead_zone: DeadZone, tests: Batch) -> DeadZone:
    """Return a dead zone of dynamic tests after it was found again with a second-order lag and a dead time.

    d = argmin min_θ J(θ, d), J the free-run error of `find_parameters`, up to a quarter of the largest
    command from the first one. The lags of `from_tests` are few and fixed: a plant that they do not describe
    seems to open too late or too early, by more than the jackknife shows. Where this halves J, it is taken,
    with the standard error of the first; otherwise, and at the edge of the search, the difference counts as
    standard error. A valve curve moves both alike: its effect is in neither.
    """
    if dead_zone.origin != "tests":
        return dead_zone
    first, names = dead_zone.value, [parameter.name for parameter in DYNAMICS.parameters]
    largest = float(np.abs(np.asarray(tests.raw_command)).max())
    starts = [
        np.array([{**lags, "dead_time": dead_time}.get(name, MIDDLE) for name in names])
        for lags, dead_time in product(SECOND_ORDER_STARTS, DEAD_TIME_STARTS)
    ]
    try:
        objective, free = Objective.of(tests.with_dead_zone(first).coarse(), DYNAMICS), range(len(names))
        fits = {first: refine_subset(objective, free, starts, FIRST_STEPS)}

        def error(value: float) -> float:
            # First the dead zone, then the coarse clock: the mean of what is beyond it is not the mean's.
            objective_there = objective.with_data(tests.with_dead_zone(value).coarse())
            best = min(fits.values(), key=lambda fit: fit.fitness)
            fit = refine_subset(objective_there, free, [best.position], STEPS)
            fits[value] = min(fit, fits.get(value, fit), key=lambda fit: fit.fitness)
            return fits[value].fitness

        # From the first one outwards, each from the best dynamics so far: there may be more minima than one.
        distances = largest * np.array([*SHARES, *np.negative(SHARES)])
        grid = np.unique(np.clip(first + distances, 0.0, LARGEST_SHARE * largest)).tolist()
        for value in sorted(set(grid) - set(fits), key=lambda value: abs(value - first)):
            error(value)
        lowest = grid.index(min(grid, key=lambda value: fits[value].fitness))
        ends = grid[max(lowest - 1, 0)], grid[min(lowest + 1, len(grid) - 1)]
        minimize_scalar(error, bounds=ends, options={"xatol": SEARCH_TOLERANCE * largest})
        # The first one had none to start from: no dead zone is better for its better start.
        error(first)
    except FitError:
        return dead_zone
    best = float(min(fits, key=lambda value: fits[value].fitness))
    is_clear = fits[first].fitness >= CLEAR_RATIO * fits[best].fitness
    is_at_edge = lowest == len(grid) - 1 or (lowest == 0 and grid[0] > 0)
    if is_clear and not is_at_edge:
        return replace(dead_zone, value=best)
    spread = max(dead_zone.spread or 0.0, abs(best - first))
    return replace(dead_zone, value=best if is_clear else first, spread=spread)


def _half_width_without_jackknife(candidates: np.ndarray, groups: np.ndarray) -> float:
    """Return how far from the best dead zone the fit worsens by its standard error at most."""
    squares = []
    for number, (gains, _) in enumerate(_gains(groups.sum(axis=0))):
        weights = np.append(gains, -1.0)
        squares.append(np.einsum("i,gij,j->g", weights, groups[:, number], weights))
    lowest = int(np.argmin(np.sum(squares, axis=1)))
    increase = np.array(squares) - squares[lowest]
    spread = increase.std(axis=1, ddof=1) / np.sqrt(len(groups))
    allowed = candidates[increase.mean(axis=1) <= spread]
    # Plus one grid step: the border lies between two candidates.
    return float(np.max(np.abs(allowed - candidates[lowest])) + candidates[1] - candidates[0])


def _normal_equations(
    command: np.ndarray,
    travel: np.ndarray,
    loss_mask: np.ndarray,
    dead_zones: np.ndarray,
    step_s: float,
    stretches: int,
) -> np.ndarray:
    """Return Σ of products of [∫u₁ … ∫u₅, w] over stretches of a test, by dead zone, shape [S, C, 6, 6]."""
    samples = np.flatnonzero(loss_mask)[:: -(-loss_mask.size // SAMPLES)]
    chunk_size = max(1, MAX_ELEMENTS // command.size)
    blocks = [
        _rows(command, travel, dead_zones[start : start + chunk_size], step_s, samples)
        for start in range(0, dead_zones.size, chunk_size)
    ]
    rows = np.concatenate(blocks)
    return np.stack([chunk @ chunk.transpose(0, 2, 1) for chunk in np.array_split(rows, stretches, axis=2)])


def _rows(
    command: np.ndarray, travel: np.ndarray, dead_zones: np.ndarray, step_s: float, samples: np.ndarray
) -> np.ndarray:
    """Return [∫u₁ … ∫u₅, w] at some samples, by dead zone, shape [C, 6, S]."""
    effective = effective_command(command[None, :], dead_zones[:, None])
    integral = step_s * (np.cumsum(effective, axis=1) - effective)
    rows = np.empty((dead_zones.size, 2 + len(LAGS_S), samples.size))
    rows[:, 0], rows[:, -1] = integral[:, samples], travel[samples]
    for column, lag in enumerate(_lags_s(step_s), start=1):
        pole = np.exp(-step_s / lag)
        rows[:, column] = np.asarray(lfilter([1 - pole], [1, -pole], integral))[:, samples]
    return rows


def _residual_sums(products: np.ndarray) -> np.ndarray:
    """Return the residual sum of squares of each candidate, shape [C]."""
    return np.array([residual_norm**2 for _, residual_norm in _gains(products)])


def _gains(products: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Return the non-negative least-squares gains and the residual norm of each candidate."""
    # A square root of the normal equations replaces the rows: same gains, same norm.
    values, vectors = np.linalg.eigh(products)
    roots = np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.transpose(0, 2, 1)
    return [nnls(root[:, :-1], root[:, -1]) for root in roots]


def _lags_s(step_s: float) -> list[float]:
    """Return the lags for a sampling time, s."""
    return [lag * slow_clock_factor(step_s) for lag in LAGS_S]


def slow_clock_factor(step_s: float) -> float:
    """Return the factor on lags at sampling times above 0.1 s; 1 below."""
    return max(1.0, step_s / FAST_STEP_S)


def _parabola_minimum(candidates: np.ndarray, residual_sums: np.ndarray) -> float:
    """Return the minimum by a parabola through the lowest candidate and its two neighbours."""
    lowest = int(np.argmin(residual_sums))
    if lowest in (0, candidates.size - 1):
        return float(candidates[lowest])
    left, middle, right = residual_sums[lowest - 1 : lowest + 2]
    curvature = left - 2 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature > 0 else 0.0
    return float(candidates[lowest] + shift * (candidates[1] - candidates[0]))
