"""Plots of a model show its speed map, step response and frequency response, with their bands."""

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import handmade
from hitchid.errors import InputError
from hitchid.handover.responses import frequency_response, step_responses
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model.parameter_draws import PARAMETER_DRAWS, draw_parameters
from plotted import characteristics, hitch

mpl.use("Agg")
MODEL = hitch()


def axes_of(count):
    return Figure().subplots(count, 1, squeeze=False)[:, 0]


def lines(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def band_of(axes, number):
    """Return the corners of one band, as x and y."""
    return np.concatenate([path.vertices for path in axes.collections[number].get_paths()])


def drawn_vectors(direction, seed=0):
    estimates = MODEL.uncertainty[direction].benchmark
    return draw_parameters(MODEL.channels[direction].benchmark, estimates, PARAMETER_DRAWS, seed)


def test_the_speed_map_shows_bands_measured_points_and_dead_zones():
    lifting, lowering = MODEL.plot(axes_of(2))
    assert set(lines(lifting)) == {"benchmark", "measured", "dead zone"}
    assert set(lines(lowering)) == {"90", "120", "measured", "dead zone"}
    expected = characteristics()
    speeds = [(point.command, point.speed) for point in expected.speed_map]
    np.testing.assert_array_equal(np.column_stack(lines(lifting)["benchmark"].get_data()), speeds)
    corners = {tuple(corner) for corner in band_of(lifting, 0)}
    highest = lifting.get_ylim()[1]
    for point in expected.speed_map:
        lower, upper = point.interval
        assert {(point.command, lower), (point.command, highest if upper is None else upper)} <= corners
    (zone,) = lifting.patches
    assert (zone.get_x(), zone.get_x() + zone.get_width()) == pytest.approx(expected.dead_zone.interval)


def test_without_arguments_every_direction_has_its_levels_load_and_title():
    titles = ["lifting, 95 % bands", "lowering, 95 % bands"]
    for axes, title in zip(MODEL.plot_step_response()[:2], titles, strict=True):
        assert axes.get_title(loc="left") == title
        assert set(lines(axes)) == {"0.4 A", "0.6 A", "0.8 A"}
    model = replace(MODEL, units={**MODEL.units, "pressure": "bar"})
    titles[1] = "lowering, by pressure / bar, 95 % bands"
    assert [axes.get_title(loc="left") for axes in model.plot()] == titles


def test_a_model_without_intervals_shows_the_speed_of_its_parameters():
    model = handmade.hitch("integrator-first-order", covered=handmade.envelope(command=(0.0, 0.6)))
    for axes, direction in zip(model.plot(axes_of(2)), model.channels, strict=True):
        zone, gain = handmade.DEAD_ZONES[direction], handmade.GAINS[direction]
        command, speed = lines(axes)["benchmark"].get_data()
        np.testing.assert_allclose(speed, gain * np.maximum(command - zone, 0), rtol=1e-12)
        assert command[-1] == pytest.approx(zone + 0.6)
        assert set(lines(axes)["dead zone"].get_xdata()) == {zone}
        assert not axes.collections


def test_a_speed_map_that_is_not_known_is_refused():
    with pytest.raises(InputError, match="channel 'lifting': the speed map is not known; expected"):
        handmade.hitch().plot(axes_of(2))


def test_the_step_response_shows_travel_and_speed_with_bands():
    travel, speed = MODEL.plot_step_response(LIFTING, [0.5, 0.7], duration_s=1.0, axes=axes_of(2), seed=3)
    expected = step_responses(MODEL.channels[LIFTING], [0.5, 0.7], 1.0, drawn_vectors(LIFTING, seed=3))
    assert [line.get_label() for line in travel.get_lines()] == ["0.5 A", "0.7 A"]
    for number, response in enumerate(expected):
        for axes, time_s, banded in (
            (travel, response.time_s, response.travel),
            (speed, response.speed_time_s, response.speed),
        ):
            line = axes.get_lines()[number]
            np.testing.assert_array_equal(line.get_xdata(), time_s)
            np.testing.assert_array_equal(line.get_ydata(), banded.value)
            corners = {tuple(corner) for corner in band_of(axes, number)}
            assert {*zip(time_s, banded.lower, strict=True)} <= corners
            assert {*zip(time_s, banded.upper, strict=True)} <= corners
    assert (travel.get_ylabel(), speed.get_ylabel()) == ("travel / mm", "speed / (mm/s)")


def test_the_bode_diagram_shows_decibels_and_degrees_with_bands():
    frequency_hz = [0.1, 1.0, 10.0]
    magnitude, phase = MODEL.plot_bode(frequency_hz=frequency_hz, axes=axes_of(2))
    for number, direction in enumerate((LIFTING, LOWERING)):
        expected = frequency_response(
            MODEL.channels[direction], np.array(frequency_hz), None, drawn_vectors(direction)
        )
        for axes, banded in (
            (magnitude, expected.magnitude.map(lambda values: 20 * np.log10(values))),
            (phase, expected.phase_rad.map(np.degrees)),
        ):
            line = axes.get_lines()[number]
            np.testing.assert_array_equal(line.get_xdata(), frequency_hz)
            np.testing.assert_allclose(line.get_ydata(), banded.value, rtol=1e-12)
            assert band_of(axes, number)[:, 1].min() == pytest.approx(banded.lower.min())
            assert band_of(axes, number)[:, 1].max() == pytest.approx(banded.upper.max())
    assert set(lines(magnitude)) == {"lifting, 95 % band", "lowering, 95 % band"}
    assert (magnitude.get_xscale(), phase.get_xscale()) == ("log", "log")
    assert (magnitude.get_ylabel(), phase.get_ylabel()) == ("magnitude (re 1 mm/A) / dB", "phase / °")


def test_a_model_without_estimates_has_no_bands():
    model = handmade.hitch("integrator-first-order")
    for axes in (
        *model.plot_bode(axes=axes_of(2)),
        *model.plot_step_response(commands=[0.5], axes=axes_of(4)),
    ):
        assert not axes.collections
        assert axes.has_data()
