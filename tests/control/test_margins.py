"""Margins of loops against their closed forms and against python-control."""

import numpy as np
import pytest

from hitchid.control.loops import margins

OMEGA = np.geomspace(0.05, 300.0, 40_000)
LOOPS = [(1.0, 0.1), (2.0, 0.2), (5.0, 0.05), (0.5, 0.9)]


def integrator(gain: float, dead_time_s: float, omega=OMEGA):
    return gain * np.exp(-1j * omega * dead_time_s) / (1j * omega)


@pytest.mark.parametrize(("gain", "dead_time_s"), LOOPS)
def test_margins_of_an_integrator_with_dead_time_are_exact(gain, dead_time_s) -> None:
    margin = margins(integrator(gain, dead_time_s), OMEGA)
    assert margin.gain_db == pytest.approx(20 * np.log10(np.pi / (2 * gain * dead_time_s)), rel=1e-3)
    assert margin.phase_deg == pytest.approx(90 - np.rad2deg(gain * dead_time_s), rel=1e-3)
    assert margin.delay_s == pytest.approx((np.pi / 2 - gain * dead_time_s) / gain, rel=1e-3)


def test_loops_with_a_leading_axis_have_the_margins_of_each() -> None:
    loops = np.stack([integrator(*loop) for loop in LOOPS])
    together = margins(loops, OMEGA)
    for number, loop in enumerate(loops):
        for rows, one in zip(together, margins(loop, OMEGA), strict=True):
            assert rows[number] == one


def test_without_half_a_turn_the_gain_margin_is_infinite() -> None:
    margin = margins(2 / (1j * OMEGA), OMEGA)
    assert margin.gain_db == np.inf
    assert margin.phase_deg == pytest.approx(90.0, rel=1e-6)
    assert margin.sensitivity == pytest.approx(1.0, rel=1e-3)
    assert margin.disk == pytest.approx(2.0, rel=1e-6)


def test_a_loop_of_zero_at_the_end_has_margins() -> None:
    loop = integrator(2.0, 0.2)
    with np.errstate(all="raise"):
        margin = margins(np.append(loop[:-1], 0.0), OMEGA)
    assert margin.gain_db == margins(loop, OMEGA).gain_db


def test_margins_of_a_double_integrator_with_lead_are_exact() -> None:
    s = 1j * OMEGA
    margin = margins((1 + s) / s**2, OMEGA)
    crossover = np.sqrt((1 + np.sqrt(5)) / 2)
    assert margin.phase_deg == pytest.approx(np.rad2deg(np.arctan(crossover)), rel=1e-3)
    assert margin.delay_s == pytest.approx(np.arctan(crossover) / crossover, rel=1e-3)


@pytest.mark.parametrize(("gain", "dead_time_s"), [(20.0, 0.1), (2.0, 1.0)])
def test_an_unstable_loop_has_negative_margins_and_none_of_delay(gain, dead_time_s) -> None:
    margin = margins(integrator(gain, dead_time_s), OMEGA)
    assert margin.gain_db == pytest.approx(20 * np.log10(np.pi / (2 * gain * dead_time_s)), rel=1e-3)
    assert margin.gain_db < 0
    assert margin.phase_deg < 0
    assert margin.delay_s == 0


def test_sensitivity_and_disk_margin_are_those_of_python_control() -> None:
    control = pytest.importorskip("control")
    if not hasattr(control, "disk_margins"):
        pytest.skip("python-control has no disk_margins")
    system = control.tf([6.0, 12.0], [0.02, 0.5, 1.0, 0.0])
    omega = np.geomspace(0.1, 100.0, 500)
    try:
        disk = control.disk_margins(system, omega, skew=0.0)[0]
    except control.ControlMIMONotImplemented:
        pytest.skip("python-control without slycot")
    loop = system(1j * omega)
    margin = margins(loop, omega)
    assert margin.disk == pytest.approx(float(np.squeeze(disk)), rel=1e-6)
    assert margin.sensitivity == pytest.approx(np.abs(1 / (1 + loop)).max(), rel=1e-12)
