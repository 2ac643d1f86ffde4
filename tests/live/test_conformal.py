"""The factor on bands keeps their coverage, whatever the strokes are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.live.channel_state import LARGEST, RATE, BandFactor

SHARES = st.lists(st.floats(0, 1), min_size=1, max_size=200)
ROUNDING = 200 * 4 * float(np.finfo(np.float64).eps)  # 200 sums of numbers up to 4


@given(SHARES, st.floats(0.01, 0.5), st.floats(-LARGEST, LARGEST))
def test_the_share_outside_is_within_its_bound_of_the_expected_one(shares, expected, start):
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
    sizes = np.repeat(scales, strokes // 2)
    for size in sizes:
        share = float(np.mean(np.abs(size * rng.standard_normal(50)) > 1.645 * band.factor))
        outside.append(share)
        band = band.advance(share, 0.1)
    # Not a matter of chance: the bound of the docstring.
    assert abs(np.mean(outside) - 0.1) <= 2 * LARGEST / (RATE * strokes)
    assert band.factor == pytest.approx(scales[1], rel=0.5)


def test_a_factor_of_one_stays_where_the_coverage_is_right():
    assert BandFactor().advance(0.1, 0.1) == BandFactor()
    assert BandFactor().advance(0.2, 0.1).factor > 1 > BandFactor().advance(0.0, 0.1).factor
