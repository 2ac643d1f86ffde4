"""Runs of a model that generated code must repeat: random commands, changes of direction, gaps."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from hitchid.data.record import DIRECTIONS
from hitchid.model import Channel, Hitch
from hitchid.model.loads import covariates_of, mean_load

SEED = 20_251  # of the commands; any
LEVEL_S = (0.05, 1.5)  # shortest and longest time of a level of command, s
GAIN_ERROR = 1.01  # of the measured displacement, so that the filter of the load has something to find
MISSING, NOT_A_NUMBER, BOTH = (
    0.02,
    0.005,
    0.15,
)  # shares of samples without measurement, command; with both commands
START_SHARE = 0.5  # of the range of displacement, for the start


@dataclass(frozen=True)
class ReferenceRun:
    """A run of a model through its public step.

    Attributes:
        start: displacement before the first sample.
        load: covariates.
        inputs: commands of the channels and measured displacement, NaN where there is none, shape [N, C + 1].
        displacement: one sample later, shape [N].
        mode: direction in charge, 0 lifting, 1 lowering, −1 none yet, shape [N].
        both_valves: whether both commands acted, shape [N].
        command_missing: whether a command was not finite, shape [N].
    """

    start: float
    load: tuple[float, ...]
    inputs: Float[np.ndarray, "n c"]
    displacement: Float[np.ndarray, " n"]
    mode: Int[np.ndarray, " n"]
    both_valves: np.ndarray
    command_missing: np.ndarray


def reference_runs(model: Hitch, samples: int, *, seed: int = SEED) -> tuple[ReferenceRun, ReferenceRun]:
    """Return a free run, and a run with measured displacements, each of a number of samples."""
    rng = np.random.default_rng(seed)
    commands = _commands(model, samples, rng)
    covariates = covariates_of(model.channels.values())
    load = tuple((mean_load(model.channels.values()) * 1.02).tolist()) if covariates else ()
    start = _start(model)
    nothing = np.full(samples, np.nan)
    free = _run(model, start, load, np.column_stack([commands, nothing]))
    travel = np.concatenate([[0.0], free.displacement[:-1] - start])
    noise = 1e-4 * (np.ptp(travel) + 1e-9) * rng.standard_normal(samples)
    measured = start + GAIN_ERROR * travel + noise
    measured[: samples // 20] = np.nan
    gaps = rng.random(samples) < MISSING
    measured[gaps | np.roll(gaps, 1) | np.roll(gaps, 2)] = np.nan
    middle = samples // 2
    measured[middle : middle + samples // 12] = np.nan  # longer than the network's innovations are used
    commands = commands.copy()
    commands[rng.random(commands.shape) < NOT_A_NUMBER] = np.nan
    return free, _run(model, start, load, np.column_stack([commands, measured]))


def displacement_range(model: Hitch, run: ReferenceRun) -> float:
    """Return the widest range of displacement in the tests; that of a run where it is not known."""
    ranges = [channel.operating_range.displacement for channel in model.channels.values()]
    widths = [float(each.highest) - float(each.lowest) for each in ranges]
    known = [width for width in widths if np.isfinite(width) and width > 0]
    return max(known, default=float(np.ptp(run.displacement)) or 1.0)


def _commands(model: Hitch, samples: int, rng: np.random.Generator) -> Float[np.ndarray, "n c"]:
    """Return levels of one direction at a time, at times of both, from below the dead zone to the largest."""
    channels = tuple(model.channels.values())
    commands = np.zeros((samples, len(channels)))
    shortest, longest = (max(1, round(length / model.step_s)) for length in LEVEL_S)
    longest = min(longest, max(shortest, samples // 20))
    at = 0
    while at < samples:
        length = int(rng.integers(shortest, longest + 1))
        active = int(rng.integers(len(channels)))
        for number, channel in enumerate(channels):
            if number == active or rng.random() < BOTH:
                commands[at : at + length, number] = rng.uniform(-0.1, 1.1) * _largest(channel)
        if rng.random() < BOTH:
            commands[at : at + length] = 0.0
        at += length
    return commands


def _largest(channel: Channel) -> float:
    highest = float(channel.operating_range.command.highest)
    return channel.dead_zone + (highest if np.isfinite(highest) else max(channel.dead_zone, 1.0))


def _start(model: Hitch) -> float:
    covered = next(iter(model.channels.values())).operating_range.displacement
    ends = float(covered.lowest), float(covered.highest)
    return ends[0] + START_SHARE * (ends[1] - ends[0]) if np.all(np.isfinite(ends)) else 100.0


def _run(
    model: Hitch, start: float, load: tuple[float, ...], inputs: Float[np.ndarray, "n c"]
) -> ReferenceRun:
    names = covariates_of(model.channels.values())
    state = model.init_state(start, dict(zip(names, load, strict=True)) or None)
    columns = [DIRECTIONS.index(direction) for direction in model.channels]
    states, displacements = [], []
    for row in inputs:
        commands = np.zeros(len(DIRECTIONS))
        commands[columns] = row[:-1]
        state, displacement = model.step(state, commands, row[-1])
        states.append(state)
        displacements.append(float(displacement))
    known = jax.vmap(model.unpack_state)(jax.tree.map(lambda *arrays: jnp.stack(arrays), *states))
    modes = np.asarray(known.mode)
    return ReferenceRun(
        start,
        load,
        inputs,
        np.array(displacements),
        np.where(modes < 0, modes, np.array(columns)[modes]),
        np.asarray(known.both_valves_active),
        np.asarray(known.command_missing),
    )
