"""A single-acting cylinder against a spring, whose oil leaks back: two real lags and no integrator."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures import LinearStructure, Parameter, Scale


class LeakingCylinder(LinearStructure):
    """Two real lags, G(s) = K T / ((T s + 1)(τ s + 1)), with the initial speed per command K.

    The spring's force grows with travel, and with it pressure and leakage: without command the piston goes
    back to its start with the leak time T. Speed follows the valve with the lag τ. T and τ have bounds that
    do not overlap, for with K T as it is they could be exchanged.
    """

    name: ClassVar[str] = "leaking-cylinder"
    formula: ClassVar[str] = "K T / ((T s + 1)(τ s + 1))"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("leak_time", "s", 0.5, 1000.0, symbol="T"),
        Parameter("lag", "s", 1e-3, 0.5, symbol="τ"),
        Parameter("gain", "{x}/(s·{u})", 1 / 100, 100.0, scale=Scale.SPEED, symbol="K"),
    )

    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B; the states are displacement and speed."""
        leak_time, lag, gain = values
        zero = jnp.zeros_like(gain)
        rate = jnp.stack([-1 / (leak_time * lag), -1 / leak_time - 1 / lag])
        return jnp.stack([jnp.stack([zero, zero + 1]), rate]), jnp.stack([zero, gain / lag])

    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of K T / (T τ s² + (T + τ) s + 1)."""
        leak_time, lag, gain = values
        return [gain * leak_time], [leak_time * lag, leak_time + lag, 1.0]


LEAKING_CYLINDER = LeakingCylinder()
