"""Controller file: gains, curves, limits, models and margins of a tuned controller, in TOML."""

import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.short_repr import short_repr
from hitchid._support.storage import write_bytes
from hitchid.control.axis import Axis
from hitchid.control.controller import Gains, HitchController, HoldWindow
from hitchid.control.tuning import Tuning
from hitchid.data.record import DIRECTIONS
from hitchid.errors import InputError, SettingsError
from hitchid.model import Hitch
from hitchid.model.channel_description import describe_channel, read_channel_benchmark

FORMAT = 1
# Of a channel's description in model.json; what is None there is left out here.
MODEL_KEYS = ("structure", "values", "dead_time_s", "shape", "scheduling", "direction", "dead_zone")
CURVE_ROWS = 33  # of the table of speed and current, for other systems; chosen


@short_repr
@dataclass(frozen=True)
class ControllerFile:
    """Content of a controller file.

    Attributes:
        controller: ready to run, at its load.
        model: folder of the model, as written; relative to the file's folder.
        digest: of the model.
        load: covariates that it is tuned for, by name.
        margins: direction to name and value of its margins.
    """

    controller: HitchController
    model: str
    digest: str
    load: Mapping[str, float]
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
    place = checks.path(path, "path")
    try:
        content = tomllib.loads(place.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(
            f"{place}: cannot be read: {error.strerror}; expected a controller file"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{place}: is not TOML: {error}") from error
    if content.get("format") != FORMAT:
        raise SettingsError(f"{place}: has format {content.get('format')!r}, expected {FORMAT}; tune again")
    try:
        return _read(content)
    except KeyError as error:
        raise SettingsError(f"{place}: lacks {error}; tune again") from error
    except (AttributeError, IndexError, TypeError, ValueError, ZeroDivisionError, InputError) as error:
        raise SettingsError(f"{place}: cannot be used: {error}; tune again") from error


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
            "acceleration_mm_per_s2": float(controller.acceleration[number]),
            "lag_s": float(controller.lags_s[number]),
            "crossing_mm_per_s": float(controller.crossing_mm_s[number]),
            "largest_current_A": axis.largest_a,
            "curve": _curve(axis),
            "margins": {
                "gain_dB": float(margins.worst.gain_db),
                "phase_deg": float(margins.worst.phase_deg),
                "delay_s": float(margins.worst.delay_s),
                "sensitivity": float(margins.worst.sensitivity),
                "disk": float(margins.worst.disk),
                "nominal_gain_dB": float(margins.nominal.gain_db),
                "nominal_phase_deg": float(margins.nominal.phase_deg),
                "nominal_delay_s": float(margins.nominal.delay_s),
                "nominal_sensitivity": float(margins.nominal.sensitivity),
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
        "rate_A_per_s": float(controller.rate_a_s),
        "draws": tuning.draws,
        "hold": {"inner_mm": float(controller.hold.inner_mm), "outer_mm": float(controller.hold.outer_mm)},
        "model": {"folder": model_folder, "digest": model.provenance.digest},
        "load": dict(tuning.load),
        "trials_mm_s": dict(tuning.trials),
        **directions,
    }


def _curve(axis: Axis) -> dict[str, list[float]]:
    """Return speed and current in the middle of the stroke, for a look-up block of another system."""
    nonlinearity = axis.model.benchmark.nonlinearity
    place = jnp.zeros(()) if nonlinearity is None else nonlinearity.scales.centre
    speeds = np.linspace(0.0, float(axis.fastest(place)), CURVE_ROWS)
    currents = [float(axis.current_for(jnp.asarray(speed), place)) for speed in speeds]
    return {"speed_mm_per_s": [float(f"{speed:.6g}") for speed in speeds], "current_A": currents}


def _read(content: dict[str, Any]) -> ControllerFile:
    rows = [content[direction] for direction in DIRECTIONS]
    step_s = _number(content, "step_s")
    if step_s == 0:
        raise ValueError("step_s: got 0, expected more than 0")
    load = {name: float(value) for name, value in content["load"].items()}
    axes = []
    for row in rows:
        described = {name: row["model"].get(name) for name in MODEL_KEYS}
        benchmark = read_channel_benchmark(described)
        axis = Axis.of(
            benchmark,
            sign=int(described["direction"]),
            dead_zone=float(described["dead_zone"]),
            step_s=step_s,
            largest_a=_number(row, "largest_current_A"),
        )
        axes.append(axis.at_load(load))
    column = lambda name: jnp.asarray([_number(row, name) for row in rows])  # noqa: E731
    controller = HitchController(
        axes=(axes[0], axes[1]),
        gains=(_gains(rows[0]), _gains(rows[1])),
        acceleration=column("acceleration_mm_per_s2"),
        speed_share=jnp.asarray(_number(content, "speed_share")),
        lags_s=column("lag_s"),
        crossing_mm_s=column("crossing_mm_per_s"),
        hold=HoldWindow(_number(content["hold"], "inner_mm"), _number(content["hold"], "outer_mm")),
        rate_a_s=jnp.asarray(_number(content, "rate_A_per_s")),
    )
    margins = {direction: dict(row["margins"]) for direction, row in zip(DIRECTIONS, rows, strict=True)}
    return ControllerFile(controller, content["model"]["folder"], content["model"]["digest"], load, margins)


def _gains(row: Mapping[str, Any]) -> Gains:
    names = ("proportional_1_per_s", "integral_1_per_s2", "speed_1", "acceleration_s")
    return Gains(*(_number(row, name) for name in names))


def _number(table: Mapping[str, Any], name: str) -> float:
    value = table[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value) or value < 0:
        raise ValueError(f"{name}: got {value!r}, expected a finite number of at least zero")
    return float(value)


def _lines(table: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Return a table as lines of TOML, its values before its tables."""
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
