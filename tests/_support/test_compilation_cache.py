"""The user's cache of compiled programs does not grow without end."""

import os

from hitchid._support import compilation_cache


def test_of_too_many_programs_the_newer_half_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(compilation_cache, "MAX_PROGRAMS", 4)
    for age in range(5):
        (tmp_path / f"{age}-cache").touch()
        os.utime(tmp_path / f"{age}-cache", (1000 - age, 1000 - age))

    compilation_cache._evict_oldest(tmp_path)

    assert sorted(path.name for path in tmp_path.iterdir()) == ["0-cache", "1-cache"]


def test_no_folder_of_programs_is_no_error(tmp_path):
    compilation_cache._evict_oldest(tmp_path / "none")
