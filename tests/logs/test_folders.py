"""Where logs, settings and CAN databases are looked for, and that links are followed."""

from pathlib import Path

import numpy as np
import pytest

from hitchid.errors import InputError
from hitchid.logs import find_logs, read, settings_of, write_table
from hitchid.logs.formats import format_of

SAMPLES = 40
COLUMNS = {
    "time_s": np.arange(SAMPLES) / 100,
    "current_up_A": np.where(np.arange(SAMPLES) > 5, 0.5, 0.0),
    "current_down_A": np.zeros(SAMPLES),
    "displacement_mm": np.sqrt(np.arange(SAMPLES)),
}


@pytest.fixture
def logs(tmp_path):
    """Return a folder with one log."""
    (tmp_path / "logs").mkdir()
    write_table(tmp_path / "logs" / "a.csv", COLUMNS)
    return tmp_path / "logs"


@pytest.fixture
def outside(tmp_path):
    """Return a folder beside that of the logs, with a log, settings and a database."""
    (tmp_path / "outside").mkdir()
    write_table(tmp_path / "outside" / "other.csv", COLUMNS)
    (tmp_path / "outside" / "campaign.toml").write_text('[tests]\n"a" = "cycle"\n')
    (tmp_path / "outside" / "bus.dbc").write_text('VERSION ""\n')
    return tmp_path / "outside"


def databases(folder, signals=None):
    """Return the databases of the logs in a folder, as paths."""
    return settings_of([folder / "a.csv"], signals)[folder].can.databases


# --- which logs ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "",
        "Pump changed before lift-03.\n2 tests repeated, 1 of them with load.\n3 hoses are new\n",
        "1. warm up\n2. lift\n",
        "2023-05-01 oil changed\n2023-05-02 sensor fixed\n",
        "\0\1\2\3" * 999,
    ],
)
def test_notes_beside_logs_are_no_logs(logs, text):
    for name in ("notes.txt", "memory.dat"):
        (logs / name).write_text(text)
        with pytest.raises(InputError, match="is not a log in the format text table"):
            format_of(logs / name)
    assert [path.name for path in find_logs(logs)] == ["a.csv"]


# --- links --------------------------------------------------------------------------------------------------

LINKS = {
    "out of the folder": lambda logs, outside: outside / "other.csv",
    "relative": lambda logs, outside: "../outside/other.csv",
    "of several links": lambda logs, outside: "sub/hop.csv",
    "within the folder": lambda logs, outside: "a.csv",
}


@pytest.mark.parametrize("target", LINKS.values(), ids=LINKS.keys())
def test_a_log_may_be_a_link(logs, outside, target):
    (outside / "hop.csv").symlink_to(outside / "other.csv")
    (logs / "sub").symlink_to(outside)
    (logs / "b.csv").symlink_to(target(logs, outside))
    assert [path.name for path in find_logs(logs)] == ["a.csv", "b.csv"]
    assert [record.name for record in read(logs).records] == ["a", "b"]
    assert [record.name for record in read([logs / "b.csv"]).records] == ["b"]


def test_a_link_to_a_folder_is_as_good_as_the_folder(logs, tmp_path):
    (logs / "b.csv").symlink_to("a.csv")
    (logs / "campaign.toml").write_text('[tests]\n"*" = "cycle"\n')
    (tmp_path / "link").symlink_to(logs)
    records = read(tmp_path / "link").records
    assert [(record.name, record.kind) for record in records] == [("a", "cycle"), ("b", "cycle")]


@pytest.mark.parametrize("name", ["b.csv", "campaign.toml", "bus.dbc"])
@pytest.mark.parametrize("target", ["nothing", "itself"])
def test_a_broken_link_is_refused_by_name(logs, name, target):
    link = logs / name
    link.symlink_to(name if target == "itself" else "nothing")
    with pytest.raises(InputError, match="is a broken link to") as caught:
        read(logs)
    assert str(caught.value).startswith(f"{link}: ")
    if name == "b.csv":
        with pytest.raises(InputError, match="is a broken link to"):
            read([link])


def test_a_broken_link_that_is_no_log_is_not_read(logs):
    (logs / "notes.md").symlink_to("nothing")
    assert [record.name for record in read(logs).records] == ["a"]


@pytest.mark.parametrize("target", ["../outside/campaign.toml", "of-all.toml"])
def test_settings_may_be_a_link(logs, outside, target):
    (logs / "of-all.toml").write_text('[tests]\n"a" = "cycle"\n')
    (logs / "campaign.toml").symlink_to(target)
    assert read(logs).records[0].kind == "cycle"


# --- databases of CAN ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ((), ()),
        (("z.dbc", "B.DBC", "a.dbc", "a.dbc.bak", "dbc"), ("B.DBC", "a.dbc", "z.dbc")),
    ],
)
def test_all_databases_beside_the_logs_count_sorted(logs, outside, files, expected):
    (logs / "folder.dbc").mkdir()
    for name in files:
        (logs / name).touch()
    assert databases(logs) == tuple(str(logs / name) for name in expected)
    # Settings that name none leave those beside the logs.
    assert databases(logs, outside / "campaign.toml") == databases(logs)


def test_databases_named_in_the_settings_count_alone_and_lie_beside_them(logs, outside):
    (logs / "b.dbc").touch()
    for settings in (logs / "campaign.toml", outside / "other.toml"):
        settings.write_text('[can]\ndatabases = ["c.dbc", "a.dbc"]\n')
        expected = (str(settings.parent / "c.dbc"), str(settings.parent / "a.dbc"))
        assert databases(logs, None if settings.parent == logs else settings) == expected


def test_each_folder_has_its_own_databases(logs, tmp_path):
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "x.dbc").touch()
    (logs / "a.dbc").touch()
    paths = [logs / "a.csv", tmp_path / "more" / "b.csv"]
    of_folders = {folder.name: settings.can.databases for folder, settings in settings_of(paths).items()}
    assert of_folders == {"logs": (str(logs / "a.dbc"),), "more": (str(tmp_path / "more" / "x.dbc"),)}


def test_a_database_may_be_a_link_or_lie_elsewhere(logs, outside):
    (logs / "bus.dbc").symlink_to(outside / "bus.dbc")
    assert databases(logs) == (str(logs / "bus.dbc"),)
    (logs / "campaign.toml").write_text('[can]\ndatabases = ["../outside/bus.dbc"]\n')
    (path,) = databases(logs)
    assert Path(path).samefile(outside / "bus.dbc")
