"""Packages of others, which bring a structure, a baseline or a renderer."""

import tomllib
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="session")
def install(tmp_path_factory):
    """Return a function that installs an example as far as Python sees: its module and its entry points."""

    def into(patch: pytest.MonkeyPatch, example: str) -> None:
        project = tomllib.loads((EXAMPLES / example / "pyproject.toml").read_text())["project"]
        folder = tmp_path_factory.mktemp(example)
        info = folder / f"{project['name'].replace('-', '_')}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 1.0\n")
        lines = []
        for group, entries in project["entry-points"].items():
            lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
        (info / "entry_points.txt").write_text("\n".join([*lines, ""]))
        patch.syspath_prepend(str(folder))
        patch.syspath_prepend(str(EXAMPLES / example))

    return into
