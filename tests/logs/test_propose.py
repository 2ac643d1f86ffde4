"""A first campaign.toml from logs alone: the mapping it finds is the one the logs were made with."""

import tomllib

import numpy as np
import pytest

from hitchid.errors import InputError
from hitchid.logs import find_logs, propose, write_table
from hitchid.logs.motion import Windows
from hitchid.logs.signal_map import SignalColumn, SignalMap, read_campaign_file

STEP_S = 0.01


def pulses(seed, levels=(-1.0, 0.0, 0.0, 1.0), samples=1000):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.choice(levels, samples // 25), 25)


def a_log(seed, *, up=False, against=False, zero=0.0, size=40.0, slower_up=1.0):
    """Return command(s), a displacement that integrates them, a target, a pressure and a counter."""
    rng, drive = np.random.default_rng(seed), pulses(seed)
    speed = np.where(drive > 0, drive / slower_up, drive)
    moved = 300 + (-1 if against else 1) * size * STEP_S * np.cumsum(speed)
    commands = {"duty_up": np.maximum(drive, 0) * 80, "duty_dn": np.maximum(-drive, 0) * 80}
    return {
        "clock": STEP_S * np.arange(drive.size),
        "noise": rng.standard_normal(drive.size),
        "stroke_mm": moved + 0.02 * rng.standard_normal(drive.size),
        **(commands if up else {"Boom Cmd": zero + 2 * drive}),
        "head_pressure": 80 + 5 * rng.standard_normal(drive.size),
    }


@pytest.fixture
def logs(tmp_path):
    """Return a function that writes four logs and returns their folder."""

    def write(**options):
        for seed in range(4):
            write_table(tmp_path / f"log-{seed}.csv", a_log(seed, **options))
        return tmp_path

    return write


@pytest.mark.parametrize("slower_up", [1.0, 4.0], ids=["alike", "lifting is four times slower"])
def test_two_one_sided_commands_are_found_with_units_and_covariate(logs, slower_up):
    folder = logs(up=True, slower_up=slower_up)
    (folder / "campaign.toml").write_text(propose(folder))
    assert read_campaign_file(folder / "campaign.toml").signals == SignalMap(
        time=SignalColumn(column="clock", unit="s"),
        lifting_command=SignalColumn(column="duty_up", unit="percent"),
        lowering_command=SignalColumn(column="duty_dn", unit="percent"),
        displacement=SignalColumn(column="stroke_mm", unit="mm"),
        covariates=("head_pressure",),
    )


@pytest.mark.parametrize("against", [False, True])
def test_a_signed_command_comes_with_its_zero_and_its_turned_sign(logs, against):
    signals = tomllib.loads(propose(logs(zero=7.4745, against=against)))["signals"]
    expected = {"column": "Boom Cmd", "unit": "percent", "zero": 7.4745}
    assert signals["command"] == (expected | {"scale": -1} if against else expected)
    assert signals["displacement"]["column"] == "stroke_mm"


def test_every_guess_has_its_reason_before_it(logs):
    lines = propose(logs()).splitlines()
    guesses = [at for at, line in enumerate(lines) if " = " in line and not line.startswith("#")]
    assert len(guesses) == 4
    assert all(lines[at - 1].startswith("# ") for at in guesses)


@pytest.mark.parametrize(
    ("ends", "expected"), [((270, 330), [270, 330]), ((270, 1000), None), ((-1000, 1000), None)]
)
def test_end_stops_are_proposed_where_the_piston_stands_at_both(tmp_path, ends, expected):
    for seed in range(4):
        log, stroke = a_log(seed, up=True), [300.0]
        drive = np.repeat(np.random.default_rng(seed).choice([-1.0, 0.0, 1.0], 10), 100)
        log["duty_up"], log["duty_dn"] = 80 * np.maximum(drive, 0), 80 * np.maximum(-drive, 0)
        for direction in drive[:-1]:
            stroke.append(np.clip(stroke[-1] + 0.4 * direction, *ends))
        log["stroke_mm"] = stroke + 0.02 * np.random.default_rng(seed).standard_normal(len(stroke))
        write_table(tmp_path / f"log-{seed}.csv", log)
    text = propose(tmp_path)
    assert tomllib.loads(text).get("end_stops") == expected
    assert ("say both" in text) == (ends == (270, 1000))


CLOCKS = {  # value of the first stamp, stamps in a second, unit
    "spreadsheet": (46086.5, 1 / 86400, "d"),
    "matlab": (738_886.0, 1 / 86400, "d"),
    "seconds since 1970": (1.7e9, 1.0, "s"),
    "milliseconds since 1970": (1.7e12, 1e3, "ms"),
    "microseconds": (0.0, 1e6, "us"),
}


@pytest.mark.parametrize(("zero", "factor", "unit"), CLOCKS.values(), ids=CLOCKS.keys())
def test_a_clock_is_found_by_its_size_despite_missing_samples(tmp_path, zero, factor, unit):
    log = {name: samples for name, samples in a_log(0, up=True).items() if name != "noise"}
    log["Zeit"] = zero + factor * log.pop("clock")
    log["stroke_mm"][100:150] = np.nan
    log["duty_up"][7] = np.nan
    log["empty"] = np.full(1000, np.nan)
    write_table(tmp_path / "log.csv", log)
    signals = tomllib.loads(propose(tmp_path))["signals"]
    assert signals.pop("covariates") == ["head_pressure"]
    assert signals == {
        "time": column("Zeit", unit),
        "lifting_command": column("duty_up", "percent"),
        "lowering_command": column("duty_dn", "percent"),
        "displacement": column("stroke_mm", "mm"),
    }


def test_logs_without_motion_are_refused_with_what_was_found(tmp_path):
    still = {"t": STEP_S * np.arange(100), "a": np.zeros(100), "b": np.ones(100)}
    write_table(tmp_path / "log.csv", still)
    with pytest.raises(InputError, match="no pair of columns correlates"):
        propose(tmp_path)


def column(name, unit, **further):
    return {"column": name, "unit": unit, **further}


MEASURED = {
    "excavator-boom": {
        "lifting_command": column("duty_up_percent", "percent"),
        "lowering_command": column("duty_down_percent", "percent"),
        "displacement": column("angle_deg", "deg"),
        "covariates": ["head_pressure"],
    },
    "dspace-raw": {
        "lifting_command": column("Boom_up_duty", "percent"),
        "lowering_command": column("Boom_dn_duty", "percent"),
        "displacement": column("Boom_ang", "deg"),
        "covariates": ["Boom_UpH_Cyl_P"],
    },
    "hanging-load": {"command": column("valve", "V"), "displacement": column("position", "V")},
    "rig-a": {
        "lifting_command": column("current_up_A", "A"),
        "lowering_command": column("current_down_A", "A"),
        "displacement": column("displacement_mm", "mm"),
    },
    # That its displacement is in cm, nothing in the files says.
    "field-excavator": {
        "command": column("Boom Cmd", "percent", zero=7.4745),
        "displacement": column("Boom Ms", "mm"),
    },
}


@pytest.mark.parametrize(("name", "expected"), MEASURED.items())
def test_measured_sets_get_the_mapping_that_stands_beside_them(data, name, expected):
    signals = tomllib.loads(propose(find_logs(data(name))))["signals"]
    assert signals.pop("time")["unit"] == "s"
    assert signals == expected


def test_motion_is_looked_for_after_its_command_and_not_before_it():
    command = np.random.default_rng(0).standard_normal(200)
    follows = np.ones(200, bool)

    def correlation(rate):
        return Windows({"u": command}, {"x": rate}, follows).correlation([command], "x")

    assert correlation(np.append(0.0, command[:-1])) == pytest.approx(1.0)
    # A rate that leads its command by a window is unrelated to it: of 200 values |r| < 4/√200.
    assert abs(correlation(np.append(command[1:], 0.0))) < 4 / np.sqrt(command.size)
