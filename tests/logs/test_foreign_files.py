"""Files that are not of the format their ending says, and formats whose library is missing."""

import sys

import pytest
from damaged import table

from hitchid.errors import LogError
from hitchid.logs import format_of, write_table
from hitchid.logs.content import ChannelSelection

FOREIGN = {
    "empty": b"",
    "one byte": b"x",
    "csv": b"time_s,x\n0,1\n" * 100,
    "noise": bytes(range(256)) * 8,
    "hdf5 cut short": b"\x89HDF\r\n\x1a\n" + b"\x00" * 600,
}
FORMATS = {".mat": "MATLAB", ".mf4": "MDF", ".h5": "HDF5", ".tdms": "TDMS", ".parquet": "Parquet"}


@pytest.mark.parametrize(("ending", "name"), FORMATS.items())
@pytest.mark.parametrize("content", FOREIGN.values(), ids=FOREIGN.keys())
def test_a_file_of_another_format_is_refused_with_the_expected_one(tmp_path, ending, name, content):
    path = tmp_path / f"log{ending}"
    path.write_bytes(content)
    with pytest.raises(LogError, match=rf"log\{ending}: .*{name}"):
        format_of(path).read(path, ChannelSelection("time_s", None))


@pytest.mark.parametrize(
    ("ending", "module", "library"),
    [(".mf4", "asammdf", "asammdf"), (".tdms", "nptdms", "npTDMS"), (".parquet", "pyarrow", "pyarrow")],
)
def test_a_library_that_is_required_to_write_is_named(tmp_path, monkeypatch, ending, module, library):
    for name in [name for name in sys.modules if name == module or name.startswith(f"{module}.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(LogError, match=f"{library} is required to write it"):
        write_table(tmp_path / f"log{ending}", table())
