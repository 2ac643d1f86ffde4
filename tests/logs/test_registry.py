"""Formats of other packages: registered by entry point, refused where their endings are taken."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from hitchid.errors import InputError, LogError
from hitchid.logs import format_of, read, write_table
from hitchid.logs.formats import formats

EXAMPLE = Path(__file__).parents[2] / "examples" / "format_from_outside"
ENTRY = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]["entry-points"]["hitchid.formats"]
TAKEN = """
from hitchid.logs import Format
TAKEN = Format("another text", (".csv",), print)
"""
OF_A_RIG = """
import numpy as np
from hitchid.logs import Content, Format, LogChannel

def read(path, selection):
    numbers = np.loadtxt(path, delimiter="|", skiprows=1)
    names = ("time_s", "current_up_A", "current_down_A", "displacement_mm")
    return Content(path, {name: LogChannel(column) for name, column in zip(names, numbers.T)})

ALL = Format("rig", (".log",), read)
OWN = Format("rig", (".log",), read, is_log=lambda path: path.read_text().startswith("RIG"))
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return a function that registers one format for a test."""

    def register(entry: str, folder: Path) -> None:
        info = tmp_path / "some_formats-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: some-formats\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[hitchid.formats]\n{entry}\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.syspath_prepend(str(folder))
        formats.cache_clear()

    yield register
    formats.cache_clear()


@pytest.fixture
def npz(install, tmp_path: Path) -> Path:
    """Return a log in the format of the example."""
    install(f"npz = {ENTRY['npz']}", EXAMPLE)
    path, rows = tmp_path / "lift.npz", np.arange(100)
    write_table(
        path,
        {
            "time_s": 0.01 * rows,
            "current_up_A": 0.5 * (rows > 20),
            "current_down_A": 0.0 * rows,
            "displacement_mm": np.maximum(0.0, rows - 20.0),
        },
    )
    return path


def test_a_registered_format_is_read_or_refused_where_damaged(npz):
    (record,) = read(npz).records
    assert (record.name, record.signals["displacement"][-1]) == ("lift", 79)
    npz.write_bytes(npz.read_bytes()[:100])
    with pytest.raises(LogError, match="cannot be read"):
        read(npz)


def test_an_ending_has_one_format(install, tmp_path):
    (tmp_path / "taken_pack.py").write_text(TAKEN)
    install("taken = taken_pack:TAKEN", tmp_path)
    with pytest.raises(InputError, match=r"text and another text both read '\.csv'"):
        format_of(Path("log.csv"))


@pytest.mark.parametrize("name", ["ALL", "OWN"])
def test_a_registered_format_comes_before_another_one_with_its_ending(install, tmp_path, name):
    """Formats of this package that share an ending leave what another package claims."""
    (tmp_path / "rig_pack.py").write_text(OF_A_RIG)
    install(f"rig = rig_pack:{name}", tmp_path)
    (tmp_path / "logs").mkdir()
    rows = "".join(f"{0.01 * k}|{0.5 * (k > 20)}|0|{max(0, k - 20)}\n" for k in range(100))
    (tmp_path / "logs" / "lift.log").write_text("RIG 7\n" + rows)
    (record,) = read(tmp_path / "logs").records
    assert (record.name, record.signals["displacement"][-1]) == ("lift", 79)
    (tmp_path / "bus.log").write_text("(0.010000) can0 123#00\n")
    assert format_of(tmp_path / "bus.log").name == {"ALL": "rig", "OWN": "candump"}[name]
    (tmp_path / "server.log").write_text("started\n")
    if name == "OWN":
        with pytest.raises(InputError, match=r"server\.log: is not a log in the format candump or rig; exp"):
            format_of(tmp_path / "server.log")


def test_a_name_too_long_for_a_disk_keeps_its_format():
    assert format_of(Path("a" * 300 + ".log")).name == "candump"
