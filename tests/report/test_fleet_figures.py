"""Figures of a fleet, of one machine, of many, with long names: a unit on each axis, no label cut off."""

import re
import warnings
from itertools import combinations

import numpy as np
import pytest

import fleet_rows
from hitchid.fleet import compare_fleet
from hitchid.fleet import figures as figures
from hitchid.fleet.figures import ABSENT, FAILED, HIGHER, LOWER
from hitchid.plots.style import PAGE_IN
from hitchid.report.svg import svg

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
KEPT = {}


@pytest.fixture(autouse=True)
def _every_warning_is_an_error():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def compared(name):
    """Return the comparison of a fleet, kept for all tests."""
    if name not in KEPT:
        KEPT[name] = compare_fleet(FLEETS[name]())
    return KEPT[name]


def texts(axis):
    """Return the label of an axis and those of its ticks, as far as they are drawn."""
    low, high = sorted(axis.get_view_interval())
    labels = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return [text for text in (axis.label, *labels) if text.get_visible() and text.get_text()]


@pytest.mark.parametrize("fleet", FLEETS)
@pytest.mark.parametrize("name", DRAWN)
def test_a_figure_has_the_width_of_a_page_units_and_no_label_that_is_cut_off_or_covered(name, fleet):
    figure = DRAWN[name](compared(fleet))
    assert figure.get_figwidth() == PAGE_IN
    figure.draw_without_rendering()
    whole = figure.bbox.padded(1.0)
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        if label := axis.label.get_text():
            assert re.search(r"/\s\S", label)
        boxes = [(text.get_text(), text.get_window_extent()) for text in texts(axis)]
        for text, box in boxes:
            assert whole.x0 <= box.x0 <= box.x1 <= whole.x1, text
            assert whole.y0 <= box.y0 <= box.y1 <= whole.y1, text
        for (one, box), (other, beside) in combinations(boxes, 2):
            assert not box.overlaps(beside), (one, other)
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert whole.x0 <= box.x0 <= box.x1 <= whole.x1
    assert "<svg" in svg(figure)


def test_a_forest_has_a_row_for_each_machine_those_that_stand_out_first():
    axes = figures.forest(compared("24"), "lowering").axes
    labels = [text.get_text() for text in axes[0].get_yticklabels()]
    assert set(labels[:2]) == {"tractor-07", "tractor-02"}
    assert len(labels) == 24
    gain = axes[0]
    (slow,) = (line.get_xydata() for line in gain.get_lines() if line.get_marker() == "v")
    estimate = compared("24").estimates[7, compared("24").column("lowering", "gain")]
    np.testing.assert_allclose(slow, [[np.exp(estimate), labels.index("tractor-07")]])


def test_of_many_machines_those_that_stand_out_are_drawn_and_the_quantiles_of_the_others():
    comparison = compared("100")
    shown, others = figures.shown_machines(comparison)
    assert [comparison.machines[machine] for machine in shown] == list(comparison.standing_out)
    assert sorted(shown + others) == list(range(100))
    labels = [text.get_text() for text in figures.forest(comparison, "lowering").axes[0].get_yticklabels()]
    assert labels[-1] == f"the other {len(others)}"
    assert len(figures.verdict_rows(comparison)[0]) == len(shown)


def test_of_many_machines_without_an_outlier_there_is_one_row_of_quantiles():
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


def test_a_machine_has_the_same_line_for_its_speed_in_both_directions():
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


def test_of_very_many_machines_like_the_others_some_are_drawn_and_all_that_stand_out(monkeypatch):
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
