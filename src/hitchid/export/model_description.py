"""`modelDescription.xml` of an FMU, FMI 2.0 and 3.0."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import pi
from typing import Literal, NamedTuple
from xml.etree import ElementTree

from hitchid._support.inert import identifiers, xml_bytes
from hitchid._support.jax_setup import installed_versions
from hitchid.export.c_templates import Field, number
from hitchid.export.constants import ModelConstants
from hitchid.logs.record import COMMAND

# Variables of an FMU: inputs, parameters and outputs of a model, with units.

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


Version = Literal["fmi2", "fmi3"]
Element = ElementTree.Element


class BaseUnit(NamedTuple):
    """A unit in SI units: factor, and exponents of kg, m, s, A, K and rad."""

    factor: float
    exponents: dict[str, int]


_LENGTH, _PRESSURE = {"m": 1}, {"kg": 1, "m": -1, "s": -2}
_VOLTAGE = {"kg": 1, "m": 2, "s": -3, "A": -1}
BASE_UNITS = {
    "m": BaseUnit(1.0, _LENGTH),
    "cm": BaseUnit(1e-2, _LENGTH),
    "mm": BaseUnit(1e-3, _LENGTH),
    "um": BaseUnit(1e-6, _LENGTH),
    "in": BaseUnit(0.0254, _LENGTH),
    "rad": BaseUnit(1.0, {"rad": 1}),
    "deg": BaseUnit(pi / 180, {"rad": 1}),
    "s": BaseUnit(1.0, {"s": 1}),
    "A": BaseUnit(1.0, {"A": 1}),
    "mA": BaseUnit(1e-3, {"A": 1}),
    "V": BaseUnit(1.0, _VOLTAGE),
    "mV": BaseUnit(1e-3, _VOLTAGE),
    "Pa": BaseUnit(1.0, _PRESSURE),
    "kPa": BaseUnit(1e3, _PRESSURE),
    "MPa": BaseUnit(1e6, _PRESSURE),
    "bar": BaseUnit(1e5, _PRESSURE),
    "percent": BaseUnit(1e-2, {}),
    "1": BaseUnit(1.0, {}),
    "K": BaseUnit(1.0, {"K": 1}),
    "N": BaseUnit(1.0, {"kg": 1, "m": 1, "s": -2}),
    "kN": BaseUnit(1e3, {"kg": 1, "m": 1, "s": -2}),
    "rpm": BaseUnit(pi / 30, {"s": -1, "rad": 1}),
}
TYPES = {
    "fmi2": {"real": "Real", "integer": "Integer", "boolean": "Boolean"},
    "fmi3": {"real": "Float64", "integer": "Int32", "boolean": "Boolean"},
}


def model_description(
    version: Version,
    name: str,
    token: str,
    variables: Sequence[Variable],
    step_s: float,
    sources: Sequence[str],
    description: str,
) -> bytes:
    """Return the model description of an FMU for Co-Simulation and Model Exchange.

    Args:
        version: of the standard.
        name: model identifier.
        token: GUID or instantiation token.
        variables: in the order of their value references.
        step_s: sampling time, s.
        sources: names of the C files.
        description: of the model, for the user.
    """
    is_2 = version == "fmi2"
    root = Element(
        "fmiModelDescription",
        {
            "fmiVersion": "2.0" if is_2 else "3.0",
            "modelName": name,
            "guid" if is_2 else "instantiationToken": token,
            "description": description,
            "generationTool": f"hitchid {installed_versions()['hitchid']}",
            "variableNamingConvention": "structured",
            **({"numberOfEventIndicators": "0"} if is_2 else {}),
        },
    )
    for kind in ("ModelExchange", "CoSimulation"):
        root.append(_interface(kind, name, sources, step_s, is_2=is_2))
    units = dict.fromkeys(variable.unit for variable in variables if variable.unit)
    root.append(_unit_definitions(units))
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", {"name": "logStatusError"})
    ElementTree.SubElement(root, "DefaultExperiment", {"startTime": "0", "stepSize": repr(step_s)})
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        listed.append(_variable_2(reference, variable) if is_2 else _variable_3(reference, variable))
    root.append(_structure(variables, is_2=is_2))
    return xml_bytes(root)


def build_description(name: str, sources: Sequence[str]) -> bytes:
    """Return `sources/buildDescription.xml` of FMI 3.0."""
    root = Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ElementTree.SubElement(root, "BuildConfiguration", {"modelIdentifier": name})
    files = ElementTree.SubElement(
        configuration, "SourceFileSet", {"language": "C99", "compilerOptions": "-ffp-contract=off"}
    )
    for source in sources:
        ElementTree.SubElement(files, "SourceFile", {"name": source})
    return xml_bytes(root)


def _interface(kind: str, name: str, sources: Sequence[str], step_s: float, *, is_2: bool) -> Element:
    element = Element(kind, {"modelIdentifier": name})
    state = "FMUstate" if is_2 else "FMUState"
    element.set(f"canGetAndSet{state}", "true")
    element.set(f"canSerialize{state}", "true")
    if kind == "CoSimulation":
        element.set("canHandleVariableCommunicationStepSize", "true")
        if not is_2:
            element.set("fixedInternalStepSize", repr(step_s))
    if is_2:
        files = ElementTree.SubElement(element, "SourceFiles")
        for source in sources:
            ElementTree.SubElement(files, "File", {"name": source})
    return element


def _unit_definitions(units: Sequence[str] | dict[str, None]) -> Element:
    element = Element("UnitDefinitions")
    for unit in units:
        defined = ElementTree.SubElement(element, "Unit", {"name": unit})
        if unit in BASE_UNITS:
            base = BASE_UNITS[unit]
            attributes = {symbol: str(exponent) for symbol, exponent in base.exponents.items()}
            ElementTree.SubElement(defined, "BaseUnit", {**attributes, "factor": repr(base.factor)})
    return element


def _value(variable: Variable) -> str:
    if variable.kind == "boolean":
        return "true" if variable.start else "false"
    return str(round(variable.start)) if variable.kind == "integer" else repr(variable.start)


def _attributes(reference: int, variable: Variable) -> dict[str, str]:
    """Return what both versions of the standard state of a variable alike."""
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.causality == "output":
        attributes["initial"] = "calculated"
    elif variable.causality == "parameter":
        attributes["initial"] = "exact"
    return attributes


def _variable_2(reference: int, variable: Variable) -> Element:
    attributes = _attributes(reference, variable)
    element = Element("ScalarVariable", attributes)
    typed = ElementTree.SubElement(element, TYPES["fmi2"][variable.kind])
    if variable.unit:
        typed.set("unit", variable.unit)
    if variable.causality != "output":
        typed.set("start", _value(variable))
    return element


def _variable_3(reference: int, variable: Variable) -> Element:
    attributes = _attributes(reference, variable)
    if variable.unit:
        attributes["unit"] = variable.unit
    if variable.causality not in ("output", "independent"):
        attributes["start"] = _value(variable)
    return Element(TYPES["fmi3"][variable.kind], attributes)


def _structure(variables: Sequence[Variable], *, is_2: bool) -> Element:
    """Return the structure: outputs depend on no input at their time; the first one on the start."""
    element = Element("ModelStructure")
    outputs = [number for number, variable in enumerate(variables) if variable.causality == "output"]
    start = next(number for number, each in enumerate(variables) if each.name == "displacement_start")
    initial = {number: [start] if variables[number].name == "displacement" else [] for number in outputs}
    if is_2:
        listed = ElementTree.SubElement(element, "Outputs")
        for number in outputs:
            ElementTree.SubElement(listed, "Unknown", {"index": str(number + 1), "dependencies": ""})
        listed = ElementTree.SubElement(element, "InitialUnknowns")
        for number, known in initial.items():
            dependencies = " ".join(str(each + 1) for each in known)
            ElementTree.SubElement(
                listed, "Unknown", {"index": str(number + 1), "dependencies": dependencies}
            )
        return element
    for number in outputs:
        ElementTree.SubElement(element, "Output", {"valueReference": str(number), "dependencies": ""})
    for number, known in initial.items():
        dependencies = " ".join(map(str, known))
        ElementTree.SubElement(
            element, "InitialUnknown", {"valueReference": str(number), "dependencies": dependencies}
        )
    return element
