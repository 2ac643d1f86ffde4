"""Check of the command for feedback: whether it follows from the measured displacement."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from hitchid._support.records import Severity, short_repr
from hitchid.logs.audit.context import CampaignContext, Findings
from hitchid.logs.record import COMMAND, IDLE, LIFTING, LOWERING, RAMP, Record

ORDER = 10  # samples; past values of each signal in a regression (chosen)
LAGS = ((0, 0), (1, 1), (2, 3), (4, 7))  # samples from displacement to command, shorter than holds of a PRBS
SHORTEST = 300  # samples of a test; a regression has 2 ORDER coefficients (chosen)
RANK_TOLERANCE = (
    1e-9  # of the largest eigenvalue; smaller ones are collinear signals, as rounding leaves them
)
FIRST_POSITIVE = 2  # samples; earlier, a positive correlation is a command logged a sample late
LEAST_CHANGED = 0.12  # of samples; switched commands change in 0.1 and less, controllers in more (chosen)
CLUSTERS = 16  # least number of tests, or parts of tests, for the standard error (chosen)
SIGNIFICANCE = 0.01  # level of the test, all groups of lags together (chosen)
LEAST_OPPOSED = 0.02  # correlation against the displacement that counts (chosen)
LEAST_POSITIVE = 0.05  # positive correlation that counts; open-loop measured logs reach 0.015
MAX_SAMPLES = 2**15  # of one record, to limit computing time (chosen)
ADVICE = (
    "log the setpoint too, and excite it or add a test signal to the command; free-run fits are biased by "
    "less than their standard errors where disturbances are small (page 'Logs recorded under feedback')"
)


@short_repr
class Feedback(NamedTuple):
    """Evidence that the command follows from the displacement.

    Attributes:
        correlation: rank correlation of the displacement's one-step error with the command's later change.
        lag_samples: first and last lag of the group with the smallest p-value.
        p_value: times the number of groups.
        tests: number of tests.
    """

    correlation: float
    lag_samples: tuple[int, int]
    p_value: float
    tests: int

    @property
    def sentence(self) -> str:
        """The evidence in words."""
        first, last = self.lag_samples
        span = f"{first}" if first == last else f"{first} to {last}"
        lag = f"{span} samples later" if last else "at the same sample"
        p_value = "below 0.001" if self.p_value < 0.001 else f"{self.p_value:.3f}"
        return (
            f"the command depends on past displacement: its changes {lag} correlate with the unpredicted "
            f"part of the displacement ({self.correlation:.2f}, p {p_value}). A controller or an operator "
            "acted on the measurement, so the command is correlated with disturbances and noise"
        )


def feedback(context: CampaignContext) -> Findings:
    """Find logs recorded under feedback, in which the command depends on past displacement: a warning."""
    evidence = feedback_of(context.campaign.records)
    if evidence is not None:
        role = COMMAND[context.directions[0]]
        yield context.finding("feedback", Severity.WARNING, evidence.sentence, ADVICE, signal=role)


def feedback_of(records: Iterable[Record]) -> Feedback | None:
    """Return the evidence of feedback in records; None where there is none.

    In open loop the command is independent of disturbances and noise, so the displacement's innovation, the
    residual of Δy regressed on its own and the command's past, does not correlate with later changes of the
    command, nor with the innovation of those given the command's own past (no causality after Granger 1969,
    cross-correlation of innovations after Haugh 1976 and Pierce & Haugh 1977). Both are replaced by their
    ranks. Correlations of four groups of lags, 0 to 7 samples, are averaged over tests, or parts of tests
    where there are few; their standard error is that over these clusters. A group counts if significant at
    1 % divided by four, two-sided, with a correlation below −0.02, or above 0.05 from two samples on
    (the sign of a derivative action). Ramps are left out, and tests whose command is held in over 88 % of the
    samples: it is switched, with or without feedback, and the residual of a linear regression differs from
    level to level.
    """
    pairs = [pair for record in records if (pair := _innovations(record)) is not None]
    if not pairs:
        return None
    # A standard error over few tests is hardly one: tests are then cut into parts.
    parts = -(-CLUSTERS // len(pairs))
    rows = np.concatenate([_correlations(*pair, parts) for pair in pairs])
    mean, error = rows.mean(axis=0), rows.std(axis=0, ddof=1) / np.sqrt(len(rows))
    ratio = np.abs(mean) / np.maximum(error, np.finfo(float).tiny)
    p_values = len(LAGS) * 2 * stdtr(len(rows) - 1, -ratio)
    late = np.array([first >= FIRST_POSITIVE for first, _ in LAGS])
    counts = (p_values < SIGNIFICANCE) & ((mean < -LEAST_OPPOSED) | (late & (mean > LEAST_POSITIVE)))
    if not counts.any():
        return None
    group = int(np.argmin(np.where(counts, p_values, np.inf)))
    return Feedback(float(mean[group]), LAGS[group], float(p_values[group]), len(pairs))


def _innovations(record: Record) -> tuple[np.ndarray, np.ndarray] | None:
    """Return normalised ranks of the innovations of command and displacement; None without evidence."""
    if record.kind in (RAMP, IDLE) or len(record) < SHORTEST:
        return None
    command = np.zeros(len(record))
    for direction, sign in ((LIFTING, 1.0), (LOWERING, -1.0)):
        if direction in record.directions:
            command += sign * record.command(direction)
    window = slice(0, MAX_SAMPLES)
    # Changes: position and a held command are as good as random walks, which always correlate.
    command_change, change = np.diff(command[window]), np.diff(record.displacement[window])
    if np.count_nonzero(command_change) < LEAST_CHANGED * command_change.size:
        return None
    constant = np.ones(change.size)
    past_commands = [constant, command[window][:-1], *_past(command_change)]
    command_innovation = _residual(command_change, past_commands)
    command_innovation[command_change[ORDER:] == 0] = 0.0  # a held command is not an answer to anything
    ranks = _ranks(command_innovation), _ranks(_residual(change, [*past_commands, *_past(change)]))
    return ranks if all(np.all(np.isfinite(part)) and part.any() for part in ranks) else None


def _past(values: np.ndarray) -> list[np.ndarray]:
    return [np.concatenate([np.zeros(lag), values[:-lag]]) for lag in range(1, ORDER + 1)]


def _residual(values: np.ndarray, regressors: list[np.ndarray]) -> np.ndarray:
    """Return the residual of a linear regression, without the first samples, whose past is unknown."""
    columns = np.array(regressors)[:, ORDER:]
    columns /= np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), np.finfo(float).tiny)
    # The normal equations cost a tenth of a decomposition of the columns.
    moments = columns @ columns.T, columns @ values[ORDER:]
    coefficients, *_ = np.linalg.lstsq(*moments, rcond=RANK_TOLERANCE)
    return values[ORDER:] - coefficients @ columns


def _ranks(values: np.ndarray) -> np.ndarray:
    """Return ranks with mean zero and variance one; zeros where all values are equal."""
    _, positions, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - 0.5 * (counts - 1))[positions]
    ranks -= ranks.mean()
    return ranks / np.maximum(ranks.std(), np.finfo(float).tiny)


def _correlations(command: np.ndarray, displacement: np.ndarray, parts: int) -> np.ndarray:
    """Return the mean correlation in each group of lags, of each part of a test, shape [parts, groups]."""
    count = command.size
    products = [
        np.pad(command[lag:] * displacement[: count - lag], (lag, 0)) for lag in range(LAGS[-1][1] + 1)
    ]
    groups = np.array([np.mean(products[first : last + 1], axis=0) for first, last in LAGS])
    return np.array([part.mean(axis=1) for part in np.array_split(groups, parts, axis=1)])
