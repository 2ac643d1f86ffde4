"""NumPy archives as logs: one vector for each channel, named like a column."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hitchid.logs import ChannelSelection, Content, Format, LogChannel, match_channels


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected vectors of an archive."""
    with np.load(path) as archive:
        matches = match_channels(path, archive.files, selection)
        channels = {
            requested: LogChannel(archive[name].astype(np.float64)) for requested, name in matches.items()
        }
    return Content(path, channels)


def write(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write vectors of equal length."""
    np.savez_compressed(path, **dict(columns))


NPZ = Format("npz", (".npz",), read, write, libraries=("numpy",))
