"""The public surface against that of the last release: what changed stands in the changelog."""

import re
import tomllib
from pathlib import Path

import pytest
from tools import surface

ROOT = Path(__file__).parents[2]
CHANGELOG = (ROOT / "CHANGELOG.md").read_text()


def test_what_changed_since_the_last_release_stands_in_the_changelog():
    version, before = surface.released()
    assert f"\n## [{version}] - " in CHANGELOG
    changed = surface.changes(before, surface.surface())
    assert surface.unmentioned(changed, CHANGELOG) == [], (
        "name it in CHANGELOG.md, under [Unreleased], as code"
    )


def test_commands_names_and_keys_are_on_the_surface():
    now = surface.surface()
    assert now["hitchid export"] == "MODEL"
    assert now["hitchid.export.to_matlab"] == "(model, folder, *, name=, compensators=, controller=, force=)"
    assert now["hitchid export --to"] == "c|matlab|fmu2|fmu3|onnx"
    inherited = {"hitchid.Hitch.linearise", "hitchid.Hitch.dynamics", "hitchid.Campaign.__getitem__"}
    assert {"hitchid --version", "hitchid fleet identify --out", "campaign.toml: signals.time"} <= now.keys()
    assert inherited <= now.keys()


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        ({"hitchid a": ""}, {"hitchid a --x": "removed"}),
        ({}, {"hitchid a": "removed"}),
        ({"hitchid a": "MODEL", "hitchid a --x": ""}, {"hitchid a": "changed"}),
        (
            {"hitchid a": "", "hitchid a --x": "", "hitchid b": "", "hitchid b --y": ""},
            {"hitchid b": "added"},
        ),
    ],
)
def test_a_change_is_told_once(now, expected):
    assert surface.changes({"hitchid a": "", "hitchid a --x": ""}, now) == expected


@pytest.mark.parametrize(
    ("line", "missing"),
    [
        ("- `hitchid a --x` is new.", []),
        ("- `--x` of `hitchid a`", ["--x"]),
        ("- `hitchid b --x` is new.", ["--x"]),
        ("- x is new.", ["--x"]),
        ("", ["--x"]),
        ("- `hitchid a --xy`", ["--x"]),
    ],
)
def test_only_an_unreleased_line_that_names_it_mentions_a_change(line, missing):
    changelog = f"## [Unreleased]\n\n{line}\n\n## [0.1.0] - 2020-01-01\n\n- `--x`, `x`\n"
    names = surface.unmentioned({"hitchid a --x": "added"}, changelog)
    assert [name.rpartition(" ")[2] for name in names] == missing


def test_all_say_the_same_version_and_day():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    newest, day = re.search(r"^## \[(\d+\.\d+\.\d+)\] - (\S+)$", CHANGELOG, re.MULTILINE).groups()
    assert newest == version == surface.released()[0]
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {version}\ndate-released: {day}\n" in citation
    minor = version.rpartition(".")[0]
    assert f"The newest minor version gets corrections: {minor}." in (ROOT / "SECURITY.md").read_text()
    assert f"| the newest minor version, {minor} |" in (ROOT / "docs" / "support.md").read_text()
