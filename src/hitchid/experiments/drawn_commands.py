"""Commands of the tests of a campaign, drawn at random within given limits."""

from collections.abc import Mapping

import numpy as np

from hitchid.data.record import DIRECTIONS
from hitchid.experiments import excitation
from hitchid.experiments.static_test import StaticResult

LOW = (0.03, 0.25)  # low level over the highest command, limits of a random draw (chosen)
HIGH = (0.5, 1.0)  # high level over the highest command, limits of a random draw (chosen)
CLOCK_S = (0.15, 0.4)  # s, shortest hold of a level, limits of a random draw (chosen)


def binary_command(
    highest: float, dead_zone: float, duration_s: float, rng: np.random.Generator, step_s: float = 0.01
) -> np.ndarray:
    """Return the command of one PRBS test, with levels and clock drawn at random, shape [N].

    Args:
        highest: largest effective command.
        dead_zone: of the direction; it is added to every level.
        duration_s: length, s.
        rng: draws levels, clock and phase.
        step_s: sampling time, s.
    """
    signal = excitation.prbs(
        low=rng.uniform(*LOW) * highest,
        high=rng.uniform(*HIGH) * highest,
        clock_s=rng.uniform(*CLOCK_S),
        duration_s=duration_s,
        seed=int(rng.integers(2**31)),
        step_s=step_s,
    )
    return excitation.precompensated(signal.command, dead_zone)


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
    """Return the commands of one mixed cycle, lifting and lowering, shape [N, 2].

    Args:
        static: direction to the result of its static test.
        highest: direction to its largest effective command.
        start_mm: initial displacement, mm.
        displacement_range: lowest and highest displacement, mm.
        duration_s: length, s.
        seed: of directions, levels and times.
        step_s: sampling time, s.
    """
    lifting, lowering = (
        (LOW[1] * highest[direction], HIGH[1] * highest[direction]) for direction in DIRECTIONS
    )
    up, down = (static[direction].speed_per_command for direction in DIRECTIONS)
    pair = excitation.duty_cycle(
        levels=(lifting, lowering),
        speeds=(up, down),
        start=start_mm,
        displacement_range=displacement_range,
        duration_s=duration_s,
        seed=seed,
        step_s=step_s,
    )
    return np.column_stack(
        [
            excitation.precompensated(signal.command, static[direction].dead_zone)
            for direction, signal in zip(DIRECTIONS, pair, strict=True)
        ]
    )
