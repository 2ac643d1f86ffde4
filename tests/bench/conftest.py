"""Benches and commands that the tests of the rig share."""

import numpy as np
import pytest

from hitchid.bench import load_rig, parameter_sets


@pytest.fixture(scope="session", params=parameter_sets())
def any_rig(request):
    """Return each of the benches that come with the package."""
    return load_rig(request.param)


@pytest.fixture(scope="session")
def rig():
    """Return the nominal bench."""
    return load_rig("nominal")


@pytest.fixture
def held():
    """Return a function that makes currents, shape [4, 1001, 2], from lifting and lowering levels."""

    def make(lifting, lowering) -> np.ndarray:
        levels = np.stack([np.resize(np.asarray(level, float), 4) for level in (lifting, lowering)], axis=-1)
        currents = np.repeat(levels[:, None, :], 1001, axis=1)
        currents[:, :20] = 0.0
        return currents

    return make


@pytest.fixture
def binary():
    """Return a function that makes random binary currents of shape [4, 1001, 2], odd tests lowering."""

    def make(seed: int = 0) -> np.ndarray:
        rng, tests, samples = np.random.default_rng(seed), 4, 1001
        currents = np.zeros((tests, samples, 2))
        for test in range(tests):
            levels = np.repeat(rng.choice([0.4, 0.62], samples // 20), rng.integers(20, 100, samples // 20))
            currents[test, 20:, test % 2] = levels[: samples - 20]
        return currents

    return make
