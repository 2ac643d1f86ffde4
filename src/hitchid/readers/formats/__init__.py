"""Which formats there are: a line for each."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid.errors import InputError
from hitchid.readers.content import ChannelSelection, Content
from hitchid.readers.formats import can, csv, hdf5, mat, mdf, parquet, tdms


class Format(NamedTuple):
    """One log format.

    Attributes:
        suffixes: the endings of its files.
        read: reads the wanted channels.
        write: writes columns of equal length, name to numbers; None where logs are not written in it.
        libraries: modules of others that read it; files of such a format are read in a process of their own.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path, ChannelSelection], Content]
    write: Callable[[Path, Mapping[str, np.ndarray]], None] | None = None
    libraries: tuple[str, ...] = ()


def _read_mdf(path: Path, selection: ChannelSelection) -> Content:
    """Read an MDF log of channels, or of a CAN bus where there are databases for it."""
    is_bus = selection.databases and can.is_bus_log(path)
    return can.read_mf4(path, selection) if is_bus else mdf.read(path, selection)


FORMATS = (
    Format(csv.SUFFIXES, csv.read, csv.write_table),
    Format(tdms.SUFFIXES, tdms.read, tdms.write_table, ("nptdms",)),
    Format(mdf.SUFFIXES, _read_mdf, mdf.write_table, ("asammdf",)),
    Format(mat.SUFFIXES, mat.read, None, ("scipy.io",)),
    Format(hdf5.SUFFIXES, hdf5.read, None, ("h5py",)),
    Format(parquet.SUFFIXES, parquet.read, parquet.write_table, ("pyarrow.parquet",)),
    Format(can.SUFFIXES, can.read, None, ("can", "cantools")),
)


def known_format(path: Path) -> Format | None:
    """Return the format of a file, told by its ending; None where it is not known."""
    name = path.name.lower()
    return next((log_format for log_format in FORMATS if name.endswith(log_format.suffixes)), None)


def format_of(path: Path) -> Format:
    """Return the format of a file, told by its ending.

    Raises:
        InputError: the ending is not known.
    """
    log_format = known_format(path)
    if log_format is None:
        raise InputError(f"{path}: the format is not known; required a file ending in {known_suffixes()}")
    return log_format


def known_suffixes() -> str:
    """Return the endings of all formats, in words."""
    return ", ".join(suffix for log_format in FORMATS for suffix in log_format.suffixes)


def record_name(path: Path) -> str:
    """Return a log's file name without its endings."""
    suffix = max((s for s in format_of(path).suffixes if path.name.lower().endswith(s)), key=len)
    return path.name[: -len(suffix)]


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length as a log; the ending of its name says the format.

    Raises:
        InputError: the ending is not known, or logs are not written in this format.
        OSError: the file cannot be written.
    """
    write = format_of(path).write
    if write is None:
        raise InputError(f"{path}: logs are not written in this format; required another ending")
    write(path, columns)
