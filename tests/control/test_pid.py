"""PI and PID control of the error: the valve of its sign, the limit of its integral, a lost measurement."""

import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.control.scenarios import PidController, baselines

TWO = jnp.ones(2)


def controller(proportional: float = 0.05, *, derivative: float = 0.0, offset: float = 0.0) -> PidController:
    return PidController(
        proportional * TWO, 2.0 * TWO, derivative * TWO, offset * TWO, jnp.array([0.8, 0.6]), 0.01
    )


def run(own: PidController, errors) -> tuple:
    """Return integrals and currents over errors of the position."""
    state, integrals, currents = own.initial_state(100.0), [], []
    for error in errors:
        state, now = own.step(state, 100.0 + error, np.nan if np.isnan(error) else 100.0)
        integrals.append(float(state.integral))
        currents.append(np.asarray(now))
    return np.array(integrals), np.array(currents)


def test_the_sign_of_the_error_chooses_the_valve() -> None:
    size = 0.05 * 4.0 * (1 + 0.01 / 2.0)
    for error, expected in ((4.0, [size, 0.0]), (-4.0, [0.0, size]), (0.0, [0.0, 0.0])):
        np.testing.assert_allclose(run(controller(), [error])[1][0], expected, rtol=1e-12)
    np.testing.assert_array_equal(run(controller(offset=0.3), [0.0])[1], [[0.0, 0.0]])


def test_a_dead_zone_is_added_where_a_current_flows() -> None:
    plain, compensated = run(controller(), [4.0, -4.0])[1], run(controller(offset=0.3), [4.0, -4.0])[1]
    np.testing.assert_allclose(compensated, np.where(plain > 0, plain + 0.3, 0.0), rtol=1e-12)


@pytest.mark.parametrize(("error", "number", "largest"), [(200.0, 0, 0.8), (-200.0, 1, 0.6)])
def test_the_integral_stops_at_the_largest_current(error: float, number: int, largest: float) -> None:
    integrals, currents = run(controller(), [error] * 20)
    np.testing.assert_array_equal(integrals, 0.0)
    np.testing.assert_array_equal(currents[:, number], largest)
    np.testing.assert_array_equal(currents[:, 1 - number], 0.0)


def test_the_integral_grows_to_the_limit_and_no_further() -> None:
    integrals, currents = run(controller(), [12.0] * 200)
    assert integrals[0] == pytest.approx(0.01 * 0.05 / 2.0 * 12.0)
    assert 0.05 * 12.0 + integrals[-1] <= 0.8 + 1e-9
    assert integrals[-1] == integrals[-2]
    assert currents.max() == pytest.approx(0.8, abs=0.01)


def test_without_a_measurement_there_is_neither_current_nor_integral() -> None:
    integrals, currents = run(controller(), [8.0, 8.0, np.nan, np.nan])
    assert integrals[1] > 0
    np.testing.assert_array_equal(integrals[2:], 0.0)
    np.testing.assert_array_equal(currents[2:], 0.0)


def test_baselines_follow_the_simc_rules(linear_controller) -> None:
    controllers = baselines(linear_controller)
    assert set(controllers) == {"SIMC PI", "SIMC PI, dead zone compensated", "fixed PID"}
    gain, theta = np.array([30.0, 20.0]), 0.064 + 0.005
    simc = controllers["SIMC PI"]
    np.testing.assert_allclose(simc.proportional, 1 / (gain * 2 * (0.08 + theta)), rtol=1e-6)
    np.testing.assert_allclose(simc.integral_s, 8 * (0.08 + theta), rtol=1e-9)
    np.testing.assert_array_equal(simc.derivative_s, 0.0)
    np.testing.assert_array_equal(simc.offset, 0.0)
    np.testing.assert_array_equal(controllers["SIMC PI, dead zone compensated"].offset, [0.35, 0.25])
    fixed = controllers["fixed PID"]
    parallel = 1 + 0.08 / (8 * theta)  # series form to parallel form
    np.testing.assert_allclose(fixed.proportional, parallel / (25.0 * 2 * theta), rtol=1e-6)
    np.testing.assert_allclose(fixed.integral_s, parallel * 8 * theta, rtol=1e-9)
    np.testing.assert_allclose(fixed.derivative_s, 0.08 / parallel, rtol=1e-9)
