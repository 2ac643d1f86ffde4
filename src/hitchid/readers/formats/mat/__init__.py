"""MATLAB `.mat` files of any version: vectors, structs of them, exports of ControlDesk and Simulink."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hitchid.errors import LogError
from hitchid.readers.content import Channel, Content, Wanted
from hitchid.readers.formats.cf import in_seconds
from hitchid.readers.formats.extra import damage, floats, picked
from hitchid.readers.formats.mat import version5, version73
from hitchid.readers.formats.mat.tree import Leaf, Source, channels_of

SUFFIXES = (".mat",)
KIND = "a MATLAB file"


def read(path: Path, wanted: Wanted) -> Content:
    """Read the wanted vectors of a MATLAB file.

    Args:
        path: the file.
        wanted: what is asked for; the time may be missing in exports that keep it for each signal.

    Raises:
        LogError: the file is damaged or was cut short, a vector is missing or not real, or h5py is missing
            for a file of version 7.3.
    """
    with damage(path, KIND):
        source = version73 if version73.is_one(path) else version5
        with source.opened(path) as log:
            named = channels_of(log.tree)
            found = picked(path, list(named), wanted, {name for name, c in named.items() if c.time})
            chosen = {asked: named[name] for asked, name in found.items()}
            leaves = [leaf for c in chosen.values() for leaf in (c.values, c.time) if leaf]
            stock = log.load([leaf.variable for leaf in leaves if leaf.variable])
            channels = _channels(path, chosen, stock, strict=wanted.signals is not None)
    return Content(path, channels)


def _channels(
    path: Path, chosen: Mapping[str, Source], stock: Mapping[str, np.ndarray], *, strict: bool
) -> dict[str, Channel]:
    channels: dict[str, Channel] = {}
    clocks: dict[int, np.ndarray] = {}
    for asked, source in chosen.items():
        values = source.values.load(stock)
        if values.dtype.kind not in "fiub":
            if strict:
                raise LogError(path, "required a real numeric vector", column=asked)
            continue  # before it is read, a complex vector cannot be told from a real one
        clock_s = None if source.time is None else _clock(source.time, source.time_unit, stock, clocks)
        channels[asked] = Channel(floats(values), source.unit, clock_s)
    return channels


def _clock(
    leaf: Leaf, unit: str | None, stock: Mapping[str, np.ndarray], clocks: dict[int, np.ndarray]
) -> np.ndarray:
    if id(leaf) not in clocks:
        clocks[id(leaf)] = in_seconds(floats(leaf.load(stock)), unit)
    return clocks[id(leaf)]
