"""Plots of validations and comparisons show measured, predicted, errors and bands as they are."""

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from hitchid.errors import InputError
from hitchid.logs.record import LIFTING
from hitchid.validation.results import label
from plotted import comparison, predictions, residuals, validation

mpl.use("Agg")


def axes_of(count):
    return Figure().subplots(count, 1, squeeze=False)[:, 0]


def lines(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def test_one_test_shows_measured_and_predicted_displacement_errors_and_band():
    tests = predictions()
    displacement, error = validation(tests).plot(axes_of(2), test="up-1", models=("benchmark", "one_step"))
    drawn = lines(displacement)
    assert set(drawn) == {"measured", label("benchmark"), label("one_step")}
    for name, rows in (("measured", tests.actual), *((label(k), v) for k, v in tests.models.items())):
        if name in drawn:
            np.testing.assert_array_equal(drawn[name].get_xdata(), tests.time_s[1])
            np.testing.assert_array_equal(drawn[name].get_ydata(), rows[1])
    for line, model in zip(error.get_lines(), ("benchmark", "one_step"), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), tests.actual[1] - tests.models[model][1])
    for axes, middle in ((displacement, tests.models["free_run"][1]), (error, 0 * tests.time_s[1])):
        (band,) = axes.collections
        corners = np.concatenate([path.vertices for path in band.get_paths()])
        offset = corners[:, 1] - np.interp(corners[:, 0], tests.time_s[1], middle)
        np.testing.assert_allclose(np.abs(offset), 2.0, atol=1e-9)
    assert (displacement.get_ylabel(), error.get_ylabel()) == ("displacement / mm", "error / mm")
    assert error.get_xlabel() == "time / s"


def test_several_tests_follow_each_other_with_gaps_between():
    tests = predictions(sizes=(30, 20, 25))
    axes = axes_of(2)
    displacement, error = validation(tests).plot(axes)
    values = lines(displacement)["measured"].get_ydata()
    assert np.isnan(values).sum() == 3
    np.testing.assert_array_equal(
        values[~np.isnan(values)], np.concatenate([actual[1:] for actual in tests.actual])
    )
    assert error.get_xlabel() == "time, test after test / s"


def test_a_new_figure_says_which_tests_it_shows():
    of_many = validation(predictions(sizes=(30,) * 9)).plot()
    assert of_many[0].get_title(loc="left").startswith("lifting: 4 of 9 unseen tests")
    alone = validation().plot(test="up-2")
    assert alone[0].get_title(loc="left") == "lifting: up-2"


def test_a_benchmark_that_equals_the_free_run_is_drawn_once():
    tests = predictions()
    tests = replace(tests, models={**tests.models, "benchmark": tests.models["free_run"]})
    displacement, _ = validation(tests).plot(axes_of(2))
    assert set(lines(displacement)) == {"measured", label("free_run")}


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_run_is_drawn_as_far_as_finite(value):
    tests = predictions()
    rows = tuple(np.where(np.arange(y.size) > y.size // 2, value, y) for y in tests.models["free_run"])
    with np.errstate(over="ignore", invalid="ignore"):
        gone = replace(tests, models={**tests.models, "free_run": rows}, band=(rows, rows))
    for test in (None, "up-0"):
        axes = validation(gone, diverged=True).plot(test=test)
        axes[0].figure.draw_without_rendering()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"section": "cycles"}, "section: expected one of lifting, got str 'cycles'"),
        ({"test": "down-1"}, "test: expected one of up-0, up-1, up-2, got str 'down-1'"),
        ({"models": ("spline",)}, "models: expected one of benchmark, free_run, one_step, got str 'spline'"),
        ({"models": ()}, "models: expected at least one"),
    ],
)
def test_what_is_not_there_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        validation().plot(**options)


def test_residuals_show_correlations_with_bounds_and_errors_in_bins():
    expected, drawn = residuals(), validation().plot_residuals(axes_of(5))
    for axes, values, bounds in (
        (drawn[0], expected.autocorrelation, expected.autocorrelation_bounds),
        (drawn[1], expected.cross_correlation, expected.cross_bounds),
    ):
        band, stems = axes.collections
        np.testing.assert_allclose([segment[1, 1] for segment in stems.get_segments()], values)
        assert band.get_paths()[0].vertices[:, 1].max() == pytest.approx(max(bounds))
    for axes, binned in zip(drawn[2:], expected.by_quantity.values(), strict=True):
        spreads, means = axes.get_lines()[0:-1:2], axes.get_lines()[1:-1:2]
        assert [set(line.get_ydata()) for line in means] == [{error_bin.mean} for error_bin in binned.bins]
        for line, error_bin in zip(spreads, binned.bins, strict=True):
            low, high = line.get_ydata()
            assert ((high - low) / 2) ** 2 + error_bin.mean**2 == pytest.approx(error_bin.rmse**2)
    assert [axes.get_xlabel() for axes in drawn[2:]] == ["displacement / mm", "speed / (mm/s)", "command / A"]


def test_residuals_of_a_run_that_diverged_say_so():
    for axes in validation(diverged=True).plot_residuals():
        assert [text.get_text() for text in axes.texts] == ["lifting, free run: diverged"]
    with pytest.raises(InputError, match="run: expected one of free_run, one_step"):
        validation().plot_residuals(run="horizon")


def test_a_comparison_shows_the_free_run_of_each_model():
    compared = comparison()
    tests = compared.free_runs(LIFTING)
    displacement, error = compared.plot(axes_of(2), test="up-0")
    drawn = lines(displacement)
    for model in tests.models:
        np.testing.assert_array_equal(drawn[label(model)].get_ydata(), tests.models[model][0])
    assert len(drawn) == 1 + len(tests.models)
    assert len(error.get_lines()) == len(tests.models)
