"""What every plot keeps: its axes, its units, and all that is not its own."""

import re
import subprocess
import sys
import warnings

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import plotted
from hitchid.errors import InputError

mpl.use("Agg")
MODEL, VALIDATION = plotted.hitch(), plotted.validation()
# Name to the plot as a function of its axes, and the number of axes.
PLOTS = {
    "record": (plotted.record().plot, 2),
    "campaign": (plotted.campaign().plot, 6),
    "lowering tests": (lambda axes=None: plotted.campaign().plot(axes, direction="lowering"), 3),
    "speed map": (MODEL.plot, 2),
    "step response": (lambda axes=None: MODEL.plot_step_response(axes=axes), 4),
    "step response, lifting": (lambda axes=None: MODEL.plot_step_response("lifting", axes=axes), 2),
    "bode": (lambda axes=None: MODEL.plot_bode(axes=axes), 2),
    "fit": (VALIDATION.plot, 2),
    "residuals": (VALIDATION.plot_residuals, 5),
    "comparison": (plotted.comparison().plot, 2),
}
WITHOUT_UNIT = {"autocorrelation\nof errors", "correlation of errors\nwith command"}


@pytest.fixture(autouse=True)
def _no_figure_is_left_and_no_warning_is_given():
    pyplot.close("all")  # those of other tests in this process
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield
    pyplot.close("all")


@pytest.fixture(params=PLOTS)
def plot(request):
    """Return each plot and the number of its axes."""
    return PLOTS[request.param]


def own_axes(count):
    """Return axes of a figure without pyplot."""
    return Figure(figsize=(8, 2 * count)).subplots(count, 1)


def contents(axes):
    return [(type(artist).__name__, artist.get_visible()) for artist in axes.get_children()]


def test_without_axes_pyplot_has_one_new_figure_with_the_axes_that_are_returned(plot):
    draw, count = plot
    before = mpl.rcParams.copy()
    axes = draw()
    assert mpl.rcParams == before
    (number,) = pyplot.get_fignums()
    shown = [each for each in pyplot.figure(number).axes if each.get_visible()]
    assert shown == list(axes)
    assert len(axes) == count


def test_axes_that_are_given_are_drawn_into_and_nothing_else_is_changed(plot):
    draw, count = plot
    own = own_axes(count + 1)
    other, title = contents(own[-1]), own[-1].figure.get_suptitle()
    settings, size = mpl.rcParams.copy(), own[0].figure.get_size_inches().tolist()
    returned = draw(axes=own[:-1])
    assert [id(each) for each in returned] == [id(each) for each in own[:-1]]
    assert all(each.has_data() for each in own[:-1])
    assert contents(own[-1]) == other
    assert (own[0].figure.get_suptitle(), own[0].figure.get_size_inches().tolist()) == (title, size)
    assert own[0].figure.legends == []
    assert pyplot.get_fignums() == []
    assert mpl.rcParams == settings


def test_axes_may_be_a_list_or_a_grid(plot):
    draw, count = plot
    grid = own_axes(count)
    draw(axes=list(grid))
    draw(axes=grid.reshape(-1, 1))


@pytest.mark.parametrize("wrong", [0, 9])
def test_another_number_of_axes_is_refused(plot, wrong):
    draw, _ = plot
    if draw in (PLOTS["campaign"][0], PLOTS["lowering tests"][0]) and wrong:
        pytest.skip("as many tests are drawn as there are axes")
    axes = [] if wrong == 0 else own_axes(wrong)
    with pytest.raises(InputError, match=r"axes: expected .*matplotlib axes, got"):
        draw(axes=axes)
    assert pyplot.get_fignums() == []


def test_what_is_no_axes_is_refused(plot):
    draw, _ = plot
    for wrong in (np.zeros(2), np.array([Figure()])):
        with pytest.raises(InputError, match=r"axes: expected .*matplotlib axes, got"):
            draw(axes=wrong)


def told(axes, direction):
    """Return the label of one direction of an axes, its own or that of the axes it shares it with."""
    shared = axes.get_shared_x_axes() if direction == "x" else axes.get_shared_y_axes()
    labels = [getattr(each, f"get_{direction}label")() for each in (axes, *shared.get_siblings(axes))]
    return next((label for label in labels if label), "")


def test_every_axis_has_a_label_with_a_unit(plot):
    axes = plot[0]()
    axes[0].figure.draw_without_rendering()
    errors_by_variable = axes[2:] if len(axes) == 5 else []
    for each in axes:
        for direction in "xy":
            label = told(each, direction)
            if direction == "y" and any(each is other for other in errors_by_variable):
                label = axes[3].get_ylabel()
            if not label and direction == "x":
                label = "below / 1" if each.get_subplotspec().rowspan.stop < each.get_gridspec().nrows else ""
            assert label in WITHOUT_UNIT or re.search(r"/\s\S", label), (direction, label)


def test_labels_and_titles_lie_within_the_figure_and_do_not_overlap(plot):
    axes = plot[0]()
    figure = axes[0].figure
    figure.draw_without_rendering()
    whole = figure.bbox.padded(1.0)
    texts = [text for each in axes for text in (each._left_title, each.xaxis.label, each.yaxis.label)]
    texts += [text for legend in figure.legends for text in legend.get_texts()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts if text.get_text()]
    for number, (text, box) in enumerate(boxes):
        assert whole.x0 <= box.x0 <= box.x1 <= whole.x1, text
        assert whole.y0 <= box.y0 <= box.y1 <= whole.y1, text
        for other, beside in boxes[number + 1 :]:
            assert not box.overlaps(beside), (text, other)


def test_a_figure_that_fails_is_closed():
    with pytest.raises(InputError, match="sampling"):
        fail()
    assert pyplot.get_fignums() == []


def fail():
    from hitchid.plots.style import canvas

    with canvas(None, 1, height_in=2.0):
        raise InputError("sampling")


def test_the_legend_of_axes_that_are_given_is_their_own():
    axes = own_axes(2)
    plotted.record().plot(axes=axes)
    assert axes[0].get_legend() is None
    assert [text.get_text() for text in axes[1].get_legend().get_texts()] == [
        "lifting command",
        "lowering command",
    ]


def test_two_plots_may_share_axes():
    axes = own_axes(2)
    one, other = plotted.record("one"), plotted.record("other", direction="lowering")
    one.plot(axes=axes)
    other.plot(axes=axes)
    for line, record in zip(axes[0].get_lines(), (one, other), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), record.displacement)


def test_matplotlib_is_not_imported_before_something_is_drawn():
    code = "import sys, hitchid.logs.campaign, hitchid.model, hitchid.validation; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)  # noqa: S603
    assert "hitchid.validation.validation" in run.stdout.split()
    assert "matplotlib" not in run.stdout.split()
