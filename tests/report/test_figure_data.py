"""The data behind each figure: written beside it, whole, with the values that the figure draws."""

import csv

import numpy as np
import pytest

import reported
import validated
from hitchid.report import figures, write_report


@pytest.fixture(scope="module")
def document():
    return validated.validation().report(trace={"lifting": reported.trace()})


@pytest.fixture(scope="module")
def folder(document, tmp_path_factory):
    out = tmp_path_factory.mktemp("figures") / "out"
    write_report(out, document, {"metrics.json": b"{}"}, mark="metrics.json")
    return out / "figures"


def columns(path):
    with path.open() as file:
        header, *rows = csv.reader(file)
    return {name: [row[column] for row in rows] for column, name in enumerate(header)}


def test_every_figure_of_a_report_has_its_data_beside_it(document, folder):
    names = {picture.name for picture in document.pictures}
    assert len(names) > 12
    assert {path.stem for path in folder.glob("*.csv")} == names
    assert {path.stem for path in folder.glob("*.svg")} == names
    for name in names:
        table = columns(folder / f"{name}.csv")
        assert len(table) >= 2
        assert any(table.values())


def test_outputs_hold_every_sample_of_the_tests_drawn(document, folder):
    tests = validated.predictions()
    table = columns(folder / "lifting-outputs.csv")
    assert table["test"] == [n for n, y in zip(tests.names, tests.actual, strict=True) for _ in y]
    for name, rows in (("measured_mm", tests.actual), ("free_run_mm", tests.models["free_run"])):
        np.testing.assert_array_equal(np.array(table[name], dtype=float), np.concatenate(rows))
    lower = np.array(table["free_run_band_lower_mm"], dtype=float)
    np.testing.assert_array_equal(lower, np.concatenate(tests.band[0]))


def test_a_figure_of_curves_of_different_lengths_keeps_each_whole(folder):
    table = columns(folder / "lifting-speed-map.csv")
    made = reported.characteristics()
    assert [cell for cell in table["measured_speed_mm/s"] if cell] == [repr(m.speed) for m in made.measured]
    assert [cell for cell in table["speed_mm/s"] if cell] == [repr(p.speed) for p in made.speed_map]
    open_ends = [point.interval[1] is None for point in made.speed_map]
    assert [cell == "" for cell in table["speed_upper_mm/s"]] == open_ends


def test_a_timeline_names_the_segment_of_every_sample():
    records = reported.mixed("cycle-01", "cycle-02")
    table = figures.timeline_picture(records, 2).data
    assert table["log"] == ["cycle-01"] * 200 + ["cycle-02"] * 200
    for record, (label, start, stop) in [(r, s) for r, segments in records for s in segments]:
        offset = 200 * (record.name == "cycle-02")
        assert set(table["segment"][offset + start : offset + stop]) == {label}
    assert len(table["displacement_mm"]) == len(table["segment"]) == 400


def test_the_first_predicted_errors_are_those_of_the_figure():
    tests = validated.predictions()
    table = figures.predicted_errors("name", {"test": tests}, "mm", "", "").data
    expected = tests.actual[0][1:] - tests.models["benchmark"][0][1:]
    np.testing.assert_array_equal(table["test_actual_mm"][1 : expected.size + 1], expected)
    assert np.isnan(table["test_actual_mm"][0])
