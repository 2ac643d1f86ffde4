"""A compensator corrects as far ahead as it did so on held-out tests, and no further."""

from dataclasses import fields

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import handmade
from hitchid.data.record import LIFTING
from hitchid.identification.compensator_horizon import judge_compensator, largest_horizon
from hitchid.identification.cross_fitting import HeldOut
from hitchid.identification.held_out_predictions import within_a_second
from hitchid.model import Channel
from hitchid.structures import Batch
from hitchid.uncertainty.prediction_spread import HeldOutErrors
from truth import levels

SAMPLES, TESTS = 150, 4
HORIZONS = (1, 2, 5, 10)


def errors(*rmse):
    return {
        horizon: HeldOutErrors([np.full(3, size)], [np.zeros(3)])
        for horizon, size in zip(HORIZONS, rmse, strict=False)
    }


@pytest.mark.parametrize(
    ("corrected", "expected"),
    [
        ((0.5, 0.5, 0.5, 0.5), 10),
        ((1.0, 1.0, 1.0, 1.0), 10),  # an untrained one changes nothing
        ((0.5, 0.5, 1.1, 0.5), 2),  # what helps again farther ahead was wrong before
        ((1.1, 0.5, 0.5, 0.5), 0),
        ((0.5, 0.5, 0.5, np.inf), 5),
        ((0.5, np.nan, 0.5, 0.5), 1),
        ((0.5, 1e200, 0.5, 0.5), 1),
        ((), 0),
    ],
)
def test_a_correction_ends_before_it_makes_errors_larger(corrected, expected):
    assert largest_horizon(errors(*corrected), errors(1.0, 1.0, 1.0, 1.0)) == expected


@given(sizes=st.lists(st.tuples(st.floats(0, 1e6), st.floats(0, 1e6)), min_size=4, max_size=4).map(np.array))
def test_up_to_the_horizon_that_is_found_no_error_is_larger(sizes):
    found = largest_horizon(errors(*sizes[:, 0]), errors(*sizes[:, 1]))
    for horizon, (corrected, uncorrected) in zip(HORIZONS, sizes, strict=True):
        assert horizon > found or corrected <= uncorrected * (1 + 1e-12)


def test_horizons_are_no_further_than_a_second():
    assert within_a_second((200, 500, 1000), 0.001) == (200, 500, 1000)
    assert within_a_second((200, 500, 1000), 0.005) == (200,)
    assert within_a_second((200, 500, 1000), 0.01) == ()


@pytest.fixture
def tests(make_record):
    """Return tests of a machine whose speed is not quite the model's."""
    rng = np.random.default_rng(4)
    records = []
    for _ in range(TESTS):
        command = levels(rng, SAMPLES, low=0.3)
        records.append(make_record(100.0 + np.cumsum(0.2 * rng.uniform(size=SAMPLES)), command))
    return Batch.of(records, LIFTING, dead_zone=0.0, sign=1)


def judged(channel, batch):
    tests = np.arange(batch.command.shape[0]) % 2 == 0
    return judge_compensator(channel, [HeldOut(tests, channel), HeldOut(~tests, channel)], batch)


def test_an_untrained_compensator_corrects_all_horizons_of_the_tests(tests):
    channel = handmade.channel(LIFTING, "integrator", compensated=False)
    found = judged(channel, tests)
    assert found.channel.compensator.max_horizon == 100
    assert [fold.channel.compensator.max_horizon for fold in found.held_out] == [100, 100]
    assert found.notices == ()


def test_one_that_is_wrong_from_the_first_sample_is_not_used_and_this_is_said(tests):
    channel = handmade.channel(LIFTING, "integrator", compensated=False)
    wrong = eqx.tree_at(
        lambda c: c.compensator.network.head.bias, channel, jnp.full(1, 100.0, dtype=jnp.float32)
    )
    found = judged(wrong, tests)
    assert found.channel.compensator is None
    assert all(fold.channel.compensator is None for fold in found.held_out)
    (notice,) = found.notices
    assert notice.startswith("compensator for predictions: not used; RMSE of held-out tests 1 sample ahead ")


class Diverging(Channel):
    """Predicts with half the error up to 20 samples ahead, and with five times the error beyond."""

    def predict(self, batch, horizons):
        factors = [1.0 if self.compensator is None else 0.5 if h <= 20 else 5.0 for h in horizons]
        return batch.displacement + jnp.array(factors)[:, None, None]


def test_one_that_diverges_corrects_as_far_as_it_helps_and_this_is_said(tests):
    plain = handmade.channel(LIFTING, "integrator", compensated=True)
    found = judged(Diverging(**{field.name: getattr(plain, field.name) for field in fields(plain)}), tests)
    assert found.channel.compensator.max_horizon == 20
    assert [fold.channel.compensator.max_horizon for fold in found.held_out] == [20, 20]
    assert found.notices == (
        "compensator for predictions: up to 20 samples ahead; RMSE of held-out tests 30 samples ahead 5 with "
        "it, 1 without it",
    )


def test_tests_of_which_none_is_long_enough_leave_no_correction(make_record):
    short = Batch.of([make_record([100.0], [0.5])] * 2, LIFTING, dead_zone=0.0, sign=1)
    found = judged(handmade.channel(LIFTING, "integrator", compensated=True), short)
    assert found.channel.compensator is None
