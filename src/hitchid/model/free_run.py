"""Free run and multi-step predictions of a hitch over a whole record."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hitchid._support.short_repr import short_repr
from hitchid.data.record import DIRECTIONS, Record
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.state import HitchState
from hitchid.structures import padded_length

ORIGINS_PER_BATCH = 64  # predictions advanced at the same time; chosen: their states fit the cache


@short_repr
class FreeRun(NamedTuple):
    """A free run on the model's clock and in its units.

    Attributes:
        displacement: at every sample, shape [N].
        active_channel: index of the channel in charge from each sample to the next, −1 before the first
            effective command, shape [N].
    """

    displacement: Float[np.ndarray, " n"]
    active_channel: Int[np.ndarray, " n"]


class InitialCondition(NamedTuple):
    """Displacement and covariate of a hitch at rest before a record, in the model's units."""

    displacement: float
    load: float


def free_run(dynamics: HitchDynamics, record: Record, initial: InitialCondition) -> FreeRun:
    """Return the free run over a record on the model's clock and in its units."""
    displacement, active_channel = simulate_free_run(
        dynamics, jnp.array(initial), pad_with_nan(commands_of(record), 1)
    )
    steps = np.asarray(active_channel)[: len(record) - 1]
    return FreeRun(
        np.concatenate([[initial.displacement], np.asarray(displacement)[: len(record) - 1]]),
        np.concatenate([steps, steps[-1:]]),
    )


def ensemble_free_runs(
    members: Sequence[HitchDynamics], record: Record, initial: InitialCondition
) -> Float[np.ndarray, "m n"]:
    """Return the displacement of the free runs of several hitches over one record, shape [M, N]."""
    commands = pad_with_nan(commands_of(record), 1)
    rows = simulate_ensemble(members, jnp.array(initial), commands)[:, : len(record) - 1]
    return np.pad(rows, ((0, 0), (1, 0)), constant_values=initial.displacement)


def multi_step_predictions(
    dynamics: HitchDynamics, record: Record, initial: InitialCondition, horizons: Sequence[int], stride: int
) -> list[Float[np.ndarray, " n"]]:
    """Return the predictions of all samples for each horizon; see `Hitch.predictions`."""
    count = len(record)
    longest = min(max(horizons), count)
    commands, measured = (
        pad_with_nan(samples, longest) for samples in (commands_of(record), record.displacement)
    )
    predictions = np.asarray(
        predict_from_origins(dynamics, jnp.array(initial), commands, measured, longest, stride)
    )
    return [
        align_predictions(predictions, initial.displacement, min(horizon, longest), count, stride)
        for horizon in horizons
    ]


def commands_of(record: Record) -> Float[np.ndarray, "n 2"]:
    """Return lifting and lowering command, zero for a direction without one, shape [N, 2]."""
    zeros = np.zeros(len(record))
    return np.stack(
        [record.command(direction) if direction in record.directions else zeros for direction in DIRECTIONS],
        axis=1,
    )


def pad_with_nan(samples: np.ndarray, extra: int) -> Array:
    """Append at least `extra` NaN, up to a length for which the functions are compiled already."""
    width = padded_length(len(samples) + extra)
    padding = ((0, width - len(samples)), *((0, 0) for _ in samples.shape[1:]))
    return jnp.asarray(np.pad(samples, padding, constant_values=np.nan))


@eqx.filter_jit
def simulate_free_run(
    dynamics: HitchDynamics, initial: Float[Array, "2"], commands: Float[Array, "n 2"]
) -> tuple[Float[Array, " n"], Int[Array, " n"]]:
    """Return displacement after each sample without measurements, and the channel in charge until then."""

    def advance(state: HitchState, command: Array) -> tuple[HitchState, tuple[Array, Array]]:
        state, displacement = dynamics.step(state, command, jnp.asarray(jnp.nan))
        return state, (displacement, state.mode)

    return jax.lax.scan(advance, dynamics.init_state(*initial), commands)[1]


def simulate_ensemble(
    members: Sequence[HitchDynamics], initial: Float[Array, "2"], commands: Float[Array, "n 2"]
) -> Float[np.ndarray, "m n"]:
    """Return displacement after each sample for several hitches; one compiled call for each structure."""
    groups: dict[object, list[int]] = {}
    for number, dynamics in enumerate(members):
        groups.setdefault(jax.tree.structure(dynamics), []).append(number)
    displacements = np.empty((len(members), len(commands)))
    for indices in groups.values():
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *(members[number] for number in indices))
        displacements[indices] = _simulate_stacked(stacked, initial, commands)
    return displacements


@eqx.filter_jit
def _simulate_stacked(stacked: HitchDynamics, initial: Array, commands: Array) -> Float[Array, "m n"]:
    return jax.vmap(lambda dynamics: simulate_free_run(dynamics, initial, commands)[0])(stacked)


@eqx.filter_jit
def predict_from_origins(
    dynamics: HitchDynamics,
    initial: Float[Array, "2"],
    commands: Float[Array, "n 2"],
    measured: Float[Array, " n"],
    horizon: int,
    stride: int,
) -> Float[Array, "h m"]:
    """Return the displacement h = 1 … horizon samples after every `stride`-th sample, shape [horizon, M].

    Origins are processed in groups of `ORIGINS_PER_BATCH`: vectorised, and small enough for the cache.
    """
    count = commands.shape[0] - horizon + 1

    def advance_measured(state: HitchState, inputs: tuple[Array, Array]) -> tuple[HitchState, HitchState]:
        state, _ = dynamics.step(state, *inputs)
        return state, state

    _, states = jax.lax.scan(
        advance_measured, dynamics.init_state(*initial), (commands[:count], measured[:count])
    )

    def coast(state: HitchState, origin: Array) -> Float[Array, " h"]:
        def advance(state: HitchState, steps_ahead: Array) -> tuple[HitchState, Array]:
            next_state, _ = dynamics.step(state, commands[origin + steps_ahead], jnp.asarray(jnp.nan))
            return next_state, state.displacement

        return jax.lax.scan(advance, state, jnp.arange(1, horizon + 1))[1]

    origins = np.arange(0, count, stride)
    groups = jnp.asarray(np.resize(origins, (-(-origins.size // ORIGINS_PER_BATCH), ORIGINS_PER_BATCH)))

    def coast_group(group: Array) -> Float[Array, "g h"]:
        return jax.vmap(coast)(jax.tree.map(lambda array: array[group], states), group)

    return jax.lax.map(coast_group, groups).reshape(-1, horizon)[: origins.size].T


def align_predictions(
    predictions_ahead: np.ndarray, initial: float, horizon: int, count: int, stride: int
) -> np.ndarray:
    """Return each sample predicted from `horizon` samples before, the first ones from sample 0."""
    first = np.concatenate([[initial], predictions_ahead[: horizon - 1, 0]])[:count]
    later = np.full(count - first.size, np.nan)
    later[::stride] = predictions_ahead[horizon - 1, : later[::stride].size]
    return np.concatenate([first, later])
