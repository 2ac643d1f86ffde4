"""The load of a model as a user gives it, as its channels take it, and estimated where it is not measured."""

from dataclasses import replace
from math import sinh, sqrt

import jax.numpy as jnp
import numpy as np
import pytest

import handmade
from hitchid.errors import InputError
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model.inputs import channel_load, covariates_of, load_row, mean_load
from hitchid.model.load_filter import LoadFilter
from hitchid.structures import CovariateScales, Scales, Scheduling, scheduled_quantities, structure_named

INTEGRATOR = structure_named("integrator")


def channel(mode, effect=0.1, spread=1.0, **means):
    """Return a channel whose logarithm of the gain varies with covariates of given means and spread."""
    plain = handmade.channel(mode, shape=True)
    scales = CovariateScales(jnp.array([*means.values()]), jnp.full(len(means), spread))
    quantities = scheduled_quantities(INTEGRATOR)
    effects = jnp.zeros((len(quantities), len(means), 2)).at[0, :, 0].set(effect)
    scales = Scales(*map(jnp.asarray, handmade.SCALES), covariates=scales)
    benchmark = replace(
        plain.benchmark,
        nonlinearity=replace(plain.benchmark.nonlinearity, scales=scales),
        scheduling=Scheduling(tuple(means), quantities, effects),
    )
    return replace(plain, benchmark=benchmark)


CHANNELS = channel(LIFTING, oil=40.0), channel(LOWERING, pressure=90.0, oil=42.0)
MODEL = handmade.hitch_of(*CHANNELS)


def test_covariates_have_one_order_and_the_first_channel_counts():
    assert covariates_of(CHANNELS) == ("oil", "pressure")
    np.testing.assert_array_equal(mean_load(CHANNELS), [40.0, 90.0])
    np.testing.assert_array_equal(mean_load([handmade.channel(LIFTING)]), [0.0])


def test_each_channel_takes_its_own_in_its_own_order():
    row = jnp.array([5.0, 120.0])
    np.testing.assert_array_equal(channel_load(CHANNELS, 0, row), [5.0])
    np.testing.assert_array_equal(channel_load(CHANNELS, 1, row), [120.0, 5.0])
    np.testing.assert_array_equal(channel_load([handmade.channel(LIFTING)], 0, row), [0.0])


def test_covariates_not_given_are_means_and_several_make_rows():
    np.testing.assert_array_equal(load_row({"pressure": 100.0}, CHANNELS, "model"), [40.0, 100.0])
    np.testing.assert_array_equal(load_row(None, CHANNELS, "model"), [40.0, 90.0])
    rows = load_row({"oil": [5.0, 70.0], "pressure": 100.0}, CHANNELS, "model")
    np.testing.assert_array_equal(rows, [[5.0, 100.0], [70.0, 100.0]])


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (80.0, "the model has the covariates oil and pressure; expected their values by name, got 80"),
        ({"head": 80.0}, "the model has no covariate 'head'; expected oil and pressure"),
        ({"oil": [1.0, 2.0], "pressure": [1.0, 2.0, 3.0]}, "expected equal numbers of values, got 2 and 3"),
        ({"oil": "warm"}, "load, oil: expected"),
    ],
)
def test_what_is_no_load_is_refused(load, message):
    with pytest.raises(InputError, match=message):
        load_row(load, CHANNELS, "model")


def test_a_run_is_that_of_the_gains_at_its_load():
    commands = np.zeros((200, 2))
    commands[5:, 0] = 1.0
    runs = MODEL.simulate(
        commands, step_s=0.01, initial=100.0, load={"oil": [40.0, 50.0], "pressure": 90.0}
    ).displacement
    travel = runs[:, 150] - 100.0
    # Ten standard deviations count as three. Speeds at one place: travel depends on its gain, too.
    first = np.diff(runs, axis=1)[:, 9]
    assert first[1] / first[0] == pytest.approx(np.exp(0.3), rel=0.01)
    assert travel[1] > 1.2 * travel[0]
    with pytest.raises(InputError, match="load: expected 'pressure' before motion"):
        MODEL.simulate(commands, step_s=0.01, initial=100.0, load={"oil": 40.0})


# --- a covariate that is not measured -----------------------------------------------------------------------

EFFECT, CENTRE, SPREAD = 0.2, 40.0, 5.0  # of the speed's logarithm per standard deviation; °C
NOISE = 0.02
NOT_MEASURED = {"oil": None}
COMMANDS = (0.8, 0.0)


def sensed():
    """Return a hitch whose speed grows with oil temperature, the same everywhere, and a sensor with noise."""
    warm = channel(LIFTING, EFFECT, SPREAD, oil=CENTRE)
    never, zero = jnp.asarray(jnp.inf), jnp.zeros(())
    curves = warm.benchmark.nonlinearity
    along_stroke = replace(curves, values=curves.values.at[-2:].set(0.0))
    filtered = LoadFilter(jnp.asarray(NOISE), zero, never, zero, never, zero)
    benchmark = replace(warm.benchmark, nonlinearity=along_stroke)
    return handmade.hitch_of(replace(warm, benchmark=benchmark, load_filter=filtered))


SENSED = sensed()


def run(load, samples, measured=()):
    """Return the state after some samples, and the displacement after each."""
    state, displacements = SENSED.init_state(100.0, load), []
    for number in range(samples):
        sample = measured[number] if number < len(measured) else None
        state, displacement = SENSED.step(state, COMMANDS, sample)
        displacements.append(float(displacement))
    return state, np.array(displacements)


def test_without_measurements_displacement_is_the_mean_over_the_loads():
    # Uniform with the tests' standard deviation: E exp(a z) = sinh(√3 a)/(√3 a). The midpoint rule over 128
    # loads is off by (√3 a)²/(6·128²).
    _, at_mean = run({"oil": CENTRE}, 60)
    _, estimated = run(NOT_MEASURED, 60)
    half_width = sqrt(3) * EFFECT
    expected = (at_mean[-1] - 100.0) * sinh(half_width) / half_width
    assert estimated[-1] - 100.0 == pytest.approx(expected, rel=half_width**2 / (6 * 128**2) * 2 + 1e-12)


@pytest.mark.parametrize("oil", [34.0, 41.0, 47.0])
def test_measured_motion_shows_the_load(oil):
    _, true = run({"oil": oil}, 300)
    noise = NOISE * np.random.default_rng(1).standard_normal(100)
    state, estimated = run(NOT_MEASURED, 300, np.concatenate([[100.0], true[:99]]) + noise)
    # Of displacements a + v t the standard error of v is about σ/t √(3/N), that of the load as that of ln v;
    # beside it, half the distance of two loads.
    travel = true[99] - 100.0
    error = NOISE / travel * sqrt(3 / 100) / EFFECT * SPREAD
    spacing = sqrt(3) * SPREAD / 128
    at_load = SENSED.unpack_state(state).channels[0].at_load.benchmark
    estimate = CENTRE + SPREAD / EFFECT * np.log(
        float(at_load.gain / SENSED.channels[LIFTING].benchmark.gain)
    )
    assert abs(estimate - oil) < 4 * error + spacing
    relative = EFFECT / SPREAD * (4 * error + spacing)
    assert estimated[-1] - true[-1] == pytest.approx(0.0, abs=relative * (true[-1] - 100.0) + 4 * NOISE)


def test_a_measured_covariate_is_taken_as_it_is():
    state, estimated = run({"oil": 44.0}, 30)
    assert SENSED.unpack_state(state).displacement == estimated[-1]
    with pytest.raises(InputError, match="no covariate 'pressure'"):
        SENSED.init_state(100.0, {"pressure": None})


def test_a_state_of_another_model_is_refused():
    plain = handmade.hitch_of(handmade.channel(LIFTING))
    with pytest.raises(InputError, match="a state of this model"):
        plain.step(SENSED.init_state(100.0, NOT_MEASURED), COMMANDS)
