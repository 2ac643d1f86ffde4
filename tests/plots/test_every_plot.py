"""What every plot keeps: its axes, its units, and all that is not its own."""

import re
import warnings

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import plotted
from hitchid.errors import InputError
from hitchid.plots.style import canvas
from legible import assert_whole_and_apart, shared_label

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


def test_without_axes_pyplot_has_one_new_legible_figure(plot):
    draw, count = plot
    settings = mpl.rcParams.copy()
    axes = draw()
    assert mpl.rcParams == settings
    (number,) = pyplot.get_fignums()
    figure = pyplot.figure(number)
    assert [shown for shown in figure.axes if shown.get_visible()] == list(axes)
    assert len(axes) == count

    figure.draw_without_rendering()
    texts = [text for drawn in axes for text in (drawn._left_title, drawn.xaxis.label, drawn.yaxis.label)]
    texts += [text for legend in figure.legends for text in legend.get_texts()]
    assert_whole_and_apart(figure, texts)

    for column, drawn in enumerate(axes):
        vertical, horizontal = shared_label(drawn, "y"), shared_label(drawn, "x")
        if count == 5 and column >= 2:  # errors by variable share the label of the middle one
            vertical = axes[3].get_ylabel()
        assert vertical in WITHOUT_UNIT or re.search(r"/\s\S", vertical), vertical
        is_lowest = drawn.get_subplotspec().rowspan.stop == drawn.get_gridspec().nrows
        assert re.search(r"/\s\S", horizontal) or (not horizontal and not is_lowest), horizontal


def test_axes_that_are_given_are_drawn_into_and_nothing_else(plot):
    draw, count = plot
    own = own_axes(count + 1)
    figure, other, settings = own[0].figure, contents(own[-1]), mpl.rcParams.copy()
    title, size = figure.get_suptitle(), figure.get_size_inches().tolist()
    returned = draw(axes=own[:-1])
    assert [id(axes) for axes in returned] == [id(axes) for axes in own[:-1]]
    assert all(axes.has_data() for axes in own[:-1])
    assert contents(own[-1]) == other
    assert (figure.get_suptitle(), figure.get_size_inches().tolist()) == (title, size)
    assert figure.legends == []
    # They may be a list or a grid, too.
    draw(axes=list(own[:-1]))
    draw(axes=own[:-1].reshape(-1, 1))
    assert pyplot.get_fignums() == []
    assert mpl.rcParams == settings


def test_another_number_of_axes_or_no_axes_is_refused(plot):
    draw, _ = plot
    wrong = [[], np.zeros(2), np.array([Figure()])]
    # Of a campaign as many tests are drawn as there are axes.
    if draw not in (PLOTS["campaign"][0], PLOTS["lowering tests"][0]):
        wrong.append(own_axes(9))
    for axes in wrong:
        with pytest.raises(InputError, match=r"axes: expected .*matplotlib axes, got"):
            draw(axes=axes)
    assert pyplot.get_fignums() == []


def test_a_figure_that_fails_is_closed():
    with pytest.raises(InputError, match="sampling"), canvas(None, 1, height_in=2.0):
        raise InputError("sampling")
    assert pyplot.get_fignums() == []


def test_the_legend_of_axes_that_are_given_is_their_own():
    axes = own_axes(2)
    plotted.record().plot(axes=axes)
    assert axes[0].get_legend() is None
    texts = [text.get_text() for text in axes[1].get_legend().get_texts()]
    assert texts == ["lifting command", "lowering command"]


def test_two_plots_may_share_axes():
    axes = own_axes(2)
    one, other = plotted.record("one"), plotted.record("other", direction="lowering")
    one.plot(axes=axes)
    other.plot(axes=axes)
    for line, record in zip(axes[0].get_lines(), (one, other), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), record.displacement)
