"""The linear baselines against plants whose equation is known."""

import jax
import numpy as np
import pytest
from plants import batch_of, context, linear_plant

from hitchid.baselines.linear import ArxBaseline
from hitchid.baselines.output_error import OutputErrorBaseline

PAST, COMMAND = np.array([1.6, -0.63]), np.array([0.02, 0.03])
NOISE_MM = 0.05


@pytest.fixture
def commands():
    rng = np.random.default_rng(0)
    return [np.repeat(rng.uniform(0, 1, 30), 10) for _ in range(8)]


def test_oe_is_found_again_behind_noise_at_the_output(commands):
    rng = np.random.default_rng(1)
    travels = [linear_plant(command, PAST, COMMAND) for command in commands]
    noisy = [travel + NOISE_MM * rng.normal(size=travel.size) for travel in travels]
    tests = batch_of(commands, noisy)
    unseen = np.repeat(rng.uniform(0, 1, 30), 10)
    travel = linear_plant(unseen, PAST, COMMAND)
    batch = batch_of([unseen], [travel])
    free_run = OutputErrorBaseline().fit(tests, context()).free_run(batch)
    # 8 tests of 300 samples give some ten parameters: the noise of a fit is σ √(10 / 2400) = 0.065 σ.
    assert np.sqrt(np.mean((free_run - travel) ** 2)) < 3 * 0.065 * NOISE_MM


def test_the_fit_uses_the_validation_tests_too(commands):
    # Noise decides on the order of both fits alike; without it rounding would.
    rng = np.random.default_rng(2)
    travels = [linear_plant(command, PAST, COMMAND) for command in commands]
    noisy = [travel + NOISE_MM * rng.normal(size=travel.size) for travel in travels]
    louder = [travel * (2.0 if row == 3 else 1.0) for row, travel in enumerate(noisy)]
    batch = batch_of(commands, travels)
    one, other = (
        OutputErrorBaseline().fit(batch_of(commands, rows), context()).free_run(batch)
        for rows in (noisy, louder)
    )
    # Every eighth sample is twice as loud: the gain of least squares rises by about an eighth.
    assert 1.02 < np.sum(one * other) / np.sum(one**2) < 1.3


@pytest.mark.parametrize("baseline", [ArxBaseline(), OutputErrorBaseline()], ids=["arx", "oe"])
def test_the_load_is_heard(baseline, commands):
    loads = np.linspace(-1, 1, len(commands))
    travels = [
        (1 + 0.4 * load) * linear_plant(command, PAST, COMMAND)
        for load, command in zip(loads, commands, strict=True)
    ]
    model = baseline.fit(batch_of(commands, travels, loads=loads), context())
    for load in (-0.5, 0.7):
        expected = (1 + 0.4 * load) * linear_plant(commands[0], PAST, COMMAND)
        batch = batch_of(commands[:1], [expected], loads=[load])
        np.testing.assert_allclose(model.free_run(batch)[0], expected, atol=1e-4)


def test_a_step_of_several_samples_is_interpolated(commands):
    from hitchid.baselines import output_error

    tests = batch_of(commands, [linear_plant(command, [1.0], [0.01]) for command in commands])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(output_error, "MAX_SAMPLES", 150)
        model = OutputErrorBaseline().fit(tests, context())
    assert int(model.samples) == 2
    np.testing.assert_allclose(model.free_run(tests), np.asarray(tests.displacement), atol=0.011)


def test_the_key_is_not_used(commands):
    tests = batch_of(commands, [linear_plant(command, PAST, COMMAND) for command in commands])
    fits = [OutputErrorBaseline().fit(tests, context(seed)) for seed in (0, 1)]
    for one, other in zip(*map(jax.tree.leaves, fits), strict=True):
        np.testing.assert_array_equal(one, other)
