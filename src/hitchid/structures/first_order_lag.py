"""First-order lag: the lowering benchmark of the method."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from jaxtyping import Array, Float

from hitchid.structures.integrator import GAIN
from hitchid.structures.structure import LinearStructure, Parameter


class FirstOrderLag(LinearStructure):
    """First-order lag, G(s) = K / (τ s + 1), searched in its initial speed per command K/τ and in τ.

    In a test much shorter than τ only K/τ can be determined (Sun et al. 2025, sec. 2.2.2, with τ ≈ 43 s in
    tests of 10 s), so K/τ is the parameter called gain, as in every other structure, and K is derived.
    """

    name: ClassVar[str] = "first-order-lag"
    formula: ClassVar[str] = "(K/τ) τ / (τ s + 1)"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        GAIN._replace(symbol="K/τ"),
        Parameter("time_constant", "s", 0.05, 1000.0, symbol="τ"),
    )
    load_dynamics: ClassVar[tuple[str, ...]] = ("time_constant",)
    fallback_quantity: ClassVar[Mapping[str, str]] = MappingProxyType({"time_constant": "gain"})

    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B; the state is the displacement."""
        gain, tau = values
        return (-1 / tau)[None, None], gain[None]

    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of K / (τ s + 1)."""
        gain, tau = values
        return [gain * tau], [tau, 1.0]

    def derived(self, values: tuple[float, ...]) -> dict[str, tuple[float, str]]:
        """Return the paper's K = α₂ and τ = β₄."""
        gain, tau = values
        return {"alpha2 = K": (gain * tau, "{x}/{u}"), "beta4 = tau": (tau, "s")}
