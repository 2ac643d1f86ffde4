"""Free run and multi-step predictions of a hitch over a whole record."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hitchid._support.records import short_repr
from hitchid.logs.record import DIRECTIONS, Record
from hitchid.model.bands import Bands, EnsembleMember, free_run_half_width
from hitchid.model.channel import Channel
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.state import HitchState
from hitchid.structures import Batch, padded_length

ORIGINS_PER_BATCH = 64  # predictions advanced at the same time; chosen: their states fit the cache


class InitialCondition(NamedTuple):
    """Displacement and covariates of a hitch at rest before a run, in the model's units.

    Attributes:
        displacement: shape [], or [M] for M runs.
        load: covariates in the order of the dynamics, shape [L] or [M, L]; one zero where there is none.
    """

    displacement: Float[np.ndarray, "*m"]
    load: Float[np.ndarray, "*m l"]

    @property
    def row(self) -> Float[np.ndarray, "*m i"]:
        """Displacement and covariates in one array."""
        return np.concatenate([self.displacement[..., None], self.load], axis=-1)


class FreeRunInputs(NamedTuple):
    """Inputs of free runs, on the model's clock and in its units.

    Attributes:
        commands: lifting and lowering command, shape [N, 2].
        initial: initial condition of each run.
    """

    commands: Float[np.ndarray, "n 2"]
    initial: InitialCondition


@short_repr
class FreeRun(NamedTuple):
    """Free run on the model's clock and in its units.

    Attributes:
        displacement: at every sample, shape [N], or [M, N] for M initial conditions.
        active_channel: index of the active channel from each sample to the next, −1 before the first
            effective command, same shape.
        is_held: whether no command demands motion from each sample to the next, same shape.
    """

    displacement: Float[np.ndarray, "*m n"]
    active_channel: Int[np.ndarray, "*m n"]
    is_held: Bool[np.ndarray, "*m n"]


def free_run(dynamics: HitchDynamics, inputs: FreeRunInputs) -> FreeRun:
    """Return the free run of each initial condition; several are advanced at the same time."""
    initial = jnp.asarray(inputs.initial.row)
    # One sample more than there are: the last command moves the piston to a displacement beyond the record,
    # which is dropped.
    commands = pad_with_nan(inputs.commands, 1)
    simulate = simulate_free_run if initial.ndim == 1 else simulate_free_runs
    count = len(inputs.commands)
    displacement, active_channel, is_held = (
        np.asarray(rows)[..., :count] for rows in simulate(numbers_as_arrays(dynamics), initial, commands)
    )
    return FreeRun(_with_initial(displacement, inputs.initial), active_channel, is_held)


def ensemble_free_runs(
    members: Sequence[HitchDynamics], inputs: FreeRunInputs
) -> Float[np.ndarray, "a *m n"]:
    """Return the displacement of the free runs of several hitches, shape [A, N] or [A, M, N]."""
    initial, commands = jnp.asarray(inputs.initial.row), pad_with_nan(inputs.commands, 1)
    groups: dict[object, list[int]] = {}
    for number, dynamics in enumerate(members):
        groups.setdefault(jax.tree.structure(dynamics), []).append(number)
    displacements = np.empty((len(members), *initial.shape[:-1], len(commands)))
    # Members of one structure are stacked: they are compiled once, not each.
    for indices in groups.values():
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *(members[number] for number in indices))
        displacements[indices] = _simulate_stacked(stacked, initial, commands)
    return _with_initial(displacements[..., : len(inputs.commands)], inputs.initial)


def _with_initial(next_displacement: np.ndarray, initial: InitialCondition) -> Float[np.ndarray, "*b n"]:
    """Return the displacement at every sample from that at the next one, the last of which is dropped."""
    first = np.broadcast_to(initial.displacement[..., None], (*next_displacement.shape[:-1], 1))
    return np.concatenate([first, next_displacement[..., :-1]], axis=-1)


def multi_step_predictions(
    dynamics: HitchDynamics, record: Record, initial: InitialCondition, horizons: Sequence[int], stride: int
) -> list[Float[np.ndarray, " n"]]:
    """Return the predictions of all samples for each horizon; see `Hitch.predictions`."""
    count = len(record)
    # No sample is farther from the first one than the record is long: a longer horizon predicts the same.
    longest = min(max(horizons), count)
    commands, measured = (
        pad_with_nan(samples, longest) for samples in (commands_of(record), record.displacement)
    )
    predictions = np.asarray(
        predict_from_origins(
            numbers_as_arrays(dynamics), jnp.asarray(initial.row), commands, measured, longest, stride
        )
    )
    return [
        align_predictions(predictions, float(initial.displacement), min(horizon, longest), count, stride)
        for horizon in horizons
    ]


def commands_of(record: Record) -> Float[np.ndarray, "n 2"]:
    """Return lifting and lowering command, zero for a direction without one, shape [N, 2]."""
    zeros = np.zeros(len(record))
    return np.stack(
        [record.command(direction) if direction in record.directions else zeros for direction in DIRECTIONS],
        axis=1,
    )


def numbers_as_arrays(dynamics: HitchDynamics) -> HitchDynamics:
    """Return dynamics whose numbers are inputs of compiled functions: models of like structure share them."""
    # Were they constants of the program, each machine of a fleet would compile its own.
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, dynamics)


def pad_with_nan(samples: np.ndarray, extra: int) -> Array:
    """Append at least `extra` NaN, up to a length for which the functions are compiled already."""
    width = padded_length(len(samples) + extra)
    padding = ((0, width - len(samples)), *((0, 0) for _ in samples.shape[1:]))
    # Not zero, which a user may have commanded or measured: NaN is what the step takes as missing.
    return jnp.asarray(np.pad(samples, padding, constant_values=np.nan))


@eqx.filter_jit
def simulate_free_run(
    dynamics: HitchDynamics, initial: Float[Array, " i"], commands: Float[Array, "n 2"]
) -> tuple[Float[Array, " n"], Int[Array, " n"], Bool[Array, " n"]]:
    """Return displacement after each sample without measurements; until then, channel and whether held."""

    def advance(state: HitchState, command: Array) -> tuple[HitchState, tuple[Array, Array, Array]]:
        # Also the free run is a step without a measurement: it cannot part from what runs on a machine.
        state, displacement = dynamics.step(state, command, jnp.asarray(jnp.nan))
        demands = [channel.valve.motion_demand[-1] for channel in state.channels]
        return state, (displacement, state.mode, ~jnp.any(jnp.stack(demands)))

    return jax.lax.scan(advance, dynamics.init_state(initial[0], initial[1:]), commands)[1]


@eqx.filter_jit
def simulate_free_runs(
    dynamics: HitchDynamics, initial: Float[Array, "m i"], commands: Float[Array, "n 2"]
) -> tuple[Float[Array, "m n"], Int[Array, "m n"], Bool[Array, "m n"]]:
    """Return `simulate_free_run` for several initial conditions."""
    return jax.vmap(lambda row: simulate_free_run(dynamics, row, commands))(initial)


@eqx.filter_jit
def _simulate_stacked(stacked: HitchDynamics, initial: Array, commands: Array) -> Float[Array, "a *m n"]:
    def simulate(dynamics: HitchDynamics, row: Array) -> Float[Array, " n"]:
        return simulate_free_run(dynamics, row, commands)[0]

    by_initial = simulate if initial.ndim == 1 else jax.vmap(simulate, in_axes=(None, 0))
    return jax.vmap(by_initial, in_axes=(0, None))(stacked, initial)


@eqx.filter_jit
def predict_from_origins(
    dynamics: HitchDynamics,
    initial: Float[Array, " i"],
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

    # One pass with measurements gives the states at all origins.
    _, states = jax.lax.scan(
        advance_measured, dynamics.init_state(initial[0], initial[1:]), (commands[:count], measured[:count])
    )

    def coast(state: HitchState, origin: Array) -> Float[Array, " h"]:
        def advance(state: HitchState, steps_ahead: Array) -> tuple[HitchState, Array]:
            # The state that follows a measured sample is one sample ahead of it already.
            next_state, _ = dynamics.step(state, commands[origin + steps_ahead], jnp.asarray(jnp.nan))
            return next_state, state.displacement

        return jax.lax.scan(advance, state, jnp.arange(1, horizon + 1))[1]

    origins = np.arange(0, count, stride)
    # The last group is filled with the first origins again, which are dropped at the end.
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


def last_measured(measured: np.ndarray, initial: float, horizon: int) -> Float[np.ndarray, " n"]:
    """Return the displacement, shape [N], from which `align_predictions` predicts each sample."""
    first = np.full(min(horizon, measured.size), initial)
    return np.concatenate([first, measured[: measured.size - first.size]])


# Ensemble of perturbed channels, and the spread of its free runs around that of the model.


def perturbed_channel(channel: Channel, member: EnsembleMember) -> Channel:
    """Return a channel with benchmark and free-run network of an ensemble member."""
    row = jnp.asarray(member.benchmark)
    perturbed = eqx.tree_at(
        lambda tree: tree.benchmark, channel, channel.benchmark.with_parameter_vector(row)
    )
    if member.network is None or channel.speed_compensator is None:
        return perturbed
    networks = channel.speed_compensator.networks
    # M copies of one network: their mean is its output, and the shapes stay, so nothing is recompiled.
    repeated_network = jax.tree.map(
        lambda leaf: jnp.asarray(np.broadcast_to(np.asarray(leaf)[member.network], leaf.shape)), networks
    )
    return eqx.tree_at(lambda tree: tree.speed_compensator.networks, perturbed, repeated_network)


def ensemble_deviations(
    channel: Channel, members: Sequence[EnsembleMember], batch: Batch
) -> tuple[Float[np.ndarray, "t n"], Float[np.ndarray, "a t n"]]:
    """Return a channel's free run, and the weighted deviations of its ensemble from it."""
    simulated = np.asarray(channel.simulate(batch))
    member_runs = [np.asarray(perturbed_channel(channel, member).simulate(batch)) for member in members]
    weights = np.array([member.weight for member in members])
    return simulated, weights[:, None, None] * (np.stack(member_runs) - simulated)


def hitch_half_width(
    dynamics: HitchDynamics,
    bands: Sequence[Bands],
    inputs: FreeRunInputs,
    run: FreeRun,
    coverage: float,
) -> Float[np.ndarray, "*m n"]:
    """Return the half width of the band around free runs at every sample, in the model's unit."""
    members = ensemble_members(dynamics, bands)
    deviations = ensemble_free_runs([member.dynamics for member in members], inputs) - run.displacement
    return ensemble_half_width(members, bands, deviations, coverage)


class HitchMember(NamedTuple):
    """A hitch of which one channel is perturbed.

    Attributes:
        dynamics: of the hitch.
        weight: factor on the deviation of its free run.
        channel: number of the perturbed channel.
    """

    dynamics: HitchDynamics
    weight: float
    channel: int


def ensemble_members(dynamics: HitchDynamics, bands: Sequence[Bands]) -> list[HitchMember]:
    """Return the hitches with one perturbed channel, of the ensembles of all channels."""
    members = []
    for number, (channel, channel_bands) in enumerate(zip(dynamics.channels, bands, strict=True)):
        for member in channel_bands.ensemble:
            # One channel at a time: the squares of their deviations add.
            channels = list(dynamics.channels)
            channels[number] = perturbed_channel(channel, member)
            perturbed = HitchDynamics.of(channels, dynamics.step_s, dynamics.drift)
            members.append(HitchMember(perturbed, member.weight, number))
    return members


def ensemble_half_width(
    members: Sequence[HitchMember],
    bands: Sequence[Bands],
    deviations: Float[np.ndarray, "a *b n"],
    coverage: float,
) -> Float[np.ndarray, "*b n"]:
    """Return the half width of the band around a free run from the deviations of the ensemble's from it."""
    weights = np.array([member.weight for member in members]).reshape(-1, *[1] * (deviations.ndim - 1))
    owners = np.array([member.channel for member in members])
    squares = (weights * deviations) ** 2
    spreads = [np.sqrt(squares[owners == number].sum(axis=0)) for number in range(len(bands))]
    return free_run_half_width(bands, spreads, coverage)
