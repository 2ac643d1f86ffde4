"""Operating points of the tests: command levels, loads, and speeds measured at constant command."""

import numpy as np
from jaxtyping import Float

from hitchid.model.characteristics import MeasuredSpeed
from hitchid.structures import Batch

LEVEL_TOLERANCE = 0.01  # changes of the command below this share of the largest are noise; all chosen
# Width of a level in tolerances, number of levels, share of the active samples in one level and in all.
MAX_LEVEL_WIDTH, MAX_LEVELS, MIN_LEVEL_SHARE, MIN_STEADY_SHARE = 3, 9, 0.02, 0.8
QUANTILES, GRID_LEVELS = (0.05, 0.95), 7  # of the evenly spaced levels: end quantiles, number
SETTLING_RESPONSE_TIMES, MIN_SAMPLES, MAX_STRETCHES = 3.0, 5, 100  # before a speed is taken; samples; speeds
MIDDLE_SHARE = 0.5  # middle part of the displacement range in which speeds are taken


def operating_levels(batch: Batch, opening: float) -> Float[np.ndarray, " l"]:
    """Return the command levels of the tests, ascending, shape [L].

    If at most 9 levels contain 80 % of the samples above `opening`, these; otherwise 7 evenly spaced levels
    from the 5 % to the 95 % quantile of those samples.

    Args:
        batch: identification tests.
        opening: command at which flow begins.
    """
    logged = np.abs(np.asarray(batch.raw_command))[np.asarray(batch.loss_mask)]
    active_commands = np.sort(logged[logged > opening])
    if not active_commands.size:
        return active_commands
    bins = np.round(active_commands / (LEVEL_TOLERANCE * active_commands[-1])).astype(int)
    groups = np.split(active_commands, np.flatnonzero(np.diff(bins) > 1) + 1)
    steady = [group for group in groups if group.size >= MIN_LEVEL_SHARE * active_commands.size]
    narrow = all(np.ptp(group) <= MAX_LEVEL_WIDTH * LEVEL_TOLERANCE * active_commands[-1] for group in steady)
    if (
        narrow
        and len(steady) <= MAX_LEVELS
        and sum(map(len, steady)) >= MIN_STEADY_SHARE * active_commands.size
    ):
        return np.array([np.median(group) for group in steady])
    slowest, fastest = np.quantile(active_commands, QUANTILES)
    return np.linspace(slowest, fastest, GRID_LEVELS)


def operating_loads(load: Float[np.ndarray, " t"]) -> Float[np.ndarray, " k"]:
    """Return mean and mean ± standard deviation of a covariate, clipped to its range, shape [K]."""
    mean, deviation = load.mean(), load.std()
    return np.unique(np.clip([mean - deviation, mean, mean + deviation], load.min(), load.max()))


def measured_speeds(
    batch: Batch, opening: float, response_time: float, load: Float[np.ndarray, " t"] | None
) -> tuple[MeasuredSpeed, ...]:
    """Return mean speeds around mid stroke at constant command, by command; the 100 longest stretches.

    A stretch begins three response times after the last change of its command, lies in the middle half of
    the displacement range and has at least five samples.

    Args:
        batch: identification tests.
        opening: command at which flow begins.
        response_time: of the speed, s.
        load: the covariate that the speed map is for, of each test; None without one.
    """
    loss_mask, displacement = np.asarray(batch.loss_mask), np.asarray(batch.displacement)
    logged = np.abs(np.asarray(batch.raw_command))
    travel = np.sign(np.asarray(batch.raw_command)) * np.asarray(batch.travel)
    low, high = displacement[loss_mask].min(), displacement[loss_mask].max()
    middle = np.abs(displacement - 0.5 * (low + high)) <= MIDDLE_SHARE * 0.5 * (high - low)
    settling_samples = int(np.ceil(SETTLING_RESPONSE_TIMES * response_time / batch.step_s)) + 1
    sized_speeds: list[tuple[int, MeasuredSpeed]] = []
    loads = [None] * len(logged) if load is None else load.tolist()
    for row, test_load in enumerate(loads):
        changed = np.abs(np.diff(logged[row])) > LEVEL_TOLERANCE * logged.max()
        for stretch in np.split(np.arange(logged.shape[1]), np.flatnonzero(changed) + 1):
            steady_samples = stretch[settling_samples:]
            steady_samples = steady_samples[(loss_mask & middle)[row, steady_samples]]
            command = float(np.median(logged[row, stretch]))
            if (
                steady_samples.size < MIN_SAMPLES
                or command <= opening
                or np.ptp(logged[row, steady_samples]) > 2 * LEVEL_TOLERANCE * command
            ):
                continue
            speed = np.polyfit(
                batch.step_s * (steady_samples - steady_samples[0]), travel[row, steady_samples], 1
            )[0]
            sized_speeds.append((steady_samples.size, MeasuredSpeed(command, test_load, float(speed))))
    longest = sorted(sized_speeds, key=lambda entry: -entry[0])[:MAX_STRETCHES]
    return tuple(sorted((speed for _, speed in longest), key=lambda entry: entry.command))
