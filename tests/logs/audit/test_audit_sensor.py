"""Flaws of the sensor planted at known places: spikes, jumps, standing still, the end of its range."""

import numpy as np
import pytest

from hitchid.logs.audit import Severity


@pytest.mark.parametrize(("width", "height"), [(1, 5.0), (2, -40.0), (3, 5.0)])
def test_spikes_are_found_where_they_are(clean, planted, findings_of, width, height):
    displacement = clean[0].displacement.copy()
    for at in (300, 800):
        displacement[at : at + width] += height
    (finding,) = findings_of(planted(displacement))
    assert (finding.check, finding.record, finding.signal) == ("spikes", "lifting-1", "displacement")
    last = 0.01 * (width - 1)
    assert np.allclose(finding.spans, [(3.0, 3.0 + last), (8.0, 8.0 + last)], atol=1e-6)


def test_a_jump_is_found_and_is_no_spike(clean, planted, findings_of):
    displacement = clean[0].displacement.copy()
    displacement[600:] += 8.0
    findings = findings_of(planted(displacement))
    jumps = [finding for finding in findings if finding.check == "jumps"]
    assert [finding.spans for finding in jumps] == [((5.99, 6.0),)]
    assert not [finding for finding in findings if finding.check == "spikes"]


@pytest.mark.parametrize("rounded", [False, True])
def test_a_stuck_sensor_is_found_with_its_span(make_test, changed, findings_of, rounded):
    command = np.concatenate([np.zeros(100), np.full(900, 0.6), np.zeros(100), np.full(100, 0.4)])
    records = [make_test(f"l-{number}", command=command) for number in range(3)]
    if rounded:
        records = [
            changed(r, signals={"displacement": 0.02 * np.round(r.displacement / 0.02)}) for r in records
        ]
    assert findings_of(records, "stuck sensor") == []
    displacement = records[1].displacement.copy()
    displacement[410:601] = displacement[410]
    records[1] = changed(records[1], signals={"displacement": displacement})
    (finding,) = findings_of(records, "stuck sensor")
    assert (finding.severity, finding.record) == (Severity.FAULT, "l-1")
    assert np.allclose(finding.spans, [(4.10, 6.00)], atol=0.02)
    assert "lifting is commanded at 0.6 A" in finding.what


def test_a_stuck_sensor_is_found_under_a_noisy_binary_command(make_test, changed, findings_of):
    rng = np.random.default_rng(4)
    command = np.concatenate([np.zeros(5), np.repeat([0.62, 0.36, 0.62, 0.36, 0.62, 0.36, 0.62], 130)])
    command[5:] += rng.normal(0.0, 0.003, command.size - 5)
    records = [make_test(f"l-{number}", command=command) for number in range(3)]
    records = [changed(r, signals={"displacement": 0.02 * np.round(r.displacement / 0.02)}) for r in records]
    assert findings_of(records, "stuck sensor") == []
    displacement = records[1].displacement.copy()
    displacement[220:420] = displacement[220]
    records[1] = changed(records[1], signals={"displacement": displacement})
    (finding,) = findings_of(records, "stuck sensor")
    # Of the stretch the middle 130 samples are under the high level.
    assert np.allclose(finding.spans, [(2.65, 3.94)], atol=0.02)


def test_a_stuck_sensor_without_noise_is_found(make_test, changed, findings_of):
    command = np.concatenate([np.zeros(100), np.full(1100, 0.6)])
    record = make_test("a", command=command, noise=0.0)
    rounded = 0.1 * np.round(record.displacement / 0.1)
    assert findings_of([changed(record, signals={"displacement": rounded})], "stuck sensor") == []
    rounded[410:601] = rounded[410]
    (finding,) = findings_of([changed(record, signals={"displacement": rounded})], "stuck sensor")
    assert np.allclose(finding.spans, [(4.10, 6.00)], atol=0.02)
    # Holding and a command within the dead zone are no standstill of the sensor.
    held = make_test("a", command=np.repeat([0, 0.6, 0.2, 0, 0.6, 0.2], 200), noise=0.0)
    assert findings_of([held], "stuck sensor") == []


def test_an_end_stop_is_found_and_keeps_the_noise(make_test, changed, findings_of):
    command = np.concatenate([np.zeros(100), np.full(900, 0.6)])
    records = [make_test(f"l-{number}", command=command) for number in range(2)]
    stopped = []
    for number, record in enumerate(records):
        noise = 0.05 * np.random.default_rng(number).standard_normal(len(record))
        stopped.append(
            changed(record, signals={"displacement": np.minimum(record.displacement, 60.0) + noise})
        )
    at = 0.01 * float(np.argmax(records[0].displacement >= 60.0))
    findings = findings_of(stopped)
    ends = [finding for finding in findings if finding.check == "end stop"]
    assert [(finding.severity, finding.record) for finding in ends] == [
        (Severity.NOTE, "l-0"),
        (Severity.NOTE, "l-1"),
    ]
    # Contact is told by what moves over 0.3 s.
    assert ends[0].spans[0][0] == pytest.approx(at, abs=0.3)
    assert ends[0].spans[0][1] == pytest.approx(9.99)
    assert float(ends[0].what.split("stays at ")[1].split()[0]) == pytest.approx(60.0, abs=0.1)
    assert not [finding for finding in findings if "sensor" in finding.check]
    assert findings_of(records, "end stop") == []


def test_a_saturated_sensor_is_found_with_its_spans(make_test, changed, findings_of):
    command = np.concatenate([np.zeros(100), np.full(900, 0.6)])
    records = [make_test(f"l-{number}", command=command) for number in range(3)]
    clipped = [
        changed(r, signals={"displacement": np.minimum(r.displacement, 60.0)}) for r in records[:2]
    ] + [make_test("l-2", command=0.7 * command)]
    findings = [finding for finding in findings_of(clipped) if finding.check == "saturated sensor"]
    assert [(finding.severity, finding.record) for finding in findings] == [
        (Severity.WARNING, "l-0"),
        (Severity.WARNING, "l-1"),
    ]
    at = 0.01 * float(np.argmax(records[0].displacement >= 60.0))
    # The noise takes samples near the end off it; there the standing begins a little later.
    assert findings[0].spans[0][0] == pytest.approx(at, abs=0.05)
    assert findings[0].spans[0][1] == pytest.approx(9.99, abs=0.011)
    assert findings_of([make_test(f"l-{n}", command=command) for n in range(3)], "saturated sensor") == []
