"""Normal equations of integrators with lags behind each of many dead zones, in one compiled program."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid._support.precision import double_precision
from hitchid.structures import padded_length


@double_precision
def normal_equations(
    command: Float[np.ndarray, " n"],
    travel: Float[np.ndarray, " n"],
    weights: Float[np.ndarray, " n"],
    dead_zones: Float[np.ndarray, " c"],
    step_s: float,
    lags_s: Sequence[float],
) -> Float[np.ndarray, "c p p"]:
    """Return Σ z zᵀ over the samples of a test, z = [∫u, ∫u₁ … ∫u_L, w], for each dead zone.

    w is the travel, u = sign(c)·max(|c| − d, 0), and ∫uᵢ is ∫u dt filtered by a lag τᵢ, held between samples:
    x(k+1) = a x(k) + (1 − a) ∫u(k+1), a = exp(−Ts/τᵢ). A test is padded, so that those of like length share
    the program.

    Args:
        command: in its unit.
        travel: in the displacement's unit.
        weights: of each sample.
        dead_zones: d, in the command's unit.
        step_s: Ts, s.
        lags_s: τᵢ, s.
    """
    padding = (0, padded_length(command.size) - command.size)
    signals = [jnp.asarray(np.pad(np.asarray(row, float), padding)) for row in (command, travel, weights)]
    poles = jnp.exp(-step_s / jnp.asarray(lags_s))[:, None]
    return np.asarray(_sum_of_products(*signals, jnp.asarray(dead_zones), poles, jnp.asarray(step_s)))


@jax.jit
def _sum_of_products(
    command: Float[Array, " n"],
    travel: Float[Array, " n"],
    weights: Float[Array, " n"],
    dead_zones: Float[Array, " c"],
    poles: Float[Array, "l 1"],
    step_s: Float[Array, ""],
) -> Float[Array, "c p p"]:
    """Return the sums, collected sample by sample: no array has all samples of all dead zones."""
    lags = poles.shape[0]

    def advance(state: tuple[Array, Array, Array], sample: tuple) -> tuple[tuple[Array, Array, Array], None]:
        integral, lagged, sums = state
        command_now, travel_now, weight = sample
        lagged = poles * lagged + (1 - poles) * integral
        rows = jnp.concatenate([integral[None], lagged, jnp.broadcast_to(travel_now, (1, dead_zones.size))])
        sums = sums + weight * rows[:, None] * rows[None]
        effective = jnp.sign(command_now) * jnp.maximum(jnp.abs(command_now) - dead_zones, 0.0)
        return (integral + step_s * effective, lagged, sums), None

    zeros = jnp.zeros((lags + 2, lags + 2, dead_zones.size))
    sums = jax.lax.scan(advance, (zeros[0, 0], zeros[0, :lags], zeros), (command, travel, weights))[0][2]
    return jnp.moveaxis(sums, 2, 0)
