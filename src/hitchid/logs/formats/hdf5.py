"""HDF5 and NetCDF files: datasets in groups, with the time in the scale of their dimension."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.formats.library import (
    as_log_errors,
    column_names,
    column_of,
    decode_values,
    import_optional,
    is_matrix,
    is_time,
    is_vector,
    match_clocked_channels,
    to_seconds,
    unit_attribute,
)

SUFFIXES = (".h5", ".hdf5", ".nc")
NUMERIC_KINDS = "fiub"  # numpy's kinds of real numbers
KIND = "an HDF5 file"
CLASSIC_MAGIC, CLASSIC_KIND = b"CDF", "a NetCDF file"  # variables on dimensions, before HDF5
# Name attribute of the empty dataset that NetCDF 4 stores for a dimension without coordinates.
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
Dataset = Any  # of h5py, which has no types


class _Column(NamedTuple):
    """Place of one channel: a dataset, or a field or column of one; an alias has a better name, too."""

    dataset: Dataset
    part: str | int | None = None
    unit: str | None = None
    is_alias: bool = False


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected datasets of an HDF5 or NetCDF file; the time is optional if each has a time scale."""
    with as_log_errors(path, KIND), path.open("rb") as stream:
        if stream.read(3) == CLASSIC_MAGIC:
            return _read_classic(path, selection)
    h5py = import_optional("h5py", "hdf5", path)
    with as_log_errors(path, KIND), h5py.File(path, "r") as file:
        columns = {
            column: part
            for name, dataset in _datasets(h5py, file)
            for column, part in _columns(name, dataset)
        }
        scales = {
            name: scale
            for name, column in columns.items()
            if (scale := _time_scale(column.dataset)) is not None
        }
        if selection.signals is None:
            # Columns of a table that names them are not read twice.
            columns = {name: column for name, column in columns.items() if not column.is_alias}
        matches = match_clocked_channels(path, list(columns), selection, scales)
        clocks: dict[str, np.ndarray] = {}
        channels: dict[str, LogChannel] = {}
        for requested, name in matches.items():
            column, scale, clock_s = columns[name], scales.get(name), None
            if scale is not None:
                if scale.name not in clocks:
                    stamps = decode_values(read_dataset(path, scale, scale.name), scale.attrs)
                    clocks[scale.name] = to_seconds(stamps, unit_attribute(scale.attrs))
                clock_s = clocks[scale.name]
            if clock_s is not None and column.dataset == scale:
                channels[requested] = LogChannel(clock_s, "s", clock_s)
                continue
            raw = read_dataset(path, column.dataset, name, column.part)
            values = decode_values(raw, column.dataset.attrs)
            channels[requested] = LogChannel(values, column.unit, clock_s)
    return Content(path, channels)


def _read_classic(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected variables of a classic NetCDF file, from before HDF5."""
    from scipy.io import netcdf_file  # not at the top: a quarter of a second

    # Without memory mapping: scipy would leave the map open as long as an array uses it.
    with as_log_errors(path, CLASSIC_KIND), netcdf_file(path, mmap=False) as file:
        numeric_variables = {
            name: variable
            for name, variable in file.variables.items()
            if variable.data.dtype.kind in "fiu" and is_vector(variable.data.shape)
        }
        scales = {}
        for name, variable in numeric_variables.items():
            scale = variable.dimensions[int(np.argmax(variable.data.shape))]
            if scale in numeric_variables and is_time(unit_attribute(_attributes(numeric_variables[scale]))):
                scales[name] = scale
        matches = match_clocked_channels(path, list(numeric_variables), selection, scales)
        clocks = {}
        for scale in {scales[name] for name in matches.values() if name in scales}:
            attributes = _attributes(numeric_variables[scale])
            stamps = decode_values(numeric_variables[scale].data, attributes)
            clocks[scale] = to_seconds(stamps, unit_attribute(attributes))
        channels = {}
        for requested, name in matches.items():
            variable, clock_s = numeric_variables[name], clocks.get(scales.get(name, ""))
            attributes = _attributes(variable)
            if clock_s is not None and variable.dimensions == (name,):
                channels[requested] = LogChannel(clock_s, "s", clock_s)
            else:
                values = decode_values(variable.data, attributes)
                channels[requested] = LogChannel(values, unit_attribute(attributes), clock_s)
    return Content(path, channels)


def _attributes(variable: Any) -> Mapping[str, object]:
    return vars(variable)["_attributes"]


def _datasets(h5py: Any, group: Any) -> Iterator[tuple[str, Dataset]]:
    """Yield full name and dataset of everything in a group; None for a link to another file.

    Soft links are left out: their target has a name of its own.
    """
    # Hard links can make a group its own member.
    seen = {_address(h5py, group)}
    pending = [("", group)]
    while pending:
        prefix, current = pending.pop()
        subgroups = []
        for name in current:
            full_name, link = f"{prefix}{name}", current.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                yield full_name, None
            elif isinstance(link, h5py.HardLink):
                item = current[name]
                if isinstance(item, h5py.Dataset):
                    yield full_name, item
                elif isinstance(item, h5py.Group) and (address := _address(h5py, item)) not in seen:
                    seen.add(address)
                    subgroups.append((f"{full_name}/", item))
        pending += reversed(subgroups)


def _columns(name: str, dataset: Dataset) -> Iterator[tuple[str, _Column]]:
    """Yield full name and place of each vector in a dataset: itself, or a field or column of it.

    A table may name its columns in an attribute `columns`, and their units in `units`.
    """
    # The shape of an external dataset is not read: HDF5 would open the other file. It is listed so that a
    # request for it gives an error with the reason.
    if is_external(dataset):
        yield name, _Column(dataset)
        return
    shape, kind = dataset.shape, dataset.dtype
    if shape is None or _text(dataset.attrs.get("NAME")).startswith(NO_VARIABLE):
        return
    if is_vector(shape) and kind.kind in NUMERIC_KINDS:
        yield name, _Column(dataset, unit=unit_attribute(dataset.attrs))
    elif is_vector(shape) and kind.names:
        for field in kind.names:
            if kind[field].kind in NUMERIC_KINDS:
                yield f"{name}/{field}", _Column(dataset, field)
    elif is_matrix(shape) and kind.kind in NUMERIC_KINDS:
        labels, units = (_texts(dataset.attrs.get(key), min(shape)) for key in ("columns", "units"))
        for index, column in enumerate(column_names(name, shape)):
            unit = units[index] if units else unit_attribute(dataset.attrs)
            if labels:
                yield f"{name}/{labels[index]}", _Column(dataset, index, unit)
            yield column, _Column(dataset, index, unit, is_alias=bool(labels))


def _texts(value: object, count: int) -> list[str]:
    """Return an attribute of one text a column; empty if it is anything else."""
    texts = [_text(text) for text in np.ravel(value).tolist()] if isinstance(value, np.ndarray) else []
    return texts if len(texts) == count else []


def read_dataset(path: Path, dataset: Any, name: str, part: str | int | None = None) -> np.ndarray:
    """Return the stored numbers of a dataset, of one field or of one column."""
    if is_external(dataset):
        raise LogError(path, "is a link to another file; expected the data in this file", column=name)
    if isinstance(part, int):
        return column_of(dataset, part)
    return dataset[()] if part is None else dataset[part]


def is_external(dataset: Any) -> bool:
    """Return whether a dataset, None for a link to another file, is stored in another file."""
    return dataset is None or dataset.is_virtual or bool(dataset.external)


def _address(h5py: Any, item: Any) -> tuple[int, int]:
    info = h5py.h5o.get_info(item.id)
    return info.fileno, info.addr


def _text(value: object) -> str:
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)


def _time_scale(dataset: Any) -> Any:
    """Return the time scale of a dataset, the dataset itself if it is a scale, or None."""
    if is_external(dataset):
        return None
    # From the attributes: HDF5's functions for scales crash the process on damaged files.
    if _text(dataset.attrs.get("CLASS")) == "DIMENSION_SCALE":
        scales = [dataset]
    elif (references := dataset.attrs.get("DIMENSION_LIST")) is None:
        scales = []
    else:
        scales = [dataset.file[reference] for reference in references[int(np.argmax(dataset.shape))]]
    for scale in scales:
        if (
            not is_external(scale)
            and is_time(unit_attribute(scale.attrs))
            and scale.size == max(dataset.shape)
        ):
            return scale if is_vector(scale.shape) and scale.dtype.kind in NUMERIC_KINDS else None
    return None
