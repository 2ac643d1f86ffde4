"""`modelDescription.xml` of an FMU, FMI 2.0 and 3.0."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi
from typing import Literal
from xml.etree import ElementTree

from hitchid._support.inert import identifiers, xml_bytes
from hitchid._support.jax_setup import installed_versions
from hitchid.export.c_templates import Field, number
from hitchid.export.constants import ModelConstants
from hitchid.logs import COMMAND

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
) -> Iterator[Variable]:
    """Yield the variables of an FMU in the order of their value references; FMI 3 requires time, too."""
    unit = model.units["displacement"]
    if with_time:
        yield Variable("time", "TIME", "real", "independent", "continuous", "Simulation time", "s")
    for channel in model.channels:
        name = COMMAND[channel.name]
        yield _input(name, f"Command of {channel.name}", model.units.get(name, "1"))
    yield _input("displacement_measured", "Measured displacement, where it is valid", unit, start)
    described = "Whether there is a measured displacement"
    yield Variable("measurement_valid", "MEASUREMENT_VALID", "boolean", "input", "discrete", described)
    yield _parameter("displacement_start", "Displacement at the start", unit, start)
    # A covariate has the name of a column, of which C takes some letters only.
    names = identifiers(model.covariates)
    for name, covariate, mean in zip(names, model.covariates, model.mean_load, strict=True):
        described = f"{covariate} before motion; its mean in the tests by default"
        yield _parameter(f"load_{name}", described, model.units.get(covariate, "1"), mean)
    for field in parameters:
        role = COMMAND.get(field.name.removesuffix("_dead_zone"))
        tunable_unit = unit if role is None else model.units.get(role, "1")
        if field.name.endswith("_gain_factor"):
            tunable_unit = "1"
        described = field.name.replace("_", " ").capitalize()
        symbol = field.name.upper()
        yield Variable(
            field.name, symbol, "real", "parameter", "tunable", described, tunable_unit, field.value
        )
    yield _output("displacement", "real", "Displacement", unit, start)
    # A single direction is in charge from the beginning.
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


Version = Literal["fmi2", "fmi3"]
Element = ElementTree.Element


_LENGTH, _PRESSURE = {"m": 1}, {"kg": 1, "m": -1, "s": -2}
_VOLTAGE = {"kg": 1, "m": 2, "s": -3, "A": -1}
# Unit to its factor in SI units, and the exponents of kg, m, s, A, K and rad.
BASE_UNITS: dict[str, tuple[float, dict[str, int]]] = {
    "m": (1.0, _LENGTH),
    "cm": (1e-2, _LENGTH),
    "mm": (1e-3, _LENGTH),
    "um": (1e-6, _LENGTH),
    "in": (0.0254, _LENGTH),
    "rad": (1.0, {"rad": 1}),
    "deg": (pi / 180, {"rad": 1}),
    "s": (1.0, {"s": 1}),
    "A": (1.0, {"A": 1}),
    "mA": (1e-3, {"A": 1}),
    "V": (1.0, _VOLTAGE),
    "mV": (1e-3, _VOLTAGE),
    "Pa": (1.0, _PRESSURE),
    "kPa": (1e3, _PRESSURE),
    "MPa": (1e6, _PRESSURE),
    "bar": (1e5, _PRESSURE),
    "percent": (1e-2, {}),
    "1": (1.0, {}),
    "K": (1.0, {"K": 1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "kN": (1e3, {"kg": 1, "m": 1, "s": -2}),
    "rpm": (pi / 30, {"s": -1, "rad": 1}),
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

    The name is the model identifier, the token its GUID, of FMI 3 the instantiation token; variables come in
    the order of their value references.
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
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in units:
        defined = ElementTree.SubElement(definitions, "Unit", {"name": unit})
        if unit in BASE_UNITS:
            factor, exponents = BASE_UNITS[unit]
            texts = {symbol: str(exponent) for symbol, exponent in exponents.items()}
            ElementTree.SubElement(defined, "BaseUnit", {**texts, "factor": repr(factor)})
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", {"name": "logStatusError"})
    ElementTree.SubElement(root, "DefaultExperiment", {"startTime": "0", "stepSize": repr(step_s)})
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        listed.append(_variable(reference, variable, is_2=is_2))
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


def _variable(reference: int, variable: Variable, *, is_2: bool) -> Element:
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.causality in ("output", "parameter"):
        attributes["initial"] = "calculated" if variable.causality == "output" else "exact"
    typed = {"unit": variable.unit} if variable.unit else {}
    if variable.causality not in ("output", "independent"):
        # No integer is an input or a parameter.
        boolean = "true" if variable.start else "false"
        typed["start"] = boolean if variable.kind == "boolean" else repr(variable.start)
    if not is_2:
        return Element(TYPES["fmi3"][variable.kind], attributes | typed)
    element = Element("ScalarVariable", attributes)
    ElementTree.SubElement(element, TYPES["fmi2"][variable.kind], typed)
    return element


def _structure(variables: Sequence[Variable], *, is_2: bool) -> Element:
    """Return the structure: outputs depend on no input at their time; the first one on the start."""
    element = Element("ModelStructure")
    outputs = [index for index, variable in enumerate(variables) if variable.causality == "output"]
    start = next(index for index, own in enumerate(variables) if own.name == "displacement_start")
    # FMI 2 lists variables by their number from 1, in lists of their own; FMI 3 by their reference, from 0.
    first, key = (1, "index") if is_2 else (0, "valueReference")
    for name in ("Output", "InitialUnknown"):
        listed = ElementTree.SubElement(element, f"{name}s") if is_2 else element
        for index in outputs:
            depends = name == "InitialUnknown" and variables[index].name == "displacement"
            attributes = {key: str(index + first), "dependencies": str(start + first) if depends else ""}
            ElementTree.SubElement(listed, "Unknown" if is_2 else name, attributes)
    return element
