"""Steady state of a physical model: opening command, steady speed, and the command for a speed."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.physical_model import PhysicalModel

Scalar = Float[Array, ""] | float


def opening_command(physical_model: PhysicalModel, dead_zone: Scalar) -> Float[Array, ""]:
    """Return the command at which flow begins, d₀ + U max(d, 0), in the command's unit."""
    if physical_model.nonlinearity is None:
        return jnp.asarray(dead_zone)
    return dead_zone + physical_model.nonlinearity.opening_command


def steady_speed(
    physical_model: PhysicalModel,
    levels: Float[Array, "*q"],
    dead_zone: Scalar,
    displacement: Scalar | Float[Array, "*q"],
) -> Float[Array, "*q"]:
    """Return K w(c − d₀) g(x): the speed at constant command after the transients, from rest.

    A structure without an integrator reaches a position instead: the speed is that at its start.

    Args:
        physical_model: of a linear structure, at its load.
        levels: command as logged, c; the speed has its sign.
        dead_zone: d₀, in the command's unit.
        displacement: x; without effect in a model without a gain along the stroke.
    """
    effective_command = jnp.sign(levels) * jnp.maximum(jnp.abs(levels) - dead_zone, 0.0)
    nonlinearity = physical_model.nonlinearity
    if nonlinearity is None:
        return physical_model.gain * effective_command
    stroke_gain = nonlinearity.gain(jnp.broadcast_to(displacement, levels.shape))
    return physical_model.gain * nonlinearity.flow(effective_command) * stroke_gain


@eqx.filter_jit
def speeds_at(
    physical_model: PhysicalModel,
    levels: Float[Array, " q"],
    displacements: Float[Array, " q"],
    loads: Float[Array, "q c"],
    dead_zone: Scalar,
) -> Float[Array, " q"]:
    """Return the steady speed of each command, displacement and load; see `steady_speed`, shape [Q]."""

    def speed(level: Array, displacement: Array, load: Array) -> Array:
        return steady_speed(physical_model.at_load(load), level, dead_zone, displacement)

    return jax.vmap(speed)(levels, displacements, loads)


def command_for_speed(
    physical_model: PhysicalModel,
    speeds: Float[Array, " q"],
    dead_zone: Scalar,
    displacement: Scalar,
) -> Float[Array, " q"]:
    """Return the command c ≥ d₀ of each speed, the inverse of `steady_speed`; for zero the opening command.

    Not finite for a speed above that of a saturated valve.

    Args:
        physical_model: of a linear structure, at its load.
        speeds: at least zero, in the direction of the command.
        dead_zone, displacement: as in `steady_speed`.
    """
    nonlinearity = physical_model.nonlinearity
    if nonlinearity is None:
        return dead_zone + speeds / physical_model.gain
    flow = speeds / (physical_model.gain * nonlinearity.gain(jnp.asarray(displacement)))
    moving = dead_zone + nonlinearity.command_for_flow(flow)
    return jnp.where(speeds > 0, moving, opening_command(physical_model, dead_zone))
