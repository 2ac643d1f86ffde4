"""Clocks: what is kept, resampled, bridged, split and refused."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import LogError
from hitchid.logs.resampling import (
    GAP_FACTOR,
    GRID_TOLERANCE,
    LONGEST_BRIDGE_S,
    REGULAR_CLOCK,
    SHORT_GAP_S,
    LogSection,
    sections,
    spread_stamps,
    uniform,
    unique_stamp_rows,
)

STEP_S = 0.01


def rows(time_s, first_line=2):
    def line_of(row):
        return None if first_line is None else first_line + row

    return unique_stamp_rows(np.asarray(time_s, dtype=float), "log.csv", column="time_s", line_of=line_of)


def sections_of(time_s, command=None, position=None):
    """Return sections of a log whose command, unless given, alternates, so that no long gap is bridged."""
    time_s = np.asarray(time_s, dtype=float)
    alternating = np.arange(time_s.size) % 2.0
    return sections(
        time_s,
        {"lifting_command": alternating if command is None else command},
        time_s if position is None else position,
    )


def swinging(fraction, samples=201):
    """Return stamps of which every second is late, so that intervals swing by ± the fraction of a step."""
    return STEP_S * (np.arange(samples) + fraction * (np.arange(samples) % 2))


@given(
    digits=st.integers(1000, 9999),
    exponent=st.integers(-6, -3),
    samples=st.integers(2, 1000),
    start_s=st.integers(0, 10**6),
)
def test_a_regular_clock_keeps_its_step_exactly(digits, exponent, samples, start_s):
    step_s = float(f"{digits}e{exponent}")  # 1 ms to 10 s
    # Stamps up to 10⁶ s are rounded to 10⁻¹⁰ s: a hundred-thousandth of the smallest step here is more.
    stamps = start_s + step_s * np.arange(samples)
    assert sections_of(stamps) == [LogSection(0, samples, step_s, resampled=False)]


@given(st.integers(2, 500), st.sampled_from([30, 60, 120, 400, 1000, 2048]))
def test_a_rate_without_a_short_decimal_step_is_kept_without_drift(samples, rate_hz):
    stamps = np.arange(samples) / rate_hz
    (section,) = sections_of(stamps)
    assert not section.resampled
    ours = section.step_s * np.arange(samples)
    assert np.max(np.abs(ours - stamps)) <= GRID_TOLERANCE / rate_hz


@pytest.mark.parametrize("fraction", [0.001, 0.9 * GRID_TOLERANCE])
def test_stamps_within_2_percent_of_a_step_are_kept(fraction):
    (section,) = sections_of(swinging(fraction))
    assert section == LogSection(0, 201, STEP_S, resampled=False, clock=REGULAR_CLOCK)


@pytest.mark.parametrize("fraction", [1.1 * GRID_TOLERANCE, 0.1, 0.24, 0.45])
def test_any_jitter_is_resampled_onto_the_median_step_and_told(fraction):
    (section,) = sections_of(swinging(fraction))
    assert section.resampled
    assert (section.start, section.stop, section.step_s) == (0, 201, STEP_S)
    assert section.clock.jitter == pytest.approx(fraction, rel=1e-6)
    assert section.clock.longest_gap_s == 0
    assert section.clock.interpolated_share == pytest.approx(100 / 201)  # every second stamp is late
    (notice,) = section.notices
    assert f"jitters by {fraction:.1%}" in notice.sentence
    assert "49.8% of the samples are interpolated" in notice.sentence


def test_60_hertz_with_two_decimals_is_resampled():
    (section,) = sections_of(np.round(np.arange(300) / 60, 2))
    assert section.resampled
    assert 0.01 <= section.step_s <= 0.02


def test_jittered_logs_of_one_machine_get_one_step():
    rng = np.random.default_rng(5)
    logs = [np.cumsum(np.maximum(0.01, rng.normal(0.0531, 0.007, 2000))) for _ in range(6)]
    assert {section.step_s for log in logs for section in sections_of(log)} == {0.053}


@pytest.mark.parametrize("step_s", [0.001, 0.01, 4.0])
def test_a_lost_sample_is_interpolated(step_s):
    stamps = np.delete(step_s * np.arange(200), [50, 120, 121])
    (section,) = sections_of(stamps)
    assert section.resampled
    assert section.step_s == step_s
    assert section.clock.interpolated_share == pytest.approx(3 / 200)
    assert section.clock.longest_gap_s == pytest.approx(3 * step_s)
    np.testing.assert_allclose(uniform(stamps, step_s), step_s * np.arange(200), rtol=1e-12)


@pytest.mark.parametrize("first_line", [2, 7, None])
def test_time_that_runs_backwards_is_refused_with_its_line(first_line):
    stamps = STEP_S * np.arange(10)
    stamps[5] = -1.0
    with pytest.raises(LogError, match=r"decrease; -1 s follows 0\.04 s") as caught:
        rows(stamps, first_line)
    assert "column 'time_s'" in str(caught.value)
    assert ("line" in str(caught.value)) == (first_line is not None)
    assert first_line is None or f"line {first_line + 5}:" in str(caught.value)


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        ([3.0] * 5, "all 5 time stamps are 3 s"),
        ([0.0, np.nan, 1.0], "got nan"),
        ([0.0, 1.0, np.inf], "got inf"),
        ([0.0, 1e-12, 2e-12], "sampling time"),
    ],
)
def test_stamps_that_say_nothing_are_refused(stamps, said):
    with pytest.raises(LogError, match=said):
        rows(stamps)


@given(st.lists(st.integers(0, 3), min_size=1, max_size=50))
def test_of_rows_with_one_stamp_the_first_is_kept(intervals):
    stamps = np.cumsum([0, *intervals, 1])
    kept = rows(STEP_S * stamps)
    np.testing.assert_array_equal(stamps[kept], np.unique(stamps))
    np.testing.assert_array_equal(kept, np.unique(stamps, return_index=True)[1])


@pytest.mark.parametrize(("gap_s", "parts"), [(0.95 * SHORT_GAP_S, 1), (1.05 * SHORT_GAP_S, 2), (1e4, 2)])
def test_a_gap_of_unknown_motion_is_bridged_only_if_short(gap_s, parts):
    stamps = STEP_S * np.arange(400)
    stamps[200:] += gap_s - STEP_S
    cut = sections_of(stamps)
    assert len(cut) == parts
    if parts == 1:
        assert cut[0].clock.longest_gap_s == pytest.approx(gap_s)
        return
    before, after = cut
    assert (before.start, before.stop, after.start, after.stop) == (0, 200, 200, 400)
    assert before.notices == ()
    assert f"{stamps[200]:g} s" in after.notices[0].sentence
    assert f"{gap_s / STEP_S:.1f} sampling times" in after.notices[0].sentence


@pytest.mark.parametrize(("gap_s", "parts"), [(0.9 * LONGEST_BRIDGE_S, 1), (1.1 * LONGEST_BRIDGE_S, 2)])
@pytest.mark.parametrize("speed", [0.0, 5.0])
def test_a_longer_gap_is_bridged_where_command_and_speed_hold(gap_s, parts, speed):
    stamps = STEP_S * np.arange(400)
    stamps[200:] += gap_s - STEP_S
    held = np.where((stamps > 1.0) & (stamps < 4.0), 1.0, 0.0)
    # Half a stroke before, so that a position that stands is judged against a range.
    position = np.minimum(stamps, 0.5) * 20 + speed * stamps
    assert len(sections_of(stamps, held, position)) == parts
    assert len(sections_of(stamps, np.where(stamps < 2.3, held, 0.5), position)) == 2
    assert len(sections_of(stamps, held, position + np.where(stamps < 2.3, 0.0, 4.0))) == 2


def test_one_stamp_or_none_makes_no_section():
    assert sections_of([]) == []
    assert sections_of([3.0]) == []


@st.composite
def logs_with_gaps(draw):
    """Draw stretches of one clock with long gaps between them, and their lengths."""
    lengths = draw(st.lists(st.integers(1, 30), min_size=1, max_size=12))
    inside = sum(lengths) - len(lengths)
    if inside < len(lengths) + 2:
        lengths.append(2 * len(lengths) + 4)
    gaps = draw(st.lists(st.floats(150, 1e6), min_size=len(lengths), max_size=len(lengths)))
    swing = draw(st.sampled_from([0.0, 0.01, 0.1, 0.4]))
    stamps, at = [], 0.0
    for length, gap in zip(lengths, gaps, strict=True):
        stamps += [at + k + swing * (k % 2) for k in range(length)]
        at = stamps[-1] + gap
    return STEP_S * np.array(stamps), lengths


@given(logs_with_gaps())
def test_sections_cover_all_but_lone_samples_and_say_what_was_done(log):
    stamps, lengths = log
    edges = np.cumsum([0, *lengths])
    wanted = [(start, stop) for start, stop in pairwise(edges) if stop - start > 1]
    cut = sections_of(stamps)
    assert [(section.start, section.stop) for section in cut] == wanted
    for section in cut:
        codes = {notice.code for notice in section.notices}
        assert ("gap-split" in codes) == (section.start > 0)
        assert ("clock-resampled" in codes) == section.resampled == (section.clock != REGULAR_CLOCK)


@given(
    st.lists(st.floats(0.001, 0.15), min_size=3, max_size=80),
    st.floats(-1e3, 1e3),
)
def test_the_grid_lies_within_the_stamps_and_runs_forward(intervals, start_s):
    stamps = start_s + np.cumsum([0.0, *intervals])
    for section in sections_of(stamps):
        part = stamps[section.start : section.stop]
        grid = uniform(part, section.step_s)
        assert grid[0] == part[0]
        assert grid[-1] <= part[-1] + 1e-5 * section.step_s
        assert part[-1] - grid[-1] < section.step_s
        assert np.all(np.diff(grid) > 0)
        assert 0 <= section.clock.interpolated_share <= 1
        assert section.clock.jitter >= 0
        assert section.clock.longest_gap_s == 0 or section.clock.longest_gap_s > GAP_FACTOR * np.median(
            intervals
        )


@pytest.mark.parametrize(("resolution_ms", "start_ms"), [(20, 0), (100, 30), (1000, 730), (15.625, 3)])
def test_a_clock_coarser_than_the_samples_is_spread_evenly(resolution_ms, start_ms):
    time_ms = start_ms + 10.0 * np.arange(500)
    stamps = np.floor(time_ms / resolution_ms) * resolution_ms / 1000
    spread, sentence = spread_stamps(stamps, np.sin(time_ms / 300))
    # The step is off by up to a sample over all of the rows, the first stamp by up to one.
    np.testing.assert_allclose(np.diff(spread), 0.01, rtol=2 * resolution_ms / 5000)
    assert np.abs(spread - time_ms / 1000).max() <= (resolution_ms + 10) / 1000
    assert "samples share each time stamp" in sentence


@pytest.mark.parametrize("kind", ["own stamps", "events", "every row twice", "a pause"])
def test_other_repeated_stamps_stay_as_they_are(kind):
    time_s, position = np.arange(500) / 100, np.sin(np.arange(500) / 30)
    if kind == "events":
        time_s, position = np.sort(np.append(time_s, time_s[::25])), np.sin(np.arange(520) / 30)
    elif kind == "every row twice":
        time_s, position = np.repeat(time_s, 2), np.repeat(position, 2)
    elif kind == "a pause":
        time_s = np.floor((time_s + 3.0 * (time_s > 2)) / 0.1) * 0.1
    assert spread_stamps(time_s, position) is None
