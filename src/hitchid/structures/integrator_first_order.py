"""Integrator with first-order lag: speed follows the command with one time constant."""

from math import pi
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.integrator import GAIN
from hitchid.structures.structure import LinearStructure, Parameter


class IntegratorFirstOrder(LinearStructure):
    """Integrator with first-order lag, G(s) = K / (s (τ s + 1))."""

    name: ClassVar[str] = "integrator-first-order"
    formula: ClassVar[str] = "K / (s (τ s + 1))"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        GAIN,
        Parameter("time_constant", "s", 1e-3, 100.0, symbol="τ"),
    )
    load_dynamics: ClassVar[tuple[str, ...]] = ("time_constant",)

    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B; the states are displacement and speed."""
        gain, tau = values
        zero = jnp.zeros_like(gain)
        return jnp.array([[zero, zero + 1], [zero, -1 / tau]]), jnp.array([zero, gain / tau])

    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of K / (τ s² + s)."""
        gain, tau = values
        return [gain], [tau, 1.0, 0.0]

    def derived(self, values: tuple[float, ...]) -> dict[str, tuple[float, str]]:
        """Return the bandwidth of the speed."""
        return {"bandwidth": (1 / (2 * pi * values[1]), "Hz")}
