"""MATLAB `.mat` files of any version: vectors, structs of them, exports of ControlDesk and Simulink."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.formats.library import as_log_errors, floats, match_clocked_channels, to_seconds
from hitchid.logs.formats.mat import version5, version73
from hitchid.logs.formats.mat.tree import ChannelSource, channels_of

SUFFIXES = (".mat",)
KIND = "a MATLAB file"


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected vectors of a MATLAB file; the time is optional where each signal has one."""
    with as_log_errors(path, KIND):
        reader = version73 if version73.is_hdf5(path) else version5
        with reader.open_log(path) as (tree, load_variables):
            sources = channels_of(tree)
            clocked = {name for name, source in sources.items() if source.time}
            matches = match_clocked_channels(path, list(sources), selection, clocked)
            selected = {requested: sources[name] for requested, name in matches.items()}
            leaves = [leaf for c in selected.values() for leaf in (c.values, c.time) if leaf]
            variables = load_variables([leaf.variable for leaf in leaves if leaf.variable])
            channels = _channels(path, selected, variables, strict=selection.signals is not None)
    return Content(path, channels)


def _channels(
    path: Path, selected: Mapping[str, ChannelSource], variables: Mapping[str, np.ndarray], *, strict: bool
) -> dict[str, LogChannel]:
    channels: dict[str, LogChannel] = {}
    clocks: dict[int, np.ndarray] = {}
    for requested, source in selected.items():
        values = source.values.load(variables)
        if values.dtype.kind not in "fiub":
            if strict:
                raise LogError(path, "expected a real numeric vector", column=requested)
            continue  # whether a vector is complex is known only after reading
        clock_s = None
        if source.time is not None:
            if id(source.time) not in clocks:
                clocks[id(source.time)] = to_seconds(floats(source.time.load(variables)), source.time_unit)
            clock_s = clocks[id(source.time)]
        channels[requested] = LogChannel(floats(values), source.unit, clock_s)
    return channels
