"""From files and folders to a campaign: which logs, which signals, which records, which notices."""

import gzip
import re

import numpy as np
import pytest

from hitchid.errors import InputError, LogError
from hitchid.logs import ReaderProcess, find_logs, read, read_log, write_table
from hitchid.logs.log_table import MIN_SAMPLES
from hitchid.logs.signal_map import DEFAULT_SIGNALS, CampaignFile, SignalColumn

EPS = np.finfo(np.float64).eps
STEP_S = 0.01
SAMPLES = 100


def columns(time_s=None, **changes):
    """Return a lifting log whose displacement is a straight line over time, 7 + 30 t."""
    time_s = np.round(STEP_S * np.arange(SAMPLES), 4) if time_s is None else np.asarray(time_s)
    up = np.where(np.arange(time_s.size) > 5, 0.5, 0.0)
    return {
        "time_s": time_s,
        "current_up_A": up,
        "current_down_A": 0 * up,
        "displacement_mm": 7.0 + 30.0 * time_s,
        **changes,
    }


@pytest.fixture
def folder(tmp_path):
    """Return a folder with one plain log, `a.csv`."""
    (tmp_path / "logs").mkdir()
    write_table(tmp_path / "logs" / "a.csv", columns())
    return tmp_path / "logs"


def names(campaign):
    return [record.name for record in campaign.records]


def settle(folder, text):
    (folder / "campaign.toml").write_text(text)
    return folder


# --- which files ------------------------------------------------------------------------------------------


def test_a_folder_gives_its_logs_sorted_and_nothing_else(folder):
    for name in ("c.csv", "b.CSV", "d.csv.gz"):
        write_table(folder / name, columns())
    for name in ("notes.txt", "e.csv.bak", "csv", ".hidden"):
        (folder / name).write_text("no log")
    (folder / "sub").mkdir()
    (folder / "sub.csv").mkdir()
    write_table(folder / "sub" / "f.csv", columns())
    assert [path.name for path in find_logs(folder)] == ["a.csv", "b.CSV", "c.csv", "d.csv.gz"]
    assert names(read(folder)) == ["a", "b", "c", "d"]


def test_files_and_folders_may_be_mixed_and_each_counts_once(folder):
    for given in ([folder / "a.csv", str(folder), folder], str(folder / "a.csv")):
        assert find_logs(given) == [folder / "a.csv"]
    with pytest.raises(InputError, match="no logs given"):
        find_logs([])


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("missing", "no such file or folder"),
        ("missing.csv", "no such file or folder"),
        ("a" * 300 + ".csv", "aaa"),
        ("loop.csv", "is a broken link to"),
        ("notes.md", r"format is not known.*\.csv, \.csv\.gz.*\.mat"),
        ("notes.txt", r"is not a log in the format text table; expected a file ending in \.csv, .*\.mat"),
        ("gz", r"format is not known"),
        ("empty", r"no log in this folder.*\.csv, \.csv\.gz.*\.mat"),
    ],
)
def test_what_is_no_log_is_refused_by_its_path(tmp_path, name, said):
    (tmp_path / "notes.md").write_text("")
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "gz").write_bytes(gzip.compress(b""))
    (tmp_path / "empty").mkdir()
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    with pytest.raises(InputError, match=said) as caught:
        find_logs(tmp_path / name)
    assert str(caught.value).startswith(f"{tmp_path / name}: ")


def test_equal_names_in_two_folders_get_the_folders_name(tmp_path):
    for subfolder in ("north", "south"):
        (tmp_path / subfolder).mkdir()
        write_table(tmp_path / subfolder / "a.csv", columns())
    write_table(tmp_path / "south" / "b.csv", columns())
    assert names(read([tmp_path / "north", tmp_path / "south"])) == ["b", "north/a", "south/a"]


def test_equal_names_in_one_folder_are_refused(folder):
    write_table(folder / "a.csv.gz", columns())
    with pytest.raises(InputError, match=r"'logs/a'.*names must differ"):
        read(folder)


# --- campaign.toml ----------------------------------------------------------------------------------------


def test_the_default_columns_need_no_settings(folder):
    (record,) = read(folder).records
    assert dict(record.units) == {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
    np.testing.assert_array_equal(record.displacement, columns()["displacement_mm"])
    np.testing.assert_array_equal(record.command("lifting"), columns()["current_up_A"])
    np.testing.assert_allclose(record.time_s, columns()["time_s"], rtol=2 * EPS)
    assert (record.source, record.notices, record.kind) == (folder / "a.csv", (), "lifting")


def test_other_names_units_and_covariates_come_from_the_folders_own_settings(tmp_path):
    renamed = {
        "t_ms": 10.0 * np.arange(SAMPLES),
        "duty": 50.0 * np.ones(SAMPLES),
        "angle_deg": np.arange(SAMPLES),
        "head_bar": np.arange(SAMPLES) ** 2,
        "oil": np.ones(SAMPLES),
    }
    write_table(tmp_path / "a.csv", renamed)
    settle(
        tmp_path,
        '[signals]\ntime = "t_ms"\ndisplacement = "angle_deg"\n'
        'lowering_command = { column = "duty", unit = "percent" }\ncovariates = ["head_bar", "oil"]\n',
    )
    (record,) = read(tmp_path).records
    assert record.step_s == STEP_S
    assert record.directions == ("lowering",)
    assert dict(record.units) == {
        "displacement": "deg",
        "lowering_command": "percent",
        "head_bar": "bar",
        "oil": "1",
    }
    np.testing.assert_array_equal(record.signals["head_bar"], renamed["head_bar"])


def test_a_signed_command_is_split_or_keeps_its_sign(tmp_path):
    signed = np.sin(np.arange(SAMPLES))
    write_table(tmp_path / "a.csv", {"time_s": columns()["time_s"], "v_V": signed, "displacement_mm": signed})
    (both,) = read(settle(tmp_path, '[signals]\ncommand = "v_V"\n')).records
    assert both.units["lifting_command"] == both.units["lowering_command"] == "V"
    np.testing.assert_array_equal(both.command("lifting"), np.maximum(signed, 0))
    np.testing.assert_array_equal(both.command("lowering"), np.maximum(-signed, 0))
    (alone,) = read(settle(tmp_path, '[signals]\nlifting_command = "v_V"\n')).records
    assert alone.directions == ("lifting",)
    np.testing.assert_array_equal(alone.command("lifting"), signed)


def test_a_settings_file_given_by_name_counts_instead_of_the_folders(folder, tmp_path):
    settle(folder, "not TOML at all")
    given = tmp_path / "other.toml"
    given.write_text('[tests]\n"a" = "cycle"\n')
    assert [record.kind for record in read(folder, signals=given).records] == ["cycle"]


def test_two_folders_each_keep_their_own_signal_map(tmp_path):
    for subfolder, unit in (("m", "m"), ("mm", "mm")):
        (tmp_path / subfolder).mkdir()
        log = columns()
        moved = log.pop("displacement_mm") / (1000 if unit == "m" else 1)
        write_table(tmp_path / subfolder / f"log-{subfolder}.csv", {**log, f"x_{unit}": moved})
        settle(
            tmp_path / subfolder,
            '[signals]\nlifting_command = "current_up_A"\nlowering_command = "current_down_A"\n'
            f'displacement = "x_{unit}"\n',
        )
    metres, millimetres = read([tmp_path / "m", tmp_path / "mm"]).records
    assert metres.unit == millimetres.unit == "m"
    np.testing.assert_allclose(millimetres.displacement, metres.displacement, rtol=4 * EPS)


def test_a_split_holds_out_tests_and_notes_unmatched_patterns(folder):
    for name in ("b", "c[1]"):
        write_table(folder / f"{name}.csv", columns())
    campaign = read(settle(folder, '[split]\ntest = ["b", "c[[]1]"]\n'))
    assert [record.name for record in campaign.held_out("lifting")] == ["b", "c[1]"]
    assert read(settle(folder, '[split]\ntest = ["c[1]"]\n')).unmatched == ("c[1]",)


def test_splits_of_two_folders_hold_out_the_tests_of_each(tmp_path):
    for subfolder, held_out in (("north", "a"), ("south", "b")):
        (tmp_path / subfolder).mkdir()
        for name in ("a", "b", "c"):
            write_table(tmp_path / subfolder / f"{name}.csv", columns())
        settle(tmp_path / subfolder, f'[split]\ntest = ["{held_out}"]\n[tests]\n"c" = "cycle"\n')
    campaign = read([tmp_path / "north", tmp_path / "south"])
    assert [record.name for record in campaign.held_out("lifting")] == ["north/a", "south/b"]
    assert [record.name for record in campaign.of_kind("cycle")] == ["north/c", "south/c"]


# --- clocks -----------------------------------------------------------------------------------------------


def test_a_gap_makes_two_records_with_a_notice(folder):
    time_s = STEP_S * np.arange(SAMPLES)
    time_s[60:] += 3.0
    write_table(folder / "a.csv", columns(time_s))
    before, after = read(folder).records
    assert (before.name, after.name) == ("a@1", "a@2")
    assert (len(before), len(after)) == (60, 40)
    assert before.notices == ()
    assert "gap of 3.01 s" in after.notices[0].sentence
    for record, rows in ((before, slice(0, 60)), (after, slice(60, None))):
        np.testing.assert_allclose(record.time_s, time_s[rows], rtol=4 * EPS)
        np.testing.assert_array_equal(record.displacement, columns(time_s)["displacement_mm"][rows])


def test_rows_with_one_stamp_count_once_and_are_told(folder):
    log = {name: np.insert(values, 50, values[49]) for name, values in columns().items()}
    log["displacement_mm"][50] += 3.0
    write_table(folder / "a.csv", log)
    (record,) = read(folder).records
    assert record.step_s == STEP_S
    np.testing.assert_array_equal(record.displacement, columns()["displacement_mm"])
    assert tuple(map(str, record.notices)) == (
        "1 rows are left out: they repeat the time stamp of the previous row",
    )


@pytest.mark.parametrize("rows", [2, 3])
def test_of_equal_stamps_the_last_command_counts(folder, rows):
    # A logger that writes each event of its own: rows before, and one after, the command has changed.
    log, edges = columns(), np.flatnonzero(np.diff(columns()["current_up_A"])) + 1
    assert edges.size
    before = np.repeat(edges, rows - 1)
    events = {name: np.insert(values, before, values[before]) for name, values in log.items()}
    events["current_up_A"] = np.insert(log["current_up_A"], before, log["current_up_A"][before - 1])
    write_table(folder / "a.csv", events)
    (record,) = read(folder).records
    np.testing.assert_array_equal(record.command("lifting"), log["current_up_A"])
    np.testing.assert_array_equal(record.displacement, log["displacement_mm"])


@pytest.mark.parametrize(("unit", "per_second"), [("s", 1), ("ms", 1000)])
@pytest.mark.parametrize("start_s", [0.0, -5.0, 1.7e9])
def test_any_start_and_unit_of_time_gives_the_same_clock(folder, unit, per_second, start_s):
    log = columns()
    log["time_s"] = (start_s + STEP_S * np.arange(SAMPLES)) * per_second
    write_table(folder / "a.csv", log)
    settings = CampaignFile(
        signals=DEFAULT_SIGNALS.model_copy(update={"time": SignalColumn(column="time_s", unit=unit)})
    )
    (record,) = read_log(folder / "a.csv", settings, ReaderProcess())
    assert record.step_s == STEP_S
    assert record.start_s == pytest.approx(start_s, abs=np.spacing(1.7e9))
    np.testing.assert_array_equal(record.displacement, columns()["displacement_mm"])


def test_a_log_too_short_is_refused_with_its_length(folder):
    for samples in (1, 2, MIN_SAMPLES - 1):
        write_table(folder / "a.csv", {name: values[:samples] for name, values in columns().items()})
        with pytest.raises(
            LogError, match=rf"a\.csv: the longest part without gaps has {samples} samples.*{MIN_SAMPLES}"
        ):
            read(folder)
    write_table(folder / "a.csv", {name: values[:MIN_SAMPLES] for name, values in columns().items()})
    assert len(read(folder).records[0]) == MIN_SAMPLES


STAMPS = STEP_S * np.arange(SAMPLES)
LOSSY = {
    "one sample long after the end": np.append(STAMPS, 100.0),
    "one sample long before the start": np.insert(STAMPS + 100, 0, 0.0),
    "seven samples between two gaps": STAMPS + 10.0 * (np.arange(SAMPLES) >= 43) + 10.0 * (STAMPS >= 0.5),
    "half the rate from the middle on": np.cumsum(np.where(STAMPS < 0.6, STEP_S, 2 * STEP_S)),
}


@pytest.mark.parametrize("time_s", LOSSY.values(), ids=LOSSY.keys())
def test_rows_are_left_out_only_with_a_notice_of_how_many(folder, time_s):
    write_table(folder / "a.csv", columns(time_s))
    try:
        records = read_log(folder / "a.csv", CampaignFile(), ReaderProcess())
    except LogError:
        return
    lost = time_s.size - sum(map(len, records))
    if records[0].clock.interpolated_share:
        assert lost < 0  # at half the rate the others are interpolated
        return
    notices = " ".join(str(notice) for record in records for notice in record.notices)
    assert lost > 0
    assert re.search(rf"\b{lost}\b", notices)
