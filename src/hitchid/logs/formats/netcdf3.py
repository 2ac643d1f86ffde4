"""NetCDF files of the classic kind, before HDF5: variables on dimensions."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.formats.clock_units import decode_values, is_time, to_seconds, unit_attribute
from hitchid.logs.formats.library import as_log_errors, is_vector, match_clocked_channels

MAGIC = b"CDF"
KIND = "a NetCDF file"
Variable = Any  # of scipy.io.netcdf_file, which has no types


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected variables of a classic NetCDF file.

    Args:
        path: the file.
        selection: the requested variables; the time is optional if each has a time coordinate.

    Raises:
        LogError: the file is damaged or was cut short, or a variable is missing.
    """
    from scipy.io import netcdf_file  # not at the top: a quarter of a second

    # Without memory mapping: scipy would leave the map open as long as an array uses it.
    with as_log_errors(path, KIND), netcdf_file(path, mmap=False) as file:
        numeric_variables = {name: v for name, v in file.variables.items() if _holds_numbers(v)}
        scales = {
            name: scale
            for name, v in numeric_variables.items()
            if (scale := _time_scale(numeric_variables, v)) is not None
        }
        matches = match_clocked_channels(path, list(numeric_variables), selection, scales)
        used = {scales[name] for name in matches.values() if name in scales}
        clocks = {scale: _read_clock(numeric_variables[scale]) for scale in used}
        channels = {
            requested: _channel(name, numeric_variables[name], clocks.get(scales.get(name, "")))
            for requested, name in matches.items()
        }
    return Content(path, channels)


def _holds_numbers(variable: Variable) -> bool:
    return variable.data.dtype.kind in "fiu" and is_vector(variable.data.shape)


def _attributes(variable: Variable) -> Mapping[str, object]:
    return vars(variable)["_attributes"]


def _time_scale(numeric_variables: Mapping[str, Variable], variable: Variable) -> str | None:
    name = variable.dimensions[int(np.argmax(variable.data.shape))]
    scale = numeric_variables.get(name)
    return name if scale is not None and is_time(unit_attribute(_attributes(scale))) else None


def _read_clock(scale: Variable) -> np.ndarray:
    attributes = _attributes(scale)
    return to_seconds(decode_values(scale.data, attributes), unit_attribute(attributes))


def _channel(name: str, variable: Variable, clock_s: np.ndarray | None) -> LogChannel:
    if clock_s is not None and variable.dimensions == (name,):
        return LogChannel(clock_s, "s", clock_s)
    attributes = _attributes(variable)
    return LogChannel(decode_values(variable.data, attributes), unit_attribute(attributes), clock_s)
