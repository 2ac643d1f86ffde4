"""What is drawn of many machines: each of them, where it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from hitchid.fleet import figures as plots

ANGLES = 73  # points of a curve


@pytest.fixture
def axes():
    return Figure().subplots()


COVARIANCES = st.tuples(st.floats(0.1, 10), st.floats(0.1, 10), st.floats(-0.95, 0.95))


@given(COVARIANCES)
def test_every_point_of_an_ellipse_has_the_distance_of_95_percent(parts):
    one, other, correlation = parts
    covariance = np.array([[one**2, correlation * one * other], [correlation * one * other, other**2]])
    curve = plots.ellipse(np.array([1.0, 2.0]), covariance) - np.array([[1.0], [2.0]])
    squared = np.einsum("ik,ij,jk->k", curve, np.linalg.inv(covariance), curve)
    np.testing.assert_allclose(squared, 5.991464547, rtol=1e-6)  # 95 % quantile of χ² with two degrees


def test_an_ellipse_without_spread_is_its_centre():
    curve = plots.ellipse(np.array([1.0, 2.0]), np.zeros((2, 2)))
    np.testing.assert_array_equal(curve, np.repeat([[1.0], [2.0]], ANGLES, axis=1))


def test_intervals_are_drawn_from_the_top_those_that_stand_out_by_their_triangle(axes):
    values = np.array([1.0, 2.0, np.nan, 4.0])
    verdicts = np.array([plots.LOWER, plots.ALIKE, plots.ABSENT, plots.HIGHER])
    plots.draw_machine_intervals(axes, values, values - 0.5, values + 0.5, verdicts)
    points = {line.get_marker(): line.get_xydata() for line in axes.get_lines()}
    np.testing.assert_array_equal(points["v"], [[1.0, 0.0]])
    np.testing.assert_array_equal(points["^"], [[4.0, 3.0]])
    np.testing.assert_array_equal(points["o"], [[2.0, 1.0], [np.nan, 2.0]])


def test_quantiles_are_those_of_the_known_values(axes):
    plots.draw_quantiles(axes, np.array([*range(101), np.nan]), 5)
    thin, thick = (collection.get_segments()[0] for collection in axes.collections)
    np.testing.assert_allclose(thin, [[2.5, 5.0], [97.5, 5.0]])
    np.testing.assert_allclose(thick, [[25.0, 5.0], [75.0, 5.0]])
    np.testing.assert_array_equal(axes.get_lines()[0].get_xydata(), [[50.0, 5.0]])
    plots.draw_quantiles(axes, np.array([np.nan]), 6)
    assert len(axes.get_lines()) == 1


def test_every_verdict_has_a_marker_of_its_own():
    assert len({marker for _, marker, _, _ in plots.VERDICTS.values()}) == len(plots.VERDICTS)


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=20))
def test_names_never_cover_each_other(points):
    axes = Figure().subplots()
    x, y = np.array(points).T
    names = [str(number) for number in range(len(points))]
    plots.draw_machine_points(axes, x, y, np.ones(len(points), bool), names)
    places = np.array([text.xy for text in axes.texts])
    assert len(places) >= 1
    share = np.array(plots.NAME_SHARE) * [np.ptp(x) or 1.0, np.ptp(y) or 1.0]
    for number, place in enumerate(places):
        distances = np.abs(places[number + 1 :] - place)
        assert not np.any(np.all(distances < share * (1 - 1e-9), axis=1))


def test_machines_are_circles_and_those_that_stand_out_diamonds_with_names(axes):
    plots.draw_machine_points(
        axes, np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([False, True]), ["", "slow"]
    )
    drawn = {line.get_marker(): line.get_xydata().tolist() for line in axes.get_lines()}
    assert drawn == {"o": [[1.0, 3.0]], "D": [[2.0, 4.0]]}
    assert [text.get_text() for text in axes.texts] == ["slow"]
