"""A covariate that is not measured, estimated from measured displacements, against plants of known load."""

from dataclasses import replace
from math import sinh, sqrt

import jax.numpy as jnp
import numpy as np
import pytest

import handmade
from hitchid.errors import InputError
from hitchid.logs.record import LIFTING
from hitchid.model.load_filter import LoadFilter
from hitchid.structures import CovariateScales, Scales, Scheduling, scheduled_quantities, structure_named

INTEGRATOR = structure_named("integrator")
EFFECT, CENTRE, SPREAD = 0.2, 40.0, 5.0  # of the speed's logarithm per standard deviation; °C
NOISE = 0.02
NOT_MEASURED = {"oil": None}
COMMANDS = (0.8, 0.0)


def model():
    """Return a hitch whose speed grows with oil temperature, and a sensor with noise."""
    plain = handmade.channel(LIFTING, shape=True)
    quantities = scheduled_quantities(INTEGRATOR)
    scales = Scales(
        *(jnp.asarray(scale) for scale in handmade.SCALES),
        covariates=CovariateScales(jnp.array([CENTRE]), jnp.array([SPREAD])),
    )
    effects = jnp.zeros((len(quantities), 1, 2)).at[0, 0, 0].set(EFFECT)
    along_stroke = plain.benchmark.nonlinearity.values.at[-2:].set(0.0)  # the speed is the same everywhere
    benchmark = replace(
        plain.benchmark,
        nonlinearity=replace(plain.benchmark.nonlinearity, values=along_stroke, scales=scales),
        scheduling=Scheduling(("oil",), quantities, effects),
    )
    never = jnp.asarray(jnp.inf)
    known = LoadFilter(jnp.asarray(NOISE), jnp.zeros(()), never, jnp.zeros(()), never, jnp.zeros(()))
    return handmade.hitch_of(replace(plain, benchmark=benchmark, load_filter=known))


MODEL = model()


def run(load, samples, measured=()):
    """Return the state after some samples, and the displacement after each."""
    state, displacements = MODEL.init_state(100.0, load), []
    for number in range(samples):
        known = measured[number] if number < len(measured) else None
        state, displacement = MODEL.step(state, COMMANDS, known)
        displacements.append(float(displacement))
    return state, np.array(displacements)


def test_without_measurements_the_displacement_is_the_mean_over_the_tests_loads():
    # Uniform with the tests' standard deviation: E exp(a z) = sinh(√3 a)/(√3 a). The midpoint rule over 128
    # loads is off by (√3 a)²/(6·128²).
    _, at_mean = run({"oil": CENTRE}, 60)
    _, found = run(NOT_MEASURED, 60)
    half_width = sqrt(3) * EFFECT
    expected = (at_mean[-1] - 100.0) * sinh(half_width) / half_width
    assert found[-1] - 100.0 == pytest.approx(expected, rel=half_width**2 / (6 * 128**2) * 2 + 1e-12)


@pytest.mark.parametrize("oil", [34.0, 41.0, 47.0])
def test_measured_motion_shows_the_load(oil):
    _, true = run({"oil": oil}, 300)
    noise = NOISE * np.random.default_rng(1).standard_normal(100)
    state, found = run(NOT_MEASURED, 300, np.concatenate([[100.0], true[:99]]) + noise)
    # Of displacements a + v t the standard error of v is about σ/t √(3/N), that of the load as that of ln v;
    # beside it, half the distance of two loads.
    travel = true[99] - 100.0
    error = NOISE / travel * sqrt(3 / 100) / EFFECT * SPREAD
    spacing = sqrt(3) * SPREAD / 128
    at_load = MODEL.unpack_state(state).channels[0].at_load.benchmark
    estimate = CENTRE + SPREAD / EFFECT * np.log(float(at_load.gain / MODEL.channels[LIFTING].benchmark.gain))
    assert abs(estimate - oil) < 4 * error + spacing
    relative = EFFECT / SPREAD * (4 * error + spacing)
    assert found[-1] - true[-1] == pytest.approx(0.0, abs=relative * (true[-1] - 100.0) + 4 * NOISE)


def test_a_measured_covariate_is_taken_as_it_is():
    state, found = run({"oil": 44.0}, 30)
    assert MODEL.unpack_state(state).displacement == found[-1]
    with pytest.raises(InputError, match="no covariate 'pressure'"):
        MODEL.init_state(100.0, {"pressure": None})


def test_a_state_of_another_model_is_refused():
    plain = handmade.hitch_of(handmade.channel(LIFTING))
    with pytest.raises(InputError, match="a state of this model"):
        plain.step(MODEL.init_state(100.0, NOT_MEASURED), COMMANDS)
