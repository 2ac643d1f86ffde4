"""What tests of readers of binary formats share: a table, files cut short, files of others."""

import numpy as np
import pytest

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection

EVERYTHING = ChannelSelection("time_s", None)


def table(samples=60, seed=3):
    """Return columns of doubles that no shorter number holds."""
    random = np.random.default_rng(seed)
    columns = {"time_s": np.arange(samples) / 100, "stroke_mm": random.normal(size=samples)}
    columns |= {"current_mA": 1e3 * random.normal(size=samples), "x": random.normal(size=samples) / 3}
    columns["x"][:4] = np.nan, np.inf, -0.0, 5e-324
    return columns


def assert_same(content, columns):
    """Check that channels are as they were written, bit for bit, the time in whichever way it is kept."""
    for name, values in columns.items():
        if name in content.channels:
            assert content.channels[name].values.tobytes() == values.tobytes(), name
        else:
            assert name == "time_s"
            for channel in content.channels.values():
                assert channel.clock_s.tobytes() == values.tobytes()


def cut_everywhere(path, read, wanted=EVERYTHING, *, cuts=120, whole_at=()):
    """Cut a file short at many places: each cut is refused by name, or nothing of the data is lost.

    Returns how many cuts were refused.
    """
    whole, everything = path.read_bytes(), read(path, wanted)
    refused = 0
    for size in sorted(
        {*range(0, len(whole), max(1, len(whole) // cuts)), *range(len(whole) - 9, len(whole))}
    ):
        if size in whole_at:
            continue
        path.write_bytes(whole[:size])
        try:
            left = read(path, wanted)
        except LogError as error:
            assert str(error).startswith(f"{path}: "), error  # noqa: PT017
            refused += 1
            continue
        assert left.channels.keys() == everything.channels.keys(), size
        for name, channel in everything.channels.items():
            np.testing.assert_array_equal(
                left.channels[name].values, channel.values, err_msg=f"{size} {name}"
            )
    path.write_bytes(whole)
    return refused


def sample(package, *parts):
    """Return a file that an installed package carries, or skip the test."""
    import importlib.util
    from pathlib import Path

    path = Path(importlib.util.find_spec(package).origin).parent.joinpath(*parts)
    if not path.is_file():
        pytest.skip(f"{package} is installed without {'/'.join(parts)}")
    return path
