"""The baselines against recursions written out by hand."""

import numpy as np
import pytest
from plants import linear_plant

from hitchid.baselines.linear import Arx, LinearInputs, UnpaddedTest, predict_ahead
from hitchid.baselines.narx import Narx

PAST, COMMAND = np.array([1.5, -0.3, -0.25]), np.array([0.2, -0.1, 0.4])
SAMPLES = 120
SCALING = LinearInputs(*map(np.asarray, ([0.0], [1.0], 0.0, 1.0)))


@pytest.fixture
def tests():
    rng = np.random.default_rng(0)
    commands = [rng.normal(size=size) for size in (SAMPLES, SAMPLES // 2)]
    return [
        UnpaddedTest(command[None], linear_plant(command, PAST, COMMAND), np.ones(command.size, dtype=bool))
        for command in commands
    ]


def test_arx_is_found_again_from_samples_that_count(tests):
    spoilt = []
    for inputs, travel, counted in tests:
        late = np.arange(travel.size) >= 40
        spoilt.append(UnpaddedTest(inputs, np.where(late, 1e3, travel), counted & ~late))
    for model in (Arx.fit(SCALING, tests, 3), Arx.fit(SCALING, spoilt, 3)):
        np.testing.assert_allclose(model.past, PAST, rtol=1e-10)
        np.testing.assert_allclose(model.gains[0], COMMAND, rtol=1e-10)


@pytest.mark.parametrize("order", [1, 3])
def test_free_run_of_arx_is_the_recursion(tests, order):
    model = Arx(SCALING, PAST[:order] / 2, COMMAND[None, :order])
    command = tests[0].inputs[0]
    expected = linear_plant(command, PAST[:order] / 2, COMMAND[:order])
    # A stable recursion adds at most six rounded products a step.
    np.testing.assert_allclose(model.simulate(command[None]), expected, atol=1e-13)


AUTOREGRESSIONS = {
    "arx": Arx(SCALING, PAST, np.stack([COMMAND, -COMMAND])),
    "narx": Narx(
        SCALING,
        np.array([[1, 0], [2, 0], [-1, 0], [-2, -2], [-2, 1], [1001, -1]]),
        np.array([1.2, -0.3, 0.5, 0.1, -0.05, 0.1]),
        np.array(2.0),
        np.array(0.5),
    ),
}

every_autoregression = pytest.mark.parametrize("model", AUTOREGRESSIONS.values(), ids=AUTOREGRESSIONS.keys())


@pytest.fixture
def measured():
    """Return inputs, shape [m, N], and a travel that no model gives, from rest, shape [N]."""
    rng = np.random.default_rng(4)
    command = np.concatenate([np.zeros(4), rng.uniform(-1.0, 1.0, SAMPLES - 4)])
    travel = np.concatenate([np.zeros(4), np.cumsum(0.1 * rng.normal(size=SAMPLES - 4))])
    return np.stack([command, 0.5 * np.ones(SAMPLES), 0.3 * np.ones(SAMPLES)]), travel


def inputs_of(model, inputs):
    """Return as many inputs as a model has."""
    return inputs[: len(model.gains)] if isinstance(model, Arx) else inputs


@every_autoregression
def test_from_the_first_sample_any_horizon_is_the_free_run(model, measured):
    inputs, travel = inputs_of(model, measured[0]), measured[1]
    horizons = [1, 5, 30, SAMPLES - 1]
    rows = predict_ahead(model, inputs, np.zeros_like(travel), horizons)
    free = model.simulate(inputs)
    for horizon, row in zip(horizons, rows, strict=True):
        np.testing.assert_array_equal(row[:horizon], 0.0)
        assert row[horizon] == pytest.approx(free[horizon], abs=1e-12)
    assert abs(free[30]) > 0.01


@every_autoregression
def test_predictions_are_the_recursion_from_what_was_measured(model, measured):
    inputs, travel = inputs_of(model, measured[0]), measured[1]
    rows = predict_ahead(model, inputs, travel, [2, 7])
    for horizon, row in zip((2, 7), rows, strict=True):
        for k in (10, 60, SAMPLES - 1):
            known = list(travel[: k - horizon + 1])
            for _ in range(horizon):
                last = slice(len(known) - model.lag, len(known))
                columns = inputs[:, last][:, ::-1, None], np.array(known)[last][::-1, None]
                known.append(float(model.predict_next(*columns)[0]))
            assert len(known) == k + 1
            assert row[k] == pytest.approx(known[-1], abs=1e-13)
    # What was measured later than that does not count.
    later = np.where(np.arange(SAMPLES) > 60 - 7, 99.0, travel)
    assert predict_ahead(model, inputs, later, [7])[0, 60] == rows[1, 60]
    assert predict_ahead(model, inputs, later, [2])[0, 60] != rows[0, 60]
