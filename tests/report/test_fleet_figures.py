"""Figures of a fleet, of one machine, of many, with long names: a unit on each axis, no label cut off."""

import re
import warnings
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

import fleet_rows
from hitchid.fleet import compare_fleet
from hitchid.fleet import figures as figures
from hitchid.fleet.figures import ABSENT, FAILED, HIGHER, LOWER
from hitchid.plots.style import PAGE_IN
from hitchid.report.svg import svg
from legible import assert_whole_and_apart, axis_texts

FAULTS = {7: {"gain_factor": 0.85}, 2: {"dead_zone_shift": 0.04}}
FLEETS = {
    "one": lambda: fleet_rows.fleet(1),
    "three": lambda: fleet_rows.fleet(3),
    "without outlier": lambda: fleet_rows.fleet(24, seed=3),
    "24": lambda: [*fleet_rows.fleet(24, faults=FAULTS), fleet_rows.failed_row("tractor-99")],
    "long names": lambda: fleet_rows.fleet(
        12, faults=FAULTS, name=lambda number: f"customer-north-yard-{'x' * 60}-{number}"
    ),
    "100": lambda: fleet_rows.fleet(100, faults=FAULTS),
}
DRAWN = {
    "forest": lambda comparison: figures.forest(comparison, "lowering"),
    "scatter": figures.scatter,
    "verdicts": figures.verdicts,
    "speed_fan": figures.speed_fan,
}


@pytest.fixture(autouse=True)
def _every_warning_is_an_error():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@cache
def compared(name):
    """Return the comparison of a fleet, kept for all tests."""
    return compare_fleet(FLEETS[name]())


@pytest.mark.parametrize("fleet", FLEETS)
@pytest.mark.parametrize("name", DRAWN)
def test_a_figure_has_the_pages_width_units_and_whole_labels(name, fleet):
    figure = DRAWN[name](compared(fleet))
    assert figure.get_figwidth() == PAGE_IN
    figure.draw_without_rendering()
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        label = axis.label.get_text()
        assert not label or re.search(r"/\s\S", label)
        assert_whole_and_apart(figure, axis_texts(axis))
    for legend in figure.legends:
        assert_whole_and_apart(figure, legend.get_texts())
    assert "<svg" in svg(figure)


def test_a_forest_has_a_row_per_machine_outliers_first():
    gain = figures.forest(compared("24"), "lowering").axes[0]
    labels = [text.get_text() for text in gain.get_yticklabels()]
    assert set(labels[:2]) == {"tractor-07", "tractor-02"}
    assert len(labels) == 24
    (slow,) = (line.get_xydata() for line in gain.get_lines() if line.get_marker() == "v")
    estimate = compared("24").estimates[7, compared("24").column("lowering", "gain")]
    np.testing.assert_allclose(slow, [[np.exp(estimate), labels.index("tractor-07")]])


def test_of_many_machines_outliers_and_quantiles_of_others_are_drawn():
    comparison = compared("100")
    shown, others = figures.shown_machines(comparison)
    assert [comparison.machines[machine] for machine in shown] == list(comparison.standing_out)
    assert sorted(shown + others) == list(range(100))
    labels = [text.get_text() for text in figures.forest(comparison, "lowering").axes[0].get_yticklabels()]
    assert labels[-1] == f"the other {len(others)}"
    assert len(figures.verdict_rows(comparison)[0]) == len(shown)


def test_many_machines_without_outlier_are_one_row_of_quantiles():
    comparison = compare_fleet(fleet_rows.fleet(70, seed=1), false_discovery_rate=1e-6)
    assert comparison.standing_out == ()
    axes = figures.forest(comparison, "lifting").axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["the other 70"]
    assert figures.verdict_rows(comparison)[0] == []
    assert svg(figures.scatter(comparison))
    assert svg(figures.speed_fan(comparison))


def test_the_map_of_verdicts_says_higher_lower_and_not_identified():
    comparison = compared("24")
    names, codes = figures.verdict_rows(comparison)
    assert names[-1] == "tractor-99"
    assert set(codes[-1]) == {FAILED}
    rows = dict(zip(names, codes, strict=True))
    assert rows["tractor-07"][comparison.column("lowering", "gain")] == LOWER
    assert rows["tractor-02"][comparison.column("lowering", "dead zone")] == HIGHER
    assert np.all(figures.verdict_codes(compared("three")) == ABSENT)


def test_a_machine_has_one_line_in_both_directions():
    rows = fleet_rows.fleet(30, faults=FAULTS)
    slow = rows[7].directions
    weak = {direction: fleet_rows.figures(direction, gain_factor=0.8) for direction in slow}
    rows[7] = fleet_rows.row(rows[7].machine, weak)
    lifting, lowering = figures.speed_fan(compare_fleet(rows)).axes
    colours = {
        line.get_color()
        for axes in (lifting, lowering)
        for line in axes.get_lines()
        if line.get_label() == "tractor-07"
    }
    assert len(colours) == 1
    (line,) = (line for line in lowering.get_lines() if line.get_label() == "tractor-07")
    (command, still), (end, speed) = line.get_xydata()[1:]
    assert (command, still) == (pytest.approx(fleet_rows.DEAD_ZONES["lowering"]), 0)
    assert speed == pytest.approx(0.8 * fleet_rows.GAINS["lowering"] * (end - command))


def test_of_very_many_machines_outliers_and_some_others_are_drawn(monkeypatch):
    monkeypatch.setattr(figures, "MOST_POINTS", 40)
    axes = figures.scatter(compared("100")).axes[1]
    points = {line.get_marker(): len(line.get_xdata()) for line in axes.get_lines()}
    comparison = compared("100")
    columns = [comparison.column("lowering", name) for name in ("gain", "dead zone")]
    outlying = np.any(comparison.outliers.named[:, columns], axis=1).sum()
    assert points["D"] == outlying
    assert points["o"] == -(-(100 - outlying) // 3)


def test_a_direction_without_errors_of_both_parameters_has_no_scatter():
    rows = [fleet_rows.row("a", {"lifting": fleet_rows.figures("lifting", dead_zone_error=0.0)})]
    assert figures.directions_with_both(compare_fleet(rows)) == []


@pytest.fixture
def axes():
    return Figure().subplots()


@given(st.tuples(st.floats(0.1, 10), st.floats(0.1, 10), st.floats(-0.95, 0.95)))
def test_points_of_an_ellipse_have_the_distance_of_95_percent(parts):
    one, other, correlation = parts
    covariance = np.array([[one**2, correlation * one * other], [correlation * one * other, other**2]])
    curve = figures.ellipse(np.array([1.0, 2.0]), covariance) - np.array([[1.0], [2.0]])
    squared = np.einsum("ik,ij,jk->k", curve, np.linalg.inv(covariance), curve)
    np.testing.assert_allclose(squared, 5.991464547, rtol=1e-6)  # 95 % quantile of χ² with two degrees
    # Without spread it is its centre.
    centre = figures.ellipse(np.array([1.0, 2.0]), np.zeros((2, 2)))
    np.testing.assert_array_equal(centre, np.repeat([[1.0], [2.0]], curve.shape[1], axis=1))


def test_intervals_are_drawn_from_the_top_outliers_as_triangles(axes):
    values = np.array([1.0, 2.0, np.nan, 4.0])
    verdicts = np.array([figures.LOWER, figures.ALIKE, figures.ABSENT, figures.HIGHER])
    figures.draw_machine_intervals(axes, values, values - 0.5, values + 0.5, verdicts)
    points = {line.get_marker(): line.get_xydata() for line in axes.get_lines()}
    np.testing.assert_array_equal(points["v"], [[1.0, 0.0]])
    np.testing.assert_array_equal(points["^"], [[4.0, 3.0]])
    np.testing.assert_array_equal(points["o"], [[2.0, 1.0], [np.nan, 2.0]])


def test_quantiles_are_those_of_the_known_values(axes):
    figures.draw_quantiles(axes, np.array([*range(101), np.nan]), 5)
    thin, thick = (collection.get_segments()[0] for collection in axes.collections)
    np.testing.assert_allclose(thin, [[2.5, 5.0], [97.5, 5.0]])
    np.testing.assert_allclose(thick, [[25.0, 5.0], [75.0, 5.0]])
    np.testing.assert_array_equal(axes.get_lines()[0].get_xydata(), [[50.0, 5.0]])
    figures.draw_quantiles(axes, np.array([np.nan]), 6)
    assert len(axes.get_lines()) == 1


def test_every_verdict_has_a_marker_of_its_own():
    assert len({marker for _, marker, _, _ in figures.VERDICTS.values()}) == len(figures.VERDICTS)


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=20))
def test_names_never_cover_each_other(points):
    axes = Figure().subplots()
    x, y = np.array(points).T
    names = [str(number) for number in range(len(points))]
    figures.draw_machine_points(axes, x, y, np.ones(len(points), bool), names)
    places = np.array([text.xy for text in axes.texts])
    assert len(places) >= 1
    share = np.array(figures.NAME_SHARE) * [np.ptp(x) or 1.0, np.ptp(y) or 1.0]
    for number, place in enumerate(places):
        distances = np.abs(places[number + 1 :] - place)
        assert not np.any(np.all(distances < share * (1 - 1e-9), axis=1))


def test_machines_are_circles_and_outliers_diamonds_with_names(axes):
    figures.draw_machine_points(
        axes, np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([False, True]), ["", "slow"]
    )
    drawn = {line.get_marker(): line.get_xydata().tolist() for line in axes.get_lines()}
    assert drawn == {"o": [[1.0, 3.0]], "D": [[2.0, 4.0]]}
    assert [text.get_text() for text in axes.texts] == ["slow"]
