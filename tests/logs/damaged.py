"""What tests of readers of binary formats share: files cut short, foreign files, missing libraries."""

import subprocess
import sys

import numpy as np
import pytest

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection

EVERYTHING = ChannelSelection("time_s", None)
FOREIGN = {
    "empty": b"",
    "one byte": b"x",
    "csv": b"time_s,x\n0,1\n" * 100,
    "noise": bytes(range(256)) * 8,
    "nuls": b"\x00" * 400,
}


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


CHANGE_BYTES = """
import importlib, pathlib, sys
import numpy as np
from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection

path, begin = pathlib.Path(sys.argv[2]), int(sys.argv[3])
read, whole = importlib.import_module(sys.argv[1]).read, path.with_suffix(".whole").read_bytes()
for number, at in enumerate(np.random.default_rng(5).integers(0, len(whole), 100).tolist()):
    if number < begin:
        continue
    print(number, flush=True)
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x5D]) + whole[at + 1:])
    try:
        read(path, ChannelSelection("time_s", None))
    except MemoryError:
        pass  # a length may have become any number
    except LogError as error:
        if not str(error).startswith(f"{path}: "):
            raise
"""


def damage_everywhere(path, read):
    """Change bytes at many places: a file is read or refused by name, whatever its library makes of it.

    In a process of its own, for libraries in C may end it; `hitchid` reads such files in one, too.
    """
    path.with_suffix(".whole").write_bytes(path.read_bytes())
    begin = deaths = 0
    while begin < 100:
        command = [sys.executable, "-c", CHANGE_BYTES, read.__module__, str(path), str(begin)]
        child = subprocess.run(command, capture_output=True, text=True, timeout=120)  # noqa: S603
        begin = int(child.stdout.split()[-1]) + 1
        assert child.returncode <= 0, child.stderr
        deaths += child.returncode < 0
    assert begin == 100
    assert deaths < 5
    path.write_bytes(path.with_suffix(".whole").read_bytes())


def without(monkeypatch, module):
    """Make a module one that is not installed."""
    for name in [name for name in sys.modules if name == module or name.startswith(f"{module}.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)


def sample(package, *parts):
    """Return a file that an installed package carries, or skip the test."""
    import importlib.util
    from pathlib import Path

    path = Path(importlib.util.find_spec(package).origin).parent.joinpath(*parts)
    if not path.is_file():
        pytest.skip(f"{package} is installed without {'/'.join(parts)}")
    return path
