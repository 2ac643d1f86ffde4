"""A look at logs: what they hold, what is odd, what is at fault, and that nothing changes."""

import json

import numpy as np
import pytest

from hitchid.errors import InputError, SettingsError
from hitchid.logs import inspect, write_table
from hitchid.logs.kinds import CommandThreshold

STEP_S = 0.01


@pytest.fixture
def write_log(tmp_path):
    """Return a function that writes a log of given commands, whose piston follows them, into one folder."""
    folder = tmp_path / "logs"
    folder.mkdir()

    def write(name, up, down=None, *, time_s=None, moved=None):
        down = np.zeros(len(up)) if down is None else down
        columns = {
            "time_s": np.round(STEP_S * np.arange(len(up)), 4) if time_s is None else time_s,
            "current_up_A": np.asarray(up, dtype=float),
            "current_down_A": np.asarray(down, dtype=float),
            "displacement_mm": np.cumsum(up) * 1.0 if moved is None else moved,
        }
        write_table(folder / f"{name}.csv", columns)
        return folder

    return write


def pulse(samples=100, level=1.0):
    return np.concatenate([np.zeros(10), np.full(samples - 10, level)])


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_every_record_is_listed_with_its_kind_sampling_units_and_ranges(write_log):
    folder = write_log("up", pulse(level=0.5))
    write_log("down", np.zeros(200), pulse(200), moved=np.linspace(7.0, -3.0, 200))
    (folder / "campaign.toml").write_text('[split]\ntest = ["down"]\n')
    found = inspect(folder)
    assert (found.notices, found.faults) == ((), ())
    down, up = (record.describe() for record in found.records)
    assert up.pop("quality")["noise"] == 0.0
    assert up == {
        "name": "up",
        "kind": "lifting",
        "held_out": False,
        "samples": 100,
        "step_s": 0.01,
        "duration_s": 0.99,
        "signals": {
            "displacement": {"unit": "mm", "lowest": 0.0, "highest": 45.0},
            "lifting_command": {"unit": "A", "lowest": 0.0, "highest": 0.5},
            "lowering_command": {"unit": "A", "lowest": 0.0, "highest": 0.0},
        },
    }
    assert (down["kind"], down["held_out"], down["duration_s"]) == ("lowering", True, 1.99)
    assert down["signals"]["displacement"] == {"unit": "mm", "lowest": -3.0, "highest": 7.0}


def test_looking_changes_nothing(write_log):
    folder = write_log("up", pulse())
    (folder / "broken.csv").write_text("time_s\n")
    before = contents(folder)
    inspect(folder)
    assert contents(folder) == before


def test_a_log_at_fault_does_not_hide_the_others(write_log):
    folder = write_log("a", pulse())
    (folder / "b.csv").write_text("time_s,current_up_A\n0,1\n")
    (folder / "c.csv").write_bytes(b"\x00\xff\xfe")
    write_log("d", pulse(), time_s=np.zeros(100))
    write_log("e", pulse())
    lenient, found = inspect(folder), inspect(folder, strict=True)
    assert lenient.faults == found.left_out == ()
    assert [each.name for each in lenient.left_out] == ["b", "c", "d"]
    assert str(lenient.warnings[-1]) == "3 of 5 logs left out"
    assert [record.name for record in found.records] == ["a", "e"]
    assert len(found.faults) == 3
    for fault, said in zip(
        found.faults, ("displacement_mm", "UTF-8", "all 100 time stamps are 0 s"), strict=True
    ):
        assert said in fault
    for fault, name in zip(found.faults, "bcd", strict=True):
        assert fault.startswith(f"{folder / name}.csv: ")


def test_a_column_that_all_logs_miss_is_one_fault_that_names_what_proposes_it(tmp_path):
    for name in "abcd":
        rows = "".join(f"{0.01 * k},{k},0\n" for k in range(50))
        (tmp_path / f"{name}.csv").write_text("time_s,valve,piston\n" + rows)
    (fault,) = inspect(tmp_path).faults
    assert "a.csv" in fault
    assert "'current_up_A'" in fault or "'displacement_mm'" in fault
    assert f"hitchid inspect {tmp_path} --propose" in fault
    assert "3 more logs" in fault


def test_faults_alone_leave_no_records(write_log):
    folder = write_log("a", pulse()[:5])
    found = inspect(folder)
    assert found.records == ()
    assert len(found.faults) == 1


def test_what_is_odd_but_usable_is_noticed_by_name(write_log):
    late = STEP_S * np.arange(100)
    late[50:] += 1.0
    uneven = STEP_S * (np.arange(100) + 0.1 * (np.arange(100) % 2))
    folder = write_log("a", pulse())
    write_log("gap", pulse(), time_s=late)
    write_log("rest", np.zeros(100))
    write_log("twice", pulse(), 0.5 * pulse())
    write_log("uneven", pulse(), time_s=uneven)
    found = inspect(folder)
    assert found.faults == ()
    assert [record.name for record in found.records] == ["a", "gap@1", "gap@2", "rest", "twice", "uneven"]
    said = {notice.place: str(notice) for notice in found.notices}
    assert set(said) == {"gap@2", "uneven"}
    assert "gap of 1.01 s" in said["gap@2"]
    assert "resampled" in said["uneven"]
    audited = {finding.check: finding for finding in found.findings if finding.record in ("rest", "twice")}
    assert "no command" in audited["excitation"].what
    assert audited["both valves"].spans == ((0.1, 0.99),)


def test_logs_that_do_not_fit_together_are_listed_with_the_reason(write_log):
    folder = write_log("a", pulse())
    write_log("b", pulse(), moved=np.full(100, 2.0))
    found = inspect(folder, strict=True)
    assert [record.kind for record in found.records] == ["not told", "not told"]
    assert len(found.faults) == 1
    assert "b.csv" in found.faults[0]
    assert "constant" in found.faults[0]


def test_one_log_of_a_folder_can_be_looked_at_although_the_split_names_others(write_log):
    folder = write_log("a", pulse())
    write_log("b", pulse())
    (folder / "campaign.toml").write_text('[split]\ntest = ["b"]\n')
    found = inspect(folder / "a.csv")
    assert found.faults == ()
    assert [record.kind for record in found.records] == ["lifting"]


def test_what_was_found_is_json(write_log):
    folder = write_log("a", pulse())
    (folder / "b.csv").write_text("")
    described = inspect(folder).describe()
    assert json.loads(json.dumps(described, allow_nan=False)) == described


def test_a_mixed_log_has_its_segments_and_how_long_each_kind_takes(write_log):
    up, down = np.repeat([0, 1.0, 0, 0, 0], 50), np.repeat([0, 0, 0, 1.0, 0], 50)
    folder = write_log("mixed", up, down, moved=np.cumsum(up - down))
    write_log("up", pulse())
    found = inspect(folder)
    mixed, single = (record.describe() for record in found.records)
    assert (mixed["kind"], single["kind"]) == ("cycle", "lifting")
    labels = ["hold", "lifting", "hold", "lowering", "hold"]
    assert mixed["segments"] == [
        {"label": label, "start_s": 0.5 * place, "stop_s": 0.5 * (place + 1)}
        for place, label in enumerate(labels)
    ]
    assert mixed["durations_s"] == {"lifting": 0.5, "lowering": 0.5, "hold": 1.5}
    assert not {"segments", "durations_s"} & set(single)
    (record,) = found.mixed
    assert record.name == "mixed"
    assert [each.label for each in record.segments] == labels
    described = found.describe()
    assert json.loads(json.dumps(described, allow_nan=False)) == described


def test_what_a_model_knows_of_the_valves_divides_a_mixed_log(write_log):
    up, down = np.repeat([0, 0.3, 1.0, 0], 50), np.repeat([0, 0, 0, 1.0], 50)
    folder = write_log("mixed", up, down, moved=np.cumsum(up - down))
    late = {"lifting": CommandThreshold(0.35, dead_time_s=0.1), "lowering": CommandThreshold(0.25)}
    (entry,) = inspect(folder, command_thresholds=lambda units: late).records
    assert [tuple(each.values()) for each in entry.describe()["segments"]] == [
        ("hold", 0.0, 1.1),
        ("lifting", 1.1, 1.5),
        ("both valves on", 1.5, 1.6),
        ("lowering", 1.6, 2.0),
    ]


def test_no_logs_and_a_broken_settings_file_are_refused(tmp_path, write_log):
    with pytest.raises(InputError, match="no log in this folder"):
        inspect(tmp_path / "logs")
    with pytest.raises(InputError, match="no logs given"):
        inspect([])
    folder = write_log("a", pulse())
    (folder / "campaign.toml").write_text("[signals]\nfoo = 1\n")
    with pytest.raises(SettingsError, match=r"signals\.foo"):
        inspect(folder)
