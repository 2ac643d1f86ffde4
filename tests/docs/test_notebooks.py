"""The notebooks of examples/notebooks are run as written, each in a folder of its own."""

import os
import runpy
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples" / "notebooks").glob("*.py"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_prints_its_results(path, tmp_path, monkeypatch, capsys):
    if "HITCHID_DATA" in path.read_text(encoding="utf-8") and not os.environ.get("HITCHID_DATA"):
        pytest.skip("HITCHID_DATA is not set")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path))
    assert "nan" not in capsys.readouterr().out


def test_there_are_notebooks_in_the_percent_format():
    assert NOTEBOOKS
    for path in NOTEBOOKS:
        text = path.read_text(encoding="utf-8")
        assert "format_name: percent" in text
        assert text.count("# %% [markdown]") >= 2


def test_from_dataframe_to_controller_takes_at_most_twelve_lines():
    path = next(path for path in NOTEBOOKS if path.stem == "from_dataframe_to_controller")
    _, _, story = path.read_text(encoding="utf-8").partition("# ## Model")
    lines = [line for line in story.splitlines() if line.strip() and not line.startswith("#")]
    assert len(lines) <= 12
