"""Flaws of the sensor planted at known places: spikes, jumps, standing still, the end of its range."""

import numpy as np
import pytest

from hitchid.logs.audit import Severity


@pytest.mark.parametrize("width", [1, 2, 3])
@pytest.mark.parametrize("height", [5.0, -40.0])
def test_spikes_are_found_where_they_are(clean, changed, found, width, height):
    displacement = clean[0].displacement.copy()
    for at in (300, 800):
        displacement[at : at + width] += height
    (finding,) = found([changed(clean[0], signals={"displacement": displacement}), *clean[1:]])
    assert (finding.check, finding.record, finding.signal) == ("spikes", "lifting-1", "displacement")
    last = 0.01 * (width - 1)
    assert np.allclose(finding.spans, [(3.0, 3.0 + last), (8.0, 8.0 + last)], atol=1e-6)


def test_a_jump_is_found_and_is_no_spike(clean, changed, found):
    displacement = clean[0].displacement.copy()
    displacement[600:] += 8.0
    findings = found([changed(clean[0], signals={"displacement": displacement}), *clean[1:]])
    jumps = [each for each in findings if each.check == "jumps"]
    assert [each.spans for each in jumps] == [((5.99, 6.0),)]
    assert not [each for each in findings if each.check == "spikes"]


@pytest.mark.parametrize("rounded", [False, True])
def test_a_stuck_sensor_is_found_with_its_span(make_test, changed, found, rounded):
    command = np.concatenate([np.zeros(100), np.full(900, 0.6), np.zeros(100), np.full(100, 0.4)])
    records = [make_test(f"l-{number}", command=command) for number in range(3)]
    if rounded:
        records = [
            changed(r, signals={"displacement": 0.02 * np.round(r.displacement / 0.02)}) for r in records
        ]
    assert found(records, "stuck sensor") == []
    displacement = records[1].displacement.copy()
    displacement[410:601] = displacement[410]
    records[1] = changed(records[1], signals={"displacement": displacement})
    (finding,) = found(records, "stuck sensor")
    assert (finding.severity, finding.record) == (Severity.FAULT, "l-1")
    assert np.allclose(finding.spans, [(4.10, 6.00)], atol=0.02)
    assert "lifting is commanded at 0.6 A" in finding.what


def test_a_stuck_sensor_is_found_under_a_noisy_binary_command_that_hardly_rests(make_test, changed, found):
    rng = np.random.default_rng(4)
    command = np.concatenate([np.zeros(5), np.repeat([0.62, 0.36, 0.62, 0.36, 0.62, 0.36, 0.62], 130)])
    command[5:] += rng.normal(0.0, 0.003, command.size - 5)
    records = [make_test(f"l-{number}", command=command) for number in range(3)]
    records = [changed(r, signals={"displacement": 0.02 * np.round(r.displacement / 0.02)}) for r in records]
    assert found(records, "stuck sensor") == []
    displacement = records[1].displacement.copy()
    displacement[220:420] = displacement[220]
    records[1] = changed(records[1], signals={"displacement": displacement})
    (finding,) = found(records, "stuck sensor")
    # Of the stretch the middle 130 samples are under the high level.
    assert np.allclose(finding.spans, [(2.65, 3.94)], atol=0.02)


def test_a_stuck_sensor_without_noise_is_found_by_motion_before_and_after(make_test, changed, found):
    command = np.concatenate([np.zeros(100), np.full(1100, 0.6)])
    record = make_test("a", command=command, noise=0.0)
    rounded = 0.1 * np.round(record.displacement / 0.1)
    assert found([changed(record, signals={"displacement": rounded})], "stuck sensor") == []
    rounded[410:601] = rounded[410]
    (finding,) = found([changed(record, signals={"displacement": rounded})], "stuck sensor")
    assert np.allclose(finding.spans, [(4.10, 6.00)], atol=0.02)


def test_holding_and_a_dead_zone_are_no_stuck_sensor(make_test, found):
    command = np.repeat([0, 0.6, 0.2, 0, 0.6, 0.2], 200)
    assert found([make_test("a", command=command, noise=0.0)], "stuck sensor") == []


def test_an_end_stop_is_found_and_keeps_the_noise(make_test, changed, found):
    command = np.concatenate([np.zeros(100), np.full(900, 0.6)])
    records = [make_test(f"l-{number}", command=command) for number in range(2)]
    stopped = []
    for number, record in enumerate(records):
        noise = 0.05 * np.random.default_rng(number).standard_normal(len(record))
        stopped.append(
            changed(record, signals={"displacement": np.minimum(record.displacement, 60.0) + noise})
        )
    at = 0.01 * float(np.argmax(records[0].displacement >= 60.0))
    findings = found(stopped)
    ends = [each for each in findings if each.check == "end stop"]
    assert [(each.severity, each.record) for each in ends] == [(Severity.NOTE, "l-0"), (Severity.NOTE, "l-1")]
    # Contact is told by what moves over 0.3 s.
    assert ends[0].spans[0][0] == pytest.approx(at, abs=0.3)
    assert ends[0].spans[0][1] == pytest.approx(9.99)
    assert float(ends[0].what.split("stays at ")[1].split()[0]) == pytest.approx(60.0, abs=0.1)
    assert not [each for each in findings if "sensor" in each.check]
    assert found(records, "end stop") == []


def test_an_end_stop_in_a_cycle_is_found(make_test, changed, found):
    up = np.concatenate([np.zeros(100), np.full(600, 0.6), np.zeros(700)])
    down = np.concatenate([np.zeros(900), np.full(300, 0.6), np.zeros(200)])
    record = make_test("a", command=up)
    lowered = make_test("a", command=down).displacement - 10
    noise = 0.05 * np.random.default_rng(1).standard_normal(1400)
    moved = np.minimum(record.displacement, 70.0) - lowered + noise
    cycle = changed(record, signals={"displacement": moved, "lowering_command": down})
    at = 0.01 * float(np.argmax(record.displacement >= 70.0))
    (finding,) = found([cycle], "end stop")
    assert finding.spans[0][0] == pytest.approx(at, abs=0.3)
    assert finding.spans[0][1] == pytest.approx(6.99, abs=0.3)


def test_a_saturated_sensor_is_found_with_its_spans(make_test, changed, found):
    command = np.concatenate([np.zeros(100), np.full(900, 0.6)])
    records = [make_test(f"l-{number}", command=command) for number in range(3)]
    clipped = [
        changed(r, signals={"displacement": np.minimum(r.displacement, 60.0)}) for r in records[:2]
    ] + [make_test("l-2", command=0.7 * command)]
    findings = [each for each in found(clipped) if each.check == "saturated sensor"]
    assert [(each.severity, each.record) for each in findings] == [
        (Severity.WARNING, "l-0"),
        (Severity.WARNING, "l-1"),
    ]
    at = 0.01 * float(np.argmax(records[0].displacement >= 60.0))
    # The noise takes samples near the end off it; there the standing begins a little later.
    assert findings[0].spans[0][0] == pytest.approx(at, abs=0.05)
    assert findings[0].spans[0][1] == pytest.approx(9.99, abs=0.011)
    assert found([make_test(f"l-{n}", command=command) for n in range(3)], "saturated sensor") == []
