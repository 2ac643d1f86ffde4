"""Test signals: ramps, maximum-length binary sequences, mixed duty cycles.

Every signal is an effective command; `precompensated` adds the dead zone found in the static test (Sun et al.
2025, sec. 2.3.1). Commands are held between samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import max_len_seq

from hitchid.errors import InputError
from hitchid.identification import from_ramps
from hitchid.logs import DIRECTIONS, LIFTING, Record

# Static test: dead zone and speed of a direction from slow ramps.

RAMP_TRAVEL_M = 0.02  # m, travel at which a ramp ends (chosen, as an operator would end it)
RAMP_TAIL_S = 1.0  # s, end of a ramp used for its speed (chosen)


@dataclass(frozen=True)
class StaticResult:
    """Result of the static test of one direction.

    Attributes:
        dead_zone: mean over the ramps, A.
        speed_per_command: speed at the end of the ramps over the effective command there, mm/(s·A).
    """

    dead_zone: float
    speed_per_command: float


def evaluate_ramps(ramps: Sequence[Record], direction: str, sign: int | None = None) -> StaticResult:
    """Return the result of one or more ramps of one direction, in mm and A (Sun et al. 2025, sec. 2.3.1).

    The sign is +1 where the displacement grows with the command; by default that of the direction.

    Raises:
        LogError: a ramp ends before the piston moves.
    """
    sign = sign or (1 if direction == LIFTING else -1)
    # The same estimate as in an identification: levels are then effective for the model, too.
    zone = from_ramps(ramps, direction, sign).value
    tail = slice(-round(RAMP_TAIL_S / ramps[0].step_s), None)
    speeds = [sign * np.polyfit(ramp.time_s[tail], ramp.displacement[tail], 1)[0] for ramp in ramps]
    # At the end of the ramps, where the notches are open: near the dead zone speed over command is smaller.
    effective = np.mean([ramp.command(direction)[tail].mean() - zone for ramp in ramps])
    return StaticResult(zone, float(np.mean(speeds) / effective))


def precompensated(command: np.ndarray, dead_zone: float) -> np.ndarray:
    """Return the command for an effective command u at dead zone d: c = u + d where u > 0, else 0."""
    return np.where(command > 0, command + dead_zone, 0.0)


def two_channel_command(direction: str, command: np.ndarray) -> np.ndarray:
    """Return the commands of a test of one direction, lifting and lowering, shape [N, 2]."""
    rows = np.zeros((len(command), len(DIRECTIONS)))
    rows[:, DIRECTIONS.index(direction)] = command
    return rows


def ramp(*, top: float, duration_s: float, step_s: float = 0.01) -> np.ndarray:
    """Return a slow rise from zero to `top`: the static test."""
    return np.linspace(0.0, top, _count(duration_s, step_s))


def prbs(
    *,
    low: float,
    high: float,
    clock_s: float,
    duration_s: float,
    seed: int,
    rest_s: float = 0.05,
    step_s: float = 0.01,
) -> np.ndarray:
    """Return a maximum-length pseudo-random binary sequence between two levels, after a short rest.

    The shift register is the shortest whose period 2ⁿ − 1 covers the test; the seed chooses its phase. A
    level is held for `clock_s` at least.

    Raises:
        InputError: not 0 ≤ low < high, or the test is shorter than a step.
    """
    if not 0 <= low < high:
        raise InputError(f"prbs: expected 0 ≤ low < high, got {low:g} and {high:g}")
    count, hold_samples = _count(duration_s, step_s), max(1, round(clock_s / step_s))
    rest = round(rest_s / step_s)
    clocks = -(-(count - rest) // hold_samples)
    # The shortest register that does not repeat itself within the test.
    bits = max(4, int(np.ceil(np.log2(clocks + 1))))
    state = np.random.default_rng(seed).integers(0, 2, bits)
    # A register of zeros would never leave them.
    state[0] |= not state.any()
    sequence = max_len_seq(bits, state=state, length=clocks)[0]
    levels = np.repeat(np.where(sequence > 0, high, low), hold_samples)
    return np.concatenate([np.zeros(rest), levels])[:count]


def duty_cycle(
    *,
    levels: tuple[tuple[float, float], tuple[float, float]],
    speeds: tuple[float, float],
    start: float,
    displacement_range: tuple[float, float],
    duration_s: float,
    seed: int,
    step_s: float = 0.01,
) -> np.ndarray:
    """Return random lift, hold and lower strokes within a range of displacement, shape [2, N].

    Levels are the lowest and highest effective command, lifting and lowering, speeds those per effective
    command, from which the travel of a stroke is predicted. The probability of a direction grows with the
    travel left in it.
    """
    rng = np.random.default_rng(seed)
    count = _count(duration_s, step_s)
    commands = np.zeros((2, count))
    (lowest, highest), height, sample = displacement_range, start, round(0.5 / step_s)
    while sample < count:
        # More often towards the farther end: the strokes do not drift to a stop.
        up = bool(rng.random() < (highest - height) / (highest - lowest))
        level = rng.uniform(*levels[0 if up else 1])
        speed = level * speeds[0 if up else 1]
        available = (highest - height) if up else (height - lowest)
        # Ended by what is left of the way, as far as its speed predicts it: not at a stop.
        hold_s = min(rng.uniform(1.0, 3.0), max(available, 0.0) / speed)
        stop = sample + round(hold_s / step_s)
        commands[0 if up else 1, sample:stop] = level
        height += (1 if up else -1) * speed * hold_s
        sample = stop + round(rng.uniform(0.2, 1.5) / step_s)
    return commands


def _count(duration_s: float, step_s: float) -> int:
    """Return the samples of a test, both ends included: 10 s at 0.01 s gives 1001."""
    if not (duration_s > 0 and step_s > 0 and duration_s >= step_s):
        raise InputError(
            f"excitation: expected a duration of at least one step, got {duration_s:g} s and {step_s:g} s"
        )
    return round(duration_s / step_s) + 1


# Commands of the tests of a campaign, drawn at random within given limits.

LOW = (0.03, 0.25)  # low level over the highest command, limits of a random draw (chosen)
HIGH = (0.5, 1.0)  # high level over the highest command, limits of a random draw (chosen)
CLOCK_S = (0.15, 0.4)  # s, shortest hold of a level, limits of a random draw (chosen)


def binary_command(
    highest: float, dead_zone: float, duration_s: float, rng: np.random.Generator, step_s: float = 0.01
) -> np.ndarray:
    """Return the command of one PRBS test, with levels up to an effective one and clock drawn, shape [N]."""
    effective = prbs(
        low=rng.uniform(*LOW) * highest,
        high=rng.uniform(*HIGH) * highest,
        clock_s=rng.uniform(*CLOCK_S),
        duration_s=duration_s,
        seed=int(rng.integers(2**31)),
        step_s=step_s,
    )
    return precompensated(effective, dead_zone)


def cycle_commands(
    static: Mapping[str, StaticResult],
    highest: Mapping[str, float],
    *,
    start_mm: float,
    displacement_range: tuple[float, float],
    duration_s: float,
    seed: int,
    step_s: float = 0.01,
) -> np.ndarray:
    """Return the commands of one mixed cycle within a range of displacement, mm, shape [N, 2].

    Each direction has its static test and its largest effective command; see `duty_cycle`.
    """
    lifting, lowering = (
        (LOW[1] * highest[direction], HIGH[1] * highest[direction]) for direction in DIRECTIONS
    )
    up, down = (static[direction].speed_per_command for direction in DIRECTIONS)
    pair = duty_cycle(
        levels=(lifting, lowering),
        speeds=(up, down),
        start=start_mm,
        displacement_range=displacement_range,
        duration_s=duration_s,
        seed=seed,
        step_s=step_s,
    )
    # Effective until here, so that strokes are predicted by one speed a direction.
    zones = [static[direction].dead_zone for direction in DIRECTIONS]
    return np.column_stack(list(map(precompensated, pair, zones)))
