"""What a structure promises: parameters, gain, linearity, options, state space and transfer function."""

import abc
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.records import short_repr
from hitchid.errors import InputError


class Scale(Enum):
    """Size taken from the tests, by which the default bounds of a parameter are multiplied."""

    NONE = "nothing: the bounds are absolute"
    SPEED = "mean speed per command"
    COMMAND = "largest command"
    TRAVEL = "range of the displacement"
    COMMAND_PER_TRAVEL = "largest command over range of displacement"
    HIGHEST = "highest displacement"


@short_repr
class Parameter(NamedTuple):
    """One identifiable parameter.

    Attributes:
        name: name in settings, reports and model folders.
        unit: unit with `{x}` for the displacement's and `{u}` for the command's.
        lower, upper: default search bounds, factors on `scale`.
        scale: size that the bounds multiply.
        linear: whether the search is linear between the bounds; otherwise it is logarithmic.
        symbol: symbol in formulas; empty for the name.
        excitation_hint: what a test must contain to determine it; empty where the unit implies it.
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: Scale = Scale.NONE
    linear: bool = False
    symbol: str = ""
    excitation_hint: str = ""


# Bounds in s: amplifiers, buses and valves answer within 1 s at any sampling time; 0.1 ms is as good as none.
DEAD_TIME = Parameter("dead_time", "s", 1e-4, 1.0, symbol="dead time")


class ModelOption(Enum):
    """Options of a model of a structure."""

    DEAD_TIME = "dead time"
    VALVE_CURVE = "valve curve"
    SPOOL_DYNAMICS = "spool dynamics"
    STROKE_GAIN = "gain along the stroke"
    COVARIATES = "measured covariates"


class Structure(eqx.Module):
    """A model from command to displacement: a subclass of `LinearStructure` or `NonlinearStructure`.

    Another package registers a structure, with default bounds that need no setting, by an entry point of the
    group `hitchid.structures`; its value is an instance.

    Attributes:
        name, formula: as in settings and reports.
        parameters: what is identified.
        gain: name of the parameter to which the speed is proportional; empty for none.
        options: options that a model of it may have.
        uses_raw_command: whether it takes the whole command, from which no dead zone is removed.
        local_starts: further random starts of the least squares, where a fit has several minima.
        fallback_quantity: parameter to the parameter or derived quantity that is reported as determined where
            it is not itself.
    """

    name: ClassVar[str]
    formula: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    gain: ClassVar[str] = ""
    options: ClassVar[frozenset[ModelOption]] = frozenset()
    uses_raw_command: ClassVar[bool] = False
    local_starts: ClassVar[int] = 0
    fallback_quantity: ClassVar[Mapping[str, str]] = MappingProxyType({})

    @property
    def linear(self) -> "LinearStructure | None":
        """The structure itself where it is linear, else None."""
        return None

    def require_linear(self) -> "LinearStructure":
        """Return the structure itself.

        Raises:
            InputError: it is not linear.
        """
        if self.linear is None:
            raise InputError(f"structure '{self.name}' is not linear; expected a linear structure")
        return self.linear

    @property
    def gain_index(self) -> int:
        """Number of the gain among the parameters; raises InputError where there is none."""
        for index, parameter in enumerate(self.parameters):
            if parameter.name == self.gain:
                return index
        raise InputError(f"structure '{self.name}' has no gain; choose a structure with a gain")

    def derived(self, values: tuple[float, ...]) -> dict[str, tuple[float, str]]:
        """Return quantities computed from the parameters: name to value and unit template."""
        return {}


@short_repr
class DryFriction(NamedTuple):
    """Dry friction as an input φ of a linear model, between −1 and 1: ẋ = A x + B u + E φ.

    Attributes:
        gains: E, shape [n].
        at_rest: φ before motion.
    """

    gains: Float[Array, " n"]
    at_rest: Float[Array, ""]


class LinearStructure(Structure):
    """A linear model from effective command to displacement away from its start.

    The output is the first state; the second, where there is one, is its rate.

    Attributes:
        has_dry_friction: whether dry friction acts on the speed, beside the linear model.
        varies_along_stroke: whether its dynamics differ from place to place; see `values_at`.
        load_dynamics: names of the parameters, all positive, that load or oil temperature may change beside
            the gain.
    """

    gain: ClassVar[str] = "gain"
    options: ClassVar[frozenset[ModelOption]] = frozenset(ModelOption)
    has_dry_friction: ClassVar[bool] = False
    varies_along_stroke: ClassVar[bool] = False
    load_dynamics: ClassVar[tuple[str, ...]] = ()

    @property
    def linear(self) -> "LinearStructure":
        """The structure itself."""
        return self

    def state_at_speed(self, values: Float[Array, " p"], speed: Float[Array, ""]) -> Float[Array, " n"]:
        """Return the state at travel zero and a given speed; with one state the speed is not part of it."""
        count = self.state_space(values)[1].shape[0]
        return jnp.zeros(count, values.dtype).at[1:2].set(speed)

    def dry_friction(self, values: Float[Array, " p"]) -> DryFriction | None:
        """Return the dry friction that acts on the speed, the second state; None where there is none."""
        del values
        return None

    def values_at(self, values: Float[Array, " p"], position: Float[Array, ""]) -> Float[Array, " p"]:
        """Return the parameters at a place on the stroke, for `state_space` and `dry_friction` there.

        Args:
            values: the parameters, those that vary in the middle of the stroke.
            position: half ranges of displacement from the middle.
        """
        del position
        return values

    @abc.abstractmethod
    def state_space(self, values: Float[Array, " p"]) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """Return A and B of ẋ = A x + B u, y = x₁ (s, displacement's unit, command's unit)."""

    @abc.abstractmethod
    def transfer_function(self, values: tuple[float, ...]) -> tuple[list[float], list[float]]:
        """Return numerator and denominator of G(s), highest power first."""
