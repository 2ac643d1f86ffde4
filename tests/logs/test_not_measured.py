"""Samples that no sensor measured are found, named and left out; what was measured stays, bit for bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import LogError
from hitchid.logs.audit import audit
from hitchid.logs.campaign import Campaign
from hitchid.logs.content import Content, LogChannel
from hitchid.logs.log_table import records_of, table_of
from hitchid.logs.signal_map import SignalColumn, SignalMap

STEP_S, SAMPLES, NOISE_MM = 0.01, 500, 0.05
SIGNALS = SignalMap(
    displacement=SignalColumn(column="x", unit="mm"),
    lifting_command=SignalColumn(column="i", unit="A"),
    covariates=(SignalColumn(column="p", unit="bar"),),
)
ONSET, RELEASE = 60, 400


def columns(start_mm=120.0, speed=0.4, digits=None, hold=1):
    """Return a log whose piston rests, lifts by `speed` mm a sample, and rests again."""
    moving = np.cumsum((np.arange(SAMPLES) >= ONSET + 4) & (np.arange(SAMPLES) < RELEASE + 4))
    x = start_mm + speed * moving + NOISE_MM * np.random.default_rng(8).standard_normal(SAMPLES)
    x = x[np.arange(SAMPLES) // hold * hold]
    i = np.where((np.arange(SAMPLES) >= ONSET) & (np.arange(SAMPLES) < RELEASE), 0.6, 0.0)
    return {"x": x if digits is None else np.round(x, digits), "i": i, "p": 100.0 + 0.1 * x}


def records(log):
    time = {"time_s": LogChannel(STEP_S * np.arange(SAMPLES))}
    content = Content("log", {**time, **{name: LogChannel(values) for name, values in log.items()}})
    return records_of("log", table_of(content, SIGNALS), SIGNALS)


def said(record):
    return [str(notice) for notice in record.notices if notice.code == "not-measured"]


@pytest.mark.parametrize("shape", [{}, {"digits": 1}, {"hold": 10}, {"speed": 0.0}, {"speed": -0.2}])
def test_a_log_without_faults_stays_as_it_is(shape):
    log = columns(**shape)
    (record,) = records(log)
    assert record.displacement.tobytes() == log["x"].tobytes()
    assert record.command("lifting").tobytes() == log["i"].tobytes()
    assert record.notices == ()


def test_a_log_that_begins_in_motion_stays_as_it_is():
    for log in (columns(), columns(start_mm=0.0, digits=1)):
        for first in (0, ONSET - 2, ONSET + 50, RELEASE - 3):
            part = {name: np.pad(values[first:], (0, first), mode="edge") for name, values in log.items()}
            (record,) = records(part)
            assert record.displacement.tobytes() == part["x"].tobytes()


@pytest.mark.parametrize("reading", [0.0, 65535.0, 1e30, 118.0, 256.0])
@pytest.mark.parametrize(("stale", "digits"), [(1, None), (3, 3), (10, None)])
def test_stale_first_samples_are_left_out_and_named(reading, stale, digits):
    # 118 mm and 256 mm: where the last log ended, two samples' motion and far away.
    log = columns(digits=digits)
    truth = log["x"][stale:].copy()
    log["x"][:stale] = reading
    (record,) = records(log)
    assert record.displacement.tobytes() == truth.tobytes()
    assert record.command("lifting").tobytes() == log["i"][stale:].tobytes()
    assert record.start_s == pytest.approx(stale * STEP_S)
    (sentence,) = said(record)
    assert sentence.startswith(f"displacement: {stale} of {SAMPLES} samples are left out")
    assert f"stale at the start of the log: {reading:.6g} mm" in sentence


@pytest.mark.parametrize("code", [0.0, -9999.0, 65535.0, 1e30, -1.0])
@pytest.mark.parametrize("rows", [[250], [30, 100, 101, 250, 333, 420, 421, 422], list(range(20, 480, 12))])
def test_error_codes_are_left_out_and_their_place_is_interpolated(code, rows):
    log = columns()
    truth = log["x"].copy()
    log["x"][rows] = code
    if code == -1.0 and len(rows) == 1:  # near the range, once: motion that nobody can tell from an error
        return
    (record,) = records(log)
    others = np.setdiff1d(np.arange(SAMPLES), rows)
    assert record.displacement[others].tobytes() == truth[others].tobytes()
    # Between two neighbours: the noise of three samples, and half the motion where it begins or ends.
    assert np.max(np.abs(record.displacement - truth)) < 3 * 4 * NOISE_MM + 2 * 0.4
    assert record.command("lifting").tobytes() == log["i"].tobytes()
    (sentence,) = said(record)
    count = f"{len(rows)} of {SAMPLES} samples are left out, the first in sample {rows[0]}"
    assert f"{count}: they read {code:.6g} mm" in sentence


def test_several_error_codes_are_left_out_and_become_findings():
    log = columns()
    truth = {name: values.copy() for name, values in log.items()}
    log["x"][[90, 300]], log["x"][[150, 310]], log["i"][200], log["p"][[45, 350]] = -9999, 1e30, 65535, -999
    (record,) = records(log)
    assert np.max(np.abs(record.displacement - truth["x"])) < 3 * 4 * NOISE_MM + 2 * 0.4
    assert record.command("lifting").tobytes() == truth["i"].tobytes()
    assert np.max(np.abs(record.signals["p"] - truth["p"])) < 0.2
    findings = [finding for finding in audit(Campaign.of([record])) if finding.check == "not measured"]
    assert {finding.signal for finding in findings} == {"displacement", "lifting_command", "p"}
    assert all(finding.severity.value == "warning" and finding.record == "log" for finding in findings)


@pytest.mark.parametrize("code", [np.nan, 0.0, 65535.0])
def test_a_long_interruption_cuts_or_ends_the_log(code):
    log = columns()
    truth = log["x"].copy()
    log["x"][200:320] = log["x"][460:] = code
    before, after = records(log)
    assert (before.name, after.name) == ("log@1", "log@2")
    assert before.displacement.tobytes() == truth[:200].tobytes()
    assert after.displacement.tobytes() == truth[320:460].tobytes()
    assert after.command("lifting").tobytes() == log["i"][320:460].tobytes()
    assert "160 of 500 samples are left out" in said(before)[0]


def test_rare_cells_have_clocks_of_their_own():
    log, truth = columns(), columns()
    log["p"] = np.where(np.arange(SAMPLES) % 100 == 0, 40.0 + np.arange(SAMPLES) / 100, np.nan)
    changes = np.flatnonzero(np.diff(truth["i"], prepend=-1.0))
    log["i"] = np.full(SAMPLES, np.nan)
    log["i"][changes] = truth["i"][changes]
    (record,) = records(log)
    assert record.displacement.tobytes() == truth["x"].tobytes()
    assert record.command("lifting").tobytes() == truth["i"].tobytes()
    # Interpolated up to its last sample, 44 at 4 s, then held.
    expected = np.minimum(40.0 + np.arange(SAMPLES) / 100, 44.0)
    np.testing.assert_allclose(record.signals["p"], expected, rtol=1e-12)


def test_a_channel_without_a_number_is_refused_by_name():
    log = columns() | {"x": np.full(SAMPLES, np.nan)}
    with pytest.raises(LogError, match="column 'x': expected finite numbers, got nan in all 500 samples"):
        records(log)


@given(
    rows=st.sets(st.integers(15, SAMPLES - 15), min_size=2, max_size=40),
    code=st.sampled_from([-9999.0, 0.0, 65535.0, 32767.0, 1e30, 3.4e38]),
    speed=st.floats(-0.25, 0.25),
)
def test_nothing_of_any_error_code_is_left(rows, code, speed):
    log = columns(speed=speed)
    truth = log["x"].copy()
    log["x"][sorted(rows)] = code
    measured = records(log)
    low, high = truth.min(), truth.max()
    for record in measured:
        assert low <= record.displacement.min() <= record.displacement.max() <= high
    assert said(measured[0])
