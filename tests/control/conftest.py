"""Hand-made controllers that the tests of control share."""

from dataclasses import replace

import jax.numpy as jnp
import pytest

from controllers import made_up_controller, made_up_model


@pytest.fixture(scope="session", params=[False, True], ids=["linear", "shaped"])
def model(request):
    """Return a hand-made hitch, without and with curves and covariates."""
    return made_up_model(shape=request.param)


@pytest.fixture(scope="session")
def controller(model):
    """Return a controller of the hand-made hitch."""
    return made_up_controller(model)


@pytest.fixture(scope="session")
def linear_controller():
    """Return a controller of the hand-made hitch without curves."""
    return made_up_controller(made_up_model(shape=False))


@pytest.fixture(scope="session")
def brisk(linear_controller):
    """Return a controller that opens the valves of the nominal bench."""
    return replace(linear_controller, rate=jnp.asarray(80.0))
