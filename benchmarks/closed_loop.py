"""Bias of a free-run fit to logs recorded under feedback: the tables of docs/closed_loop.md.

    python benchmarks/closed_loop.py [--campaigns 200] [--seed 0]

A plant of the class K/(s (τ s + 1)) is identified from campaigns of ten simulated tests by output error, the
method of phase 1, once recorded behind a proportional controller, once with commands that are independent of
the disturbances: those of the same controller in another draw of them.
"""

import argparse
import sys
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

STEP_S, DURATION_S, HOLD_S = 0.01, 12.0, 3.0  # s; a setpoint is held for HOLD_S
GAIN, LAG_S = 40.0, 0.08  # mm/(s·A) and s, about the lifting channel of the virtual bench
CONTROLLER = 0.05  # A/mm; bandwidth 2 rad/s
LARGEST_A = 1.0  # A; limit of the command
LAG_BOUNDS_S = (0.002, 0.5)  # s, of the estimate
STROKE_MM = 60.0  # setpoints are drawn over this range
TESTS = 10
ITERATIONS = 8  # of Newton's method for the instruments (chosen)
CORRELATION_S = 1.0  # s, of the coloured disturbance
SAMPLES = round(DURATION_S / STEP_S)
DECAY = float(np.exp(-STEP_S / LAG_S))


class Disturbance(NamedTuple):
    """Standard deviations of what disturbs a test: sensor, mm; speed, mm/s; gain between tests, fraction."""

    sensor_mm: float = 0.0
    speed_mm_s: float = 0.0
    gain: float = 0.0


# A speed disturbance s wanders by s √(2 CORRELATION_S t) in a time t: 4.5 s in ten seconds. The names tell
# which measured set has this error in free run, as a share of its range.
LEVELS = {
    "sensor 0.05 mm (rig-a)": Disturbance(0.05),
    "sensor 0.5 mm": Disturbance(0.5),
    "sensor 2 mm": Disturbance(2.0),
    "gain differs by 3 % between tests (rig-a, lowering)": Disturbance(0.05, 0.0, 0.03),
    "gain differs by 10 %": Disturbance(0.05, 0.0, 0.10),
    "coloured speed 0.05 mm/s (hanging-load)": Disturbance(0.05, 0.05),
    "coloured speed 0.2 mm/s (EMPS)": Disturbance(0.05, 0.2),
    "coloured speed 1 mm/s (field-excavator)": Disturbance(0.05, 1.0),
}


class Tests(NamedTuple):
    """Signals of a campaign, each of shape [TESTS, SAMPLES]: mm, A and mm."""

    setpoint: np.ndarray
    command: np.ndarray
    displacement: np.ndarray


def setpoints(rng: np.random.Generator) -> np.ndarray:
    """Return random steps of the setpoint, mm."""
    steps = rng.uniform(0, STROKE_MM, (TESTS, round(DURATION_S / HOLD_S)))
    return np.repeat(steps, round(HOLD_S / STEP_S), axis=1)


def record(
    rng: np.random.Generator, level: Disturbance, setpoint: np.ndarray, command: np.ndarray | None = None
) -> Tests:
    """Simulate the tests: under feedback, or with a given command."""
    noise = level.sensor_mm * rng.standard_normal((TESTS, SAMPLES))
    decay = np.exp(-STEP_S / CORRELATION_S)
    white = level.speed_mm_s * np.sqrt(1 - decay**2) * rng.standard_normal((TESTS, SAMPLES))
    speed = lfilter([1.0], [1.0, -decay], white)
    gain = GAIN * (1 + level.gain * rng.standard_normal(TESTS))
    position, valve = np.zeros(TESTS), np.zeros(TESTS)
    commands, displacements = np.zeros((TESTS, SAMPLES)), np.zeros((TESTS, SAMPLES))
    for k in range(SAMPLES):
        displacements[:, k] = position + noise[:, k]
        feedback = np.clip(CONTROLLER * (setpoint[:, k] - displacements[:, k]), -LARGEST_A, LARGEST_A)
        commands[:, k] = feedback if command is None else command[:, k]
        valve = DECAY * valve + (1 - DECAY) * commands[:, k]
        position = position + STEP_S * (gain * valve + speed[:, k])
    return Tests(setpoint, commands, displacements)


def unit_travel(command: np.ndarray, lag_s: float) -> np.ndarray:
    """Return the travel of the model with gain one for a command, mm."""
    decay = np.exp(-STEP_S / lag_s)
    valve = lfilter([1 - decay], [1.0, -decay], command)
    travel = STEP_S * np.cumsum(valve, axis=1)
    return np.concatenate([np.zeros((len(command), 1)), travel[:, :-1]], axis=1)


def fit(command: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return K and τ by output error, and their standard errors, robust with tests as clusters."""

    def residuals(theta: np.ndarray) -> np.ndarray:
        return (theta[0] * unit_travel(command, float(np.exp(theta[1]))) - displacement).ravel()

    start = np.array([GAIN, np.log(LAG_S)])
    bounds = [0.0, np.log(LAG_BOUNDS_S[0])], [10 * GAIN, np.log(LAG_BOUNDS_S[1])]
    result = least_squares(residuals, start, x_scale=[GAIN, 1.0], bounds=bounds)
    scores = (result.jac * result.fun[:, None]).reshape(len(command), -1, 2).sum(axis=1)
    inverse = np.linalg.pinv(result.jac.T @ result.jac)
    covariance = inverse @ (scores.T @ scores) @ inverse * TESTS / (TESTS - 1)
    lag = float(np.exp(result.x[1]))
    return np.array([result.x[0], lag]), np.sqrt(np.diag(covariance)) * [1.0, lag]


def instrumental(tests: Tests) -> np.ndarray:
    """Return K and τ by instrumental variables (Söderström and Stoica 1983), consistent under feedback.

    Zᵀ (y − ŷ) = 0, ŷ being simulated from the recorded command, Z the derivatives of ŷ for the command that
    the setpoint alone gives in the loop of the model: it is independent of disturbances and noise.
    """
    theta, _ = fit(tests.command, tests.displacement)
    instruments = _derivatives(_command_from_setpoint(tests.setpoint, theta), theta)
    for _ in range(ITERATIONS):
        residual = (tests.displacement - theta[0] * unit_travel(tests.command, theta[1])).ravel()
        moments = instruments.T @ _derivatives(tests.command, theta)
        theta = theta + np.linalg.solve(moments, instruments.T @ residual)
        theta[1] = np.clip(theta[1], *LAG_BOUNDS_S)
    return theta


def _derivatives(command: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return the derivatives of the model's travel by K and τ, shape [TESTS · SAMPLES, 2]."""
    gain, lag_s = theta
    by_lag = gain * (unit_travel(command, 1.01 * lag_s) - unit_travel(command, 0.99 * lag_s)) / (0.02 * lag_s)
    return np.column_stack([unit_travel(command, lag_s).ravel(), by_lag.ravel()])


def _command_from_setpoint(setpoint: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return the command of the loop of a model without disturbance, A."""
    gain, lag_s = theta
    decay, position, valve = np.exp(-STEP_S / lag_s), np.zeros(TESTS), np.zeros(TESTS)
    commands = np.zeros_like(setpoint)
    for k in range(SAMPLES):
        commands[:, k] = np.clip(CONTROLLER * (setpoint[:, k] - position), -LARGEST_A, LARGEST_A)
        valve = decay * valve + (1 - decay) * commands[:, k]
        position = position + STEP_S * gain * valve
    return commands


def trial(rng: np.random.Generator, level: Disturbance) -> np.ndarray:
    """Return K and τ, shape [4, 2]: open loop, feedback, feedback by instruments, standard errors."""
    setpoint = setpoints(rng)
    closed = record(rng, level, setpoint)
    other = record(rng, level, setpoint)
    opened = record(rng, level, setpoint, other.command)
    closed_estimate, error = fit(closed.command, closed.displacement)
    open_estimate, _ = fit(opened.command, opened.displacement)
    return np.array([open_estimate, closed_estimate, instrumental(closed), error])


def row(name: str, level: Disturbance, campaigns: int, seed: int) -> list[str]:
    """Return one line of the table: bias of each estimate in percent, ± its standard error over campaigns."""
    truth = np.array([GAIN, LAG_S])
    values = np.array([trial(np.random.default_rng([seed, n]), level) for n in range(campaigns)])
    relative = 100 * (values[:, :3] / truth - 1)
    bias = relative.mean(axis=0)
    error = relative.std(axis=0, ddof=1) / np.sqrt(campaigns)
    reported = 100 * np.median(values[:, 3] / truth, axis=0)
    cells = [f"{bias[kind, p]:+.2f} ± {error[kind, p]:.2f}" for p in range(2) for kind in range(3)]
    return [name, *cells[:3], f"{reported[0]:.2f}", *cells[3:], f"{reported[1]:.2f}"]


def main() -> None:
    """Print the bias of gain and lag for each disturbance."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    header = ["disturbance"]
    for parameter in ("K", "τ"):
        header += [
            f"{parameter}: {kind} / %" for kind in ("open loop", "feedback", "instruments", "std. error")
        ]
    _print(header)
    _print(["---", *["---:"] * 8])
    for name, level in LEVELS.items():
        _print(row(name, level, arguments.campaigns, arguments.seed))


def _print(cells: list[str]) -> None:
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
