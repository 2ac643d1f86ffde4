"""Templates of the generated C99 code, filled with the numbers of a model."""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined

from hitchid._support.inert import comment, html_text
from hitchid._support.jax_setup import installed_versions
from hitchid.export.constants import ChannelConstants, ModelConstants
from hitchid.export.error_constants import COVERAGE, Range
from hitchid.logs import COMMAND

Precision = Literal["mixed", "double", "single"]
LAYOUT = 1  # version of the saved state
MAGIC = b"HITC"
SMALLEST_SINGLE = 1.1754943508222875e-38  # smallest normal number of single precision
LARGEST_SINGLE = 3.4028234e38
PER_LINE = 6  # numbers of an array in a line
BITS = {"double": "uint64_t", "float": "uint32_t"}
BYTES = {"double": 8, "float": 4, "int32_t": 4}


@dataclass(frozen=True)
class Field:
    """A number, or an array of numbers, in a structure of the generated code.

    Attributes:
        name: in its structure.
        kind: `real`, `net` or `int`.
        shape: empty of a single number.
        comment: meaning and unit.
        value: at the start, of parameters.
    """

    name: str
    kind: Literal["real", "net", "int"]
    shape: tuple[int, ...] = ()
    comment: str = ""
    value: float = 0.0

    @property
    def dimensions(self) -> str:
        """The dimensions as C writes them."""
        return "".join(f"[{size}]" for size in self.shape)

    @property
    def count(self) -> int:
        """Number of numbers."""
        return math.prod(self.shape)


@dataclass(frozen=True, kw_only=True)
class Typed(Field):
    """A field with its C type, and how the state's address of its first number is written."""

    type: str
    access: str

    @classmethod
    def of(cls, field: Field, owner: str, name: str) -> "Typed":
        """Return a field of a structure in the state, `owner` with its dot, in code with a prefix."""
        types = {"real": f"{name}_real", "net": f"{name}_net", "int": "int32_t"}
        access = f"&state->{owner}{field.name}" + "[0]" * len(field.shape)
        return cls(**vars(field), type=types[field.kind], access=access)


@dataclass(frozen=True)
class CTemplates:
    """Templates of the generated code, with the numbers of one model.

    Attributes:
        context: what the templates can name.
        environment: that renders them.
        saved_bytes: of a saved state.
        state_bytes: of the numbers in the state, without padding.
    """

    context: Mapping[str, Any]
    environment: Environment
    saved_bytes: int
    state_bytes: int

    def render(self, template: str, **more: object) -> str:
        """Return the text of a template, such as `model.c`."""
        text = self.environment.get_template(f"{template}.jinja").render({**self.context, **more})
        # No trailing blanks, and at most one empty line at a time.
        text = re.sub(r"[ \t]+\n", "\n", text)
        return re.sub(r"\n{3,}", "\n\n", text).strip("\n") + "\n"

    def constant_bytes(self, source: str) -> int:
        """Return the bytes of the tables of numbers in a source, which a microcontroller keeps in its ROM."""
        sizes = {f"{self.context['name']}_{kind}": BYTES[self.context[kind]] for kind in ("real", "net")}
        return sum(
            sizes.get(kind, 4) * (table.count(",") + 1)
            for kind, table in re.findall(r"static const (\w+) \w+[^=;]*= (\{.*?\});", source, re.DOTALL)
        )


def c_templates(model: ModelConstants, name: str, precision: Precision) -> CTemplates:
    """Return the templates with the numbers of a model, and a prefix of all names in the code.

    `mixed` is physics in double, networks in single precision.
    """
    # What a file says goes into comments of C only as text that cannot end one.
    loads = [f"{comment(name)} ({comment(model.units.get(name, '1'))})" for name in model.covariates]
    model = replace(
        model,
        units={role: comment(unit) for role, unit in model.units.items()},
        covariates=tuple(map(comment, model.covariates)),
    )
    command_units = dict.fromkeys(model.units.get(COMMAND[own.name], "1") for own in model.channels)
    real = "float" if precision == "single" else "double"
    net = "double" if precision == "double" else "float"
    sizes = {"real": BYTES[real], "net": BYTES[net], "int": 4}
    parameters = list(_parameters(model))
    common = _common_fields(model)
    by_channel = {channel.name: _channel_fields(channel) for channel in model.channels}

    fields = [Typed.of(field, "", name) for field in common]
    channel_fields = {
        owner: [Typed.of(field, f"{owner}.", name) for field in own] for owner, own in by_channel.items()
    }
    # A state is saved field by field, not as memory: padding and byte order differ between machines.
    saved = [Typed.of(field, "parameters.", name) for field in parameters] + fields
    saved += [field for own in channel_fields.values() for field in own]
    state_bytes = sum(sizes[field.kind] * field.count for field in saved)
    # With the model's digest, so that the state of another model is refused.
    header = MAGIC + LAYOUT.to_bytes(4, "little") + bytes.fromhex(model.digest[:16].ljust(16, "0"))
    context = {
        **vars(model),
        "name": name,
        "guard": name.upper(),
        "version": installed_versions()["hitchid"],
        "digest": model.digest or "that was not saved",
        "precision": precision,
        "real": real,
        "net": net,
        "real_bits": BITS[real],
        "net_bits": BITS[net],
        "directions": " and ".join(channel.name for channel in model.channels),
        "command_units": " and ".join(command_units),
        "loads": ", ".join(loads),
        "parameters": parameters,
        "fields": fields,
        "channel_fields": channel_fields,
        "saved": saved,
        "saved_bytes": 16 + state_bytes + 4,
        "header": list(header),
        "hidden": _hidden(model),
        "scheduled": any(channel.scheduling for channel in model.channels),
        "coverage": COVERAGE,
        "is_controller": False,
        "fn": lambda function: f"{function}f" if real == "float" else function,
        "net_fn": lambda function: f"{function}f" if net == "float" else function,
        "trust": lambda covered, value: _trust(covered, value, real),
        "centred": lambda covered, value: _centred(covered, value, real),
    }
    return CTemplates(context, _environment(real, net), 16 + state_bytes + 4, state_bytes)


def number(value: float | int, kind: str) -> str:
    """Return a number of C with all its digits; kind `double` or `float`."""
    value = float(value)
    if kind == "float":
        if value and abs(value) < SMALLEST_SINGLE:
            value = math.copysign(SMALLEST_SINGLE, value)
        value = max(-LARGEST_SINGLE, min(LARGEST_SINGLE, value))
        text = f"{value:.9g}"  # nine digits read back to the same single
    else:
        # As few digits as read back to the same number.
        text = f"{value:.17g}"
        if float(shorter := f"{value:.16g}") == value:
            text = shorter
    if not any(mark in text for mark in ".en"):
        text += ".0"
    return f"{text}f" if kind == "float" else text


def template_environment(**filters: Callable[..., Any]) -> Environment:
    """Return an environment for templates of code, with filters.

    The text is code, not HTML: nothing is escaped. What a file says stands in it through `comment` alone.
    """
    environment = Environment(  # noqa: S701
        loader=PackageLoader("hitchid.export"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= filters
    return environment


@cache
def _environment(real: str, net: str) -> Environment:
    return template_environment(
        real=lambda value: number(value, real),
        net=lambda value: number(value, net),
        array=lambda values: _array(values, lambda value: number(value, real)),
        nets=lambda values: _array(values, lambda value: number(value, net)),
        ints=lambda values: _array(values, str),
        html=html_text,
    )


def _array(values: Iterable[Any], written: Any, indent: int = 8) -> str:
    """Return nested numbers as an initialiser of C."""
    values = list(values)
    if values and isinstance(values[0], tuple):
        inner = f",\n{' ' * indent}".join(_array(value, written, indent + 2) for value in values)
        return f"{{ {inner} }}"
    texts = [written(value) for value in values]
    lines = [", ".join(texts[start : start + PER_LINE]) for start in range(0, len(texts), PER_LINE)]
    return f"{{ {(',' + chr(10) + ' ' * indent).join(lines)} }}"


def _trust(covered: Range | None, value: str, real: str) -> str:
    if covered is None:
        return number(1, real)
    ends = ", ".join(number(end, real) for end in (covered.lowest, covered.highest, covered.margin))
    return f"trust_of({value}, {ends})"


def _centred(covered: Range | None, value: str, real: str) -> str:
    if covered is None or not covered.half_width > 0:
        return number(0, real)
    return f"({value} - {number(covered.middle, real)}) / {number(covered.half_width, real)}"


def _hidden(model: ModelConstants) -> int:
    """Return the size of the largest network of the compensators for predictions; 0 without any."""
    return max((own.compensator["hidden"] for own in model.channels if own.compensator), default=0)


def _parameters(model: ModelConstants) -> Iterable[Field]:
    unit = model.units["displacement"]
    for channel in model.channels:
        command_unit = model.units.get(COMMAND[channel.name], "1")
        yield Field(f"{channel.name}_dead_zone", "real", (), f"{command_unit}", channel.dead_zone)
        if channel.may_scale_gain:
            yield Field(f"{channel.name}_gain_factor", "real", (), "on the identified gain", 1.0)
        if channel.end_stop is not None:
            yield Field(f"{channel.name}_end_stop", "real", (), unit, channel.end_stop)
    if model.limits is not None:
        yield Field("lower_limit", "real", (), unit, model.limits.lower)
        yield Field("upper_limit", "real", (), unit, model.limits.upper)


def _common_fields(model: ModelConstants) -> Iterable[Field]:
    unit = model.units["displacement"]
    yield Field("displacement", "real", (), f"{unit}, of the last output")
    yield Field("error", "real", (), f"{unit}, measured displacement minus the physical model's")
    yield Field("innovation", "real", (), f"{unit}, of the filter, as predicted by the network")
    yield Field("benchmark", "real", (), f"{unit}, of the physical model")
    yield Field("free_run", "real", (), f"{unit}, of the compensated free run")
    yield Field("start", "real", (), f"{unit}, where the direction in charge took over")
    yield Field("last_measured", "real", (), unit)
    if model.covariates:
        yield Field("load", "real", (len(model.covariates),), ", ".join(model.covariates))
    yield Field("mode", "int", (), "direction in charge")
    yield Field("samples_since_measurement", "int", (), "-1 before the first")
    if hidden := _hidden(model):
        yield Field("index_in_window", "int")
        for name in ("command", "benchmark", "displacement"):
            yield Field(f"last_{name}", "real")
        yield Field("error_before", "real")
        yield Field("error_two_before", "real")
        yield Field("error_sum", "real", (), f"{unit} s")
        yield Field("hidden", "net", (2, hidden), "of the present and of the next window")
        yield Field("cell", "net", (2, hidden))


def _channel_fields(channel: ChannelConstants) -> Iterable[Field]:
    yield Field("command", "real", (), "last valid")
    yield from valve_fields(channel)
    yield Field("samples_in_charge", "int")
    if channel.speed_compensator is not None:
        yield Field("speed", "real")
        yield Field("acceleration", "real")
    yield Field("mean", "real", (3,), "of the filter: offset, load, transient")
    yield Field("covariance", "real", (6,))
    yield Field("gain", "real", (3,))
    if channel.scheduling is not None:
        yield Field("opening", "real", (), "of the valve at the load")
        plant, most = channel.plant, 3  # MAX_STATES columns as in the C code
        yield Field("transition", "real", (plant.nodes, plant.states, plant.states), "at the load")
        yield Field("gamma0", "real", (plant.nodes, most))
        yield Field("gamma1", "real", (plant.nodes, plant.states))
        if plant.friction_at_rest is not None:
            yield Field("friction", "real", (plant.nodes, most))
            yield Field("natural_frequency", "real", (), "rad/s")
        yield Field("speed_row", "real", (plant.states,))
        yield Field("speed_gain", "real")


def valve_fields(channel: ChannelConstants) -> Iterable[Field]:
    """Return the fields of the state of a valve and its plant."""
    plant = channel.plant
    if channel.curves is not None:
        yield Field("lagged", "real", (), "command after the lag of the spool")
        yield Field("play", "real", (), "the same after play")
    yield Field("effective", "real", (), "command beyond the dead zone")
    yield Field("flows", "real", (plant.delay_samples + 2,), "through the valve, the newest first")
    yield Field("demands", "int", (plant.delay_samples + 1,), "whether the command demanded motion")
    yield Field("plant", "real", (plant.states,), "state of the physical model")
