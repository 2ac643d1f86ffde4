"""A campaign in which nothing is wrong, for tests that plant one flaw."""

import numpy as np
import pytest
from flawed import changed, make_test

from hitchid.logs.record import DIRECTIONS


@pytest.fixture(scope="session")
def clean():
    """Return the records of a campaign in which nothing is wrong: six tests and two ramps a mode."""
    ramp = np.linspace(0, 0.6, 2000)
    return [
        *(make_test(f"{mode}-{number}", mode) for mode in DIRECTIONS for number in range(1, 7)),
        *(make_test(f"ramp-{mode}-{number}", mode, command=ramp) for mode in DIRECTIONS for number in (1, 2)),
    ]


@pytest.fixture
def planted(clean):
    """Return a function that gives the clean campaign with another displacement in its first test."""
    return lambda displacement: [changed(clean[0], displacement), *clean[1:]]
