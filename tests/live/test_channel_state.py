"""What is learned of a channel beside its parameters: the factor on its bands, the levels of its command."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import machine
from hitchid.live.channel_state import LARGEST, RATE, BandFactor, level, levels_differ
from hitchid.logs.record import LIFTING
from machine import DIRECTIONS, MODEL

SHARES = st.lists(st.floats(0, 1), min_size=1, max_size=200)
ROUNDING = 200 * 4 * float(np.finfo(np.float64).eps)  # 200 sums of numbers up to 4


@given(SHARES, st.floats(0.01, 0.5), st.floats(-LARGEST, LARGEST))
def test_the_share_outside_is_near_the_expected_one(shares, expected, start):
    band, since = BandFactor(start), 0
    for number, outside in enumerate(shares, 1):
        band = band.advance(outside, expected)
        assert abs(band.log) <= LARGEST
        if abs(band.log) == LARGEST:
            since = number  # at a limit; the bound is for strokes within
        elif number > since:
            strokes = number - since
            difference = abs(np.mean(shares[since:number]) - expected)
            assert difference <= 2 * LARGEST / (RATE * strokes) + ROUNDING


@pytest.mark.parametrize("scales", [(1, 1), (1, 3), (3, 1), (0.2, 5)])
def test_coverage_is_kept_through_a_change_of_the_errors(scales):
    rng = np.random.default_rng(5)
    strokes, band, outside = 1000, BandFactor(), []
    for size in np.repeat(scales, strokes // 2):
        share = float(np.mean(np.abs(size * rng.standard_normal(50)) > 1.645 * band.factor))
        outside.append(share)
        band = band.advance(share, 0.1)
    # Not a matter of chance: the bound of the docstring.
    assert abs(np.mean(outside) - 0.1) <= 2 * LARGEST / (RATE * strokes)
    assert band.factor == pytest.approx(scales[1], rel=0.5)


@pytest.mark.parametrize("mode", DIRECTIONS)
@pytest.mark.parametrize(("levels", "median"), [((0.3,), 0.3), ((0.1, 0.4, 0.4), 0.4)])
def test_a_level_is_the_median_beyond_the_dead_zone(mode, levels, median):
    assert level(MODEL.channels[mode], machine.stroke(mode, levels)) == pytest.approx(median, rel=1e-12)


@pytest.mark.parametrize(("first", "second", "differ"), [(0.3, 0.35, False), (0.3, 0.37, True)])
def test_levels_differ_by_a_factor_if_there_are_any(first, second, differ):
    channel, strokes = MODEL.channels[LIFTING], [machine.stroke(LIFTING, (own,)) for own in (first, second)]
    assert levels_differ(channel, strokes) is differ
    assert levels_differ(channel, [machine.stroke(LIFTING, (first, second))]) is differ
    still = strokes[0]._replace(commands=np.zeros_like(strokes[0].commands))
    assert level(channel, still) == 0.0
    assert not levels_differ(channel, [still])
