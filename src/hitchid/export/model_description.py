"""`modelDescription.xml` of an FMU, FMI 2.0 and 3.0."""

from collections.abc import Sequence
from math import pi
from typing import Literal, NamedTuple
from xml.etree import ElementTree

from hitchid._support.inert import xml_bytes
from hitchid._support.versions import installed_versions
from hitchid.export.fmu_variables import Variable

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
