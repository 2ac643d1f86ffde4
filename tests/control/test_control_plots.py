"""Figures of closed and open loops: what is drawn is what was given, with a unit on every axis."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from hitchid.control import ClosedLoops, Kind, OpenLoop, Scenario, TrialRun, drive_report, tune_report
from hitchid.control.prediction import Band
from hitchid.plots.style import PAGE_IN
from hitchid.report.svg import svg

OMEGA = np.geomspace(0.1, 100.0, 50)
TIME_S = 0.01 * np.arange(300)


def loops() -> dict[str, OpenLoop]:
    gains = np.array([[2.0], [1.8], [2.2]])
    response = gains * np.exp(-0.05j * OMEGA) / (1j * OMEGA)
    return {"lifting": OpenLoop(OMEGA, response), "lowering": OpenLoop(OMEGA, 0.5 * response)}


def scenario() -> Scenario:
    target = np.where(TIME_S < 1, 100.0, 105.0)
    return Scenario("step +5 mm", Kind.STEP, target, 100.0, 100, amplitude=5.0)


def runs() -> ClosedLoops:
    displacement = np.stack([np.where(TIME_S < 1.2, 100.0, 105.1), np.where(TIME_S < 1.3, 100.0, 104.9)])
    currents = np.zeros((2, 300, 2))
    currents[:, 100:120, 0] = 0.7
    return ClosedLoops(scenario().target, displacement, displacement + 0.01, currents)


def drawn(name: str) -> Figure:
    match name:
        case "bode":
            return tune_report.bode(loops())
        case "nichols":
            return tune_report.nichols(loops(), 1.7)
        case "sensitivity":
            return tune_report.sensitivity(loops(), 1.7)
        case "steps":
            target = scenario().target
            return tune_report.step_fan([TrialRun(TIME_S, target, runs().measured)] * 2, "mm")
        case _:
            band = Band(scenario().target - 1, scenario().target + 1)
            return drive_report.closed_loop(scenario(), runs(), runs(), band, "SIMC PI", ("mm", "A"))


@pytest.mark.parametrize("name", ["bode", "nichols", "sensitivity", "steps", "closed loop"])
def test_a_figure_fits_the_page_and_names_its_units(name: str):
    figure = drawn(name)
    assert figure.get_figwidth() == PAGE_IN
    assert "<svg" in svg(figure)
    labels = {label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label}
    assert labels
    assert all("/" in label for label in labels - {"sensitivity"})


def line_of(axes, label: str) -> np.ndarray:
    return next(line.get_ydata() for line in axes.lines if line.get_label() == label)


def test_the_magnitude_is_that_of_the_model():
    magnitude, phase = drawn("bode").axes
    np.testing.assert_allclose(line_of(magnitude, "lifting"), 20 * np.log10(2.0 / OMEGA))
    np.testing.assert_allclose(line_of(phase, "lifting"), -90 - np.rad2deg(0.05 * OMEGA))


def test_displacement_and_error_are_those_of_the_loops():
    displacement, error, current = drawn("closed loop").axes
    np.testing.assert_array_equal(line_of(displacement, "controller"), runs().displacement[0])
    np.testing.assert_allclose(error.lines[0].get_ydata(), runs().displacement[0] - scenario().target)
    assert {line.get_label() for line in current.lines} == {"lifting current", "lowering current"}
