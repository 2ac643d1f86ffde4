"""Quality of a displacement: its noise and its smallest step, against what was put in."""

import numpy as np
import pytest
from flawed import changed, findings_of, make_test, make_tests, rounded

from hitchid.logs.audit import Severity
from hitchid.logs.audit.context import quality
from hitchid.logs.resampling import ClockQuality

# The median of |d²y| has a relative standard error of 1.17/√N; neighbours share samples, which makes it
# √1.94 times larger, 1.94 being 1 + 2 (ρ₁² + ρ₂²).
NOISE_ERROR = 1.6


@pytest.mark.parametrize("sigma", [0.01, 0.05, 1.0])
@pytest.mark.parametrize("quantum", [None, 0.02])
def test_noise_is_told_within_its_statistical_error(sigma, quantum):
    record = make_test("a", samples=20_000, noise=0.0)
    rng = np.random.default_rng(7)
    displacement = record.displacement + sigma * rng.standard_normal(len(record))
    if quantum:
        displacement = quantum * np.round(displacement / quantum)
    measured = quality(changed(record, displacement))
    tolerance = 5 * NOISE_ERROR / np.sqrt(len(record)) * np.hypot(sigma, (quantum or 0) / 12**0.5)
    assert measured.noise == pytest.approx(sigma, abs=tolerance + 0.02 * sigma)
    assert measured.quantum == (pytest.approx(quantum) if quantum else None)


@pytest.mark.parametrize("factor", [1.0, 1e-3, 25.4])
def test_the_smallest_step_is_found_in_any_unit(factor):
    record = make_test("a")
    displacement = factor * (3.217 + 0.25 * np.round(record.displacement / 0.25))
    assert quality(changed(record, displacement)).quantum == pytest.approx(0.25 * factor)


def test_steady_motion_without_noise_is_not_quantised(make_record):
    displacement = np.concatenate([np.zeros(50), np.linspace(0, 7, 200), np.full(50, 7.0)])
    measured = quality(make_record(displacement, np.ones(300)))
    assert (measured.quantum, measured.noise) == (None, 0.0)


def test_a_jittering_clock_is_told_as_reading_found_it():
    record = make_test("a")
    assert quality(record).jitter is None
    assert quality(changed(record, clock=ClockQuality(jitter=0.125))).jitter == 0.125
    assert quality(changed(record, clock=ClockQuality(jitter=1e-9, longest_gap_s=0.02))).jitter is None


def test_a_coarse_sensor_is_found(clean):
    findings = findings_of(rounded(clean, 5.0), "quantisation")
    (warned,) = [finding for finding in findings if finding.severity is Severity.WARNING]
    assert "steps of 5 mm" in warned.what


def test_one_step_motion_lost_in_rounding_is_noted():
    records = make_tests(2, samples=6000, noise=0.0)
    noted = findings_of(rounded(records, 0.4), "quantisation")
    assert [finding.severity for finding in noted] == [Severity.NOTE] * 2
    assert "steps of 0.4 mm" in noted[0].what
    assert findings_of(rounded(records, 0.01), "quantisation") == []


def test_noise_above_one_percent_of_the_range_is_found():
    (finding,) = findings_of([make_test("a", noise=2.0), make_test("b", noise=0.05)], "noise")
    assert finding.record == "a"
    assert "standard deviation of 2" in finding.what or "standard deviation of 1.9" in finding.what


@pytest.mark.parametrize("quantum", [None, 0.01])
@pytest.mark.parametrize("period", [2.0, 2.5, 3.0, 10.0])
def test_a_sensor_read_less_often_than_logged_is_found(clean, planted, period, quantum):
    rows = (np.arange(len(clean[0])) // period * period).astype(int)
    held = clean[0].displacement[rows]
    held = held if quantum is None else quantum * np.round(held / quantum)
    findings = findings_of(planted(held), "sampling")
    (finding,) = [finding for finding in findings if "updated" in finding.what]
    assert (finding.record, finding.severity) == ("lifting-1", Severity.WARNING)
    # Of a period of two and a half samples every second change comes after two, or after three.
    said = float(finding.what.split("every ")[1].split()[0])
    assert said == pytest.approx(0.01 * period, abs=0.005 if period % 1 else 1e-9)


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("gain", [1.0, 40.0])
def test_rounding_of_slow_motion_is_no_slow_sensor(gain, noise):
    # At 0.02 mm a step, 1 mm/(s A) moves by 0.1 to 0.3 of it in a sample, 40 by 4 to 12 of them.
    records = make_tests(3, gain=gain, noise=noise)
    findings = findings_of(rounded(records, 0.02), "sampling")
    assert not [finding for finding in findings if "updated" in finding.what]


def test_a_dead_band_of_the_sensor_is_found():
    record = make_test("a", noise=0.0, samples=3000)
    smooth, held = record.displacement, [record.displacement[0]]
    for value in smooth[1:]:
        held.append(value if abs(value - held[-1]) > 0.4 else held[-1])
    (finding,) = findings_of([changed(record, np.array(held))], "dead band")
    hop = float(finding.what.split("jumps by ")[1].split()[0])
    assert 0.4 <= hop < 0.6
    assert findings_of([record], "dead band") == []
