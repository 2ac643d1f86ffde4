"""A compensator corrects only so far ahead that predictions of held-out tests do not diverge."""

from dataclasses import fields

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import handmade
from hitchid.identification.held_out import HeldOut, held_out_errors
from hitchid.identification.held_out_training import diverging, judge_compensator
from hitchid.logs.record import LIFTING
from hitchid.model import Channel
from hitchid.structures import Batch
from hitchid.uncertainty.conformal import HeldOutErrors
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
        ((0.5, 0.5, 0.5, 0.5), None),
        ((1.0, 1.2, 1.5, 2.0), None),  # worse, as one trained on fewer tests may be, but not diverging
        ((0.5, 0.5, 2.1, 0.5), 5),
        ((0.5, 0.5, 0.5, np.inf), 10),
        ((0.5, np.nan, 0.5, 0.5), 2),
        ((), None),
    ],
)
def test_errors_more_than_twice_those_without_correction_diverge(corrected, expected):
    assert diverging(errors(*corrected), errors(1.0, 1.0, 1.0, 1.0)) == expected


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
    outcome = judged(channel, tests)
    assert outcome.channel.compensator.max_horizon == 100
    assert [fold.channel.compensator.max_horizon for fold in outcome.held_out] == [100, 100]
    assert outcome.notices == ()


def test_a_compensator_wrong_from_the_start_is_not_used(tests):
    channel = handmade.channel(LIFTING, "integrator", compensated=False)
    wrong = eqx.tree_at(
        lambda c: c.compensator.network.head.bias, channel, jnp.full(1, 100.0, dtype=jnp.float32)
    )
    outcome = judged(wrong, tests)
    assert outcome.channel.compensator is None
    assert all(fold.channel.compensator is None for fold in outcome.held_out)
    (notice,) = outcome.notices
    words = "the compensator for predictions is not used; else the RMSE of held-out tests 1 sample ahead is "
    assert notice.startswith(words)


class Diverging(Channel):
    """Predicts with half the error, and five times the error where more than 20 samples are corrected."""

    def predict(self, batch, horizons, every=1):
        corrected = 0 if self.compensator is None else self.compensator.max_horizon
        factors = [1.0 if corrected == 0 else 0.5 if min(h, corrected) <= 20 else 5.0 for h in horizons]
        return batch.displacement + jnp.array(factors)[:, None, None]


def test_a_compensator_corrects_as_far_as_it_does_not_diverge(tests):
    plain = handmade.channel(LIFTING, "integrator", compensated=True)
    outcome = judged(Diverging(**{field.name: getattr(plain, field.name) for field in fields(plain)}), tests)
    assert outcome.channel.compensator.max_horizon == 20
    assert [fold.channel.compensator.max_horizon for fold in outcome.held_out] == [20, 20]
    assert outcome.notices == (
        "the compensator for predictions corrects up to 20 samples ahead; else the RMSE of held-out tests 30 "
        "samples ahead is 5, and 1 without it",
    )


def test_tests_too_short_to_judge_leave_it_as_it_is(make_record):
    short = Batch.of([make_record([100.0], [0.5])] * 2, LIFTING, dead_zone=0.0, sign=1)
    outcome = judged(handmade.channel(LIFTING, "integrator", compensated=True), short)
    assert outcome.channel.compensator.max_horizon == 100
    assert outcome.errors == {}


def test_the_errors_are_those_of_the_channels_that_are_returned(tests):
    outcome = judged(handmade.channel(LIFTING, "integrator", compensated=True), tests)
    again = held_out_errors(outcome.held_out, tests, outcome.errors)
    assert again.keys() == outcome.errors.keys()
    for horizon, row in again.items():
        np.testing.assert_array_equal(
            np.concatenate(row.errors), np.concatenate(outcome.errors[horizon].errors)
        )
