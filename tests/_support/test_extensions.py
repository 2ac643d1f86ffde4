"""Parts of other packages: found by entry point, refused by name where they do not fit."""

from pathlib import Path

import pytest

from hitchid._support.extensions import with_extensions
from hitchid.errors import InputError

OWN = ("first", "second")


def install(folder: Path, entries: str) -> None:
    """Lay a package with entry points of the group `hitchid.words` into a folder."""
    (folder / "words_pack.py").write_text("third = 'third'\nfirst = 'first'\nnumber = 3\n")
    info = folder / "words_pack-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: words-pack\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[hitchid.words]\n{entries}\n")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def words() -> list[str]:
    return list(with_extensions("hitchid.words", OWN, kind=str, name=str))


def test_without_other_packages_there_are_the_own_parts():
    assert words() == ["first", "second"]


def test_a_registered_part_stands_behind_the_own_ones(folder: Path):
    install(folder, "third = words_pack:third")
    assert words() == ["first", "second", "third"]


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        ("gone = words_pack:fourth", "AttributeError"),
        ("gone = no_such_pack:part", "ModuleNotFoundError"),
        ("number = words_pack:number", "expected str, got int"),
        ("twice = words_pack:first", "'first' is taken"),
    ],
)
def test_a_part_that_does_not_fit_names_its_package(folder: Path, entry: str, named: str):
    install(folder, entry)
    with pytest.raises(InputError) as caught:
        words()
    assert "words-pack" in str(caught.value)
    assert named in str(caught.value)
