"""Where tests were: levels of the command, loads, and the speeds measured while the command stood."""

import numpy as np
from jaxtyping import Float

from hitchid.structures import Batch
from hitchid.uncertainty.characteristics import MeasuredSpeed

SAME = 0.01
WIDEST, MOST, RARE, MOSTLY = 3, 9, 0.02, 0.8
QUANTILES, GRID = (0.05, 0.95), 7
SETTLED, FEWEST, LONGEST = 3.0, 5, 100
AROUND = 0.5


def operating_levels(batch: Batch, opening: float) -> Float[np.ndarray, " l"]:
    """Return the levels of the command at which tests were run, ascending, shape [L].

    Where up to nine levels hold four fifths of the time beyond the dead zone, these; otherwise seven levels
    evenly between the 5 % and the 95 % quantile of the commands in that time.

    Args:
        batch: identification tests.
        opening: command at which flow begins.
    """
    logged = np.abs(np.asarray(batch.logged))[np.asarray(batch.counted)]
    beyond = np.sort(logged[logged > opening])
    if not beyond.size:
        return beyond
    bins = np.round(beyond / (SAME * beyond[-1])).astype(int)
    groups = np.split(beyond, np.flatnonzero(np.diff(bins) > 1) + 1)
    steady = [group for group in groups if group.size >= RARE * beyond.size]
    narrow = all(np.ptp(group) <= WIDEST * SAME * beyond[-1] for group in steady)
    if narrow and len(steady) <= MOST and sum(map(len, steady)) >= MOSTLY * beyond.size:
        return np.array([np.median(group) for group in steady])
    slowest, fastest = np.quantile(beyond, QUANTILES)
    return np.linspace(slowest, fastest, GRID)


def operating_loads(batch: Batch, *, measured: bool) -> Float[np.ndarray, " k"]:
    """Return mean load and mean ± standard deviation within what occurred, ascending, shape [K]; or zero."""
    load = np.asarray(batch.load)
    if not measured:
        return np.zeros(1)
    mean, deviation = load.mean(), load.std()
    return np.unique(np.clip([mean - deviation, mean, mean + deviation], load.min(), load.max()))


def measured_speeds(
    batch: Batch, opening: float, response_time: float, *, loaded: bool
) -> tuple[MeasuredSpeed, ...]:
    """Return mean speeds around mid stroke while commands stood, the hundred longest, by command.

    A stretch counts from three response times after its command came to stand, over the middle half of the
    range of displacement, where five samples or more of it are left.

    Args:
        batch: identification tests.
        opening: command at which flow begins.
        response_time: of the speed, s.
        loaded: whether the tests have a measured load.
    """
    counted, displacement = np.asarray(batch.counted), np.asarray(batch.displacement)
    logged = np.abs(np.asarray(batch.logged))
    travel = np.sign(np.asarray(batch.logged)) * np.asarray(batch.travel)
    low, high = displacement[counted].min(), displacement[counted].max()
    middle = np.abs(displacement - 0.5 * (low + high)) <= AROUND * 0.5 * (high - low)
    wait = int(np.ceil(SETTLED * response_time / batch.step_s)) + 1
    found: list[tuple[int, MeasuredSpeed]] = []
    for row, load in enumerate(np.asarray(batch.load)):
        changed = np.abs(np.diff(logged[row])) > SAME * logged.max()
        for stretch in np.split(np.arange(logged.shape[1]), np.flatnonzero(changed) + 1):
            inside = stretch[wait:]
            inside = inside[(counted & middle)[row, inside]]
            command = float(np.median(logged[row, stretch]))
            if inside.size < FEWEST or command <= opening or np.ptp(logged[row, inside]) > 2 * SAME * command:
                continue
            speed = np.polyfit(batch.step_s * (inside - inside[0]), travel[row, inside], 1)[0]
            found.append((inside.size, MeasuredSpeed(command, float(load) if loaded else None, float(speed))))
    longest = sorted(found, key=lambda each: -each[0])[:LONGEST]
    return tuple(sorted((speed for _, speed in longest), key=lambda each: each.command))
