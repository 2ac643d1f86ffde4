"""Nonlinear structures: a vector field, integrated by the classical Runge-Kutta method."""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.structures.discretisation import Scalar
from hitchid.structures.limited import limited
from hitchid.structures.structure import Parameter, Scale, Structure


class NonlinearStructure(Structure):
    """A model from the command as logged to displacement, ẋ = f(x, u); its first state is the displacement.

    Attributes:
        substeps: steps of integration in one sample.
    """

    uses_raw_command: ClassVar[bool] = True
    substeps: ClassVar[int]

    @abc.abstractmethod
    def init_state(self, values: Float[Array, " p"], displacement: Float[Array, " t"]) -> Float[Array, "n t"]:
        """Return the state before the first sample of each of T tests, shape [n, T]."""

    @abc.abstractmethod
    def vector_field(
        self, values: Float[Array, " p"], state: Float[Array, "n t"], command: Float[Array, " t"]
    ) -> Float[Array, "n t"]:
        """Return the state's rate of change, shape [n, T]."""


@eqx.filter_jit
def simulate_nonlinear(
    structure: NonlinearStructure,
    values: Float[Array, " p"],
    command: Float[Array, "t n"],
    displacement: Float[Array, " t"],
    step_s: Scalar,
) -> Float[Array, "t n"]:
    """Return displacement at every sample, the command held between samples, shape [T, N].

    The classical method of fourth order, `substeps` steps a sample.
    """

    def advance(state: Array, u: Array) -> tuple[Array, Array]:
        return rk4_step(structure, values, state, u, step_s), state[0]

    return jax.lax.scan(advance, structure.init_state(values, displacement), command.T)[1].T


def rk4_step(
    structure: NonlinearStructure,
    values: Float[Array, " p"],
    state: Float[Array, "n t"],
    command: Float[Array, " t"],
    step_s: Scalar,
) -> Float[Array, "n t"]:
    """Return the state one sample later, the command held; see `simulate_nonlinear`."""
    width = step_s / structure.substeps

    def step(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        state, u = carry
        first = structure.vector_field(values, state, u)
        second = structure.vector_field(values, state + 0.5 * width * first, u)
        third = structure.vector_field(values, state + 0.5 * width * second, u)
        fourth = structure.vector_field(values, state + width * third, u)
        return state + width / 6 * (first + 2 * (second + third) + fourth), u

    return jax.lax.fori_loop(0, structure.substeps, step, (state, command))[0]


# A mass moved by a force against friction: electric axes, and cylinders commanded in force.

# Shares of the speed at which viscous friction equals Coulomb friction: v₀ and v₁.
SIGN_SMOOTHING, STRIBECK = 0.01, 0.2


class InertiaWithFriction(NonlinearStructure):
    """Double integrator with viscous and Coulomb friction, both unequal in the two directions.

    With the speed v = ẋ and the smooth sign g = tanh(v/v₀),

        ẍ = K (u − o − g (c + s exp(−(v/v₁)²))) − (B + a g) v,  ȯ = d abs(v)

    c is Coulomb friction, s what static friction has beyond it, o an offset that changes by d with the
    distance travelled, as guides and amplifiers warm up with use; time is no input. v₀ is 1 % and v₁ 20 % of
    the speed K c/B at which viscous friction equals Coulomb friction. Friction of this form:
    Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083, sec. 2.
    """

    name: ClassVar[str] = "inertia-with-friction"
    formula: ClassVar[str] = "ẍ = K (u - o - sgn(ẋ) (c + s exp(-(ẋ/v₁)²))) - (B + a sgn(ẋ)) ẋ, ȯ = d |ẋ|"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("gain", "{x}/(s²·{u})", 1.0, 1000.0, scale=Scale.SPEED),
        Parameter("viscous_friction", "1/s", 0.2, 20.0),
        Parameter("coulomb_friction", "{u}", 0.01, 1.0, scale=Scale.COMMAND),
        Parameter("offset", "{u}", -0.2, 0.2, scale=Scale.COMMAND, linear=True),
        Parameter("asymmetry", "1/s", -1.0, 1.0, linear=True),
        Parameter("static_friction", "{u}", -0.1, 0.1, scale=Scale.COMMAND, linear=True),
        # At its bounds the offset changes by 1 % of the largest command over one range of displacement.
        Parameter(
            "offset_per_travel",
            "{u}/{x}",
            -0.01,
            0.01,
            scale=Scale.COMMAND_PER_TRAVEL,
            linear=True,
            symbol="d",
        ),
        Parameter("initial_speed", "{x}/s", -0.1, 0.1, scale=Scale.TRAVEL, linear=True),
    )
    substeps: ClassVar[int] = 1
    local_starts: ClassVar[int] = 3

    def init_state(self, values: Float[Array, " p"], displacement: Float[Array, " t"]) -> Float[Array, "n t"]:
        """Return displacement, speed and offset before the first sample."""
        one = jnp.ones_like(displacement)
        return jnp.stack([displacement, values[7] * one, values[3] * one])

    def vector_field(
        self, values: Float[Array, " p"], state: Float[Array, "n t"], command: Float[Array, " t"]
    ) -> Float[Array, "n t"]:
        """Return speed, acceleration and the rate of the offset."""
        gain, viscous, coulomb, _, asymmetry, static, offset_per_travel, _ = values
        _, speed, offset = state
        equal_friction_speed = gain * coulomb / viscous
        sign = jnp.tanh(speed / (SIGN_SMOOTHING * equal_friction_speed))
        dry = sign * (coulomb + static * jnp.exp(-((speed / (STRIBECK * equal_friction_speed)) ** 2)))
        acceleration = gain * (command - offset - dry) - (viscous + asymmetry * sign) * speed
        return jnp.stack([speed, acceleration, offset_per_travel * jnp.abs(speed)])


# Two tanks, one above the other, filled by a pump, that overflow: levels under gravity flow.

UPPER_BRIM, LOWER_BRIM = 0.005, 0.002  # share of a full tank over which overflow sets in; it smooths the edge
EMPTY = 1e-7  # share of a full tank below which the outflow law is held: the root has no derivative at zero


class CascadedTanks(NonlinearStructure):
    """Two tanks in cascade, emptied by the square root of their levels, the upper spilling into the lower.

    With the levels ξ = 1 where a tank is full, the brim h₂ of the lower tank in the displacement's unit, and
    over = max(k u − a₁√ξ₁, 0) where the upper tank is full:

        ξ̇₁ = k u − a₁√ξ₁ − over
        ξ̇₂ = b√ξ₁ + s·over − a₂√ξ₂ − l ξ₂, not rising where the lower tank is full
        x = h₂ ξ₂

    The correction l is negative where the lower outflow grows more slowly than the square root of the level.
    Free outflow: Torricelli's law; overflow as in Schoukens et al., Workshop on Nonlinear System
    Identification Benchmarks, 2016.
    """

    name: ClassVar[str] = "cascaded-tanks"
    formula: ClassVar[str] = "dξ₁/dt = k u - a₁√ξ₁ - over, dξ₂/dt = b√ξ₁ + s·over - a₂√ξ₂ - l ξ₂"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("inflow", "1/(s·{u})", 1e-3, 0.03),
        Parameter("upper_outflow", "1/s", 3e-4, 0.1),
        Parameter("transfer", "1/s", 3e-3, 0.1),
        Parameter("lower_outflow", "1/s", 3e-3, 0.1),
        Parameter("outflow_correction", "1/s", -0.02, 0.02, linear=True),
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
        inflow, upper_outflow, transfer, lower_outflow, rate, spill, _, brim = values
        upper, lower = limited(state[1], EMPTY), limited(state[0] / brim, EMPTY)
        outflow = upper_outflow * jnp.sqrt(upper)
        full = jax.nn.sigmoid((upper - 1) / UPPER_BRIM)
        overflow = full * limited(inflow * command - outflow, 0.0)
        net = transfer * jnp.sqrt(upper) + spill * overflow - lower_outflow * jnp.sqrt(lower) - rate * lower
        blocked_rise = jax.nn.sigmoid((lower - 1) / LOWER_BRIM) * limited(net, 0.0)
        return jnp.stack([brim * (net - blocked_rise), inflow * command - outflow - overflow])
