"""NetCDF files of the classic kind, before HDF5: variables on dimensions."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.readers.content import Channel, Content, Wanted
from hitchid.readers.formats.cf import decoded, in_seconds, is_time, unit_in
from hitchid.readers.formats.extra import damage, is_vector, picked

MAGIC = b"CDF"
KIND = "a NetCDF file"


def read(path: Path, wanted: Wanted) -> Content:
    """Read the wanted variables of a classic NetCDF file.

    Args:
        path: the file.
        wanted: what is asked for; the time may be missing where each has a coordinate of time.

    Raises:
        LogError: the file is damaged or was cut short, or a variable is missing.
    """
    from scipy.io import netcdf_file  # not at the top: a quarter of a second

    # Not mapped into memory: scipy would leave the map open behind arrays that still show it.
    with damage(path, KIND), netcdf_file(path, mmap=False) as file:
        variables = file.variables
        named = {name: variable for name, variable in variables.items() if _holds_numbers(variable)}
        scales = {name: scale for name, v in named.items() if (scale := _scale(named, v)) is not None}
        found = picked(path, list(named), wanted, scales)
        used = {scales[name] for name in found.values() if name in scales}
        clocks = {scale: _time(named[scale]) for scale in used}
        channels = {
            asked: _channel(name, named[name], clocks.get(scales.get(name, "")))
            for asked, name in found.items()
        }
    return Content(path, channels)


def _holds_numbers(variable: Any) -> bool:
    return variable.data.dtype.kind in "fiu" and is_vector(variable.data.shape)


def _attributes(variable: Any) -> Mapping[str, object]:
    return vars(variable)["_attributes"]


def _scale(named: Mapping[str, Any], variable: Any) -> str | None:
    name = variable.dimensions[int(np.argmax(variable.data.shape))]
    scale = named.get(name)
    return name if scale is not None and is_time(unit_in(_attributes(scale))) else None


def _time(scale: Any) -> np.ndarray:
    attributes = _attributes(scale)
    return in_seconds(decoded(scale.data, attributes), unit_in(attributes))


def _channel(name: str, variable: Any, clock_s: np.ndarray | None) -> Channel:
    if clock_s is not None and variable.dimensions == (name,):
        return Channel(clock_s, "s", clock_s)
    attributes = _attributes(variable)
    return Channel(decoded(variable.data, attributes), unit_in(attributes), clock_s)
