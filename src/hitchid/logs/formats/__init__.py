"""The registry of log formats: one line for each; other packages add theirs by entry point."""

from collections import Counter
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid._support.extensions import with_extensions
from hitchid.errors import InputError
from hitchid.logs.content import ChannelSelection, Content
from hitchid.logs.formats import can, hdf5, mat, mdf, parquet, tdms, text


class Format(NamedTuple):
    """One log format.

    Attributes:
        name: unique among all formats.
        suffixes: endings of its files, in lower case, each with its point.
        read: reads the selected channels; raises `LogError` where the file is damaged or was cut short, a
            channel is missing, or a library is not installed.
        write: writes columns of equal length, name to numbers; None for a format that is only read.
        libraries: third-party modules that read it; such files are read in a process of their own.
        is_log: whether a file with one of the endings is a log of this format, for endings that others use
            as well; None for a format that has its endings to itself, or reads all that no other one claims.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, ChannelSelection], Content]
    write: Callable[[Path, Mapping[str, np.ndarray]], None] | None = None
    libraries: tuple[str, ...] = ()
    is_log: Callable[[Path], bool] | None = None


def _read_mdf(path: Path, selection: ChannelSelection) -> Content:
    """Read an MDF log of channels, or of a CAN bus where there are databases for it."""
    # Without a database frames cannot be decoded, and the file may have channels, too.
    is_bus = selection.databases and can.is_bus_log(path)
    return (can if is_bus else mdf).read(path, selection)


BUILT_IN = (
    Format("text", text.SUFFIXES, text.read, text.write_table),
    Format("text table", text.SHARED_SUFFIXES, text.read, text.write_table, (), text.is_table),
    Format("tdms", tdms.SUFFIXES, tdms.read, tdms.write_table, ("nptdms",)),
    Format("mdf", mdf.SUFFIXES, _read_mdf, mdf.write_table, ("asammdf",)),
    Format("matlab", mat.SUFFIXES, mat.read, None, ("scipy.io",)),
    Format("hdf5", hdf5.SUFFIXES, hdf5.read, None, ("h5py",)),
    Format("parquet", parquet.SUFFIXES, parquet.read, parquet.write_table, ("pyarrow.parquet",)),
    Format("can", can.SUFFIXES, can.read, None, ("can", "cantools")),
    Format("candump", can.CANDUMP_SUFFIXES, can.read, None, ("can", "cantools"), can.is_candump),
)


@cache
def formats() -> Mapping[str, Format]:
    """Return all formats by name: those of this package, then the entry points `hitchid.formats`.

    Raises:
        InputError: a registered format cannot be loaded, or its name or an ending is taken.
    """
    log_format = with_extensions(
        "hitchid.formats", BUILT_IN, kind=Format, name=lambda log_format: log_format.name
    )
    # Formats that look into a file may share an ending; two that do not would hide one another.
    exclusive = {name: item.suffixes for name, item in log_format.items() if item.is_log is None}
    count = Counter(suffix for suffixes in exclusive.values() for suffix in suffixes)
    for suffix in (suffix for suffix in count if count[suffix] > 1):
        names = " and ".join(name for name, suffixes in exclusive.items() if suffix in suffixes)
        raise InputError(
            f"hitchid.formats: {names} both read '{suffix}'; expected one format per file ending"
        )
    return log_format


def known_format(path: Path) -> Format | None:
    """Return the format of a file by its ending; None for an unknown ending or a file of another kind.

    Where several formats share an ending, those of other packages come first.
    """
    # Those of other packages first: they know files that this package can only guess at.
    for log_format in reversed(tuple(formats().values())):
        if not path.name.lower().endswith(log_format.suffixes):
            continue
        try:
            if log_format.is_log is None or not path.is_file() or log_format.is_log(path):
                return log_format
        except OSError:
            return log_format  # its reader says why the file cannot be read
    return None


def format_of(path: Path) -> Format:
    """Return the format of a file by its ending.

    Raises:
        InputError: the ending is not known, or stands for a format that the file does not have.
    """
    log_format = known_format(path)
    if log_format is None:
        name = path.name.lower()
        others = [other.name for other in formats().values() if name.endswith(other.suffixes)]
        problem = f"is not a log in the format {' or '.join(others)}" if others else "the format is not known"
        raise InputError(f"{path}: {problem}; expected a file ending in {known_suffixes()}")
    return log_format


def known_suffixes() -> str:
    """Return the endings of all formats, separated by commas."""
    suffixes = (suffix for log_format in formats().values() for suffix in log_format.suffixes)
    return ", ".join(dict.fromkeys(suffixes))


def record_name(path: Path) -> str:
    """Return a log's file name without its endings."""
    suffix = max((s for s in format_of(path).suffixes if path.name.lower().endswith(s)), key=len)
    return path.name[: -len(suffix)]


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length as a log in the format of its ending.

    Raises:
        InputError: the ending is not known, or logs are not written in this format.
        OSError: the file cannot be written.
    """
    write = format_of(path).write
    if write is None:
        raise InputError(f"{path}: hitchid cannot write this format; choose another file ending")
    write(path, columns)
