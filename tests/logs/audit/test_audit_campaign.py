"""Flaws of a whole campaign: units, signs, commands, repeats that drift, too little excitation."""

import numpy as np
import pytest
from flawed import changed, findings_of, make_test

from hitchid.logs.audit import Severity
from hitchid.logs.record import DIRECTIONS


def scaled(records, role, factor, unit):
    return [
        changed(record, signals={role: factor * record.signals[role]}, units={role: unit})
        for record in records
    ]


@pytest.mark.parametrize(
    ("role", "factor", "unit", "level", "probably"),
    [
        ("displacement", 1.0, "m", Severity.FAULT, "such as mm"),
        ("displacement", 1e-3, "mm", Severity.WARNING, "such as m,"),
        ("displacement", 10.0, "deg", Severity.WARNING, "probably a raw count"),
        ("displacement", 1.0, "rad", Severity.WARNING, "probably degrees"),
        ("displacement", 0.02, "deg", Severity.NOTE, "probably radians"),
        ("displacement", 1.0, "1", Severity.WARNING, "probably percent"),
        ("lifting_command", 1.0, "percent", Severity.WARNING, "probably a fraction"),
        ("lifting_command", 1000.0, "percent", Severity.WARNING, "probably a raw count"),
        ("lifting_command", 100.0, "1", Severity.WARNING, "probably percent"),
        ("lifting_command", 1000.0, "A", Severity.FAULT, "probably mA"),
        ("lifting_command", 1.0, "mA", Severity.WARNING, "probably A"),
        ("lifting_command", 1000.0, "V", Severity.WARNING, "probably mV"),
        ("displacement", 1e-3, "m", None, ""),
        ("displacement", 0.1, "cm", None, ""),
        ("displacement", 0.5, "deg", None, ""),
        ("displacement", 0.005, "1", None, ""),
        ("displacement", 0.5, "percent", None, ""),
        ("lifting_command", 1000.0, "mA", None, ""),
        ("lifting_command", 100.0, "percent", None, ""),
        ("lifting_command", 1.0, "1", None, ""),
        ("lifting_command", 10.0, "V", None, ""),
    ],
)
def test_a_wrong_unit_is_told_and_a_right_one_not_doubted(clean, role, factor, unit, level, probably):
    findings = findings_of(scaled(clean, role, factor, unit), "units")
    summaries = [(finding.severity, finding.signal, finding.record) for finding in findings]
    assert summaries == ([] if level is None else [(level, role, "")])
    assert all(probably in finding.what for finding in findings)


@pytest.mark.parametrize(
    ("name", "unit", "value", "level"),
    [
        ("pressure", "bar", 2000.0, Severity.WARNING),
        ("pressure", "bar", -5.0, Severity.WARNING),
        ("pressure", "bar", 180.0, None),
        ("pressure", "MPa", 18.0, None),
        ("pressure", "1", 180.0, Severity.NOTE),
        ("tank", "bar", -0.5, None),
    ],
)
def test_further_signals_are_held_against_their_unit(clean, name, unit, value, level):
    records = [changed(r, signals={name: np.full(len(r), value)}, units={name: unit}) for r in clean]
    findings = findings_of(records, "units")
    assert [finding.severity for finding in findings] == ([] if level is None else [level])


def turned(record):
    return changed(record, 300 - record.displacement)


def test_one_test_against_the_others_is_that_tests_fault(clean):
    (finding,) = findings_of([turned(clean[0]), *clean[1:]], "sign")
    assert (finding.severity, finding.record) == (Severity.FAULT, "lifting-1")
    assert "decreases" in finding.what


def test_both_reversed_is_a_warning_and_both_alike_a_fault(clean):
    (both,) = findings_of([turned(record) for record in clean], "sign")
    assert both.severity is Severity.WARNING
    assert "measures downwards" in both.advice
    assert "scale = -1" in both.advice
    lifting = [r for r in clean if "lifting" in r.name]
    lowering = [turned(r) for r in clean if "lowering" in r.name]
    (alike,) = findings_of([*lifting, *lowering], "sign")
    assert alike.severity is Severity.FAULT
    assert "increases in lifting and in lowering" in alike.what


def test_both_valves_at_once_are_found_with_their_span(clean):
    command = np.zeros(len(clean[0]))
    command[200:300] = 0.5
    for stop, severity in ((300, Severity.WARNING), (205, Severity.NOTE)):
        command[stop:] = 0
        both = changed(clean[0], signals={"lowering_command": command})
        (finding,) = findings_of([both, *clean[1:]], "both valves")
        assert (finding.severity, finding.record) == (severity, "lifting-1")
        assert finding.spans == ((2.0, stop / 100 - 0.01),)


@pytest.mark.parametrize(("offset", "level"), [(0.1, Severity.WARNING), (0.02, Severity.NOTE), (0.002, None)])
def test_a_command_that_is_never_zero_is_found(clean, offset, level):
    records = [changed(r, signals={"lifting_command": r.command("lifting") + offset}) for r in clean]
    findings = findings_of(records, "idle command")
    assert [(finding.severity, finding.signal) for finding in findings] == (
        [] if level is None else [(level, "lifting_command")]
    )
    if level:
        assert f"{offset:g} A" in findings[0].what


@pytest.mark.parametrize("last", [1.0, 1.03, 1.2, 0.85])
def test_a_drift_of_the_speed_is_found_with_its_size(last):
    rng = np.random.default_rng(2)
    scatter = 1 + 0.005 * rng.standard_normal(10)
    gains = 40 * np.linspace(1, last, 10) * scatter
    records = [make_test(f"l-{k}", gain=gain, samples=1500) for k, gain in enumerate(gains)]
    findings = findings_of(records, "drift")
    if abs(last - 1) < 0.05:
        assert findings == []
    else:
        (finding,) = findings
        change = float(finding.what.split(" is ")[1].split("%")[0]) / 100
        assert ("faster" in finding.what) == (last > 1)
        # Scatter of 0.5 % in each of ten gains gives the slope a standard error of 0.5 %.
        assert change == pytest.approx(abs(last - 1), abs=0.025)


def test_four_tests_and_levels_in_rising_order_are_no_drift():
    assert findings_of([make_test(f"l-{k}", gain=40 + 5 * k) for k in range(4)], "drift") == []
    levels = np.linspace(0.45, 0.9, 10)
    step = np.concatenate([np.zeros(50), np.ones(500), np.zeros(50)])
    records = [make_test(f"l-{k}", command=level * step) for k, level in enumerate(levels)]
    assert findings_of(records, "drift") == []


def test_starts_at_unlike_places_are_noted(clean):
    moved = changed(clean[0], clean[0].displacement + 20)
    (finding,) = findings_of([moved, *clean[1:]], "start position")
    assert finding.severity is Severity.NOTE
    assert "6 lifting tests start between" in finding.what


def test_ramps_that_set_off_at_unlike_commands_are_found():
    ramp = np.linspace(0, 0.6, 2000)
    alike = [make_test(f"r-{k}", command=ramp, zone=zone) for k, zone in enumerate([0.30, 0.31])]
    assert findings_of(alike, "dead zone") == []
    unlike = [make_test(f"r-{k}", command=ramp, zone=zone) for k, zone in enumerate([0.25, 0.4])]
    (finding,) = findings_of(unlike, "dead zone")
    low, high = (float(part.split()[0]) for part in finding.what.split("between ")[1].split(" and "))
    # Both have gone as far past their dead zones; the travel of one is half of the other's at most.
    assert 0.25 < low < 0.4 < high < 0.6


def said(findings, text):
    return [finding for finding in findings if text in finding.what]


def test_one_level_of_command_and_few_changes_are_told(clean):
    step = np.concatenate([np.zeros(50), np.full(500, 0.6), np.zeros(50)])
    findings = findings_of([make_test(f"l-{k}", command=step) for k in range(5)], "excitation")
    (one,) = said(findings, "one level of command, about 0.6 A")
    (few,) = said(findings, "changes fewer than 4 times")
    assert (one.severity, few.severity) == (Severity.WARNING, Severity.NOTE)
    assert "in 5 of 5 tests" in few.what
    several = [make_test(f"l-{k}", command=level * step) for k, level in enumerate((0.6, 0.8, 1.0))]
    assert not said(findings_of(several, "excitation"), "one level")


def test_little_motion_short_tests_and_rests_are_told(clean):
    still = make_test("lifting-7", gain=0.1)
    brief = make_test("lifting-8", samples=250)
    rest = np.concatenate([np.zeros(4000), np.full(150, 0.6), np.full(150, 0.4), np.full(50, 0.6)])
    resting = make_test("lifting-9", command=rest)
    idle = make_test("lifting-10", command=np.zeros(500), gain=0.0)
    findings = findings_of([*clean, still, brief, resting, idle], "excitation")
    (little,) = said(findings, "times its noise")
    assert (little.severity, little.record) == (Severity.WARNING, "lifting-7")
    assert [finding.record for finding in said(findings, "lasts 2.49 s")] == ["lifting-8"]
    assert [finding.record for finding in said(findings, "is active in 8.0%")] == ["lifting-9"]
    assert [finding.record for finding in said(findings, "no command is active")] == ["lifting-10"]


def test_a_default_split_of_the_strongest_tests_alone_is_noted():
    levels = np.linspace(0.4, 0.9, 10)
    named = [make_test(f"a{k}", command=prbs_at(level)) for k, level in enumerate(levels)]
    (finding,) = said(
        findings_of(named, "excitation"), "the held-out lifting tests reach 0.844 to 0.9 A only"
    )
    assert (finding.severity, finding.advice[-6:]) == (Severity.NOTE, "a2, a7")
    mixed = [make_test(f"a{k}", command=prbs_at(level)) for k, level in enumerate(np.roll(levels, 5))]
    assert not said(findings_of(mixed, "excitation"), "the held-out")
    alike = [make_test(f"a{k}", command=prbs_at(0.6)) for k in range(10)]
    assert not said(findings_of(alike, "excitation"), "the held-out")


def prbs_at(level):
    """Return pulses between rest and a level."""
    return level * np.repeat(np.random.default_rng(0).choice([0.0, 1.0], 24), 50)


def test_commands_barely_above_the_dead_zone_are_told(clean):
    weak = [make_test(f"w-{k}", command=0.5 * r.command("lifting")) for k, r in enumerate(clean[:6])]
    findings = findings_of([*weak, *clean[6:]], "excitation")
    (finding,) = said(findings, "motion starts in ramps")
    assert (finding.severity, finding.signal) == (Severity.WARNING, "lifting_command")


def test_missing_ramps_tests_and_held_out_tests_are_noted(clean):
    findings = findings_of([make_test("lifting-1")], "excitation")
    assert said(findings, "no slow lifting ramp")
    assert said(findings, "lifting tests or strokes: 1, too few")
    assert said(findings, "no lifting test is held out")
    assert said(findings, "lowering is never commanded")
    assert {finding.severity for finding in findings} == {Severity.NOTE}
    without = findings_of([r for r in clean if "ramp" not in r.name], "excitation")
    assert [finding.signal for finding in without] == [f"{mode}_command" for mode in DIRECTIONS]


def signed_around(zero):
    """Return tests of one signed command that rests at a reading, mapped as campaign.toml says no zero."""
    records = []
    for number in range(3):
        record = make_test(f"test-{number}", seed=number)
        pulses = np.repeat(np.random.default_rng(number).choice([-1.0, 0.0, 0.0, 1.0], 24), 50)
        reading = zero + pulses
        moved = 80 + 0.4 * np.cumsum(pulses)
        commands = {"lifting_command": np.maximum(reading, 0), "lowering_command": np.maximum(-reading, 0)}
        records.append(changed(record, signals={"displacement": moved, **commands}))
    return records


@pytest.mark.parametrize(("zero", "level"), [(7.4745, Severity.FAULT), (-0.2, Severity.WARNING)])
def test_a_command_that_rests_at_a_constant_gets_its_zero_proposed(zero, level):
    (finding,) = findings_of(signed_around(zero), "neutral")
    assert finding.severity is level
    assert f"zero = {zero:g} " in finding.advice


def test_commands_resting_at_zero_need_no_other_zero(clean):
    assert findings_of(signed_around(0.0), "neutral") == []
    assert findings_of(clean, "neutral") == []
    busy = [make_test(f"b-{n}", command=np.repeat([0.4, 0.6, 0.5], 400)) for n in range(3)]
    assert findings_of(busy, "neutral") == []


@pytest.mark.parametrize(
    ("factor", "said"), [(0.1, "10 times less"), (0.001, "1000 times less"), (25.4, "25.4 times more")]
)
def test_logs_in_another_unit_are_a_fault_each(factor, said):
    commands = [
        np.concatenate([np.zeros(100), np.full(400, level)]) for level in (0.6, 0.7, 0.8, 0.65, 0.75, 0.7)
    ]
    logs = [make_test(f"l-{number}", command=command) for number, command in enumerate(commands)]
    assert findings_of(logs, "units") == []
    for number in (1, 4):
        logs[number] = changed(logs[number], factor * logs[number].displacement)
    findings = findings_of(logs, "units")
    assert [(finding.severity.value, finding.record) for finding in findings] == [
        ("fault", "l-1"),
        ("fault", "l-4"),
    ]
    assert all(said in finding.what for finding in findings)
