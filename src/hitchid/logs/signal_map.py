"""Settings file of a campaign: signal columns, kinds of tests, split."""

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Literal, TypeVar, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
    field_validator,
    model_validator,
)

from hitchid._support import checks
from hitchid.errors import InputError, SettingsError
from hitchid.logs.record import COMMAND
from hitchid.logs.units import UNITS, check_unit, unit_of_column

# Errors of settings as sentences: the key, what was expected, what was found.

MAX_SHOWN, MAX_PRINTED = 200, 10**100  # characters, largest integer in a message (chosen)
ERRORS = {
    "true or false": "bool_parsing bool_type",
    "a table": "dataclass_type dict_type mapping_type model_attributes_type model_type",
    "a list": "frozen_set_type list_type tuple_type",
    "a number": "float_parsing float_type",
    "a finite number": "finite_number",
    "a whole number": "int_from_float int_parsing int_type",
    "a smaller whole number": "int_parsing_size",
    "a number above {gt:g}": "greater_than",
    "a number below {lt:g}": "less_than",
    "at least {ge:g}": "greater_than_equal",
    "at most {le:g}": "less_than_equal",
    "at least {min_length} entries": "too_short",
    "at most {max_length} entries": "too_long",
    "a value": "missing missing_argument",
    "text in quotes": "string_type",
    "text like {pattern}": "string_pattern_mismatch",
    "{expected}": "literal_error",
    "the key {discriminator}": "union_tag_not_found",
    "{discriminator} to be one of {expected_tags}": "union_tag_invalid",
    "JSON of at most 200 levels": "json_invalid",
}
EXPECTED = {error: text for text, errors in ERRORS.items() for error in errors.split()}
"""Type of a pydantic error to what was expected, with fields of its context."""


def describe_settings(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """Return the first error of a validation as one sentence that names the key."""
    # The first alone: the others often follow from it.
    first = error.errors(include_url=False)[0]
    kind, location = first["type"], first["loc"]
    key = _truncated(".".join(map(str, location)) or "settings")
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"key '{key}' is not known{_suggestion(str(location[-1]), location[:-1], model)}"
    value, context = first.get("input"), first.get("ctx", {})
    if kind == "value_error":  # the sentence of a validator of this package, which may name the value itself
        if not location:  # of the whole file: the sentence names the key
            return str(context["error"])
        return f"key '{key}': {context['error']}{_received(value) if _is_scalar(value) else ''}"
    expected = EXPECTED.get(kind, "another value").format_map(context)
    return (
        f"key '{key}': expected {expected}{', got none' if kind.startswith('missing') else _received(value)}"
    )


def _suggestion(name: str, location: tuple[int | str, ...], model: type[BaseModel] | None) -> str:
    """Return the nearest key of the table at a place in the settings, else all its keys, else nothing."""
    for part in location:
        if model is not None and isinstance(part, str):  # a number is a place in a list of tables
            field = model.model_fields.get(part)
            model = None if field is None else next(_models_in(field.annotation), None)
    keys = () if model is None else tuple(model.model_fields)
    nearest = get_close_matches(name, keys, n=1)
    if nearest:
        return f"; did you mean '{nearest[0]}'?"
    return f"; expected one of {', '.join(keys)}" if keys else "; check its spelling"


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def _is_scalar(value: object) -> bool:
    return isinstance(value, str | int | float | bool)


def _received(value: object) -> str:
    if isinstance(value, bool):
        return f", got {'true' if value else 'false'}"  # as in TOML
    if value is None:
        return ", got null"  # as in JSON; TOML has none
    # Python prints no integer above 4300 digits; TOML allows longer ones in hexadecimal.
    if isinstance(value, int) and abs(value) >= MAX_PRINTED:
        return ", got a huge number"
    if _is_scalar(value):
        return f", got {_truncated(repr(value))}"
    return ", got a table" if isinstance(value, Mapping) else ", got a list"


def _truncated(text: str) -> str:
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"


CAMPAIGN_FILE = "campaign.toml"
MAX_LENGTH, MAX_DOTS = 2**20, 100  # characters of a settings file; dots in one key (chosen)
POSITIONS = ("length", "angle", "voltage", "ratio")  # dimensions of a displacement
COMMANDS = ("current", "voltage", "ratio", "pressure", "flow", "frequency")  # dimensions of a command
DIMENSIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "time": ("time",),
        "displacement": POSITIONS,
        "command": COMMANDS,
        "lifting_command": COMMANDS,
        "lowering_command": COMMANDS,
    }
)
"""Role to the admissible dimensions of its unit; a covariate may have any."""


class StrictSettings(BaseModel):
    """Settings read from a file; an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SignalColumn(StrictSettings):
    """A column of the log and its scaling: signal = (reading − zero) · scale.

    Attributes:
        column: name of the column.
        unit: of the signal; None for the unit given by the log.
        zero: reading at signal zero, in the log's unit.
        scale: `unit` per reading, negative to reverse the sign; None for readings in the log's unit, or in
            `unit` if the log gives none.
    """

    column: str
    unit: str | None = None
    zero: float = Field(default=0.0, allow_inf_nan=False)
    scale: float | None = Field(default=None, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _from_name(cls, value: object) -> object:
        # The short form, column = "stroke_mm", has its unit in the name.
        if isinstance(value, str):
            return {"column": value, "unit": unit_of_column(value)}
        return value

    @field_validator("unit")
    @classmethod
    def _known_unit(cls, unit: str | None) -> str | None:
        try:
            return None if unit is None else check_unit(unit, "unit")
        except InputError as error:
            raise ValueError(str(error)) from error

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, scale: float | None) -> float | None:
        # A signal of zeros would be refused much later, as one that never moves.
        if scale == 0:
            raise ValueError("expected a number other than zero (units per reading)")
        return scale


class SignalMap(StrictSettings):
    """Map from signals to columns of a log.

    Either one signed `command`, positive for lifting and negative for lowering, or `lifting_command` and
    `lowering_command`; one of these alone is a plant with one channel, whose command may have both signs.
    Commands alone, for a simulation, have no displacement.
    """

    time: SignalColumn = SignalColumn(column="time_s", unit="s")
    displacement: SignalColumn | None = SignalColumn(column="displacement_mm", unit="mm")
    command: SignalColumn | None = None
    lifting_command: SignalColumn | None = None
    lowering_command: SignalColumn | None = None
    covariates: tuple[SignalColumn, ...] = ()

    @field_validator("covariates", mode="before")
    @classmethod
    def _by_name(cls, value: object) -> object:
        """Convert names to columns in the log's unit, whatever unit the name ends in."""
        if not isinstance(value, list | tuple):
            return value
        return tuple({"column": item} if isinstance(item, str) else item for item in value)

    @property
    def measured(self) -> tuple[str, ...]:
        """Columns of displacement, commands and covariates, without the time."""
        mapped = (self.displacement, self.command, self.lifting_command, self.lowering_command)
        return tuple(dict.fromkeys(c.column for c in (*mapped, *self.covariates) if c is not None))

    @model_validator(mode="after")
    def _check_signals(self) -> "SignalMap":
        if self.command and (self.lifting_command or self.lowering_command):
            raise ValueError("expected either command or lifting_command and lowering_command, not both")
        if not (self.command or self.lifting_command or self.lowering_command):
            raise ValueError("expected at least one of command, lifting_command, lowering_command")
        # Signals and covariates share one mapping of the record: a covariate must not replace a signal.
        reserved = DIMENSIONS.keys() & {covariate.column for covariate in self.covariates}
        if reserved:
            raise ValueError(f"covariates: '{reserved.pop()}' is the name of a signal; rename the column")
        for role, dimensions in DIMENSIONS.items():
            column = getattr(self, role)
            if column is None or column.unit is None:
                continue
            dimension = UNITS[column.unit].dimension
            if dimension not in dimensions:
                raise ValueError(
                    f"{role}: '{column.unit}' is a unit of {dimension}, "
                    f"expected one of {', '.join(dimensions)}"
                )
        return self


DEFAULT_SIGNALS = SignalMap(
    lifting_command=SignalColumn(column="current_up_A", unit="A"),
    lowering_command=SignalColumn(column="current_down_A", unit="A"),
)


def command_columns(directions: Iterable[str], units: Mapping[str, str]) -> dict[str, SignalColumn]:
    """Return role to the column of a command in logs that this package writes.

    The default column where it has the unit, otherwise the role and the unit: `lifting_command_percent`.
    """
    columns = {}
    for role in (COMMAND[direction] for direction in directions):
        default, unit = getattr(DEFAULT_SIGNALS, role), units[role]
        # A log that is written must read back without a campaign.toml, or with one that names it.
        columns[role] = default if unit == default.unit else SignalColumn(column=f"{role}_{unit}", unit=unit)
    return columns


class Split(StrictSettings):
    """Held-out tests, as patterns on their names."""

    test: tuple[str, ...] = Field(min_length=1)


class Can(StrictSettings):
    """DBC files of the CAN bus, relative to the settings file."""

    databases: tuple[str, ...] = ()


class CampaignFile(StrictSettings):
    """Content of `campaign.toml`.

    Attributes:
        signals: columns of the logs.
        can: databases of the bus.
        split: held-out tests.
        tests: pattern on names to kind.
        end_stops: lowest and highest position of the piston, in the displacement's unit.
    """

    signals: SignalMap = DEFAULT_SIGNALS
    can: Can = Can()
    split: Split | None = None
    tests: dict[str, Literal["lifting", "lowering", "ramp", "cycle"]] = {}
    end_stops: tuple[FiniteFloat, FiniteFloat] | None = None

    @field_validator("end_stops")
    @classmethod
    def _lower_first(cls, end_stops: tuple[float, float] | None) -> tuple[float, float] | None:
        if end_stops is not None and not end_stops[0] < end_stops[1]:
            raise ValueError("expected the lower and the higher position, in the displacement's unit")
        return end_stops


def signal_map_of(signals: Mapping[str, object]) -> SignalMap:
    """Return the signal map of a dict with the content of `[signals]`.

    Raises:
        SettingsError: a key is unknown or a value invalid.
    """
    if not isinstance(signals, Mapping):
        raise checks.input_error("signals", "signal to column, as [signals] in campaign.toml", signals)
    try:
        return CampaignFile.model_validate({"signals": dict(signals)}).signals
    except ValidationError as error:
        raise SettingsError(describe_settings(error)) from error


def read_campaign_file(path: Path) -> CampaignFile:
    """Read a `campaign.toml`.

    Raises:
        SettingsError: the file cannot be read, is not TOML, or has an unknown key or invalid value.
    """
    return parse_settings(path, CampaignFile)


Settings = TypeVar("Settings", bound=StrictSettings)


def parse_settings(path: Path, model: type[Settings]) -> Settings:
    """Read a TOML file into settings; errors name file and key."""
    try:
        with path.open(encoding="utf-8-sig") as stream:
            text = stream.read(MAX_LENGTH + 1)
    except (OSError, ValueError) as error:  # no text, or a path no file can have
        raise SettingsError(f"{path}: cannot be read: {error}") from error
    content = parse_toml(text, path)
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise SettingsError(f"{path}: {describe_settings(error, model)}") from error
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error


def parse_toml(text: str, source: object) -> dict[str, object]:
    """Parse TOML; text that is none, or too long for settings, is a `SettingsError`."""
    # Time and memory of tomllib grow with the square of the number of parts of a dotted key.
    if len(text) > MAX_LENGTH or any(
        fragment.count(".") > MAX_DOTS for fragment in re.split(r"[\n=,]", text)
    ):
        raise SettingsError(f"{source}: is too large for a settings file; check the path")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # numbers that are too long, nesting that is too deep
        raise SettingsError(f"{source}: is not valid TOML: {error}") from error
