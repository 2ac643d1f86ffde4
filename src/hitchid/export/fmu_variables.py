"""Variables of an FMU: inputs, parameters and outputs of a model, with units."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from hitchid._support.inert import identifiers
from hitchid.data.record import COMMAND
from hitchid.export.c_templates import Field, number
from hitchid.export.constants import ModelConstants

Kind = Literal["real", "integer", "boolean"]
Causality = Literal["independent", "input", "parameter", "output"]
TYPE_CODES: dict[Kind, int] = {"real": 0, "integer": 1, "boolean": 2}
SETTABLE = {("parameter", "fixed"): 1, ("parameter", "tunable"): 2, ("input", "discrete"): 2}


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU.

    Attributes:
        name: as the importing tool shows it.
        symbol: in the generated code.
        kind, causality, variability: as the standard names them.
        description: for the user.
        unit: of the model, empty for none.
        start: value before the start; of an output that the FMU computes, what it computes by default.
    """

    name: str
    symbol: str
    kind: Kind
    causality: Causality
    variability: str
    description: str
    unit: str = ""
    start: float = 0.0

    @property
    def type_code(self) -> int:
        """Type in the generated code."""
        return TYPE_CODES[self.kind]

    @property
    def settable(self) -> int:
        """When it may be set: 0 never, 1 before initialisation ends, 2 always."""
        return SETTABLE.get((self.causality, self.variability), 0)

    @property
    def start_text(self) -> str:
        """Start value in C."""
        return number(self.start, "double")


def fmu_variables(
    model: ModelConstants, parameters: Sequence[Field], start: float, *, with_time: bool
) -> tuple[Variable, ...]:
    """Return the variables of an FMU in the order of their value references.

    Args:
        model: numbers of the model.
        parameters: that may be tuned.
        start: displacement at the start, by default.
        with_time: whether time is a variable, as FMI 3 requires.
    """
    return tuple(_variables(model, parameters, start, with_time=with_time))


def _variables(
    model: ModelConstants, parameters: Sequence[Field], start: float, *, with_time: bool
) -> Iterable[Variable]:
    unit = model.units["displacement"]
    if with_time:
        yield Variable("time", "TIME", "real", "independent", "continuous", "Simulation time", "s")
    for channel in model.channels:
        name = COMMAND[channel.name]
        yield _input(name, f"Command of {channel.name}", model.units.get(name, "1"))
    yield _input("displacement_measured", "Measured displacement, where it is valid", unit, start)
    yield Variable(
        "measurement_valid",
        "MEASUREMENT_VALID",
        "boolean",
        "input",
        "discrete",
        "Whether there is a measured displacement",
    )
    yield _parameter("displacement_start", "Displacement at the start", unit, start)
    names = identifiers(model.covariates)
    for name, covariate, mean in zip(names, model.covariates, model.mean_load, strict=True):
        described = f"{covariate} before motion; its mean in the tests by default"
        yield _parameter(f"load_{name}", described, model.units.get(covariate, "1"), mean)
    for field in parameters:
        unit_of_field = _unit_of(field.name, model)
        yield Variable(
            field.name,
            field.name.upper(),
            "real",
            "parameter",
            "tunable",
            field.name.replace("_", " ").capitalize(),
            unit_of_field,
            field.value,
        )
    yield _output("displacement", "real", "Displacement", unit, start)
    mode = float(model.channels[0].command) if len(model.channels) == 1 else -1.0
    yield _output("mode", "integer", "Direction in charge: 0 lifting, 1 lowering, -1 none yet", "", mode)
    flags = "Sum of 1: command missing, 2: not measured, 4: both valves, 8: restarted"
    yield _output("flags", "integer", flags, "", 0.0)
    if model.has_bands:
        described = "Half width of the 90 % band; negative before the first measured displacement"
        yield _output("half_width", "real", described, unit, -1.0)


def _input(name: str, description: str, unit: str, start: float = 0.0) -> Variable:
    return Variable(name, name.upper(), "real", "input", "discrete", description, unit, start)


def _parameter(name: str, description: str, unit: str, start: float) -> Variable:
    return Variable(name, name.upper(), "real", "parameter", "fixed", description, unit, start)


def _output(name: str, kind: Kind, description: str, unit: str, start: float) -> Variable:
    return Variable(name, name.upper(), kind, "output", "discrete", description, unit, start)


def _unit_of(parameter: str, model: ModelConstants) -> str:
    if parameter.endswith("_gain_factor"):
        return "1"
    if parameter.endswith("_dead_zone"):
        return model.units.get(COMMAND[parameter.removesuffix("_dead_zone")], "1")
    return model.units["displacement"]
