"""Trim, detrend, low-pass, decimate: against closed form, each with a notice."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import InputError
from hitchid.logs.record import Record

N, STEP_S = 4000, 0.01
TIME_S = STEP_S * np.arange(N)
INSIDE = slice(N // 4, 3 * N // 4)  # away from the ends, where a filter knows one side only
EPS = np.finfo(np.float64).eps


def record(displacement, command=None, **options):
    """Return a lifting test at 100 Hz in mm, A and bar."""
    command = np.zeros(len(displacement)) if command is None else command
    signals = {"displacement": displacement, "lifting_command": command, "pressure": 3.0 * displacement}
    units = {"displacement": "mm", "lifting_command": "A", "pressure": "bar"}
    return Record("up", STEP_S, signals, units, kind="lifting", **options)


def amplitude(samples, frequency_hz, time_s):
    """Return the complex amplitude of one frequency by least squares, relative to a sine."""
    angle = 2 * np.pi * frequency_hz * time_s
    (sine, cosine, _), *_ = np.linalg.lstsq(
        np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1), samples, rcond=None
    )
    return sine + 1j * cosine


@given(first=st.integers(0, 98), samples=st.integers(2, 100))
def test_trim_keeps_the_samples_between_two_times_both_included(first, samples):
    whole = record(np.sqrt(np.arange(100.0)), start_s=5.0)
    last = min(first + samples, 100) - 1
    if last == first:
        return
    trimmed = whole.trim(whole.time_s[first], whole.time_s[last])
    np.testing.assert_array_equal(trimmed.displacement, whole.displacement[first : last + 1])
    np.testing.assert_allclose(trimmed.time_s, whole.time_s[first : last + 1], rtol=4 * EPS)
    assert [notice.code for notice in trimmed.notices] == ["trimmed"]
    assert f"{last - first + 1} of 100 samples" in str(trimmed.notices[0])


def test_trim_without_times_keeps_everything():
    whole = record(np.arange(50.0))
    assert replace(whole.trim(), notices=()) == whole
    assert len(whole.trim(start_s=0.4)) == 10
    assert len(whole.trim(stop_s=0.4)) == 41


@given(slope=st.floats(-1e3, 1e3), offset=st.floats(-1e3, 1e3))
def test_detrend_takes_the_slope_and_leaves_the_mean(slope, offset):
    wave = np.cos(2 * np.pi * np.arange(200) / 199)  # symmetric in time: its own least-squares slope is 0
    whole = record(offset + slope * STEP_S * np.arange(200) + wave)
    flat = whole.detrend()
    largest = np.abs(whole.displacement).max()
    np.testing.assert_allclose(
        flat.displacement, whole.displacement.mean() + wave - wave.mean(), atol=1e3 * EPS * (1 + largest)
    )
    np.testing.assert_array_equal(flat.signals["pressure"], whole.signals["pressure"])
    assert flat.notices[0].code == "detrended"


def test_detrend_names_signal_slope_and_unit():
    flat = record(2.0 * TIME_S).detrend("displacement", "pressure")
    assert [str(notice) for notice in flat.notices] == [
        "detrended: displacement without its slope of 2 mm/s",
        "detrended: pressure without its slope of 6 bar/s",
    ]


@pytest.mark.parametrize("frequency_hz", [0.5, 2.0, 5.0, 20.0])
def test_low_pass_is_a_butterworth_filter_run_twice_without_phase(frequency_hz):
    cutoff_hz = 2.0
    filtered = record(np.sin(2 * np.pi * frequency_hz * TIME_S), TIME_S).low_pass(cutoff_hz)
    ratio = np.tan(np.pi * frequency_hz * STEP_S) / np.tan(np.pi * cutoff_hz * STEP_S)  # bilinear transform
    expected = 1 / (1 + ratio**4)
    for signal, size in (("displacement", 1.0), ("pressure", 3.0)):
        measured = amplitude(filtered.signals[signal][INSIDE], frequency_hz, TIME_S[INSIDE])
        # The transient from the ends decays as exp(-π √2 f_c t), t = 10 s: 1e-38.
        assert measured == pytest.approx(size * expected, abs=1e-10)
    np.testing.assert_array_equal(filtered.command("lifting"), TIME_S)
    assert "for display" in str(filtered.notices[0])


def test_decimation_keeps_slow_signals_and_holds_commands():
    command = np.repeat([0.0, 0.4, 0.6, 0.0], N // 4)
    slow = record(50.0 + np.sin(2 * np.pi * 0.5 * TIME_S), command).decimate(5)
    assert (slow.step_s, len(slow)) == (5 * STEP_S, N // 5)
    assert slow.clock.logged_step_s == STEP_S
    np.testing.assert_array_equal(slow.command("lifting"), command[::5])
    # At 0.5 of 6 Hz, the cutoff, the two runs take 1 - 1/(1 + (0.5/6)^16) < 1e-17.
    inside = slice(N // 20, 3 * N // 20)
    np.testing.assert_allclose(
        slow.displacement[inside], 50.0 + np.sin(2 * np.pi * 0.5 * slow.time_s[inside]), atol=1e-9
    )
    assert slow.notices[0].code == "decimated"


@pytest.mark.parametrize("frequency_hz", [10.5, 19.0, 30.0, 49.0])
def test_decimation_folds_no_fast_signal_onto_slow_ones(frequency_hz):
    fast = record(np.sin(2 * np.pi * frequency_hz * TIME_S)).decimate(5)
    limit = 1 / (1 + (1 / 0.6) ** 16)  # at half the new sampling rate, 10 Hz; less above it
    assert np.abs(fast.displacement[N // 20 : 3 * N // 20]).max() < limit


@given(samples=st.integers(4, 300), factor=st.integers(2, 40))
def test_decimation_of_any_length(samples, factor):
    whole = record(np.full(samples, 7.0))
    if factor > int(0.3 * samples):  # two samples of the filter's period, factor / 0.6, fit
        with pytest.raises(InputError, match="factor: expected at most"):
            whole.decimate(factor)
        return
    decimated = whole.decimate(factor)
    assert len(decimated) == -(-samples // factor)
    np.testing.assert_allclose(decimated.displacement, 7.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (lambda r: r.trim(1.0, 0.5), "expected at least 2 samples from 1 s to 0.5 s, got 0"),
        (lambda r: r.trim(start_s=float("nan")), "start_s: expected a finite number"),
        (lambda r: r.detrend("lifting_command"), "signals: expected one of displacement, pressure"),
        (lambda r: r.detrend("load"), "signals: expected one of displacement, pressure"),
        (lambda r: r.low_pass(0.0), "cutoff_hz: expected a finite number above 0"),
        (lambda r: r.low_pass(0.5), "cutoff_hz: expected at least 1 Hz, one period in the record, got 0.5"),
        (lambda r: r.slice(0, 1).detrend(), "expected at least 2 samples, got 1"),
        (lambda r: r.low_pass(50.0), "below half the sampling rate, 50 Hz, got 50"),
        (lambda r: r.low_pass(5.0, "lifting_command"), "signals: expected one of"),
        (lambda r: r.decimate(1), "factor: expected a whole number of at least 2"),
    ],
)
def test_what_cannot_be_done_is_refused(work, message):
    with pytest.raises(InputError, match=message):
        work(record(np.arange(100.0)))


def test_the_record_itself_is_not_changed_and_notices_add_up():
    whole = record(np.arange(100.0))
    before = whole.displacement.copy()
    prepared = whole.trim(0.1).detrend().low_pass(5.0).decimate(2)
    assert [notice.code for notice in prepared.notices] == ["trimmed", "detrended", "low-pass", "decimated"]
    np.testing.assert_array_equal(whole.displacement, before)
    assert whole.notices == ()
