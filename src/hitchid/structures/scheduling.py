"""Parameters that vary with measured covariates, such as the pressure before motion or oil temperature."""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.short_repr import short_repr
from hitchid.structures.structure import LinearStructure, Parameter

OPENING = "opening"  # of the valve curve: shifted, where the other quantities are multiplied
MAX_SPREADS = 3.0  # standard deviations of a covariate beyond which it has no further effect; chosen
MAX_QUADRATIC_SPREADS = 2.0  # the same for its square: about the range of twenty tests; chosen
POWERS = (1, 2)  # of a covariate
# Change per standard deviation: of the logarithm of a speed up to a factor of e, of the logarithm of a
# dynamic parameter (oil is ten times as viscous at 5 °C as at 70 °C), of an opening in largest commands.
MAX_SPEED_EFFECT, MAX_DYNAMIC_EFFECT, MAX_SHIFT = 1.0, 1.5, 0.3
LOADS = "tests at other values of the covariate"


@short_repr
@dataclass(frozen=True)
class CovariateEffects:
    """What one covariate changes.

    Attributes:
        covariate: name of the measured input.
        dynamics: whether it changes the dynamics beside the speed and the opening of the valve.
        quadratic: whether its square does, too.
    """

    covariate: str
    dynamics: bool = False
    quadratic: bool = False

    def parameters(self, structure: LinearStructure) -> tuple[Parameter, ...]:
        """Return the parameters that are identified for a structure."""
        quantities = scheduled_quantities(structure) if self.dynamics else (structure.gain, OPENING)
        powers = POWERS if self.quadratic else POWERS[:1]
        return tuple(
            effect_parameter(structure, quantity, self.covariate, power)
            for power in powers
            for quantity in quantities
        )


class CovariateScales(eqx.Module):
    """Scales of the covariates, taken from the identification tests.

    Attributes:
        centre, spread: mean and standard deviation, shape [C].
    """

    centre: Float[Array, " c"]
    spread: Float[Array, " c"]

    @classmethod
    def none(cls) -> "CovariateScales":
        """Return the scales of no covariates."""
        return cls(jnp.zeros(0), jnp.zeros(0))


@short_repr
class Scheduling(eqx.Module):
    """Effects of covariates c on the parameters of a model: θ(c) = θ·exp(β₁ᵀz + β₂ᵀz²), z = (c − c̄)/σ.

    The opening of the valve is shifted by β₁ᵀz + β₂ᵀz² instead. z is limited at ±3, in z² at ±2.

    Attributes:
        covariates: names of the measured inputs, C of them.
        quantities: names of the parameters that vary, P of them.
        effects: β₁ and β₂, shape [P, C, 2].
    """

    covariates: tuple[str, ...] = eqx.field(static=True)
    quantities: tuple[str, ...] = eqx.field(static=True)
    effects: Float[Array, "p c 2"]

    def changes(self, load: Float[Array, " c"], scales: CovariateScales) -> Float[Array, " p"]:
        """Return β₁ᵀz + β₂ᵀz² of each quantity.

        Args:
            load: the covariates, in their units.
            scales: of the covariates.
        """
        scaled = (load - scales.centre) / scales.spread
        linear = jnp.clip(scaled, -MAX_SPREADS, MAX_SPREADS)
        square = jnp.clip(scaled, -MAX_QUADRATIC_SPREADS, MAX_QUADRATIC_SPREADS) ** 2
        return self.effects[..., 0] @ linear + self.effects[..., 1] @ square


def scheduled_quantities(structure: LinearStructure) -> tuple[str, ...]:
    """Return the names of the parameters that may vary with a covariate."""
    return (structure.gain, *structure.load_dynamics, OPENING)


def effect_parameter(structure: LinearStructure, quantity: str, covariate: str, power: int) -> Parameter:
    """Return the parameter of one effect, such as `gain_by_head_pressure`."""
    limits = {structure.gain: MAX_SPEED_EFFECT, OPENING: MAX_SHIFT}
    limit = limits.get(quantity, MAX_DYNAMIC_EFFECT)
    name = f"{quantity}_by_{covariate}" + ("_squared" if power > 1 else "")
    return Parameter(name, "1", -limit, limit, linear=True, excitation_hint=LOADS)


def effect_parameters(structure: LinearStructure, covariates: Sequence[str]) -> tuple[Parameter, ...]:
    """Return the parameters of all effects, in the order of `Scheduling.effects`."""
    return tuple(
        effect_parameter(structure, quantity, covariate, power)
        for quantity in scheduled_quantities(structure)
        for covariate in covariates
        for power in POWERS
    )
