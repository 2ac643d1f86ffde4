"""The form of one direction: a structure, and the options that are identified with it."""

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.errors import InputError
from hitchid.structures.nonlinearity import (
    NEUTRAL,
    NONLINEARITY_PARAMETERS,
    SPOOL_DYNAMICS,
    STROKE_GAIN_LINEAR,
    STROKE_GAIN_QUADRATIC,
    VALVE_CURVE,
    CovariateEffects,
    Scales,
    Scheduling,
    StaticNonlinearity,
    effect_parameters,
    scheduled_quantities,
)
from hitchid.structures.physical_model import PhysicalModel
from hitchid.structures.structure import DEAD_TIME, ModelOption, Parameter, Structure


@dataclass(frozen=True)
class ModelSpec:
    """The form of one direction: what is identified.

    Attributes:
        structure: the structure.
        dead_time: whether a dead time is searched too.
        valve_curve: whether the valve's opening, exponent and saturation are.
        spool_dynamics: whether hysteresis and lag of the valve's spool are.
        stroke_gain_linear: whether a gain that grows or falls evenly along the stroke is. So that loads that
            are not measured and differ from test to test are not taken for it, each test then has a factor on
            its speed during estimation.
        stroke_gain_quadratic: whether a gain that varies along the stroke in any way is, slope and curve.
        covariates: measured inputs that parameters vary with, and what each changes.
        without: names of parameters of these options that the form goes without: each has no effect.
        bounds: parameter name to lower and upper bound, in its unit, where the default will not do.
    """

    structure: Structure
    dead_time: bool = False
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict, hash=False)
    valve_curve: bool = False
    spool_dynamics: bool = False
    stroke_gain_linear: bool = False
    stroke_gain_quadratic: bool = False
    covariates: tuple[CovariateEffects, ...] = ()
    without: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse options that the structure does not take, and bounds that do not fit."""
        refused = [option.value for option in ModelOption if option in self.options - self.structure.options]
        if refused:
            raise InputError(
                f"structure '{self.structure.name}' has no {' and no '.join(refused)}; "
                "choose another structure"
            )
        if isinstance(self.without, str):
            raise InputError(f"without: expected a sequence of names, got {self.without!r}")
        object.__setattr__(self, "without", tuple(sorted(set(self.without))))
        optional = replace(self, without=())._curves_and_effects() if self.without else frozenset()
        for name in self.without:
            if name in optional:
                continue
            expected = ", ".join(sorted(optional)) or "none, for there are no curves and no covariates"
            raise InputError(f"without: there is no parameter '{name}' of an option; expected {expected}")
        by_name = {parameter.name: parameter for parameter in self.parameters}
        for name, (lower, upper) in self.bounds.items():
            if name not in by_name:
                raise InputError(
                    f"bounds: there is no parameter '{name}'; expected one of {', '.join(by_name)}"
                )
            if not (by_name[name].linear or lower > 0) or not -np.inf < lower < upper < np.inf:
                raise InputError(
                    f"bounds of '{name}': expected 0 < lower < upper, got {lower:g} and {upper:g}"
                )

    @property
    def options(self) -> frozenset[ModelOption]:
        """The options that are identified."""
        enabled = {
            ModelOption.DEAD_TIME: self.dead_time,
            ModelOption.VALVE_CURVE: self.valve_curve,
            ModelOption.SPOOL_DYNAMICS: self.spool_dynamics,
            ModelOption.STROKE_GAIN: self.stroke_gain_linear or self.stroke_gain_quadratic,
            ModelOption.COVARIATES: bool(self.covariates),
        }
        return frozenset(option for option, is_enabled in enabled.items() if is_enabled)

    def with_structure(self, structure: Structure) -> "ModelSpec":
        """Return the form with another structure and those of the options that it takes."""
        taken = structure.options
        has_stroke_gain = ModelOption.STROKE_GAIN in taken
        spec = ModelSpec(
            structure,
            dead_time=self.dead_time and ModelOption.DEAD_TIME in taken,
            valve_curve=self.valve_curve and ModelOption.VALVE_CURVE in taken,
            spool_dynamics=self.spool_dynamics and ModelOption.SPOOL_DYNAMICS in taken,
            stroke_gain_linear=self.stroke_gain_linear and has_stroke_gain,
            stroke_gain_quadratic=self.stroke_gain_quadratic and has_stroke_gain,
            covariates=self.covariates if ModelOption.COVARIATES in taken else (),
        )
        option_names = {parameter.name for parameter in spec.parameters} - {
            p.name for p in structure.parameters
        }
        without = tuple(name for name in self.without if name in option_names)
        bounds = {name: self.bounds[name] for name in option_names.difference(without) & self.bounds.keys()}
        return replace(spec, bounds=bounds, without=without)

    def limited_to(self, names: Set[str]) -> "ModelSpec":
        """Return the smallest form that has those of this one's optional parameters that are named."""
        kept = {parameter.name for parameter in self.parameters} & names
        scheduled = {effects: {p.name for p in self._effects(effects)} for effects in self.covariates}
        curved, played = ({p.name for p in group} for group in (VALVE_CURVE, SPOOL_DYNAMICS))
        slope, curve = (parameter.name for parameter in STROKE_GAIN_QUADRATIC)
        own = {parameter.name for parameter in self.structure.parameters}
        smallest = replace(
            self,
            dead_time=DEAD_TIME.name in kept,
            valve_curve=bool(curved & kept),
            spool_dynamics=bool(played & kept),
            stroke_gain_linear=slope in kept and curve not in kept,
            stroke_gain_quadratic=curve in kept,
            covariates=tuple(
                effects.limited_to(self.structure.require_linear(), kept)
                for effects, effect_names in scheduled.items()
                if effect_names & kept
            ),
            bounds={name: limits for name, limits in self.bounds.items() if name in kept | own},
            without=(),
        )
        return replace(smallest, without=tuple(smallest._curves_and_effects() - kept))

    @property
    def covariate_names(self) -> tuple[str, ...]:
        """Names of the covariates, in their order."""
        return tuple(effects.covariate for effects in self.covariates)

    @property
    def nonlinearity_parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the curves that are searched."""
        groups = (
            (self.valve_curve, VALVE_CURVE),
            (self.spool_dynamics, SPOOL_DYNAMICS),
            (self.stroke_gain_linear and not self.stroke_gain_quadratic, STROKE_GAIN_LINEAR),
            (self.stroke_gain_quadratic, STROKE_GAIN_QUADRATIC),
        )
        return self._with_effect(parameter for enabled, group in groups if enabled for parameter in group)

    @property
    def covariate_parameters(self) -> tuple[Parameter, ...]:
        """The effects of the covariates that are searched."""
        return self._with_effect(p for effects in self.covariates for p in self._effects(effects))

    def _curves_and_effects(self) -> frozenset[str]:
        return frozenset(p.name for p in (*self.nonlinearity_parameters, *self.covariate_parameters))

    def _effects(self, effects: CovariateEffects) -> tuple[Parameter, ...]:
        return effects.parameters(self.structure.require_linear())

    def _with_effect(self, parameters: Iterable[Parameter]) -> tuple[Parameter, ...]:
        return tuple(parameter for parameter in parameters if parameter.name not in self.without)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that are searched, in their order."""
        delay = (DEAD_TIME,) if self.dead_time else ()
        return (*self.structure.parameters, *self.nonlinearity_parameters, *self.covariate_parameters, *delay)

    def physical_model(self, values: Float[Array, " q"], scales: Scales) -> PhysicalModel:
        """Return the benchmark with searched values; options that are not identified are neutral.

        Args:
            values: of `parameters`, in their order.
            scales: of the nonlinearities.
        """
        structure, count = self.structure, len(self.structure.parameters)
        dead_time = values[-1] if self.dead_time else jnp.zeros((), values.dtype)
        needs_curves = structure.linear is not None and structure.linear.varies_along_stroke
        if not (self.nonlinearity_parameters or self.covariates or needs_curves):
            return PhysicalModel(structure, values[:count], dead_time)
        searched = dict(zip((parameter.name for parameter in self.parameters), values, strict=True))

        def stacked(parameters: Sequence[Parameter]) -> Float[Array, " p"]:
            """Return the values of parameters, neutral ones where they are not searched."""
            neutral = (searched.get(p.name, NEUTRAL.get(p.name, 0.0)) for p in parameters)
            return jnp.stack([jnp.asarray(value, values.dtype) for value in neutral])

        curves = StaticNonlinearity(stacked(NONLINEARITY_PARAMETERS), scales)
        if not self.covariates:
            return PhysicalModel(structure, values[:count], dead_time, curves)
        linear, names = structure.require_linear(), self.covariate_names
        quantities = scheduled_quantities(linear)
        effects = stacked(effect_parameters(linear, names)).reshape(len(quantities), len(names), -1)
        scheduling = Scheduling(names, quantities, effects)
        return PhysicalModel(structure, values[:count], dead_time, curves, scheduling)

    def has_lag(self, values: np.ndarray) -> bool:
        """Return whether the speed follows the command with a lag, given the searched values."""
        linear = self.structure.linear
        if linear is None or (self.spool_dynamics and "spool_lag" not in self.without):
            return True
        _, inputs = linear.state_space(jnp.asarray(values[: len(linear.parameters)]))
        return bool(inputs[0] == 0)

    def derived(self, values: np.ndarray, dead_zone: float) -> dict[str, tuple[float, str]]:
        """Return quantities that follow from searched values: name to value and unit template.

        Args:
            values: of `parameters`, in their order.
            dead_zone: of the command, in its unit.
        """
        by_name = dict(
            zip((parameter.name for parameter in self.parameters), map(float, values), strict=True)
        )
        quantities = self.structure.derived(tuple(by_name.values())[: len(self.structure.parameters)])
        if "hysteresis" in by_name:
            quantities["width of the hysteresis"] = (by_name["hysteresis"] * dead_zone, "{u}")
        return quantities
