"""A look at logs: what they hold, what is odd, what is at fault, and that nothing changes."""

import json

import numpy as np
import pytest

from hitchid.errors import InputError, SettingsError
from hitchid.logs import inspect
from hitchid.logs.kinds import CommandThreshold

STEP_S = 0.01


def pulse(samples=100, level=1.0):
    return np.concatenate([np.zeros(10), np.full(samples - 10, level)])


def test_every_record_is_listed_with_its_kind_sampling_units_and_ranges(write_log):
    folder = write_log("up", pulse(level=0.5))
    write_log("down", np.zeros(200), pulse(200), moved=np.linspace(7.0, -3.0, 200))
    (folder / "campaign.toml").write_text('[split]\ntest = ["down"]\n')
    inspection = inspect(folder)
    assert (inspection.notices, inspection.faults) == ((), ())
    down, up = (record.describe() for record in inspection.records)
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


def test_a_log_at_fault_does_not_hide_the_others(write_log):
    folder = write_log("a", pulse())
    (folder / "b.csv").write_text("time_s,current_up_A\n0,1\n")
    (folder / "c.csv").write_bytes(b"\x00\xff\xfe")
    write_log("d", pulse(), time_s=np.zeros(100))
    write_log("e", pulse())
    lenient, inspection = inspect(folder), inspect(folder, strict=True)
    assert lenient.faults == inspection.left_out == ()
    assert [log.name for log in lenient.left_out] == ["b", "c", "d"]
    assert str(lenient.warnings[-1]) == "3 of 5 logs left out"
    assert [record.name for record in inspection.records] == ["a", "e"]
    assert len(inspection.faults) == 3
    reasons = ("displacement_mm", "UTF-8", "all 100 time stamps are 0 s")
    for fault, name, reason in zip(inspection.faults, "bcd", reasons, strict=True):
        assert fault.startswith(f"{folder / name}.csv: ")
        assert reason in fault


def test_a_column_that_all_logs_miss_is_one_fault(tmp_path):
    for name in "abcd":
        rows = "".join(f"{0.01 * k},{k},0\n" for k in range(50))
        (tmp_path / f"{name}.csv").write_text("time_s,valve,piston\n" + rows)
    assert inspect(tmp_path).records == ()
    (fault,) = inspect(tmp_path).faults
    assert "a.csv" in fault
    assert "'current_up_A'" in fault or "'displacement_mm'" in fault
    assert f"hitchid inspect {tmp_path} --propose" in fault
    assert "3 more logs" in fault


def test_what_is_odd_but_usable_is_noticed_by_name(write_log):
    late = STEP_S * np.arange(100)
    late[50:] += 1.0
    uneven = STEP_S * (np.arange(100) + 0.1 * (np.arange(100) % 2))
    folder = write_log("a", pulse())
    write_log("gap", pulse(), time_s=late)
    write_log("rest", np.zeros(100))
    write_log("twice", pulse(), 0.5 * pulse())
    write_log("uneven", pulse(), time_s=uneven)
    inspection = inspect(folder)
    assert inspection.faults == ()
    assert [record.name for record in inspection.records] == [
        "a",
        "gap@1",
        "gap@2",
        "rest",
        "twice",
        "uneven",
    ]
    said = {notice.place: str(notice) for notice in inspection.notices}
    assert set(said) == {"gap@2", "uneven"}
    assert "gap of 1.01 s" in said["gap@2"]
    assert "resampled" in said["uneven"]
    audited = {
        finding.check: finding for finding in inspection.findings if finding.record in ("rest", "twice")
    }
    assert "no command" in audited["excitation"].what
    assert audited["both valves"].spans == ((0.1, 0.99),)


def test_logs_that_do_not_fit_together_are_listed_with_the_reason(write_log):
    folder = write_log("a", pulse())
    write_log("b", pulse(), moved=np.full(100, 2.0))
    inspection = inspect(folder, strict=True)
    assert [record.kind for record in inspection.records] == ["not told", "not told"]
    assert len(inspection.faults) == 1
    assert "b.csv" in inspection.faults[0]
    assert "constant" in inspection.faults[0]


def test_one_log_is_inspected_although_the_split_names_others(write_log):
    folder = write_log("a", pulse())
    write_log("b", pulse())
    (folder / "campaign.toml").write_text('[split]\ntest = ["b"]\n')
    inspection = inspect(folder / "a.csv")
    assert inspection.faults == ()
    assert [record.kind for record in inspection.records] == ["lifting"]


def test_what_was_found_is_json_and_looking_changes_nothing(write_log):
    folder = write_log("a", pulse())
    (folder / "b.csv").write_text("")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    described = inspect(folder).describe()
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_mixed_log_has_segments_and_durations(write_log):
    up, down = np.repeat([0, 1.0, 0, 0, 0], 50), np.repeat([0, 0, 0, 1.0, 0], 50)
    folder = write_log("mixed", up, down, moved=np.cumsum(up - down))
    write_log("up", pulse())
    inspection = inspect(folder)
    mixed, single = (record.describe() for record in inspection.records)
    assert (mixed["kind"], single["kind"]) == ("cycle", "lifting")
    labels = ["hold", "lifting", "hold", "lowering", "hold"]
    assert mixed["segments"] == [
        {"label": label, "start_s": 0.5 * number, "stop_s": 0.5 * (number + 1)}
        for number, label in enumerate(labels)
    ]
    assert mixed["durations_s"] == {"lifting": 0.5, "lowering": 0.5, "hold": 1.5}
    assert not {"segments", "durations_s"} & set(single)
    (record,) = inspection.mixed
    assert record.name == "mixed"
    assert [segment.label for segment in record.segments] == labels


def test_what_a_model_knows_of_the_valves_divides_a_mixed_log(write_log):
    up, down = np.repeat([0, 0.3, 1.0, 0], 50), np.repeat([0, 0, 0, 1.0], 50)
    folder = write_log("mixed", up, down, moved=np.cumsum(up - down))
    late = {"lifting": CommandThreshold(0.35, dead_time_s=0.1), "lowering": CommandThreshold(0.25)}
    (entry,) = inspect(folder, command_thresholds=lambda units: late).records
    assert [tuple(part.values()) for part in entry.describe()["segments"]] == [
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
