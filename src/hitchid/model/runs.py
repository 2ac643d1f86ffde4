"""Whole records through a hitch's motion: free runs, and predictions ahead of every sample."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hitchid.benchmark import padded_length
from hitchid.model.stepping import Motion, State

AT_ONCE = 1024


class FreeRun(NamedTuple):
    """A free run on the model's clock and in its units.

    Attributes:
        displacement: at every sample, shape [N].
        charge: place of the channel in charge from each sample to the next, −1 while none is yet, shape [N].
    """

    displacement: Float[np.ndarray, " n"]
    charge: Int[np.ndarray, " n"]


def padded(samples: np.ndarray, beyond: int) -> Array:
    """Return samples with NaN behind them, so many at least and up to a length for which programs exist."""
    width = padded_length(len(samples) + beyond)
    behind = ((0, width - len(samples)), *((0, 0) for _ in samples.shape[1:]))
    return jnp.asarray(np.pad(samples, behind, constant_values=np.nan))


@eqx.filter_jit
def stepped(
    motion: Motion, start: State, commands: Float[Array, "n 2"]
) -> tuple[Float[Array, " n"], Int[Array, " n"]]:
    """Return displacement after each sample without measurements, and the channel in charge meanwhile."""

    def advance(state: State, command: Array) -> tuple[State, tuple[Array, Array]]:
        state, displacement = motion.step(state, command, jnp.asarray(jnp.nan))
        return state, (displacement, state.mode)

    return jax.lax.scan(advance, start, commands)[1]


@eqx.filter_jit
def ahead_of(
    motion: Motion,
    start: State,
    commands: Float[Array, "n 2"],
    measured: Float[Array, " n"],
    horizon: int,
    every: int,
) -> Float[Array, "h m"]:
    """Return the displacement h = 1 … horizon samples after samples that have so many behind them."""
    count = commands.shape[0] - horizon + 1

    def heard(state: State, given: tuple[Array, Array]) -> tuple[State, State]:
        state, _ = motion.step(state, *given)
        return state, state

    _, states = jax.lax.scan(heard, start, (commands[:count], measured[:count]))

    def coast(state: State, at: Array) -> Float[Array, " h"]:
        def advance(state: State, ahead: Array) -> tuple[State, Array]:
            after, _ = motion.step(state, commands[at + ahead], jnp.asarray(jnp.nan))
            return after, state.displacement

        return jax.lax.scan(advance, state, jnp.arange(1, horizon + 1))[1]

    origins = jax.tree.map(lambda array: array[::every], (states, jnp.arange(count)))
    return jax.lax.map(lambda given: coast(*given), origins, batch_size=AT_ONCE).T


def from_origins(ahead: np.ndarray, initial: float, horizon: int, count: int, every: int) -> np.ndarray:
    """Return the prediction of samples from `horizon` before, of the first ones from sample 0."""
    first = np.concatenate([[initial], ahead[: horizon - 1, 0]])[:count]
    rest = np.full(count - first.size, np.nan)
    rest[::every] = ahead[horizon - 1, : rest[::every].size]
    return np.concatenate([first, rest])
