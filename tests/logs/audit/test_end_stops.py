"""End stops: found where a piston stands at the extreme of its travel under command, and nowhere else."""

import numpy as np
import pytest
from flawed import changed, findings_of, make_test

from hitchid.errors import InputError, SettingsError
from hitchid.logs import read
from hitchid.logs.audit import Severity, audit, find_end_stop
from hitchid.logs.campaign import Campaign

STEP_S, NOISE, LAG_S, DELAY = 0.01, 0.03, 0.15, 8
SPEED = {1: 0.45, -1: 0.60}  # (%/s)/%, lifting and lowering
DEAD_ZONE = {1: 15.0, -1: 12.0}  # %


def piston(command, start=50.0, stops=(0.0, 100.0), seed=0):
    """Return the measured position of a piston with dead zone, delay, lag and end stops, %."""
    speed, position, measured = 0.0, start, []
    for signed in np.concatenate([np.zeros(DELAY), command])[: len(command)]:
        sign = 1 if signed > 0 else -1
        wanted = sign * SPEED[sign] * max(0.0, abs(signed) - DEAD_ZONE[sign])
        speed += STEP_S / LAG_S * (wanted - speed)
        measured.append(position)
        position = float(np.clip(position + STEP_S * speed, *stops))
    return np.array(measured) + NOISE * np.random.default_rng(seed).standard_normal(len(measured))


@pytest.fixture
def log(make_record):
    """Return a function that makes the log of a signed command, given as levels of some seconds."""

    def make(name, *levels, start=50.0, stops=(0.0, 100.0)):
        command = np.concatenate([np.full(round(seconds / STEP_S), level) for level, seconds in levels])
        position = piston(command, start, stops, seed=len(name))
        return make_record(position, np.maximum(command, 0), np.maximum(-command, 0), name=name)

    return make


@pytest.mark.parametrize("level", [20.0, 60.0, 100.0])
def test_one_standstill_is_a_stop_and_names_its_logs(log, level):
    # 20 % moves by 2.25 %/s: a command that is weak beside the others is enough.
    stands = log("stands", (0, 1), (60, 1.5), (0, 1), (level, 1 + 25 / (0.45 * (level - 15)) + 1), start=60.0)
    touches = log("touches", (0, 1), (60, 4.0), (0, 1), (-60, 1), (0, 1), start=30.0)
    passes = log("stays away", (0, 1), (20, 3), (60, 1.0), (0, 1), start=20.0)
    stop = find_end_stop([stands, touches, passes], "lifting", 1)
    assert stop is not None
    assert stop.position == pytest.approx(100.0, abs=NOISE)
    assert stop.reached == ("stands", "touches")
    (first, last), *_ = stop.standing["stands"]
    assert np.all(np.abs(stands.displacement[first + 40 : last] - 100.0) < 5 * NOISE)
    assert find_end_stop([stands, touches, passes], "lowering", -1) is None


def test_a_piston_within_its_dead_zone_is_at_no_stop(log):
    # At the extreme of its travel and 10 % of command, which moves nothing: neither here nor elsewhere.
    held = [log(f"held-{n}", (0, 1), (60, 2.0), (10, 3), (0, 1), start=10.0 + n) for n in range(3)]
    assert find_end_stop(held, "lifting", 1) is None
    assert [finding for finding in audit(Campaign.of(held)) if finding.check == "end stop"] == []


def test_a_piston_that_stands_elsewhere_is_at_no_stop(log):
    # Blocked at 60 and at 80 %: whatever holds it, it is no end of the stroke.
    blocked = [log(f"b-{end}", (0, 1), (60, 6), (0, 1), start=20.0, stops=(0.0, end)) for end in (60.0, 80.0)]
    assert find_end_stop(blocked, "lifting", 1) is None


def test_the_audit_names_both_stops_of_mixed_logs(log):
    up_and_down = [(0, 1), (70, 4), (0, 1), (-80, 4), (0, 1), (30, 2), (0, 1)]
    logs = [log("both", *up_and_down), log("neither", (0, 1), (40, 1), (0, 1), (-40, 1), (0, 1))]
    findings = [finding for finding in audit(Campaign.of(logs)) if finding.check == "end stop"]
    assert [finding.record for finding in findings] == ["both", "both"]
    positions = sorted(float(finding.what.split("stays at ")[1].split()[0]) for finding in findings)
    np.testing.assert_allclose(positions, [0.0, 100.0], atol=NOISE)


def test_logs_beyond_a_given_stop_are_named(log):
    logs = [log("near", (0, 1), (40, 2), (0, 1), start=60.0), log("far", (0, 1), (60, 4), (0, 1), start=17.0)]
    stop = find_end_stop(logs, "lifting", 1, known=100.0)
    assert (stop.position, stop.reached, dict(stop.standing)) == (100.0, (), {})
    campaign = Campaign.of(logs, end_stops=(0.0, 90.0))
    assert (campaign.end_stop(1), campaign.end_stop(-1)) == (90.0, 0.0)
    beyond = [finding for finding in audit(campaign) if finding.severity.value == "warning"]
    assert [(f.check, f.record) for f in beyond if "beyond end_stops = [0, 90]" in f.what] == [
        ("end stop", "far")
    ]
    assert campaign.digest != Campaign.of(logs).digest


@pytest.mark.parametrize("end_stops", [(1.0,), (100.0, 0.0), (0.0, np.inf), (0.0, 50.0, 100.0)])
def test_end_stops_that_are_none_are_refused(log, end_stops):
    with pytest.raises(InputError, match="end_stops: expected"):
        Campaign.of([log("a", (0, 1), (60, 2))], end_stops=end_stops)


def write_log(folder, settings, factor=1.0):
    folder.mkdir()
    command = np.where(np.arange(300) < 100, 0.0, 60.0)
    position = factor * piston(command, 10.0)
    rows = [f"{k / 100},{c},{x:.4f}" for k, (c, x) in enumerate(zip(command, position, strict=True))]
    (folder / f"{folder.name}.csv").write_text("\n".join(["time_s,i,x", *rows, ""]))
    columns = '[signals]\nlifting_command = {{ column = "i", unit = "percent" }}\n'
    (folder / "campaign.toml").write_text(settings + columns.format() + DISPLACEMENT[factor])
    return folder


DISPLACEMENT = {
    1.0: 'displacement = { column = "x", unit = "mm" }\n',
    0.1: 'displacement = { column = "x", unit = "cm" }\n',
}


def test_campaign_toml_says_the_stops_in_the_unit_of_its_displacement(tmp_path):
    logs = [
        write_log(tmp_path / "a", "end_stops = [0, 100]\n"),
        write_log(tmp_path / "b", "end_stops = [0, 10.0]\n", factor=0.1),
        write_log(tmp_path / "c", ""),
    ]
    assert read(logs).end_stops == (0.0, 100.0)
    assert read(logs[2]).end_stops is None
    other = write_log(tmp_path / "d", "end_stops = [0, 90]\n")
    with pytest.raises(InputError, match="end_stops: expected the same in all folders"):
        read([*logs, other])


@pytest.mark.parametrize("wrong", ["[100, 0]", "[0]", "[0, nan]", '["a", "b"]', "100"])
def test_stops_that_are_no_range_are_refused_with_the_file(tmp_path, wrong):
    with pytest.raises(SettingsError, match=r"campaign\.toml: key 'end_stops"):
        read(write_log(tmp_path / "a", f"end_stops = {wrong}\n"))


def test_a_piston_that_something_holds_before_its_end_is_found(clean):
    assert findings_of(clean, "stall") == []
    command = np.repeat([0.0, 0.6, 0.5, 0.0], 300)
    held, free = make_test("held", command=command), make_test("free", command=command)
    rng = np.random.default_rng(0)
    limited = np.minimum(held.displacement, 25.0) + 0.05 * rng.standard_normal(len(held))
    # At 0.6 A stands what 0.4 A moves in the others.
    (finding,) = findings_of([changed(held, limited), free, *clean], "stall")
    assert (finding.record, finding.severity) == ("held", Severity.WARNING)
    stands_at = float(finding.what.split("stands at ")[1].split()[0])
    assert stands_at == pytest.approx(25.0, abs=0.05)  # the noise
    # Contact is at 15 mm of travel at 12 mm/s; a standstill shows 0.3 s later.
    assert finding.spans[0][0] == pytest.approx(3.0 + 15 / 12 + 0.3, abs=0.15)
