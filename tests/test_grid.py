"""Clocks: what is kept, resampled, split and refused."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import LogError
from hitchid.grid import GAP, KEPT_DEVIATION, LARGEST_JITTER, Section, sections

STEP_S = 0.01


def found(time_s, first_line=2):
    def line_of(row):
        return None if first_line is None else first_line + row

    return sections(np.asarray(time_s, dtype=float), "log.csv", column="time_s", line_of=line_of)


def swinging(fraction, samples=201):
    """Return stamps of which every second is late, so that intervals swing by ± the fraction of a step."""
    return STEP_S * (np.arange(samples) + fraction * (np.arange(samples) % 2))


@given(
    digits=st.integers(1000, 9999),
    exponent=st.integers(-6, -2),
    samples=st.integers(2, 1000),
    start_s=st.integers(0, 10**6),
)
def test_a_regular_clock_is_kept_with_its_step_to_the_last_digit(digits, exponent, samples, start_s):
    step_s = float(f"{digits}e{exponent}")
    # Stamps up to 10⁶ s are rounded to 10⁻¹⁰ s: a hundred-thousandth of the smallest step here is more.
    stamps = start_s + step_s * np.arange(samples)
    assert found(stamps) == [Section(0, samples, step_s, resampled=False, notice="")]


@given(st.integers(2, 500), st.sampled_from([30, 60, 120, 400, 1000, 2048]))
def test_a_rate_without_a_short_decimal_step_is_kept_without_drift(samples, rate_hz):
    stamps = np.arange(samples) / rate_hz
    (section,) = found(stamps)
    assert not section.resampled
    ours = section.step_s * np.arange(samples)
    assert np.max(np.abs(ours - stamps)) <= KEPT_DEVIATION / rate_hz


def test_seconds_since_1970_are_kept_as_well_as_any_others():
    stamps = 1.7e9 + STEP_S * np.arange(500)
    assert found(stamps) == [Section(0, 500, STEP_S, resampled=False, notice="")]


@pytest.mark.parametrize("fraction", [0.001, 0.9 * KEPT_DEVIATION])
def test_stamps_within_2_percent_of_a_step_are_kept(fraction):
    (section,) = found(swinging(fraction))
    assert section == Section(0, 201, STEP_S, resampled=False, notice="")


@pytest.mark.parametrize("fraction", [1.1 * KEPT_DEVIATION, 0.1, 0.95 * LARGEST_JITTER])
def test_jitter_below_20_percent_is_to_be_resampled_and_said(fraction):
    (section,) = found(swinging(fraction))
    assert section.resampled
    assert (section.start, section.stop) == (0, 201)
    assert section.step_s == pytest.approx(STEP_S, rel=1e-12)  # 200 intervals, their sum rounded
    assert f"{fraction:.1%}" in section.notice


@pytest.mark.parametrize("fraction", [1.05 * LARGEST_JITTER, 0.4])
def test_jitter_of_20_percent_and_more_is_refused(fraction):
    with pytest.raises(LogError) as caught:
        found(swinging(fraction))
    for said in ("log.csv", "line 2", "'time_s'", f"{fraction:.0%}", "20 %"):
        assert said in str(caught.value)


def test_60_hertz_with_two_decimals_is_refused_not_taken_for_another_rate():
    stamps = np.round(np.arange(300) / 60, 2)
    with pytest.raises(LogError, match="jitters"):
        found(stamps)


@pytest.mark.parametrize("first_line", [2, 7, None])
@pytest.mark.parametrize(("row", "stamp"), [(1, 0.0), (5, 0.04), (5, -1.0), (9, 0.01)])
def test_time_that_stands_still_or_runs_back_is_refused_with_its_line(row, stamp, first_line):
    stamps = STEP_S * np.arange(10)
    stamps[row] = stamp
    with pytest.raises(LogError) as caught:
        found(stamps, first_line)
    assert "log.csv" in str(caught.value)
    assert "'time_s'" in str(caught.value)
    if first_line is None:
        assert "line" not in str(caught.value)
    else:
        assert f"line {first_line + row}:" in str(caught.value)


@pytest.mark.parametrize(("intervals", "parts"), [(0.99 * GAP, 1), (1.01 * GAP, 2), (1e6, 2)])
def test_a_gap_is_an_interval_beyond_one_and_a_half_steps(intervals, parts):
    stamps = STEP_S * np.arange(400)
    stamps[200:] += (intervals - 1) * STEP_S
    if parts == 1:
        with pytest.raises(LogError, match="jitters"):
            found(stamps)
        return
    before, after = found(stamps)
    assert (before.start, before.stop, after.start, after.stop) == (0, 200, 200, 400)
    assert before.notice == ""
    assert f"{stamps[200]:g} s" in after.notice
    assert f"{intervals:.1f} sampling times" in after.notice


def test_one_stamp_or_none_makes_no_section():
    assert found([]) == []
    assert found([3.0]) == []


@st.composite
def logs_with_gaps(draw):
    """Draw stretches of one clock with gaps between them, most intervals being no gap, and their lengths."""
    lengths = draw(st.lists(st.integers(1, 30), min_size=1, max_size=12))
    inside = sum(lengths) - len(lengths)
    if inside < len(lengths) + 2:
        lengths.append(2 * len(lengths) + 4)
    gaps = draw(st.lists(st.floats(2, 1e6), min_size=len(lengths), max_size=len(lengths)))
    swing = draw(st.sampled_from([0.0, 0.01, 0.1]))
    stamps, at = [], 0.0
    for length, gap in zip(lengths, gaps, strict=True):
        stamps += [at + k + swing * (k % 2) for k in range(length)]
        at = stamps[-1] + gap
    return STEP_S * np.array(stamps), lengths


@given(logs_with_gaps())
def test_sections_do_not_overlap_and_cover_all_but_lone_samples(log):
    stamps, lengths = log
    edges = np.cumsum([0, *lengths])
    wanted = [(start, stop) for start, stop in pairwise(edges) if stop - start > 1]
    assert [(section.start, section.stop) for section in found(stamps)] == wanted


@given(logs_with_gaps())
def test_every_section_after_a_gap_says_so(log):
    stamps, _ = log
    for section in found(stamps):
        assert ("gap" in section.notice) == (section.start > 0)
        assert ("resampled" in section.notice) == section.resampled
