"""Plots of records and campaigns show the samples, and count what they do not show."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from hitchid.errors import InputError
from hitchid.logs.campaign import Campaign
from hitchid.logs.kinds import LABELS, segments
from hitchid.logs.plotting import MAX_TESTS, MAX_TITLE
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.plots.drawing import SEGMENT_COLOURS
from plotted import campaign, record

mpl.use("Agg")


def axes_of(count):
    return Figure().subplots(count, 1, squeeze=False)[:, 0]


@pytest.mark.parametrize("samples", [300, 5000])
def test_a_record_shows_every_sample_over_the_time_of_the_log(samples):
    shown = record(samples=samples).slice(20, samples)
    displacement, commands = shown.plot(axes_of(2))
    (line,) = displacement.get_lines()
    np.testing.assert_array_equal(line.get_xdata(), shown.time_s)
    np.testing.assert_array_equal(line.get_ydata(), shown.displacement)
    assert len(commands.get_lines()) == 2
    for command, direction in zip(commands.get_lines(), (LIFTING, LOWERING), strict=True):
        np.testing.assert_array_equal(command.get_ydata(), shown.command(direction))
        assert command.get_label() == f"{direction} command"
    assert (displacement.get_ylabel(), commands.get_ylabel()) == ("displacement / mm", "command /\nA")
    assert commands.get_xlabel() == "time / s"


def test_a_record_of_one_command_in_other_units_has_one_line(make_record):
    alone = make_record([1.0, 2.0, 3.0], [0.0, 1.0, 1.0]).convert(
        {"displacement": "cm", "lifting_command": "mA"}
    )
    displacement, commands = alone.plot(axes_of(2))
    assert len(commands.get_lines()) == 1
    assert (displacement.get_ylabel(), commands.get_ylabel()) == ("displacement / cm", "command /\nmA")


def test_a_campaign_shows_segments_and_marks_held_out_tests():
    tests = campaign(3)
    drawn = tests.plot()
    assert len(drawn) == len(tests.records) == 6
    for axes, shown in zip(drawn, tests.records, strict=True):
        (line,) = axes.get_lines()
        np.testing.assert_array_equal(line.get_ydata(), shown.displacement)
        held_out = shown in (*tests.held_out(LIFTING), *tests.held_out(LOWERING))
        assert axes.get_title(loc="left") == shown.name + " (held out)" * held_out
        spans = [(patch.get_label(), patch.get_x()) for patch in axes.patches]
        expected = [(part.label, shown.start_s + shown.step_s * part.start) for part in segments(shown)]
        assert spans == [(label, pytest.approx(start)) for label, start in expected]
    assert sum("held out" in axes.get_title(loc="left") for axes in drawn) == 2


def test_one_direction_of_a_campaign():
    drawn = campaign(2).plot(direction=LOWERING)
    assert [axes.get_title(loc="left").split()[0] for axes in drawn] == ["lowering-0", "lowering-1"]


def test_tests_beyond_the_most_are_counted():
    drawn = campaign(10).plot()
    assert len(drawn) == MAX_TESTS
    titles = [axes.get_title(loc="left") for axes in drawn]
    assert titles[-1].endswith("+ 8 more tests")
    assert not any("more" in title for title in titles[:-1])


def test_given_axes_show_as_many_tests():
    few = campaign(2).plot(axes_of(1))
    assert [axes.get_title(loc="left") for axes in few] == ["lifting-0 + 3 more tests"]
    axes = axes_of(5)
    drawn = campaign(2).plot(axes)
    assert len(drawn) == 4
    assert not axes[4].has_data()
    assert "more" not in drawn[-1].get_title(loc="left")


def test_a_campaign_without_such_tests_is_refused():
    lifting = Campaign.of([record("a", seed=1), record("b", seed=2)])
    with pytest.raises(InputError, match="no lowering tests to plot; expected at least one"):
        lifting.plot(direction=LOWERING)


@pytest.mark.parametrize("name", ["x" * 200, "$log$ $1$", "log_\udce4"])
def test_any_file_name_can_be_a_title(name):
    (axes,) = Campaign.of([record(name)]).plot()
    axes.figure.draw_without_rendering()
    assert len(axes.get_title(loc="left")) <= MAX_TITLE
    record(name).plot()[0].figure.draw_without_rendering()


def test_every_kind_of_segment_has_a_colour():
    assert set(SEGMENT_COLOURS) == set(LABELS)
