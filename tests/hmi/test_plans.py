"""What an operator asks for is understood, or refused with the name of what is wrong."""

import contextlib
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import InputError, SettingsError
from hitchid.hmi.plans import MOST_BYTES, MOST_SAMPLES, Limits, read_commands, read_limits, read_plan

CAMPAIGN = {"kind": "campaign", "name": "monday"}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=10), inner, max_size=3),
    max_leaves=10,
)


@pytest.mark.parametrize(
    ("content", "key"),
    [
        ({}, "kind"),
        ({"kind": "dance"}, "kind"),
        ({"kind": "campaign"}, "name"),
        ({**CAMPAIGN, "name": "../up"}, "name"),
        ({**CAMPAIGN, "name": ".hidden"}, "name"),
        ({**CAMPAIGN, "name": "a/b"}, "name"),
        ({**CAMPAIGN, "name": "a\n"}, "name"),
        ({**CAMPAIGN, "name": ""}, "name"),
        ({**CAMPAIGN, "name": 61 * "a"}, "name"),
        ({**CAMPAIGN, "ramps": 0}, "ramps"),
        ({**CAMPAIGN, "ramp_s": float("nan")}, "ramp_s"),
        ({**CAMPAIGN, "tests": 1001}, "tests"),
        ({**CAMPAIGN, "test_s": "ten"}, "test_s"),
        ({**CAMPAIGN, "cycles": -1}, "cycles"),
        ({**CAMPAIGN, "directions": []}, "directions"),
        ({**CAMPAIGN, "directions": ["sideways"]}, "directions"),
        ({**CAMPAIGN, "seed": 2**31}, "seed"),
        ({**CAMPAIGN, "speed": 2}, "speed"),
        ({"kind": "file", "name": "a"}, "file"),
        ({"kind": "file", "name": "a", "file": "uploads/a.csv", "unattended": True}, "unattended"),
        ({"kind": "file", "name": "a", "file": "uploads/a.csv", "campaign": "../b"}, "campaign"),
        ({"kind": "drive", "name": "a"}, "controller"),
        (
            {"kind": "drive", "name": "a", "controller": "controllers/a.toml", "unattended": True},
            "unattended",
        ),
    ],
)
def test_a_wrong_plan_is_refused_with_its_key(content, key):
    with pytest.raises(InputError, match=rf"^plan: .*{key}"):
        read_plan(content)


@given(JSON | st.fixed_dictionaries({"kind": st.sampled_from(["campaign", "file", "drive"]), "name": JSON}))
def test_anything_is_a_plan_or_refused(content):
    with contextlib.suppress(InputError):
        assert read_plan(content).name == content["name"]


def test_a_campaign_counts_its_logs_and_its_time():
    times = {"ramp_s": 10, "test_s": 5, "cycle_s": 30}
    plan = read_plan({**CAMPAIGN, **times, "ramps": 2, "tests": 3, "cycles": 1})
    assert plan.total == 2 * 2 + 2 * 3 + 1
    assert plan.duration_s > 4 * 10 + 6 * 5 + 30
    one_way = {**CAMPAIGN, "directions": ["lifting"], "ramps": 2, "tests": 3}
    alone, mixed = read_plan(one_way), read_plan({**one_way, "cycles": 1})
    assert (alone.excited, alone.total) == (("lifting",), 5)
    assert (mixed.excited, mixed.total) == (("lifting", "lowering"), 8)


def written(tmp_path, text):
    path = tmp_path / "next.csv"
    path.write_text(text)
    return path


def test_commands_are_held_until_the_next_row(tmp_path):
    path = written(tmp_path, "time_s,lifting_command,lowering_command\n5,0.1,0\n5.03,0,0.2\n5.05,0.3,0\n")
    expected = [[0.1, 0.0]] * 3 + [[0.0, 0.2]] * 2 + [[0.3, 0.0]]
    np.testing.assert_array_equal(read_commands(path, 0.01), expected)
    os.truncate(path, MOST_BYTES + 1)
    with pytest.raises(InputError, match=r"next\.csv: is larger than 50 MB"):  # which it does not read
        read_commands(path, 0.01)


@given(st.lists(st.integers(1, 9), min_size=1, max_size=30), st.sampled_from([0.01, 0.004, 0.02]))
def test_each_row_is_held_as_long_as_it_says(tmp_path_factory, holds, step_s):
    starts = np.concatenate([[0], np.cumsum(holds)])
    rows = "".join(f"{start * step_s:.9g},{1 + number}\n" for number, start in enumerate(starts))
    path = written(tmp_path_factory.mktemp("file"), f"time_s,lifting_command\n{rows}")
    lifting, lowering = read_commands(path, step_s).T
    expected = np.concatenate([np.repeat(np.arange(len(holds)), holds), [len(holds)]]) + 1.0
    np.testing.assert_array_equal(lifting, expected)
    assert not lowering.any()


@pytest.mark.parametrize(
    "header",
    [
        "time_s,lifting_command,lowering_command",
        "time_s,current_up_A,current_down_A",
        "time_s,lifting_command_A,lowering_command_A",
        "time_s, lifting_command , lowering_command ",
        "time_s,lowering_command,lifting_command",
    ],
)
def test_columns_are_found_by_name(tmp_path, header):
    path = written(tmp_path, f"{header}\n0,0.5,0\n0.01,0.5,0\n")
    expected = [0.0, 0.5] if "lowering_command,lifting" in header else [0.5, 0.0]
    assert read_commands(path, 0.01)[0].tolist() == expected


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "expected time_s first"),
        ("time_s,lifting_command\n", "expected time_s first"),
        ("time_s,lifting_command\n0,0.5\n", "expected time_s first"),
        ("lifting_command,time_s\n0,0\n1,0\n", "expected time_s first"),
        ("time_s,position\n0,0\n1,0\n", "expected time_s first"),
        ("time_s,lifting_command\n0,0.5\n1,0.5,0.5\n", "cannot be read"),
        ("time_s,lifting_command\n0,high\n1,0.5\n", "cannot be read"),
        ("time_s,lifting_command\n0,\n1,0.5\n", "cannot be read"),
        ("time_s,lifting_command\n0,nan\n1,0.5\n", "finite numbers"),
        ("time_s,lifting_command\n0,0.5\ninf,0.5\n", "finite numbers"),
        ("time_s,lifting_command\n0,0.5\n0,0.5\n", "rising times"),
        ("time_s,lifting_command\n0,0.5\n1,-0.5\n", "at least zero"),
        ("time_s,lifting_command\n0,0.5\n1e9,0.5\n", f"at most {MOST_SAMPLES}"),
        ("time_s,lifting_command\n0,0.5\n1e300,0.5\n", f"at most {MOST_SAMPLES}"),
        ("time_s,lifting_command,lowering_command\n0,0.5,0.1\n1,0,0\n", "both valves at once"),
        (bytes(range(256)), "cannot be read"),
    ],
)
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_a_file_that_is_none_of_commands_is_refused(tmp_path, text, problem):
    path = tmp_path / "next.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=rf"^next\.csv: .*{problem}"):
        read_commands(path, 0.01)


LIMITS = {
    "lifting_command": "0.9",
    "lowering_command": "0.8",
    "lowest_displacement": "10",
    "highest_displacement": "210",
}


def limits_file(tmp_path, **changed):
    path = tmp_path / "limits.toml"
    entries = {name: value for name, value in {**LIMITS, **changed}.items() if value}
    path.write_text("".join(f"{name} = {value}\n" for name, value in entries.items()))
    return path


def test_a_limits_file_is_read(tmp_path):
    limits = read_limits(limits_file(tmp_path, sensor_silence_s="0.2"))
    assert (limits.commands, limits.displacement, limits.travel) == ((0.9, 0.8), (10.0, 210.0), 200.0)
    assert limits.sensor_silence_s == 0.2


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"lifting_command": ""}, "lifting_command"),
        ({"lifting_command": "0"}, "lifting_command"),
        ({"lowering_command": "inf"}, "lowering_command"),
        ({"lowering_command": "nan"}, "lowering_command"),
        ({"lowest_displacement": "210"}, "lowest_displacement"),
        ({"highest_displacement": "'high'"}, "highest_displacement"),
        ({"sensor_silence_s": "0"}, "sensor_silence_s"),
        ({"sensor_silence_s": "2"}, "sensor_silence_s"),
        ({"watchdog_s": "2"}, "watchdog_s"),
    ],
)
def test_a_wrong_limits_file_is_refused_with_its_key(tmp_path, changed, key):
    with pytest.raises(SettingsError, match=key):
        read_limits(limits_file(tmp_path, **changed))


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_only_what_is_outside_the_travel_s_margin_is_beyond(displacement):
    limits = Limits.model_validate({name: float(value) for name, value in LIMITS.items()})
    assert limits.is_beyond(displacement) == (not 6.0 <= displacement <= 214.0)
