"""What a user gives as the load of a model, and the row of covariates that its channels take."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import handmade
from hitchid.errors import InputError
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model.inputs import channel_load, covariates_of, load_row, mean_load
from hitchid.structures import CovariateScales, Scales, Scheduling, scheduled_quantities, structure_named

INTEGRATOR = structure_named("integrator")


def channel(mode, **means):
    """Return a channel whose gain varies with covariates of given means, by 0.1 per unit."""
    plain = handmade.channel(mode, shape=True)
    curves = plain.benchmark.nonlinearity
    scales = CovariateScales(jnp.array([*means.values()]), jnp.ones(len(means)))
    quantities = scheduled_quantities(INTEGRATOR)
    effects = jnp.zeros((len(quantities), len(means), 2)).at[0, :, 0].set(0.1)
    benchmark = replace(
        plain.benchmark,
        nonlinearity=replace(curves, scales=Scales(*handmade_scales(), covariates=scales)),
        scheduling=Scheduling(tuple(means), quantities, effects),
    )
    return replace(plain, benchmark=benchmark)


def handmade_scales():
    return tuple(jnp.asarray(scale) for scale in handmade.SCALES)


CHANNELS = channel(LIFTING, oil=40.0), channel(LOWERING, pressure=90.0, oil=42.0)
MODEL = handmade.hitch_of(*CHANNELS)


def test_covariates_and_their_means_are_in_one_order_and_the_first_channel_counts():
    assert covariates_of(CHANNELS) == ("oil", "pressure")
    np.testing.assert_array_equal(mean_load(CHANNELS), [40.0, 90.0])
    np.testing.assert_array_equal(mean_load([handmade.channel(LIFTING)]), [0.0])


def test_each_channel_takes_its_own_in_its_own_order():
    row = jnp.array([5.0, 120.0])
    np.testing.assert_array_equal(channel_load(CHANNELS, 0, row), [5.0])
    np.testing.assert_array_equal(channel_load(CHANNELS, 1, row), [120.0, 5.0])
    np.testing.assert_array_equal(channel_load([handmade.channel(LIFTING)], 0, row), [0.0])


def test_what_is_not_given_is_the_mean_and_several_values_make_several_rows():
    np.testing.assert_array_equal(load_row({"pressure": 100.0}, CHANNELS, "model"), [40.0, 100.0])
    np.testing.assert_array_equal(load_row(None, CHANNELS, "model"), [40.0, 90.0])
    found = load_row({"oil": [5.0, 70.0], "pressure": 100.0}, CHANNELS, "model")
    np.testing.assert_array_equal(found, [[5.0, 100.0], [70.0, 100.0]])


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
