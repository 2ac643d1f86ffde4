"""Flaws of the sensor planted at known places: spikes, jumps, standing still, the end of its range."""

import numpy as np
import pytest
from flawed import changed, findings_of, make_test, make_tests, rounded

from hitchid.logs.audit import Severity


@pytest.mark.parametrize(("width", "height"), [(1, 5.0), (2, -40.0), (3, 5.0)])
def test_spikes_are_found_where_they_are(clean, planted, width, height):
    displacement = clean[0].displacement.copy()
    for at in (300, 800):
        displacement[at : at + width] += height
    (finding,) = findings_of(planted(displacement))
    assert (finding.check, finding.record, finding.signal) == ("spikes", "lifting-1", "displacement")
    last = 0.01 * (width - 1)
    assert np.allclose(finding.spans, [(3.0, 3.0 + last), (8.0, 8.0 + last)], atol=1e-6)


def test_a_jump_is_found_and_is_no_spike(clean, planted):
    displacement = clean[0].displacement.copy()
    displacement[600:] += 8.0
    findings = findings_of(planted(displacement))
    jumps = [finding for finding in findings if finding.check == "jumps"]
    assert [finding.spans for finding in jumps] == [((5.99, 6.0),)]
    assert not [finding for finding in findings if finding.check == "spikes"]


LIFT = np.concatenate([np.zeros(100), np.full(900, 0.6)])
SWITCHED = np.concatenate([np.zeros(5), np.repeat([0.62, 0.36, 0.62, 0.36, 0.62, 0.36, 0.62], 130)])
SWITCHED[5:] += np.random.default_rng(4).normal(0.0, 0.003, SWITCHED.size - 5)
AND_WEAK = np.concatenate([LIFT, np.zeros(100), np.full(100, 0.4)])
STUCK = {  # command, noise and quantum, mm, samples in which the sensor is stuck, interval that is found, s
    "noise": (AND_WEAK, 0.05, None, slice(410, 601), (4.10, 6.00)),
    "noise above the quantum": (AND_WEAK, 0.05, 0.02, slice(410, 601), (4.10, 6.00)),
    "no noise": (LIFT, 0.0, 0.1, slice(410, 601), (4.10, 6.00)),
    # Of the stretch the middle 130 samples are under the high level.
    "switched command": (SWITCHED, 0.05, 0.02, slice(220, 420), (2.65, 3.94)),
}


@pytest.mark.parametrize(("command", "noise", "quantum", "stuck", "interval"), STUCK.values(), ids=STUCK)
def test_a_stuck_sensor_is_found_with_its_span(command, noise, quantum, stuck, interval):
    records = make_tests(3, command=command, noise=noise)
    records = records if quantum is None else rounded(records, quantum)
    assert findings_of(records, "stuck sensor") == []
    displacement = records[1].displacement.copy()
    displacement[stuck] = displacement[stuck.start]
    (finding,) = findings_of([records[0], changed(records[1], displacement), records[2]], "stuck sensor")
    assert (finding.severity, finding.record) == (Severity.FAULT, "l-1")
    assert np.allclose(finding.spans, [interval], atol=0.02)
    assert "lifting is commanded at 0.6" in finding.what


def test_holding_within_the_dead_zone_is_no_stuck_sensor():
    held = make_test("a", command=np.repeat([0, 0.6, 0.2, 0, 0.6, 0.2], 200), noise=0.0)
    assert findings_of([held], "stuck sensor") == []


def test_an_end_stop_is_found_and_keeps_the_noise():
    records, rng = make_tests(2, command=LIFT), np.random.default_rng(0)
    stopped = [
        changed(r, np.minimum(r.displacement, 60.0) + 0.05 * rng.standard_normal(len(r))) for r in records
    ]
    at = 0.01 * float(np.argmax(records[0].displacement >= 60.0))
    findings = findings_of(stopped)
    ends = [finding for finding in findings if finding.check == "end stop"]
    assert [(finding.severity.value, finding.record) for finding in ends] == [
        ("note", "l-0"),
        ("note", "l-1"),
    ]
    # Contact is told by what moves over 0.3 s.
    assert ends[0].spans[0][0] == pytest.approx(at, abs=0.3)
    assert ends[0].spans[0][1] == pytest.approx(9.99)
    assert float(ends[0].what.split("stays at ")[1].split()[0]) == pytest.approx(60.0, abs=0.1)
    assert not [finding for finding in findings if "sensor" in finding.check]
    assert findings_of(records, "end stop") == []


def test_a_saturated_sensor_is_found_with_its_spans():
    records = make_tests(3, command=LIFT)
    clipped = [changed(r, np.minimum(r.displacement, 60.0)) for r in records[:2]]
    findings = findings_of([*clipped, make_test("l-2", command=0.7 * LIFT)], "saturated sensor")
    assert [finding.record for finding in findings] == ["l-0", "l-1"]
    assert {finding.severity for finding in findings} == {Severity.WARNING}
    at = 0.01 * float(np.argmax(records[0].displacement >= 60.0))
    # The noise takes samples near the end off it; there the standing begins a little later.
    assert findings[0].spans[0][0] == pytest.approx(at, abs=0.05)
    assert findings[0].spans[0][1] == pytest.approx(9.99, abs=0.011)
    assert findings_of(records, "saturated sensor") == []
