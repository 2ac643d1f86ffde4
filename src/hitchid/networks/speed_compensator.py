"""The compensator for free run: LSTMs that scale the benchmark's speed, and so move nothing that stands.

Where the compensator of Sun et al. 2025, sec. 2.2.3, hears the measured displacement, this one hears its own.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from hitchid.networks.lstm import SINGLE, Hidden, Lstm
from hitchid.networks.operating_range import Envelope

AUTHORITY = 0.5
INPUTS = 4


class Drive(NamedTuple):
    """What a free run hears, block by block; B blocks of several samples each, T tests.

    Attributes:
        command: effective command, mean over the block before, shape [B, T].
        before: travel of the benchmark over the block before, shape [B, T].
        moved: travel of the benchmark over the block, shape [B, T].
        initial: displacement before motion, shape [T].
        load: second input, shape [T].
    """

    command: Float[Array, "b t"]
    before: Float[Array, "b t"]
    moved: Float[Array, "b t"]
    initial: Float[Array, " t"]
    load: Float[Array, " t"]


class SpeedCompensator(eqx.Module):
    """An ensemble of LSTMs that scales the benchmark's speed by 1 ± ½.

    y(j+1) = y(j) + (y_tf(j+1) − y_tf(j)) (1 + ½ m(j) Σᵢ tanh fᵢ(x(0) … x(j))/M) over blocks j of some
    samples; x is command and speed of the benchmark over the block before, own displacement and second input
    at the start of the block, and m the trust in them, 1 within what the tests covered. Where the benchmark
    stands, the sum does.

    Attributes:
        networks: M networks, every array with a leading axis M.
        command, moved: scales of command and of the benchmark's travel in a block, shape [].
        envelope: the ranges of the tests.
        direction: +1 where displacement grows with travel, −1 where it falls.
        every: samples in a block.
    """

    networks: Lstm
    command: Float[Array, ""]
    moved: Float[Array, ""]
    envelope: Envelope
    direction: int = eqx.field(static=True)
    every: int = eqx.field(static=True)

    def features(
        self, command: Float[Array, " t"], moved: Float[Array, " t"], place: Float[Array, " t"], load: Array
    ) -> Float[Array, "t 4"]:
        """Return what the networks read, in single precision, shape [T, 4]."""
        ranges = (self.envelope.displacement, self.envelope.load)
        scaled = [
            2 * (value - each.lowest) / jnp.where(each.highest > each.lowest, each.highest - each.lowest, 1.0)
            - 1
            for value, each in zip((place, load), ranges, strict=True)
        ]
        return jnp.stack([command / self.command, moved / self.moved, *scaled], axis=-1).astype(SINGLE)

    def hear(
        self,
        networks: Lstm,
        hidden: Hidden,
        command: Array,
        before: Array,
        place: Array,
        load: Array,
        *,
        joined: bool = False,
    ) -> tuple[Hidden, Float[Array, " t"]]:
        """Return the networks' state and the factor on the benchmark's speed in the block that begins.

        Args:
            networks: M networks; their mean counts.
            hidden: their state, shape [M, T, H].
            command, before: effective command and travel of the benchmark in the block before, shape [T].
            place, load: displacement and second input, shape [T].
            joined: see `Lstm.read`.
        """
        inputs = self.features(command, before, place, load)
        read = partial(Lstm.read, joined=joined)
        hidden = jax.vmap(read, in_axes=(0, 0, None))(networks, hidden, inputs)
        share = jnp.mean(jnp.tanh(jax.vmap(Lstm.output)(networks, hidden)), axis=0)
        trust = self.envelope.trust(jnp.abs(command), place, load)
        return hidden, 1 + AUTHORITY * trust * share.astype(trust.dtype)

    def rollout(
        self,
        networks: Lstm,
        drive: Drive,
        *,
        measured: Float[Array, "b t"] | None = None,
        anchored_every: Int[Array, ""] | int = 1,
        joined: bool = False,
    ) -> tuple[Float[Array, "b t"], Float[Array, "b t"]]:
        """Return travel at the start of each block and the factor on the benchmark's speed in it.

        Args:
            networks: M networks; their mean counts.
            drive: what is heard.
            measured: measured travel at the start of each block, to start anew from; None for free run.
            anchored_every: blocks between two such starts.
            joined: see `Lstm.read`.
        """
        blocks, tests = drive.command.shape
        members = networks.head.weight.shape[0]
        given = jnp.zeros_like(drive.command) if measured is None else measured

        def advance(
            carry: tuple[Hidden, Array], block: tuple
        ) -> tuple[tuple[Hidden, Array], tuple[Array, Array]]:
            hidden, travel = carry
            number, command, before, moved, known = block
            if measured is not None:
                travel = jnp.where(number % anchored_every == 0, known, travel)
            place = drive.initial + self.direction * travel
            hidden, factor = self.hear(networks, hidden, command, before, place, drive.load, joined=joined)
            return (hidden, travel + factor * moved), (travel, factor)

        start = (networks.blank((members, tests)), jnp.zeros_like(drive.initial))
        inputs = (jnp.arange(blocks), drive.command, drive.before, drive.moved, given)
        return jax.lax.scan(advance, start, inputs)[1]


def driven_by(
    benchmark: Float[Array, "t n"],
    command: Float[Array, "t n"],
    initial: Float[Array, " t"],
    load: Float[Array, " t"],
    every: int,
) -> Drive:
    """Gather what a free run hears, block by block.

    Args:
        benchmark: travel of the benchmark, shape [T, N].
        command: effective command, shape [T, N].
        initial, load: shape [T].
        every: samples in a block.
    """
    tests, count = benchmark.shape
    blocks = -(-count // every)
    wide = ((0, 0), (0, blocks * every - count))
    held = jnp.pad(benchmark, wide, mode="edge")[:, ::every]
    moved = jnp.diff(held, axis=1, append=benchmark[:, -1:])
    means = jnp.pad(command, wide, mode="edge").reshape(tests, blocks, every).mean(axis=2)
    command_before, before = (jnp.pad(each, ((0, 0), (1, 0)))[:, :-1].T for each in (means, moved))
    return Drive(command_before, before, moved.T, initial, load)


@eqx.filter_jit
def compensated(
    compensator: SpeedCompensator,
    benchmark: Float[Array, "t n"],
    command: Float[Array, "t n"],
    initial: Float[Array, " t"],
    load: Float[Array, " t"],
) -> Float[Array, "t n"]:
    """Return the free run's travel, shape [T, N].

    Args:
        compensator: trained.
        benchmark: travel of the benchmark, shape [T, N].
        command: effective command, shape [T, N].
        initial, load: displacement and second input before motion, shape [T].
    """
    every, count = compensator.every, benchmark.shape[1]
    drive = driven_by(benchmark, command, initial, load, every)
    travel, factor = compensator.rollout(compensator.networks, drive)
    block = jnp.arange(count) // every
    since = benchmark - benchmark[:, block * every]
    return travel.T[:, block] + factor.T[:, block] * since
