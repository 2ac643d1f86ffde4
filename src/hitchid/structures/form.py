"""What is searched for one direction: a structure, and which curves stand around it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.errors import InputError
from hitchid.structures.physical_model import Benchmark
from hitchid.structures.shape import CURVE, LOAD, NEUTRAL, POSITION, SHAPE, SLOPE, SPOOL, Scales, Shape
from hitchid.structures.structure import DEAD_TIME, LinearStructure, Parameter, Structure


@dataclass(frozen=True)
class Form:
    """What is searched for one direction.

    Attributes:
        structure: the benchmark's form.
        dead_time: whether a dead time is searched too.
        curve: whether the valve's opening, exponent and saturation are.
        spool: whether hysteresis and lag of the valve's spool are.
        slope: whether a gain that grows or falls evenly along the stroke is. Tests of one plant differ by
            loads that nobody measures; so that these are not taken for it, each test may then be faster or
            slower by a factor of its own while parameters are found.
        position: whether a gain that varies along the stroke in any way is, slope and curve.
        load: name of a second measured input that shifts the opening and scales the gain; None for none.
        bounds: parameter name to lower and upper bound, in its unit, where the default will not do.
    """

    structure: Structure
    dead_time: bool = False
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict, hash=False)
    curve: bool = False
    spool: bool = False
    slope: bool = False
    position: bool = False
    load: str | None = None

    def __post_init__(self) -> None:
        """Refuse curves around what is not linear, and bounds that do not fit."""
        around = self.dead_time or bool(self.shaped)
        if around and not isinstance(self.structure, LinearStructure):
            raise InputError(
                f"'{self.structure.name}' stands alone; required no dead time, curve, spool, slope, position "
                "or load beside it"
            )
        known = {parameter.name: parameter for parameter in self.parameters}
        for name, (least, most) in self.bounds.items():
            if name not in known:
                raise InputError(
                    f"bounds: there is no parameter '{name}'; required one of {', '.join(known)}"
                )
            if not (known[name].linear or least > 0) or not -np.inf < least < most < np.inf:
                raise InputError(
                    f"bounds of '{name}': required 0 < lower < upper, came {least:g} and {most:g}"
                )

    @property
    def shaped(self) -> tuple[Parameter, ...]:
        """The parameters of the curves that are searched."""
        parts = (
            (self.curve, CURVE),
            (self.spool, SPOOL),
            (self.slope and not self.position, SLOPE),
            (self.position, POSITION),
            (self.load is not None, LOAD),
        )
        return tuple(parameter for asked, part in parts if asked for parameter in part)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that are searched, in their order."""
        late = (DEAD_TIME,) if self.dead_time else ()
        return (*self.structure.parameters, *self.shaped, *late)

    def benchmark(self, values: Float[Array, " q"], scales: Scales) -> Benchmark:
        """Return the benchmark with searched values; curves that are not searched are neutral.

        Args:
            values: of `parameters`, in their order.
            scales: what the curves are measured in.
        """
        count, shaped = len(self.structure.parameters), self.shaped
        dead_time = values[-1] if self.dead_time else jnp.zeros((), values.dtype)
        if not shaped:
            return Benchmark(self.structure, values[:count], dead_time)
        found = {parameter: values[count + place] for place, parameter in enumerate(shaped)}
        neutral = {parameter: NEUTRAL.get(parameter.name, 0.0) for parameter in SHAPE}
        curves = jnp.stack([jnp.asarray(found.get(p, neutral[p]), values.dtype) for p in SHAPE])
        return Benchmark(self.structure, values[:count], dead_time, Shape(curves, scales), self.load)

    def derived(self, values: np.ndarray, dead_zone: float) -> dict[str, tuple[float, str]]:
        """Return quantities that follow from searched values: name to value and unit template.

        Args:
            values: of `parameters`, in their order.
            dead_zone: of the command, in its unit.
        """
        named = dict(zip((parameter.name for parameter in self.parameters), map(float, values), strict=True))
        found = self.structure.derived(tuple(named.values())[: len(self.structure.parameters)])
        if self.spool:
            found["width of the hysteresis"] = (named["hysteresis"] * dead_zone, "{u}")
        return found
