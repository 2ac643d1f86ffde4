"""Simulations of many tests: a linear benchmark, a black box, the virtual bench."""

from collections.abc import Callable

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lfilter_whale import single_threaded
from scipy.signal import cont2discrete, lfilter, lsim
from timings import OURS

from hitchid.baselines.narx import Sections, polynomial_run
from hitchid.bench import load_rig, simulate
from hitchid.structures import PhysicalModel, structure_named

VALUES = (20.0, 18.0, 1.8)
STEP_S, SAMPLES = 0.01, 1001
TESTS = (16, 400)
HOLD_SAMPLES = 50
LAG = 2


def commands(tests: int) -> np.ndarray:
    """Return random levels held for half a second each, shape [T, N]."""
    levels = np.random.default_rng(0).uniform(0.0, 0.5, (tests, -(-SAMPLES // HOLD_SAMPLES)))
    return np.repeat(levels, HOLD_SAMPLES, axis=1)[:, :SAMPLES]


def by_hitchid(inputs: np.ndarray) -> Callable[[], np.ndarray]:
    """Return our simulation, all tests side by side."""
    structure = structure_named("integrator-second-order")
    benchmark = PhysicalModel(structure, jnp.asarray(VALUES), jnp.zeros(()))
    device_inputs = jnp.asarray(inputs)
    return lambda: np.asarray(benchmark.response(device_inputs, STEP_S))


def transfer_function() -> tuple[list[float], list[float]]:
    """Return K / (s³/ω² + 2 ξ s²/ω + s)."""
    gain, omega, damping = VALUES
    return [gain], [1 / omega**2, 2 * damping / omega, 1.0, 0.0]


def by_control(inputs: np.ndarray) -> Callable[[], np.ndarray]:
    """Return python-control's simulation of the discrete model, test by test."""

    @single_threaded
    def run() -> np.ndarray:
        system = control.c2d(control.tf2ss(*transfer_function()), STEP_S, "zoh")
        return np.stack([control.forced_response(system, inputs=row).outputs for row in inputs])

    return run


def by_lsim(inputs: np.ndarray) -> Callable[[], np.ndarray]:
    """Return scipy's `lsim`, commands held between samples, test by test."""
    clock = STEP_S * np.arange(SAMPLES)

    @single_threaded
    def run() -> np.ndarray:
        return np.stack([lsim(transfer_function(), row, clock, interp=False)[1] for row in inputs])

    return run


def by_lfilter(inputs: np.ndarray) -> Callable[[], np.ndarray]:
    """Return scipy's `lfilter` over the model discretised by hand, all tests in one call."""

    @single_threaded
    def run() -> np.ndarray:
        numerator, denominator, _ = cont2discrete(transfer_function(), STEP_S, method="zoh")
        return lfilter(numerator[0], denominator, inputs, axis=1)

    return run


SIMULATORS = {
    OURS: by_hitchid,
    "python-control": by_control,
    "scipy `lsim`": by_lsim,
    "scipy `lfilter`, discretised by hand": by_lfilter,
}


@pytest.mark.parametrize("by", SIMULATORS)
@pytest.mark.parametrize("tests", TESTS)
def test_linear(timed, by, tests):
    """A linear benchmark over tests of ten seconds, every simulator with the same result."""
    inputs = commands(tests)
    expected = by_lfilter(inputs)()
    what = f"integrator with second-order lag, {tests} tests of 10 s"
    simulated = timed(SIMULATORS[by](inputs), what, by, slow=by in ("python-control", "scipy `lsim`"))
    np.testing.assert_allclose(simulated, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


@pytest.fixture(scope="module")
def black_box():
    """Return a NARX that sysidentpy found for one test, its command [N], and the travel of the test [N]."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    (command,) = commands(1)
    travel = by_lfilter(command[None])()[0] + 0.01 * np.random.default_rng(1).standard_normal(SAMPLES)
    model = FROLS(n_terms=5, order_selection=False, xlag=LAG, ylag=LAG, basis_function=Polynomial(degree=2))
    model.fit(X=command[:, None], y=travel[:, None])
    return model, command, travel


def to_terms(model) -> np.ndarray:
    """Return sysidentpy's terms as ours: 1000 + i stands for w(k−i), 2000 + i for u(k−i)."""
    codes = np.asarray(model.final_model)
    return np.where(codes > 2000, 2000 - codes, np.where(codes > 1000, codes - 1000, 0))


def test_our_narx(timed, black_box):
    """The free run of a black box, the same model in both programs."""
    model, command, travel = black_box
    terms, coefficients = to_terms(model), np.asarray(model.theta)[:, 0]
    start = Sections(command[None], travel[None, :LAG], np.zeros((1, 2)))
    simulated = timed(lambda: polynomial_run(terms, coefficients, start, LAG)[0][0], NARX)
    expected = model.predict(X=command[:, None], y=travel[:LAG, None])[LAG:, 0]
    np.testing.assert_allclose(simulated, expected, rtol=1e-6)


def test_sysidentpy_narx(timed, black_box):
    """The same by sysidentpy."""
    model, command, travel = black_box
    timed(
        single_threaded(lambda: model.predict(X=command[:, None], y=travel[:LAG, None])), NARX, "sysidentpy"
    )


NARX = "free run of one NARX of five terms, one test of 10 s"


@pytest.mark.parametrize("tests", [1, 40])
@pytest.mark.parametrize("substeps", [8, 32])
def test_rig(timed, tests, substeps):
    """The virtual bench, with the usual step and a finer one, beside the time the tests would take."""
    levels = commands(tests)[..., None] * np.array([1.0, 0.0])
    rig = load_rig("nominal")

    def run() -> None:
        motion = simulate(rig, levels + 0.35 * (levels > 0), initial_displacement_m=0.05, substeps=substeps)
        jax.block_until_ready(motion.displacement_m)

    what = f"virtual bench, {tests} tests of 10 s, {substeps} steps a sample"
    timed(run, what, bar=("real time", 10.0 * tests))
