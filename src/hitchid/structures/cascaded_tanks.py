"""Two tanks, one above the other, filled by a pump, that overflow: levels under gravity flow."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.limited import limited
from hitchid.structures.nonlinear import NonlinearStructure
from hitchid.structures.structure import Parameter, Scale

UPPER_BRIM, LOWER_BRIM = 0.005, 0.002  # share of a full tank over which overflow sets in; it smooths the edge
EMPTY = 1e-7  # share of a full tank below which the outflow law is held: the root has no derivative at zero


class CascadedTanks(NonlinearStructure):
    """Two tanks in cascade, emptied by the square root of their levels, the upper spilling into the lower.

    With the levels ξ = 1 where a tank is full, the brim h₂ of the lower tank in the displacement's unit, and
    over = max(k u − a₁√ξ₁, 0) where the upper tank is full:

        ξ̇₁ = k u − a₁√ξ₁ − over
        ξ̇₂ = b√ξ₁ + s·over − a₂√ξ₂ − l ξ₂, not rising where the lower tank is full
        x = h₂ ξ₂

    The leak l corrects the square-root law of the lower outlet. Free outflow: Torricelli's law; overflow as
    in Schoukens et al., Workshop on Nonlinear System Identification Benchmarks, 2016.
    """

    name: ClassVar[str] = "cascaded-tanks"
    formula: ClassVar[str] = "dξ₁/dt = k u - a₁√ξ₁ - over, dξ₂/dt = b√ξ₁ + s·over - a₂√ξ₂ - l ξ₂"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("inflow", "1/(s·{u})", 1e-3, 0.03),
        Parameter("upper_outflow", "1/s", 3e-4, 0.1),
        Parameter("transfer", "1/s", 3e-3, 0.1),
        Parameter("lower_outflow", "1/s", 3e-3, 0.1),
        Parameter("leak", "1/s", -0.02, 0.02, linear=True),
        Parameter("spill", "1", 0.1, 3.0),
        Parameter("initial_upper_level", "1", 0.1, 1.0, linear=True),
        Parameter("brim", "{x}", 0.95, 1.05, scale=Scale.HIGHEST, linear=True),
    )
    substeps: ClassVar[int] = 2
    local_starts: ClassVar[int] = 8

    def init_state(self, values: Float[Array, " p"], displacement: Float[Array, " t"]) -> Float[Array, "n t"]:
        """Return the lower level, in the displacement's unit, and the upper one before the first sample."""
        return jnp.stack([displacement, values[6] * jnp.ones_like(displacement)])

    def vector_field(
        self, values: Float[Array, " p"], state: Float[Array, "n t"], command: Float[Array, " t"]
    ) -> Float[Array, "n t"]:
        """Return the rate of the lower level, in the displacement's unit, and of the upper one."""
        inflow, upper_outflow, transfer, lower_outflow, leak, spill, _, brim = values
        upper, lower = limited(state[1], EMPTY), limited(state[0] / brim, EMPTY)
        outflow = upper_outflow * jnp.sqrt(upper)
        full = jax.nn.sigmoid((upper - 1) / UPPER_BRIM)
        overflow = full * limited(inflow * command - outflow, 0.0)
        net = transfer * jnp.sqrt(upper) + spill * overflow - lower_outflow * jnp.sqrt(lower) - leak * lower
        blocked_rise = jax.nn.sigmoid((lower - 1) / LOWER_BRIM) * limited(net, 0.0)
        return jnp.stack([brim * (net - blocked_rise), inflow * command - outflow - overflow])
