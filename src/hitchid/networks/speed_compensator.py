"""Compensator for free run: an ensemble of LSTMs that scales the speed of the benchmark.

The compensator of Sun et al. 2025, sec. 2.2.3, takes the measured displacement; this one its own output.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from hitchid.networks.lstm import SINGLE, Lstm, LstmState
from hitchid.networks.operating_range import OperatingRange

AUTHORITY = 0.5  # largest relative correction of the speed; chosen
INPUTS = 4  # features of a network, see `SpeedCompensator.features`


class BlockInputs(NamedTuple):
    """Inputs of a free run in B blocks of samples for T tests.

    Attributes:
        command: effective command, mean over the previous block, shape [B, T].
        previous_increment: travel of the benchmark over the previous block, shape [B, T].
        travel_increment: travel of the benchmark over the block, shape [B, T].
        initial: displacement before motion, shape [T].
        load: covariate, shape [T].
    """

    command: Float[Array, "b t"]
    previous_increment: Float[Array, "b t"]
    travel_increment: Float[Array, "b t"]
    initial: Float[Array, " t"]
    load: Float[Array, " t"]


class SpeedCompensator(eqx.Module):
    """Ensemble of LSTMs that scales the speed of the benchmark by 1 ± ½.

    y(j+1) = y(j) + (y_tf(j+1) − y_tf(j)) (1 + ½ m(j) Σᵢ tanh fᵢ(x(0) … x(j))/M) over blocks j. x: command
    and speed of the benchmark over the previous block, predicted displacement and covariate at the start of
    the block. m: trust factor, 1 within the operating range of the tests. While the benchmark is at
    standstill, the output is too.

    Attributes:
        networks: M networks, every array with a leading axis M.
        command_scale, increment_scale: scales of command and of the benchmark's travel in a block, shape [].
        operating_range: ranges of the signals in the identification tests.
        sign: +1 where displacement grows with travel, −1 where it falls.
        block_size: samples in a block.
    """

    networks: Lstm
    command_scale: Float[Array, ""]
    increment_scale: Float[Array, ""]
    operating_range: OperatingRange
    sign: int = eqx.field(static=True)
    block_size: int = eqx.field(static=True)

    def features(
        self,
        command: Float[Array, " t"],
        previous_increment: Float[Array, " t"],
        displacement: Float[Array, " t"],
        load: Array,
    ) -> Float[Array, "t 4"]:
        """Return the scaled inputs of the networks in single precision, shape [T, 4]."""
        ranges = (self.operating_range.displacement, self.operating_range.load)
        scaled = [
            2
            * (value - signal_range.lowest)
            / jnp.where(
                signal_range.highest > signal_range.lowest, signal_range.highest - signal_range.lowest, 1.0
            )
            - 1
            for value, signal_range in zip((displacement, load), ranges, strict=True)
        ]
        return jnp.stack(
            [command / self.command_scale, previous_increment / self.increment_scale, *scaled], axis=-1
        ).astype(SINGLE)

    def step(
        self,
        networks: Lstm,
        hidden: LstmState,
        command: Array,
        previous_increment: Array,
        displacement: Array,
        load: Array,
        *,
        fused: bool = False,
    ) -> tuple[LstmState, Float[Array, " t"]]:
        """Return the state of the networks and the factor on the benchmark's speed in the next block.

        Args:
            networks: M networks whose outputs are averaged.
            hidden: their state, shape [M, T, H].
            command, previous_increment: mean effective command and travel of the benchmark in the previous
                block, shape [T].
            displacement, load: displacement and covariate, shape [T].
            fused: see `Lstm.step`.
        """
        inputs = self.features(command, previous_increment, displacement, load)
        lstm_step = partial(Lstm.step, fused=fused)
        hidden = jax.vmap(lstm_step, in_axes=(0, 0, None))(networks, hidden, inputs)
        mean_output = jnp.mean(jnp.tanh(jax.vmap(Lstm.output)(networks, hidden)), axis=0)
        trust = self.operating_range.trust(jnp.abs(command), displacement, load)
        return hidden, 1 + AUTHORITY * trust * mean_output.astype(trust.dtype)

    def rollout(
        self,
        networks: Lstm,
        block_inputs: BlockInputs,
        *,
        measured: Float[Array, "b t"] | None = None,
        anchor_interval: Int[Array, ""] | int = 1,
        fused: bool = False,
    ) -> tuple[Float[Array, "b t"], Float[Array, "b t"]]:
        """Return travel at the start of each block and the factor on the benchmark's speed in it.

        Args:
            networks: M networks whose outputs are averaged.
            block_inputs: inputs of the free run.
            measured: measured travel at the start of each block, for re-initialisation; None for free run.
            anchor_interval: blocks between two re-initialisations.
            fused: see `Lstm.step`.
        """
        blocks, tests = block_inputs.command.shape
        members = networks.head.weight.shape[0]
        anchors = jnp.zeros_like(block_inputs.command) if measured is None else measured

        def advance(
            carry: tuple[LstmState, Array], block: tuple
        ) -> tuple[tuple[LstmState, Array], tuple[Array, Array]]:
            hidden, travel = carry
            index, command, previous_increment, travel_increment, anchor = block
            if measured is not None:
                travel = jnp.where(index % anchor_interval == 0, anchor, travel)
            displacement = block_inputs.initial + self.sign * travel
            hidden, factor = self.step(
                networks, hidden, command, previous_increment, displacement, block_inputs.load, fused=fused
            )
            return (hidden, travel + factor * travel_increment), (travel, factor)

        start = (networks.zero_state((members, tests)), jnp.zeros_like(block_inputs.initial))
        inputs = (
            jnp.arange(blocks),
            block_inputs.command,
            block_inputs.previous_increment,
            block_inputs.travel_increment,
            anchors,
        )
        return jax.lax.scan(advance, start, inputs)[1]


def compute_block_inputs(
    benchmark: Float[Array, "t n"],
    command: Float[Array, "t n"],
    initial: Float[Array, " t"],
    load: Float[Array, " t"],
    block_size: int,
) -> BlockInputs:
    """Return the inputs of a free run in blocks.

    Args:
        benchmark: travel of the benchmark, shape [T, N].
        command: effective command, shape [T, N].
        initial, load: displacement and covariate before motion, shape [T].
        block_size: samples in a block.
    """
    tests, count = benchmark.shape
    blocks = -(-count // block_size)
    padding = ((0, 0), (0, blocks * block_size - count))
    block_travel = jnp.pad(benchmark, padding, mode="edge")[:, ::block_size]
    travel_increment = jnp.diff(block_travel, axis=1, append=benchmark[:, -1:])
    mean_command = jnp.pad(command, padding, mode="edge").reshape(tests, blocks, block_size).mean(axis=2)
    previous_command, previous_increment = (
        jnp.pad(values, ((0, 0), (1, 0)))[:, :-1].T for values in (mean_command, travel_increment)
    )
    return BlockInputs(previous_command, previous_increment, travel_increment.T, initial, load)


@eqx.filter_jit
def simulate_compensated(
    compensator: SpeedCompensator,
    benchmark: Float[Array, "t n"],
    command: Float[Array, "t n"],
    initial: Float[Array, " t"],
    load: Float[Array, " t"],
) -> Float[Array, "t n"]:
    """Return the travel of the compensated free run, shape [T, N].

    Args:
        compensator: a trained compensator.
        benchmark: travel of the benchmark, shape [T, N].
        command: effective command, shape [T, N].
        initial, load: displacement and covariate before motion, shape [T].
    """
    block_size, count = compensator.block_size, benchmark.shape[1]
    block_inputs = compute_block_inputs(benchmark, command, initial, load, block_size)
    travel, factor = compensator.rollout(compensator.networks, block_inputs)
    block = jnp.arange(count) // block_size
    increment = benchmark - benchmark[:, block * block_size]
    return travel.T[:, block] + factor.T[:, block] * increment
