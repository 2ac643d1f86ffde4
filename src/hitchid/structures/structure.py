"""What a benchmark structure is: identifiable parameters, a state space, a transfer function."""

import abc
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Scale(Enum):
    """What the data say of the size of a parameter, by which its default bounds are multiplied."""

    NONE = "nothing: the bounds are absolute"
    SPEED = "mean speed per command"
    COMMAND = "largest command"
    TRAVEL = "range of the displacement"
    HIGHEST = "highest displacement"


class Parameter(NamedTuple):
    """One identifiable parameter.

    Attributes:
        name: the field's word for it.
        unit: unit with `{x}` for the displacement's and `{u}` for the command's.
        lower, upper: default search bounds, factors on `scale`.
        scale: what they are factors on.
        linear: whether it is searched between its bounds as it is, not by its logarithm.
        symbol: how formulas call it; its name where there is none.
        excitation_hint: what a test that determines it must have, where its unit does not say.
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: Scale = Scale.NONE
    linear: bool = False
    symbol: str = ""
    excitation_hint: str = ""


DEAD_TIME = Parameter("dead_time", "s", 1e-4, 1.0, symbol="dead time")


class Structure(eqx.Module):
    """A model from command to displacement.

    Attributes:
        name, formula: how settings and reports call it.
        parameters: what can be identified.
        fallback_quantity: parameter to what of the others or of the derived is determined where it is not.
    """

    name: ClassVar[str]
    formula: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    fallback_quantity: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def derived(self, values: tuple[float, ...]) -> dict[str, tuple[float, str]]:
        """Return quantities computed from the parameters: name to value and unit template."""
        return {}


class LinearStructure(Structure):
    """A linear model from effective command to displacement away from its start.

    Every parameter is positive. Output is the first state; the second, where there is one, is its rate.
    """

    def state_at_speed(self, values: Float[Array, " p"], speed: Float[Array, ""]) -> Float[Array, " n"]:
        """Return the state at travel zero and a given speed; without a second state speed is none of it."""
        count = self.state_space(values)[1].shape[0]
        return jnp.zeros(count, values.dtype).at[1:2].set(speed)

    @abc.abstractmethod
    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B of ẋ = A x + B u, y = x₁ (s, displacement's unit, command's unit)."""

    @abc.abstractmethod
    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of G(s), highest power first."""
