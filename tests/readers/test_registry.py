"""Formats of other packages: registered by entry point, refused where their endings are taken."""

from pathlib import Path

import pytest

from hitchid.errors import InputError
from hitchid.readers import format_of, read
from hitchid.readers.formats import formats

PACKAGE = """
import numpy as np
from hitchid.readers.content import Content, LogChannel
from hitchid.readers.formats import Format

def read(path, selection):
    table = np.genfromtxt(path, names=True)
    return Content(path, {name: LogChannel(table[name]) for name in table.dtype.names})

columns = Format("columns", (".columns",), read)
taken = Format("another text", (".csv",), read)
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return a function that installs a package with one entry point for a test."""

    def install_entry(entry: str) -> None:
        (tmp_path / "columns_pack.py").write_text(PACKAGE)
        info = tmp_path / "columns_pack-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: columns-pack\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[hitchid.formats]\n{entry}\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        formats.cache_clear()

    yield install_entry
    formats.cache_clear()


def test_a_log_in_a_registered_format_is_read(install, tmp_path):
    install("columns = columns_pack:columns")
    rows = [f"{0.01 * row} {0.5 * (row > 20)} 0 {max(0, row - 20)}" for row in range(100)]
    header = "time_s current_up_A current_down_A displacement_mm"
    (tmp_path / "lift.columns").write_text("\n".join((header, *rows)))
    campaign = read(tmp_path / "lift.columns")
    assert [record.name for record in campaign.records] == ["lift"]
    assert campaign.records[0].signals["displacement"][-1] == 79


def test_an_ending_has_one_format(install):
    install("taken = columns_pack:taken")
    with pytest.raises(InputError, match=r"text and another text both read '\.csv'"):
        format_of(Path("log.csv"))
