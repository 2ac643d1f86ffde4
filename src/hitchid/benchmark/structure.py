"""What a benchmark structure is: identifiable parameters, a state space, a transfer function."""

import abc
from typing import ClassVar, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float


class Parameter(NamedTuple):
    """One identifiable parameter.

    Attributes:
        name: the field's word for it.
        unit: unit with `{x}` for the displacement's and `{u}` for the command's.
        lower, upper: default search bounds; for a parameter in units of speed per command they are factors
            on the mean speed per command of the data, for a time or frequency they are absolute.
        relative: whether the bounds are such factors.
        linear: whether it is searched between its bounds as it is, not by its logarithm.
    """

    name: str
    unit: str
    lower: float
    upper: float
    relative: bool = False
    linear: bool = False


DEAD_TIME = Parameter("dead_time", "s", 1e-4, 1.0)


class Structure(eqx.Module):
    """A linear model from effective command to displacement away from its start.

    Every parameter is positive. Output is the first state.
    """

    name: ClassVar[str]
    formula: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]

    @abc.abstractmethod
    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B of ẋ = A x + B u, y = x₁ (s, displacement's unit, command's unit)."""

    @abc.abstractmethod
    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of G(s), highest power first."""

    def derived(self, values: tuple[float, ...]) -> dict[str, tuple[float, str]]:
        """Return quantities computed from the parameters: name to value and unit template."""
        return {}
