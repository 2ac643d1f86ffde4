"""Pure integrator: speed follows the command at once."""

from collections.abc import Mapping
from math import hypot, pi, sqrt
from types import MappingProxyType
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.structure import DryFriction, LinearStructure, Parameter, Scale

GAIN = Parameter("gain", "{x}/(s·{u})", 1 / 100, 100.0, scale=Scale.SPEED, symbol="K")


class Integrator(LinearStructure):
    """Integrator with gain, G(s) = K / s."""

    name: ClassVar[str] = "integrator"
    formula: ClassVar[str] = "K / s"
    parameters: ClassVar[tuple[Parameter, ...]] = (GAIN,)

    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B; the state is the displacement."""
        return jnp.zeros((1, 1), values.dtype), values[:1]

    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of K / s."""
        return [values[0]], [1.0, 0.0]


# Integrator with first-order lag: speed follows the command with one time constant.


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


# Integrator with second-order lag: the lifting benchmark of the method.

LAG = "lag 2ξh/ωh"


class IntegratorSecondOrder(LinearStructure):
    """Integrator with second-order lag, G(s) = K / (s (s²/ωh² + 2 ξh s/ωh + 1)).

    Of the four coefficients α₁ / (β₁ s³ + β₂ s² + β₃ s) of Sun et al. 2025, sec. 2.2.2, one is a free
    scale; K, ωh and ξh are what can be identified.
    """

    name: ClassVar[str] = "integrator-second-order"
    formula: ClassVar[str] = "K / (s (s²/ωh² + 2 ξh s/ωh + 1))"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        GAIN,
        Parameter("natural_frequency", "rad/s", 0.5, 1000.0, symbol="ωh"),
        # At 0.05 an oscillation halves in 2.2 periods; the verdict names a bound that is met.
        Parameter("damping_ratio", "1", 0.05, 50.0, symbol="ξh"),
    )
    load_dynamics: ClassVar[tuple[str, ...]] = ("natural_frequency", "damping_ratio")
    fallback_quantity: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"natural_frequency": LAG, "damping_ratio": LAG}
    )

    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B; the states are displacement, speed, and acceleration over ωh."""
        gain, omega, damping = values
        zero = jnp.zeros_like(gain)
        return (
            jnp.array([[zero, zero + 1, zero], [zero, zero, omega], [zero, -omega, -2 * damping * omega]]),
            jnp.array([zero, zero, gain * omega]),
        )

    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of K / (s³/ωh² + 2 ξh s²/ωh + s)."""
        gain, omega, damping = values
        return [gain], [1 / omega**2, 2 * damping / omega, 1.0, 0.0]

    def derived(self, values: tuple[float, ...]) -> dict[str, tuple[float, str]]:
        """Return the lag 2 ξh/ωh, the bandwidth of the speed, and the paper's α₁, β₁, β₂ for β₃ = 1.

        At the bandwidth the speed's amplitude is 1/√2 of that at rest: with c = 1 − 2 ξh²,
        ω = ωh √(c + √(c² + 1)).
        """
        (alpha1,), (beta1, beta2, _, _) = self.transfer_function(values)
        _, omega, damping = values
        c = 1 - 2 * damping**2
        # c + √(c² + 1), where c is far below zero without losing its digits.
        square = c + hypot(c, 1) if c > 0 else 1 / (hypot(c, 1) - c)
        return {
            LAG: (beta2, "s"),
            "bandwidth": (omega * sqrt(square) / (2 * pi), "Hz"),
            "alpha1 (beta3 = 1)": (alpha1, "{x}/(s·{u})"),
            "beta1 (beta3 = 1)": (beta1, "s²"),
            "beta2 (beta3 = 1)": (beta2, "s"),
        }


# Integrator with second-order lag and dry friction of the load.

REVERSALS = "strokes that start from rest or reverse"  # what a test must contain to determine friction


class IntegratorSecondOrderFriction(IntegratorSecondOrder):
    """Integrator with second-order lag whose mass slides with dry (Coulomb) friction.

    v̇ = a − δ ωh² φ, ȧ = ωh² (K u − v) − 2 ξh ωh v̇, where a is the acceleration by the pressure, δ the
    displacement by which the friction force compresses the oil column, and φ the share of the friction force
    that acts, against positive travel: sign(v) in motion, between −1 and 1 at rest. Before motion it is φ₀:
    −1 where the load came to rest against the direction of travel, +1 where it came to rest along it.
    """

    name: ClassVar[str] = "integrator-second-order-friction"
    formula: ClassVar[str] = "K / (s (s²/ωh² + 2 ξh s/ωh + 1)) with dry friction δ ωh² sign(v)"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *IntegratorSecondOrder.parameters,
        # Share of the range of displacement: a millionth is far below any sensor, a tenth far above any seal.
        Parameter(
            "friction_travel", "{x}", 1e-6, 0.1, scale=Scale.TRAVEL, symbol="δ", excitation_hint=REVERSALS
        ),
        Parameter("friction_at_rest", "1", -1.0, 1.0, linear=True, symbol="φ₀", excitation_hint=REVERSALS),
    )

    has_dry_friction: ClassVar[bool] = True

    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B without friction; the states are displacement, speed, and a over ωh."""
        return super().state_space(values[:3])

    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator without friction; see `IntegratorSecondOrder`."""
        return super().transfer_function(values[:3])

    def derived(self, values: tuple[float, ...]) -> dict[str, tuple[float, str]]:
        """Return the derived quantities of the linear part; see `IntegratorSecondOrder`."""
        return super().derived(values[:3])

    def dry_friction(self, values: Float[Array, " p"]) -> DryFriction:
        """Return the friction's input vector, and the share of it that acts before motion."""
        _, omega, damping, travel, at_rest = values
        acceleration = travel * omega**2
        return DryFriction(jnp.stack([0 * omega, -acceleration, 2 * damping * acceleration]), at_rest)

    def state_at_speed(self, values: Float[Array, " p"], speed: Float[Array, ""]) -> Float[Array, " n"]:
        """Return the state at travel zero and a speed, its pressure in balance with the friction."""
        _, omega, _, travel, at_rest = values
        share = jnp.where(speed == 0, at_rest, jnp.sign(speed))
        return jnp.stack([jnp.zeros_like(speed), speed, travel * omega * share])


# Integrator with second-order lag and dry friction, its natural frequency varying along the stroke.


class IntegratorSecondOrderStroke(IntegratorSecondOrderFriction):
    """Integrator with second-order lag and dry friction, its natural frequency ω = ωh exp(c ξ).

    v̇ = ω q − δ ω² φ, q̇ = ω (K u − v) − 2 ξh v̇: as in `IntegratorSecondOrderFriction`, with a = ω q. ξ is the
    displacement in half ranges from the middle of its range. The volume of oil under the piston and
    the lever between load and piston change along the stroke, and with them the stiffness of the oil column
    and the mass that it carries (Merritt 1967, Hydraulic Control Systems, sec. 6-2). The damping ratio and
    the displacement by which the friction force compresses the oil are taken to stay.
    """

    name: ClassVar[str] = "integrator-second-order-stroke"
    formula: ClassVar[str] = f"{IntegratorSecondOrderFriction.formula} and ωh = ω₀ exp(c ξ) along the stroke"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *IntegratorSecondOrderFriction.parameters,
        # At one, the frequency is e² times as high at one end of the range as at the other.
        Parameter(
            "frequency_slope",
            "1",
            -1.0,
            1.0,
            linear=True,
            symbol="c",
            excitation_hint="tests over more of the stroke",
        ),
    )
    varies_along_stroke: ClassVar[bool] = True

    def dry_friction(self, values: Float[Array, " p"]) -> DryFriction:
        """Return the friction in the middle of the stroke; see `IntegratorSecondOrderFriction`."""
        return super().dry_friction(values[:-1])

    def state_at_speed(self, values: Float[Array, " p"], speed: Float[Array, ""]) -> Float[Array, " n"]:
        """Return the state in the middle of the stroke; see `IntegratorSecondOrderFriction`."""
        return super().state_at_speed(values[:-1], speed)

    def values_at(self, values: Float[Array, " p"], position: Float[Array, ""]) -> Float[Array, " p"]:
        """Return the parameters with the natural frequency of a place on the stroke."""
        return values.at[1].multiply(jnp.exp(values[-1] * position))


# First-order lag: the lowering benchmark of the method.


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
