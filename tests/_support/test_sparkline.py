"""A small picture shows the extremes of a curve, whatever its length."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.tables import COLUMNS, HEIGHT, MARGIN, WIDTH, sparkline


def points(picture):
    """Return the points of each curve, shape [N, 2], the strongest last."""
    root = ElementTree.fromstring(picture)  # noqa: S314 - our own
    return [np.array([pair.split(",") for pair in line.get("points").split()], float) for line in root]


@given(samples=st.integers(1, 5000), peak=st.integers(0, 4999))
def test_a_single_peak_is_seen_and_the_picture_stays_small(samples, peak):
    curve = np.zeros(samples)
    curve[peak % samples] = 1.0
    (line,) = points(sparkline([curve], "peak"))
    assert len(line) <= max(2 * COLUMNS, 1)
    if samples > 1:
        assert line[:, 1].min() == MARGIN
        assert line[:, 1].max() == HEIGHT - MARGIN
        assert (
            abs(
                line[line[:, 1].argmin(), 0]
                - MARGIN
                - (WIDTH - 2 * MARGIN) * (peak % samples) / (samples - 1)
            )
            <= 0.5
        )


def test_missing_samples_are_left_out_and_labels_are_escaped():
    curve = np.array([np.nan, 0.0, np.inf, 1.0])
    picture = sparkline([curve, np.full(4, np.nan)], '"><script>')
    assert "<script>" not in picture
    (line,) = points(picture)
    assert len(line) == 2
    assert not re.search("nan|inf", picture)


def test_curves_share_a_scale_where_asked():
    low, high = np.array([0.0, 1.0]), np.array([0.0, 2.0])
    faint, strong = points(sparkline([high, low], "two", [high, high]))
    assert strong[1, 1] == MARGIN
    assert faint[1, 1] == pytest.approx(HEIGHT / 2)
