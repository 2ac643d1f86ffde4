"""What tests of logs share: a folder into which a test writes logs of its commands."""

import numpy as np
import pytest
from mat_files import mat5, mat73

from hitchid.logs import write_table


@pytest.fixture
def write_log(tmp_path):
    """Return a function that writes a log of given commands, whose piston follows them, into one folder."""
    folder = tmp_path / "logs"
    folder.mkdir()

    def write(name, up, down=None, *, time_s=None, moved=None):
        down = np.zeros(len(up)) if down is None else down
        columns = {
            "time_s": np.round(0.01 * np.arange(len(up)), 4) if time_s is None else time_s,
            "current_up_A": np.asarray(up, dtype=float),
            "current_down_A": np.asarray(down, dtype=float),
            "displacement_mm": np.cumsum(up) * 1.0 if moved is None else moved,
        }
        write_table(folder / f"{name}.csv", columns)
        return folder

    return write


@pytest.fixture(params=[mat5, mat73], ids=["version 5", "version 7.3"])
def saved(request, tmp_path):
    """Return a function that saves structs in either kind of file and returns its path."""

    def save(variables):
        request.param(tmp_path / "log.mat", variables)
        return tmp_path / "log.mat"

    return save
