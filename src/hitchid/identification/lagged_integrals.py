"""Normal equations of integrators with lags behind each of many dead zones, in one compiled program."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hitchid._support.precision import double_precision
from hitchid.structures import padded_length


@double_precision
def normal_equations(
    command: Float[np.ndarray, " n"],
    travel: Float[np.ndarray, " n"],
    stretch: Int[np.ndarray, " n"],
    stretches: int,
    dead_zones: Float[np.ndarray, " c"],
    step_s: float,
    lags_s: Sequence[float],
) -> Float[np.ndarray, "s c p p"]:
    """Return Σ z zᵀ over stretches of a test, z = [∫u, ∫u₁ … ∫u_L, w], for each dead zone.

    w is the travel, u = sign(c)·max(|c| − d, 0), and ∫uᵢ is ∫u dt filtered by a lag τᵢ, held between samples:
    x(k+1) = a x(k) + (1 − a) ∫u(k+1), a = exp(−Ts/τᵢ). A test is padded, so that those of like length share
    the program.

    Args:
        command: in its unit.
        travel: in the displacement's unit.
        stretch: number of the stretch that each sample belongs to; −1 for none.
        stretches: S, how many there are.
        dead_zones: d, in the command's unit.
        step_s: Ts, s.
        lags_s: τᵢ, s.
    """
    padding = (0, padded_length(command.size) - command.size)
    signals = [jnp.asarray(np.pad(np.asarray(row, float), padding)) for row in (command, travel)]
    numbers = jnp.asarray(np.pad(stretch, padding, constant_values=-1))
    poles = jnp.exp(-step_s / jnp.asarray(lags_s))[:, None]
    return np.asarray(
        _sums_of_products(*signals, numbers, jnp.asarray(dead_zones), poles, jnp.asarray(step_s), stretches)
    )


@partial(jax.jit, static_argnums=6)
def _sums_of_products(
    command: Float[Array, " n"],
    travel: Float[Array, " n"],
    stretch: Int[Array, " n"],
    dead_zones: Float[Array, " c"],
    poles: Float[Array, "l 1"],
    step_s: Float[Array, ""],
    stretches: int,
) -> Float[Array, "s c p p"]:
    """Return the sums, collected sample by sample: no array has all samples of all dead zones."""
    lags = poles.shape[0]

    def advance(state: tuple[Array, Array, Array], sample: tuple) -> tuple[tuple[Array, Array, Array], None]:
        integral, lagged, sums = state
        command_now, travel_now, number = sample
        lagged = poles * lagged + (1 - poles) * integral
        rows = jnp.concatenate([integral[None], lagged, jnp.broadcast_to(travel_now, (1, dead_zones.size))])
        products = jnp.where(number >= 0, rows[:, None] * rows[None], 0.0)
        sums = sums.at[jnp.maximum(number, 0)].add(products)
        effective = jnp.sign(command_now) * jnp.maximum(jnp.abs(command_now) - dead_zones, 0.0)
        return (integral + step_s * effective, lagged, sums), None

    zeros = jnp.zeros((stretches, lags + 2, lags + 2, dead_zones.size))
    start = (zeros[0, 0, 0], zeros[0, 0, :lags], zeros)
    sums = jax.lax.scan(advance, start, (command, travel, stretch))[0][2]
    return jnp.moveaxis(sums, 3, 1)
