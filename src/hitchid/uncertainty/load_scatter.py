"""Scatter of the speed between tests due to a load that nobody measures: a mixed-effects model."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular
from scipy.optimize import minimize, minimize_scalar, root_scalar
from scipy.stats import chi2, t

from hitchid._support.records import short_repr
from hitchid.errors import FitError
from hitchid.estimation import Objective
from hitchid.model.estimates import STANDSTILL, Interval, LoadOfTest, LoadScatter
from hitchid.uncertainty.scores import with_shifted_dead_zone

LEVEL = 0.95  # of the intervals
FEWEST_CONTRASTS = 2  # differences between tests; of fewer a scatter has no interval
FEWEST_SAMPLES = 4  # of a test: one more than offset, load and variance
MIN_TRAVEL = 1e-3  # of a test that moves, share of the longest travel; chosen
MAX_SAMPLES = 100  # of a test, evenly spaced; chosen: the slow errors decide
STEP = 1e-4  # of the unit cube, for central differences, whose error is of the order of its square; chosen
DEAD_ZONE_STEP = 1e-3  # share of the highest command; chosen
MIN_EIGENVALUE = 1e-6  # relative; the information below which a combination counts as unknown; chosen
MAX_SCATTER = 3.0  # largest ω, relative; chosen: far beyond any load
# Limits of the search, chosen: correlation time, samples and test lengths; white over slow variance.
SHORTEST, LONGEST, SPREAD = 0.5, 3.0, 1e-6
STARTS, START_RATIO = (0.03, 0.3), 0.1  # where it starts, chosen: test lengths; white over slow variance
SMALLEST, GRID = 0.01, 60  # ω times the largest sensitivity; values of ω tried first; chosen
TOLERANCE = 1e-9  # of ω
TINY = np.finfo(float).tiny  # smallest sum of squares divided, in the displacement's unit squared


@short_repr
class FreeRunErrors(NamedTuple):
    """Errors of the free runs, with what they are made of, at evenly spaced samples.

    Attributes:
        columns: constant, travel, error, and derivatives of the travel with respect to what is common to all
            tests, shape [T, M, 3 + D]; zero where samples do not count.
        counted: samples that count, the first ones of each test, shape [T, M].
        step_s: time between samples, s.
    """

    columns: Float[np.ndarray, "t m c"]
    counted: Bool[np.ndarray, "t m"]
    step_s: float


@short_repr
class Contrasts(NamedTuple):
    """Independent combinations of the errors that tell of the loads, c = D Wᵀ b + ε, ε ~ N(0, I).

    Attributes:
        values: c, shape [K].
        sensitivities: diagonal of D, shape [K]; none is zero.
        directions: W, orthonormal columns, shape [T, K].
    """

    values: Float[np.ndarray, " k"]
    sensitivities: Float[np.ndarray, " k"]
    directions: Float[np.ndarray, "t k"]

    def statistic(self, scatter: float) -> float:
        """Return Q(ω) = Σ c²/(1 + ω² d²), of χ² distribution with K degrees of freedom at the true ω."""
        return float(np.sum(self.values**2 / (1 + (scatter * self.sensitivities) ** 2)))

    def negative_log_likelihood(self, scatter: float) -> float:
        """Return half of Q(ω) + Σ log(1 + ω² d²), the restricted likelihood."""
        logarithms = np.log1p((scatter * self.sensitivities) ** 2)
        return 0.5 * (self.statistic(scatter) + float(np.sum(logarithms)))


def load_scatter(
    objective: Objective, position: np.ndarray, free: np.ndarray, names: Sequence[str]
) -> LoadScatter:
    """Return the scatter of the speed between tests with its interval, and each test's own speed.

    The error of test t is that of a linear mixed-effects model, the fit linearised::

        y − y_b = a + b ŷ − J δ + ε,   b ~ N(0, ω²),   cov ε = σ² exp(−|Δt|/τ) + r² [Δt = 0]

    with the benchmark's travel ŷ, an offset a of the test, derivatives J of the travel with respect to the
    parameters and the dead zone, which all tests share, and their errors δ. Because a and δ may be anything,
    nothing that the parameters took up of the loads counts: the likelihood is the restricted one (Patterson
    & Thompson 1971, Biometrika 58, 545). σ, τ and r are those of the errors within tests, for any b. The
    contrasts c of the tests are then independent, c_i ~ N(0, 1 + ω² d_i²). ω has the largest likelihood; its
    interval is that of Q(ω) = Σ c_i²/(1 + ω² d_i²) ~ χ²_K (Viechtbauer 2007, Statistics in Medicine 26, 37).
    The tests' own values are the best linear unbiased predictions, with quantiles of t_K (Henderson 1975,
    Biometrics 31, 423); the shrinkage is that of Savic & Karlsson 2009, AAPS Journal 11, 558.

    Args:
        objective: identification tests and form.
        position: the estimates in the unit cube, shape [D].
        free: mask of the parameters that were estimated, shape [D].
        names: of the tests, length T.

    Raises:
        FitError: no parameter was estimated, fewer than three tests move, or they do not differ in more than
            the parameters.
    """
    if not np.any(free):
        raise FitError("no parameter of the form was estimated; the load scatter requires one at least")
    # With one gain for all tests: a gain of each test's own would take up its load.
    errors = errors_of_tests(objective.pooled(), position, free)
    return scatter_of(contrasts_of(errors), names)


def scatter_of(contrasts: Contrasts, names: Sequence[str]) -> LoadScatter:
    """Return scatter, interval, shrinkage and each test's own value from independent contrasts.

    Raises:
        FitError: there are fewer than two contrasts, or a test would run backward.
    """
    values, sensitivities, directions = contrasts
    if values.size < FEWEST_CONTRASTS:
        raise FitError(
            f"the tests have {values.size} differences that the parameters do not explain; at least "
            f"{FEWEST_CONTRASTS} are required"
        )
    scatter = _most_likely(contrasts)
    precision = (scatter * sensitivities) ** 2 / (1 + (scatter * sensitivities) ** 2)
    predictions = directions @ (precision * values / sensitivities)
    slowest = int(np.argmin(predictions))
    if predictions[slowest] <= STANDSTILL:
        raise FitError(
            f"{names[slowest]}: the speed would differ from the model's by {100 * predictions[slowest]:.0f} "
            f"%, by a load that stops the piston it is {100 * STANDSTILL:.0f} %: the errors are no load's"
        )
    variances = scatter**2 * (1 - directions**2 @ precision)
    half_widths = t.ppf(0.5 + 0.5 * LEVEL, values.size) * np.sqrt(variances)
    # No load makes a piston run backward.
    lower, upper = np.maximum(predictions - half_widths, STANDSTILL), predictions + half_widths
    rows = zip(names, predictions.tolist(), zip(lower.tolist(), upper.tolist(), strict=True), strict=True)
    tests = tuple(LoadOfTest(*row) for row in rows)
    spread = np.sqrt(np.sum(predictions**2) / values.size)
    shrinkage = float(1 - spread / scatter) if scatter > 0 else 1.0
    return LoadScatter(scatter, _interval(contrasts), shrinkage, tests)


def errors_of_tests(objective: Objective, position: np.ndarray, free: np.ndarray) -> FreeRunErrors:
    """Return the errors of each test's free run, its travel, and the derivatives of the travel.

    Of a test without motion no sample counts.
    """
    batch = objective.batch
    steps = STEP * np.eye(position.size)[np.asarray(free, bool)]
    command_step = DEAD_ZONE_STEP * float(np.abs(np.asarray(batch.raw_command)).max())

    def travel_at(point: np.ndarray, shift: float = 0.0) -> np.ndarray:
        return with_shifted_dead_zone(objective, shift).travel(point)

    derivatives = [travel_at(position + step) - travel_at(position - step) for step in steps]
    derivatives.append(travel_at(position, command_step) - travel_at(position, -command_step))
    travel = travel_at(position)
    error = np.asarray(batch.travel) - travel
    # Of unit length, so that one limit of the eigenvalues is right for parameters of any unit.
    sizes = [float(np.linalg.norm(column)) or 1.0 for column in derivatives]
    scaled = [column / size for column, size in zip(derivatives, sizes, strict=True)]
    rows = np.stack([np.ones_like(travel), travel, error, *scaled], axis=2)
    distance = np.ptp(travel, axis=1)
    mask = np.asarray(batch.loss_mask)
    moves = (distance > MIN_TRAVEL * distance.max()) & (mask.sum(axis=1) >= FEWEST_SAMPLES)
    mask = mask & moves[:, None]
    # Every m-th sample: the slow errors decide, and the likelihood takes the cube of their number.
    stride = max(1, -(-int(mask.sum(axis=1).max()) // MAX_SAMPLES))
    indices = [np.flatnonzero(row)[::stride] for row in mask]
    count = max(map(len, indices))
    columns, counted = np.zeros((len(rows), count, rows.shape[2])), np.zeros((len(rows), count), bool)
    for test, index in enumerate(indices):
        columns[test, : index.size] = rows[test, index]
        counted[test, : index.size] = True
    return FreeRunErrors(columns, counted, stride * batch.step_s)


def contrasts_of(errors: FreeRunErrors) -> Contrasts:
    """Return the independent combinations of the errors that tell of the loads.

    Raises:
        FitError: no test moves.
    """
    if not errors.counted.any():
        raise FitError("the piston does not move in the identification tests")
    grams = _grams(errors, _error_correlation(errors))[0]
    # The offset of each test may be anything; then what the parameters took up of the loads goes, too.
    grams = _eliminated(grams, 1)[0]
    loads, shared, cross = grams[:, 0, 0], grams[:, 2:, 2:].sum(axis=0), grams[:, 0, 2:]
    inverse = np.linalg.pinv(shared, MIN_EIGENVALUE**2, hermitian=True)
    information = np.diag(loads) - cross @ inverse @ cross.T
    slopes = grams[:, 0, 1] - cross @ inverse @ grams[:, 1, 2:].sum(axis=0)
    eigenvalues, vectors = np.linalg.eigh(information)
    determined = eigenvalues > MIN_EIGENVALUE * loads.max()
    sensitivities = np.sqrt(eigenvalues[determined])
    return Contrasts(vectors[:, determined].T @ slopes / sensitivities, sensitivities, vectors[:, determined])


def _error_correlation(errors: FreeRunErrors) -> np.ndarray:
    """Return the covariance of the errors of consecutive samples, of largest restricted likelihood.

    The likelihood is that of the errors within tests: offset and load of each test may be anything.
    """
    count = errors.counted.shape[1]
    lags_s = errors.step_s * np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    tests = int(np.count_nonzero(errors.counted.any(axis=1)))
    within = _eliminated(_grams(errors, np.eye(count))[0], 2)[0].sum(axis=0)[1:, 1:]
    eigenvalues, vectors = np.linalg.eigh(within)
    basis = vectors[:, eigenvalues > MIN_EIGENVALUE]
    degrees = int(errors.counted.sum()) - 2 * tests - basis.shape[1]

    def correlation(logarithms: np.ndarray) -> np.ndarray:
        time_s, ratio = np.exp(logarithms)
        return np.exp(-lags_s / time_s) + ratio * np.eye(count)

    def profiled(logarithms: np.ndarray) -> tuple[float, float]:
        grams, determinant = _grams(errors, correlation(logarithms))
        grams, tests_determinant = _eliminated(grams, 2)
        total = grams.sum(axis=0)
        curvature, slope = basis.T @ total[1:, 1:] @ basis, basis.T @ total[1:, 0]
        squares = float(total[0, 0] - slope @ np.linalg.solve(curvature, slope))
        variance = max(squares, TINY) / degrees
        log_determinant = determinant + tests_determinant + float(np.linalg.slogdet(curvature)[1])
        return 0.5 * (log_determinant + degrees * np.log(variance)), variance

    times_s = np.log([SHORTEST * errors.step_s, LONGEST * count * errors.step_s])
    bounds = [tuple(times_s), tuple(np.log([SPREAD, 1 / SPREAD]))]
    starts = [np.log([share * count * errors.step_s, START_RATIO]) for share in STARTS]
    results = [
        minimize(lambda logarithms: profiled(logarithms)[0], start, method="L-BFGS-B", bounds=bounds)
        for start in starts
    ]
    best = min(results, key=lambda result: result.fun).x
    return profiled(best)[1] * correlation(best)


def _grams(errors: FreeRunErrors, covariance: np.ndarray) -> tuple[Float[np.ndarray, "t c c"], float]:
    """Return Xᵀ R⁻¹ X of each test's columns X, and the sum of log |R| over the tests."""
    factor = np.linalg.cholesky(covariance)
    tests, count, columns = errors.columns.shape
    stacked = errors.columns.transpose(1, 0, 2).reshape(count, -1)
    whitened = solve_triangular(factor, stacked, lower=True).reshape(count, tests, columns)
    # Samples that count are the first of a test: the rest of the factor is not theirs.
    whitened = np.where(errors.counted.T[..., None], whitened, 0.0)
    log_diagonal = np.log(np.diag(factor))
    return np.einsum("ntc,ntd->tcd", whitened, whitened), 2 * float(np.sum(errors.counted @ log_diagonal))


def _eliminated(grams: Float[np.ndarray, "t c c"], count: int) -> tuple[Float[np.ndarray, "t d d"], float]:
    """Return the matrices without the first columns, which each test fits; and Σ log |their block|."""
    counted = grams[:, 0, 0] > 0
    remaining = np.zeros((len(grams), grams.shape[1] - count, grams.shape[1] - count))
    block, cross = grams[counted, :count, :count], grams[counted, :count, count:]
    remaining[counted] = grams[counted, count:, count:] - cross.transpose(0, 2, 1) @ np.linalg.solve(
        block, cross
    )
    return remaining, float(np.sum(np.linalg.slogdet(block)[1]))


def _most_likely(contrasts: Contrasts) -> float:
    """Return ω of largest restricted likelihood, which may be 0."""
    # The likelihood is flat at 0, a function of ω²: a search that starts there stays, so a grid comes first.
    grid = np.concatenate([[0.0], np.geomspace(SMALLEST / contrasts.sensitivities.max(), MAX_SCATTER, GRID)])
    best = int(np.argmin([contrasts.negative_log_likelihood(scatter) for scatter in grid]))
    around = (float(grid[max(best - 1, 0)]), float(grid[min(best + 1, GRID)]))
    tolerance = {"xatol": TOLERANCE}
    result: Any = minimize_scalar(contrasts.negative_log_likelihood, bounds=around, options=tolerance)
    scatter = float(result.x)
    is_better = contrasts.negative_log_likelihood(scatter) < contrasts.negative_log_likelihood(0.0)
    return scatter if is_better else 0.0


def _interval(contrasts: Contrasts) -> Interval:
    """Return where Q(ω) lies between the quantiles of χ²_K, from 0 to the largest ω."""
    tails = (0.5 + 0.5 * LEVEL, 0.5 - 0.5 * LEVEL)
    lower, upper = (_crossing(contrasts, float(chi2.ppf(tail, contrasts.values.size))) for tail in tails)
    return lower, upper


def _crossing(contrasts: Contrasts, quantile: float) -> float | None:
    """Return ω at which Q(ω) falls below a quantile; 0 where it is always below, None where never."""
    # Q falls as ω grows, so it crosses a quantile once at most.
    if contrasts.statistic(0.0) <= quantile:
        return 0.0
    if contrasts.statistic(MAX_SCATTER) > quantile:
        return None
    return float(
        root_scalar(lambda scatter: contrasts.statistic(scatter) - quantile, bracket=(0.0, MAX_SCATTER)).root
    )
