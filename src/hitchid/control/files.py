"""Controller file: gains, curves, limits, models and margins of a tuned controller, in TOML."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
from pydantic import ConfigDict, Field, field_validator, model_validator

from hitchid._support import checks
from hitchid._support.bounded import Number, Positive, Size
from hitchid._support.files import write_bytes
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.control.axis import Axis
from hitchid.control.controller import Gains, HitchController, HoldWindow
from hitchid.control.tuning import Tuning
from hitchid.logs import DIRECTIONS, parse_settings
from hitchid.model import (
    Described,
    DescribedRow,
    Hitch,
    PhysicalDescription,
    StepTime,
    describe_channel,
    read_physical_model,
)
from hitchid.structures import structure_named

FORMAT = 2
# Of a channel's description in model.json; what is None there is left out here.
MODEL_KEYS = ("structure", "values", "dead_time_s", "shape", "scheduling", "direction", "dead_zone")
# Of a file, in the order of `Margins`; the disk margin of the model itself is not stored.
MARGINS = ("gain_dB", "phase_deg", "delay_s", "sensitivity", "disk")
NOMINAL_MARGINS = tuple(f"nominal_{name}" for name in MARGINS[:-1])
CURVE_ROWS = 33  # of the table of speed and current, for other systems; chosen


class Curve(Described):
    """Speed and current in the middle of the stroke, for a look-up block of another system."""

    speed: DescribedRow[float]
    command: DescribedRow[float]


class MarginsContent(Described):
    """Margins of one direction, of the worst draw and of the model; ∞ where nothing ends them."""

    model_config = ConfigDict(allow_inf_nan=True)

    gain_dB: float
    phase_deg: float
    delay_s: float
    sensitivity: float
    disk: float
    nominal_gain_dB: float
    nominal_phase_deg: float
    nominal_delay_s: float
    nominal_sensitivity: float
    largest_dead_time_s: float
    passed: bool


class DirectionContent(Described):
    """Gains, limits, curve, margins and model of one direction; see `HitchController`."""

    proportional_1_per_s: Positive
    integral_1_per_s2: Size
    speed_1: Size
    acceleration_s: Size
    deceleration: Positive
    lag_s: Size
    crossing_speed: Positive
    largest_command: Positive
    curve: Curve
    margins: MarginsContent
    model: PhysicalDescription

    @field_validator("model")
    @classmethod
    def _integrates(cls, model: PhysicalDescription) -> PhysicalDescription:
        linear = structure_named(model.structure).linear
        # Without an integrator no speed is steady, and the inverse of the opening curve has no meaning.
        if linear is None or linear.transfer_function(model.values)[1][-1] != 0:
            raise ValueError(f"got '{model.structure}', expected a linear structure with an integrator")
        return model


class HoldContent(Described):
    """Window in which the hitch is held; see `HoldWindow`."""

    inner: Size
    outer: Size


class UnitsContent(Described):
    """Units of displacement and commands."""

    displacement: str
    lifting_command: str
    lowering_command: str


class ModelReference(Described):
    """Folder of the model, relative to that of the file, and its digest."""

    folder: str
    digest: str


class ControllerContent(Described):
    """Content of a controller file."""

    format: int
    method: str
    step_s: StepTime
    speed_share: Annotated[float, Field(gt=0, le=2)]
    rate: Positive
    draws: Annotated[int, Field(ge=0, le=10**9)]
    hold: HoldContent
    model: ModelReference
    units: UnitsContent
    load: dict[str, Number]
    trials: dict[str, Annotated[float, Field(allow_inf_nan=True)]]
    lifting: DirectionContent
    lowering: DirectionContent

    @field_validator("format")
    @classmethod
    def _known(cls, version: int) -> int:
        if version != FORMAT:
            raise ValueError(f"expected {FORMAT}; tune again")
        return version

    @model_validator(mode="after")
    def _short_delays(self) -> "ControllerContent":
        for direction in DIRECTIONS:
            row: DirectionContent = getattr(self, direction)
            row.model.check_delay(self.step_s)
        return self


@short_repr
@dataclass(frozen=True)
class ControllerFile:
    """Content of a controller file.

    Attributes:
        controller: ready to run, at its load.
        model: folder of the model, as written; relative to the file's folder.
        digest: of the model.
        load: covariates that it is tuned for, by name.
        units: of displacement and commands, by role.
        margins: direction to name and value of its margins.
    """

    controller: HitchController
    model: str
    digest: str
    load: Mapping[str, float]
    units: Mapping[str, str]
    margins: Mapping[str, Mapping[str, float]]


@double_precision
def save_controller(
    tuning: Tuning, model: Hitch, path: str | Path, *, model_folder: str = "", force: bool = False
) -> None:
    """Write a controller file.

    Args:
        tuning: of `tune`.
        model: that was tuned for.
        path: file to write.
        model_folder: of the model, for the bands of `hitchid drive`.
        force: replace an existing file.

    Raises:
        OutputError: the file exists and `force` is not given, or it cannot be written.
    """
    text = "\n".join(_lines(_content(tuning, model, model_folder))) + "\n"
    write_bytes(checks.path(path, "path"), text.encode(), force=force)


@double_precision
def load_controller(path: str | Path) -> ControllerFile:
    """Read a controller file.

    Raises:
        SettingsError: the file is missing, no TOML, of another format, or a number is missing or wrong.
    """
    content = parse_settings(checks.path(path, "path"), ControllerContent)
    # Its models are inside: the model folder is for the bands of `hitchid drive` alone.
    rows = [content.lifting, content.lowering]
    axes = [
        Axis.of(
            read_physical_model(row.model),
            sign=row.model.direction,
            dead_zone=row.model.dead_zone,
            step_s=content.step_s,
            largest_command=row.largest_command,
        ).at_load(content.load)
        for row in rows
    ]
    controller = HitchController(
        axes=(axes[0], axes[1]),
        gains=(_gains(rows[0]), _gains(rows[1])),
        deceleration=jnp.asarray([row.deceleration for row in rows]),
        speed_share=jnp.asarray(content.speed_share),
        lags_s=jnp.asarray([row.lag_s for row in rows]),
        crossing_speed=jnp.asarray([row.crossing_speed for row in rows]),
        hold=HoldWindow(jnp.asarray(content.hold.inner), jnp.asarray(content.hold.outer)),
        rate=jnp.asarray(content.rate),
    )
    margins = {direction: row.margins.model_dump() for direction, row in zip(DIRECTIONS, rows, strict=True)}
    return ControllerFile(
        controller,
        content.model.folder,
        content.model.digest,
        content.load,
        content.units.model_dump(),
        margins,
    )


def _gains(row: DirectionContent) -> Gains:
    values = (row.proportional_1_per_s, row.integral_1_per_s2, row.speed_1, row.acceleration_s)
    return Gains(*map(jnp.asarray, values))


def _content(tuning: Tuning, model: Hitch, model_folder: str) -> dict[str, Any]:
    controller = tuning.controller
    directions = {}
    for number, (direction, axis) in enumerate(zip(DIRECTIONS, controller.axes, strict=True)):
        described = describe_channel(model.channels[direction])
        margins, gains = tuning.margins[direction], controller.gains[number]
        directions[direction] = {
            "proportional_1_per_s": float(gains.proportional),
            "integral_1_per_s2": float(gains.integral),
            "speed_1": float(gains.speed),
            "acceleration_s": float(gains.acceleration),
            "deceleration": float(controller.deceleration[number]),
            "lag_s": float(controller.lags_s[number]),
            "crossing_speed": float(controller.crossing_speed[number]),
            "largest_command": axis.largest_command,
            "curve": _curve(axis),
            "margins": {
                **dict(zip(MARGINS, map(float, margins.worst), strict=True)),
                **dict(zip(NOMINAL_MARGINS, map(float, margins.nominal), strict=False)),
                "largest_dead_time_s": margins.dead_time_s,
                "passed": margins.passed,
            },
            "model": {name: described[name] for name in MODEL_KEYS if described[name] is not None},
        }
    return {
        "format": FORMAT,
        "method": tuning.method,
        "step_s": controller.step_s,
        "speed_share": float(controller.speed_share),
        "rate": float(controller.rate),
        "draws": tuning.draws,
        "hold": {"inner": float(controller.hold.inner), "outer": float(controller.hold.outer)},
        "model": {"folder": model_folder, "digest": model.provenance.digest},
        "units": dict(tuning.units),
        "load": dict(tuning.load),
        "trials": dict(tuning.trials),
        **directions,
    }


def _curve(axis: Axis) -> dict[str, list[float]]:
    """Return speed and current in the middle of the stroke, for a look-up block of another system."""
    nonlinearity = axis.model.benchmark.nonlinearity
    middle = jnp.zeros(()) if nonlinearity is None else nonlinearity.scales.centre
    speeds = np.linspace(0.0, float(axis.fastest(middle)), CURVE_ROWS)
    currents = [float(axis.current_for(jnp.asarray(speed), middle)) for speed in speeds]
    # Rounded for a person who copies the table; the controller itself solves for each speed.
    return {"speed": [float(f"{speed:.6g}") for speed in speeds], "command": currents}


def _lines(table: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Return a table as lines of TOML, its values before its tables."""
    # What stands below the head of a table belongs to it, so that values come before further tables.
    lines = [
        f"{_key(name)} = {_value(value)}" for name, value in table.items() if not isinstance(value, Mapping)
    ]
    for name, value in table.items():
        if isinstance(value, Mapping):
            path = f"{prefix}{_key(name)}"
            lines += ["", f"[{path}]", *_lines(value, f"{path}.")]
    return lines


def _key(name: str) -> str:
    """Return a name as a key of TOML, in quotes where it has other letters than a bare key may have."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _value(value: object) -> str:
    """Return a value as TOML; JSON's text, number, truth value and list are TOML's, too."""
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return json.dumps(value, ensure_ascii=False)
