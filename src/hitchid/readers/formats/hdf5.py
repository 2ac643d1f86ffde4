"""HDF5 and NetCDF files: datasets in groups, with the time in the scale of their dimension."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.data.content import Content, LogChannel
from hitchid.errors import LogError
from hitchid.readers.content import ChannelSelection
from hitchid.readers.formats import netcdf3
from hitchid.readers.formats.cf import decode_values, is_time, to_seconds, unit_attribute
from hitchid.readers.formats.extra import as_log_errors, import_optional, is_vector, match_clocked_channels

SUFFIXES = (".h5", ".hdf5", ".nc")
NUMERIC_KINDS = "fiub"  # numpy's kinds of real numbers
KIND = "an HDF5 file"
# Name attribute of the empty dataset that NetCDF 4 stores for a dimension without coordinates.
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
Dataset = Any  # of h5py, which has no types


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected datasets of an HDF5 or NetCDF file.

    Args:
        path: the file.
        selection: the requested datasets; the time is optional if each has a time scale.

    Raises:
        LogError: the file is damaged or was cut short, a dataset is missing or in another file, or h5py is
            not installed.
    """
    with as_log_errors(path, KIND), path.open("rb") as stream:
        if stream.read(3) == netcdf3.MAGIC:
            return netcdf3.read(path, selection)
    h5py = import_optional("h5py", "hdf5", path)
    with as_log_errors(path, KIND), h5py.File(path, "r") as file:
        datasets = {name: dataset for name, dataset in _datasets(h5py, file) if _holds_numbers(dataset)}
        scales = {
            name: scale for name, dataset in datasets.items() if (scale := _time_scale(dataset)) is not None
        }
        matches = match_clocked_channels(path, list(datasets), selection, scales)
        clocks: dict[str, np.ndarray] = {}
        for scale in {name: scales[name] for name in matches.values() if name in scales}.values():
            if scale.name not in clocks:
                clocks[scale.name] = _read_clock(path, scale)
        channels = {
            requested: _channel(path, name, datasets, scales.get(name), clocks)
            for requested, name in matches.items()
        }
    return Content(path, channels)


def _datasets(h5py: Any, group: Any) -> Iterator[tuple[str, Dataset]]:
    """Yield full name and dataset of everything in a group; None for a link to another file.

    Soft links are left out: their target has a name of its own.
    """
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


def _is_real(dataset: Any) -> bool:
    """Return whether a dataset is one row or column of more than one real number."""
    return dataset.shape is not None and dataset.dtype.kind in NUMERIC_KINDS and is_vector(dataset.shape)


def read_dataset(path: Path, dataset: Any, name: str) -> np.ndarray:
    """Return the stored numbers of a dataset.

    Raises:
        LogError: the dataset is in another file.
    """
    if is_external(dataset):
        raise LogError(path, "is in another file; expected in this one", column=name)
    return dataset[()]


def is_external(dataset: Any) -> bool:
    """Return whether a dataset, None for a link to another file, is stored in another file."""
    return dataset is None or dataset.is_virtual or bool(dataset.external)


def _address(h5py: Any, item: Any) -> tuple[int, int]:
    info = h5py.h5o.get_info(item.id)
    return info.fileno, info.addr


def _holds_numbers(dataset: Any) -> bool:
    # The shape of an external dataset is not read: HDF5 would open the other file. It is listed so that a
    # request for it gives an error with the reason.
    if is_external(dataset):
        return True
    return _is_real(dataset) and not _text(dataset.attrs.get("NAME")).startswith(NO_VARIABLE)


def _text(value: object) -> str:
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)


def _time_scale(dataset: Any) -> Any:
    """Return the time scale of a dataset, the dataset itself if it is a scale, or None."""
    if is_external(dataset):
        return None
    for scale in _scales(dataset):
        if not is_external(scale) and is_time(unit_attribute(scale.attrs)) and scale.size == dataset.size:
            return scale if _is_real(scale) else None
    return None


def _scales(dataset: Any) -> list[Any]:
    # From the attributes: HDF5's functions for scales crash the process on damaged files.
    if _text(dataset.attrs.get("CLASS")) == "DIMENSION_SCALE":
        return [dataset]
    references = dataset.attrs.get("DIMENSION_LIST")
    return (
        []
        if references is None
        else [dataset.file[reference] for reference in references[int(np.argmax(dataset.shape))]]
    )


def _read_clock(path: Path, scale: Any) -> np.ndarray:
    raw = read_dataset(path, scale, scale.name)
    return to_seconds(decode_values(raw, scale.attrs), unit_attribute(scale.attrs))


def _channel(
    path: Path, name: str, datasets: Mapping[str, Dataset], scale: Dataset, clocks: Mapping[str, np.ndarray]
) -> LogChannel:
    clock_s, dataset = (None if scale is None else clocks[scale.name]), datasets[name]
    if clock_s is not None and dataset == scale:
        return LogChannel(clock_s, "s", clock_s)
    raw = read_dataset(path, dataset, name)
    return LogChannel(decode_values(raw, dataset.attrs), unit_attribute(dataset.attrs), clock_s)
