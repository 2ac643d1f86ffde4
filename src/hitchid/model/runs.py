"""Whole records through a hitch's motion: free runs, and predictions ahead of every sample."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hitchid.model.stepping import Motion, State
from hitchid.structures import padded_length

ABREAST = 64


class FreeRun(NamedTuple):
    """A free run on the model's clock and in its units.

    Attributes:
        displacement: at every sample, shape [N].
        charge: place of the channel in charge from each sample to the next, −1 while none is yet, shape [N].
    """

    displacement: Float[np.ndarray, " n"]
    charge: Int[np.ndarray, " n"]


class Rest(NamedTuple):
    """A hitch that stands before a record: displacement and second measured input, in the model's units."""

    displacement: float
    load: float


def padded(samples: np.ndarray, beyond: int) -> Array:
    """Return samples with NaN behind them, so many at least and up to a length for which programs exist."""
    width = padded_length(len(samples) + beyond)
    behind = ((0, width - len(samples)), *((0, 0) for _ in samples.shape[1:]))
    return jnp.asarray(np.pad(samples, behind, constant_values=np.nan))


@eqx.filter_jit
def stepped(
    motion: Motion, rest: Float[Array, "2"], commands: Float[Array, "n 2"]
) -> tuple[Float[Array, " n"], Int[Array, " n"]]:
    """Return displacement after each sample without measurements, and the channel in charge meanwhile."""

    def advance(state: State, command: Array) -> tuple[State, tuple[Array, Array]]:
        state, displacement = motion.step(state, command, jnp.asarray(jnp.nan))
        return state, (displacement, state.mode)

    return jax.lax.scan(advance, motion.initial(*rest), commands)[1]


def stepped_abreast(
    motions: Sequence[Motion], rest: Float[Array, "2"], commands: Float[Array, "n 2"]
) -> Float[np.ndarray, "m n"]:
    """Return displacement after each sample as `stepped` does, of several motions; one form, one call."""
    alike: dict[object, list[int]] = {}
    for number, motion in enumerate(motions):
        alike.setdefault(jax.tree.structure(motion), []).append(number)
    found = np.empty((len(motions), len(commands)))
    for numbers in alike.values():
        abreast = jax.tree.map(lambda *leaves: np.stack(leaves), *(motions[number] for number in numbers))
        found[numbers] = _stepped_abreast(abreast, rest, commands)
    return found


@eqx.filter_jit
def _stepped_abreast(motions: Motion, rest: Array, commands: Array) -> Float[Array, "m n"]:
    return jax.vmap(lambda motion: stepped(motion, rest, commands)[0])(motions)


@eqx.filter_jit
def ahead_of(
    motion: Motion,
    rest: Float[Array, "2"],
    commands: Float[Array, "n 2"],
    measured: Float[Array, " n"],
    horizon: int,
    every: int,
) -> Float[Array, "h m"]:
    """Return the displacement h = 1 … horizon samples after samples that have so many behind them.

    Origins go side by side in groups of one size: that fills a processor's arithmetic and fits its cache.
    """
    count = commands.shape[0] - horizon + 1

    def heard(state: State, given: tuple[Array, Array]) -> tuple[State, State]:
        state, _ = motion.step(state, *given)
        return state, state

    _, states = jax.lax.scan(heard, motion.initial(*rest), (commands[:count], measured[:count]))

    def coast(state: State, at: Array) -> Float[Array, " h"]:
        def advance(state: State, ahead: Array) -> tuple[State, Array]:
            after, _ = motion.step(state, commands[at + ahead], jnp.asarray(jnp.nan))
            return after, state.displacement

        return jax.lax.scan(advance, state, jnp.arange(1, horizon + 1))[1]

    origins = np.arange(0, count, every)
    groups = jnp.asarray(np.resize(origins, (-(-origins.size // ABREAST), ABREAST)))

    def coasted(group: Array) -> Float[Array, "g h"]:
        return jax.vmap(coast)(jax.tree.map(lambda array: array[group], states), group)

    return jax.lax.map(coasted, groups).reshape(-1, horizon)[: origins.size].T


def from_origins(ahead: np.ndarray, initial: float, horizon: int, count: int, every: int) -> np.ndarray:
    """Return the prediction of samples from `horizon` before, of the first ones from sample 0."""
    first = np.concatenate([[initial], ahead[: horizon - 1, 0]])[:count]
    rest = np.full(count - first.size, np.nan)
    rest[::every] = ahead[horizon - 1, : rest[::every].size]
    return np.concatenate([first, rest])
