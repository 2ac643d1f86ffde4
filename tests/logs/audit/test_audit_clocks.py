"""Clocks and sampling: lags planted between samples, motion ahead of its command, unlike steps, gaps."""

import numpy as np
import pytest
from flawed import changed, findings_of, make_test

from hitchid.logs.audit import Severity
from hitchid.logs.audit.clock_checks import lag_of


def with_current(name, delay_s, *, noise=0.005):
    """Return a test whose measured current is its command, late by any time, as a coil's and filter's is."""
    record = make_test(name, samples=3000)
    time_s = record.time_s
    smooth = np.convolve(np.pad(record.command("lifting"), 10, "edge"), np.hanning(21) / 10, "valid")
    current = np.interp(time_s - delay_s, time_s, smooth)
    current += noise * np.random.default_rng(3).standard_normal(time_s.size)
    signals = {"current_measured": current, "lifting_command": smooth}
    return changed(record, signals=signals, units={"current_measured": "A"})


@pytest.mark.parametrize("delay_s", [0.0, 0.0137, 0.042, 0.25])
def test_a_lag_is_found_to_a_fraction_of_a_sample(delay_s):
    record = with_current("a", delay_s)
    lag, fit = lag_of(record.command("lifting"), record.signals["current_measured"], step_s=record.step_s)
    assert lag == pytest.approx(delay_s, abs=0.1 * record.step_s)
    assert fit > 0.95


@pytest.mark.parametrize(
    ("delay_s", "level", "said"),
    [
        (0.03, Severity.NOTE, "lags behind the lifting command by 0.03"),
        (0.2, Severity.WARNING, "lags behind the lifting command by 0.2"),
        (-0.05, Severity.FAULT, "leads the lifting command by 0.05"),
    ],
)
def test_a_leading_current_is_a_fault_a_lagging_one_noted(delay_s, level, said):
    (finding,) = findings_of([with_current("a", delay_s)], "lag")
    assert (finding.severity, finding.signal) == (level, "current_measured")
    stated = float(finding.what.rsplit(" ", 2)[1])
    assert stated == pytest.approx(abs(delay_s), abs=0.001)
    assert finding.what.startswith("current_measured " + said.rsplit(" ", 1)[0])


def test_a_current_of_both_valves_is_compared_with_both_commands():
    record = make_test("a")
    down = np.roll(record.command("lifting"), 400)
    up = np.where(down > 0, 0.0, record.command("lifting"))
    signals = {"lifting_command": up, "lowering_command": down, "total": np.roll(up + down, 3)}
    (finding,) = findings_of([changed(record, signals=signals, units={"total": "A"})], "lag")
    assert finding.what == "total lags behind the commands by 0.0300 s"


def test_an_unrelated_current_has_no_lag():
    record = make_test("a")
    assert findings_of([record], "lag") == []
    other = np.random.default_rng(5).standard_normal(len(record))
    assert findings_of([changed(record, signals={"x": other}, units={"x": "A"})], "lag") == []
    assert lag_of(np.ones(100), np.ones(100), step_s=0.01) is None


def test_motion_ahead_of_the_command_in_most_tests_is_a_fault(clean):
    def ahead(record):
        return changed(record, np.roll(record.displacement, -40))

    early = [ahead(clean[0]), ahead(clean[1]), *clean[2:]]
    two = findings_of(early, "motion before command")
    assert [(finding.record, finding.severity) for finding in two] == [
        ("lifting-1", Severity.WARNING),
        ("lifting-2", Severity.WARNING),
    ]
    # The command comes at 0.5 s; the displacement is early by 0.4 s and takes the valve's lag to get clear.
    start, stop = two[0].spans[0]
    assert 0.1 < start < 0.25
    assert stop == pytest.approx(0.5)
    (every,) = findings_of([ahead(record) for record in clean[:12]], "motion before command")
    assert every.severity is Severity.FAULT


def test_creeping_before_a_test_warns_and_a_spike_does_not(clean, planted):
    creep = clean[0].displacement + np.minimum(clean[0].time_s, 0.5) * 2.0
    (finding,) = findings_of(planted(creep), "motion before command")
    assert finding.severity is Severity.WARNING
    assert "creeps" in finding.what
    spike = clean[0].displacement.copy()
    spike[20] += 20
    assert not findings_of(planted(spike), "motion before command")


def test_resampled_logs_are_told(clean):
    from hitchid.logs.record import Record
    from hitchid.logs.resampling import ClockQuality

    slow = Record("lifting-0", 0.02, {role: x[::2] for role, x in clean[0].signals.items()}, clean[0].units)
    jitter = changed(clean[1], clock=ClockQuality(0.15, 0.0, 0.9))
    little = changed(clean[2], clock=ClockQuality(0.031, 0.0, 0.9))
    lost = changed(clean[3], clock=ClockQuality(0.001, 0.03, 0.06))
    findings = findings_of([slow, clean[0], jitter, little, lost, *clean[4:]], "sampling")
    assert [(finding.record, finding.severity) for finding in findings] == [
        ("lifting-0", Severity.WARNING),
        ("lifting-2", Severity.WARNING),
        ("lifting-4", Severity.WARNING),
        ("lifting-3", Severity.NOTE),
    ]
    assert "sampled every 0.02 s, the campaign every 0.01 s" in findings[0].what
    assert "15.0%" in findings[1].what
    assert "6.0% of the samples were lost" in findings[2].what


def test_a_step_too_coarse_for_the_motion_is_found():
    from hitchid.logs.record import Record

    command = np.concatenate([np.zeros(100), np.full(400, 0.6), np.zeros(100)])
    fine = make_test("a", command=command)
    assert findings_of([fine], "sampling") == []
    signals = {role: samples[::50] for role, samples in fine.signals.items()}
    (finding,) = findings_of([Record("a", 0.5, signals, fine.units)], "sampling")
    # At 0.6 A the piston moves at 40 (0.6 − 0.3) = 12 mm/s, 6 mm in 0.5 s, of 48 mm in all.
    assert "by up to 6" in finding.what or "by up to 5.9" in finding.what
    assert "12%" in finding.what or "13%" in finding.what


def test_gaps_are_counted_with_what_is_lost(clean):
    whole = clean[0]
    first, second = whole.slice(0, 400, name="cut@1"), whole.slice(650, 1200, name="cut@2")
    (finding,) = findings_of([first, second, *clean[1:]], "gaps")
    assert (finding.record, finding.severity) == ("cut@1", Severity.WARNING)
    assert np.allclose(finding.spans, [(3.99, 6.5)])
    assert "2.51 s of 11.99 s" in finding.what
    short = whole.slice(402, 1200, name="cut@2")
    (finding,) = findings_of([first, short, *clean[1:]], "gaps")
    assert finding.severity is Severity.NOTE


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "ms or us"), (0.001, "s"), (20.0, None), (0.1, None)])
def test_a_time_in_another_unit_is_found(clean, factor, unit):
    records = [changed(record, step_s=factor * record.step_s) for record in clean]
    said = [finding.what for finding in findings_of(records, "units") if "the time is" in finding.what]
    assert [text.rpartition(" in ")[2] for text in said] == ([] if unit is None else [unit])
