"""Where logs, settings and CAN databases are looked for, and that links are followed."""

import gzip
import os
from pathlib import Path

import numpy as np
import pytest

from hitchid.errors import InputError
from hitchid.logs import find_logs, read, settings_of, write_table
from hitchid.logs.formats import BUILT_IN, format_of

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


# Any text may have these endings: a log of them is known from what it holds.
CONTENT = {".log": "(0.010000) can0 123#00\n", ".txt": "t y\n0 1\n1 2\n", ".dat": "t y\n0 1\n1 2\n"}


def databases(folder, signals=None):
    """Return the databases of the logs in a folder, as paths."""
    return settings_of([folder / "a.csv"], signals)[folder].can.databases


# --- which logs ---------------------------------------------------------------------------------------------


def test_logs_of_every_format_are_found_in_one_folder_sorted_by_name(logs):
    suffixes = [suffix for known in BUILT_IN for suffix in known.suffixes]
    for number, suffix in enumerate(reversed(suffixes)):
        content = CONTENT.get(suffix.removesuffix(".gz"), "").encode()
        (logs / f"b{number:02d}{suffix.upper() if number % 2 else suffix}").write_bytes(
            gzip.compress(content) if suffix.endswith(".gz") else content
        )
    for name in ("notes.txt", "campaign.toml", "bus.dbc", "b.mat.bak", "mat", "server.log", "empty.dat"):
        (logs / name).touch()
    found = [path.name for path in find_logs(logs)]
    assert found == sorted(found)
    assert len(found) == 1 + len(suffixes)
    assert {suffix for suffix in suffixes if any(name.lower().endswith(suffix) for name in found)} == set(
        suffixes
    )


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


def test_logs_of_several_formats_make_one_campaign(logs):
    for name in ("b.parquet", "c.csv.gz", "d.csv"):
        write_table(logs / name, COLUMNS)
    records = read(logs).records
    assert [record.name for record in records] == ["a", "b", "c", "d"]
    assert len({record.fingerprint for record in records}) == 1


# --- links --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("relative", [False, True])
def test_a_log_may_be_a_link_out_of_its_folder(logs, outside, relative):
    target = outside / "other.csv"
    (logs / "b.csv").symlink_to(os.path.relpath(target, logs) if relative else target)
    assert [record.name for record in read(logs).records] == ["a", "b"]


def test_a_log_may_lie_behind_several_links(logs, outside):
    (outside / "hop.csv").symlink_to(outside / "other.csv")
    (logs / "sub").symlink_to(outside)
    (logs / "b.csv").symlink_to("sub/hop.csv")
    assert [path.name for path in find_logs(logs)] == ["a.csv", "b.csv"]


def test_links_within_the_folder_are_followed(logs):
    (logs / "sub").mkdir()
    write_table(logs / "sub" / "deep.csv", COLUMNS)
    (logs / "b.csv").symlink_to("a.csv")
    (logs / "c.csv").symlink_to(logs / "sub" / "deep.csv")
    assert [path.name for path in find_logs(logs)] == ["a.csv", "b.csv", "c.csv"]


def test_a_folder_that_is_reached_by_a_link_is_as_good_as_its_target(logs, tmp_path):
    (logs / "b.csv").symlink_to("a.csv")
    (logs / "campaign.toml").write_text('[tests]\n"*" = "cycle"\n')
    (tmp_path / "link").symlink_to(logs)
    records = read(tmp_path / "link").records
    assert [(record.name, record.kind) for record in records] == [("a", "cycle"), ("b", "cycle")]


def test_a_log_given_by_name_may_be_a_link(logs, outside):
    (logs / "b.csv").symlink_to(outside / "other.csv")
    assert [record.name for record in read([logs / "b.csv"]).records] == ["b"]


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


def test_settings_may_be_a_link_out_of_the_folder(logs, outside):
    (logs / "campaign.toml").symlink_to(outside / "campaign.toml")
    assert read(logs).records[0].kind == "cycle"


def test_settings_that_are_a_link_within_the_folder_count(logs):
    (logs / "of-all.toml").write_text('[tests]\n"a" = "cycle"\n')
    (logs / "campaign.toml").symlink_to("of-all.toml")
    assert read(logs).records[0].kind == "cycle"


# --- databases of CAN ---------------------------------------------------------------------------------------


def test_all_databases_beside_the_logs_count_sorted_whatever_the_case(logs):
    for name in ("z.dbc", "B.DBC", "a.dbc", "a.dbc.bak", "dbc"):
        (logs / name).touch()
    assert databases(logs) == tuple(str(logs / name) for name in ("B.DBC", "a.dbc", "z.dbc"))


def test_without_databases_there_are_none(logs):
    assert databases(logs) == ()


def test_databases_named_in_the_settings_count_alone_and_lie_beside_them(logs, outside):
    for name in ("a.dbc", "b.dbc", "c.dbc"):
        (logs / name).touch()
    named = '[can]\ndatabases = ["c.dbc", "a.dbc"]\n'
    (logs / "campaign.toml").write_text(named)
    assert databases(logs) == (str(logs / "c.dbc"), str(logs / "a.dbc"))
    (outside / "other.toml").write_text(named)
    assert databases(logs, outside / "other.toml") == (str(outside / "c.dbc"), str(outside / "a.dbc"))


def test_settings_given_by_name_without_databases_leave_those_beside_the_logs(logs, outside):
    (logs / "a.dbc").touch()
    assert databases(logs, outside / "campaign.toml") == (str(logs / "a.dbc"),)


def test_each_folder_has_its_own_databases(logs, tmp_path):
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "x.dbc").touch()
    (logs / "a.dbc").touch()
    paths = [logs / "a.csv", tmp_path / "more" / "b.csv"]
    found = {folder.name: settings.can.databases for folder, settings in settings_of(paths).items()}
    assert found == {"logs": (str(logs / "a.dbc"),), "more": (str(tmp_path / "more" / "x.dbc"),)}


def test_a_database_may_be_a_link_or_lie_elsewhere(logs, outside):
    (logs / "bus.dbc").symlink_to(outside / "bus.dbc")
    assert databases(logs) == (str(logs / "bus.dbc"),)
    (logs / "campaign.toml").write_text('[can]\ndatabases = ["../outside/bus.dbc"]\n')
    (found,) = databases(logs)
    assert Path(found).samefile(outside / "bus.dbc")


def test_a_folder_named_like_a_database_is_none(logs):
    (logs / "sub.dbc").mkdir()
    assert databases(logs) == ()
