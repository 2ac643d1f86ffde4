"""Ensemble of perturbed channels, and the spread of its free runs around that of the model."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hitchid.model.bands import Bands, EnsembleMember, free_run_half_width
from hitchid.model.channel import Channel
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.free_run import FreeRun, FreeRunInputs, ensemble_free_runs
from hitchid.structures import Batch


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
    """Return a channel's free run, and the weighted deviations of its ensemble from it.

    Args:
        channel: channel of the model.
        members: members of its ensemble.
        batch: tests.
    """
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
    """Return the half width of the band around free runs of a hitch, in the model's unit.

    Args:
        dynamics: dynamics of the hitch in free run.
        bands: bands of each channel.
        inputs: inputs of the free runs.
        run: the free runs.
        coverage: share of samples within the band.

    Returns:
        Half width at every sample, shape [N] or [M, N].
    """
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
    """Return the half width of the band around a free run from the deviations of the ensemble's.

    Args:
        members: of the ensembles of all channels.
        bands: of each channel.
        deviations: free run of each member less that of the model, in the displacement's unit.
        coverage: share of samples within the band.
    """
    weights = np.array([member.weight for member in members]).reshape(-1, *[1] * (deviations.ndim - 1))
    owners = np.array([member.channel for member in members])
    squares = (weights * deviations) ** 2
    spreads = [np.sqrt(squares[owners == number].sum(axis=0)) for number in range(len(bands))]
    return free_run_half_width(bands, spreads, coverage)
