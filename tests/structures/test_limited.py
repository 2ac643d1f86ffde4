"""Limits whose derivative is that of the value they return."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.structures.limited import limited

# XLA takes subnormal numbers for zero.
NUMBERS = st.floats(-1e3, 1e3, allow_subnormal=False)
INSIDE, BELOW, ABOVE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@given(value=NUMBERS, bounds=st.tuples(NUMBERS, NUMBERS).map(sorted))
def test_it_returns_what_clip_does(value, bounds):
    assert float(limited(jnp.asarray(value), *bounds)) == np.clip(value, *bounds)


@pytest.mark.parametrize(
    ("value", "gradient"), [(0.5, INSIDE), (-2.0, BELOW), (3.0, ABOVE), (0.0, INSIDE), (1.0, INSIDE)]
)
def test_its_derivative_is_that_of_the_value_it_returns(value, gradient):
    arguments = jnp.asarray(value), jnp.asarray(0.0), jnp.asarray(1.0)
    assert jax.grad(limited, argnums=(0, 1, 2))(*arguments) == gradient


def test_one_bound_alone_has_a_finite_derivative():
    values = jnp.array([-1.0, 2.0])
    for bounds, expected in (({"lowest": 0.0}, [0.0, 1.0]), ({"highest": 0.0}, [1.0, 0.0])):
        gradient = jax.grad(lambda at, bounds=bounds: jnp.sum(limited(at, **bounds)))(values)
        np.testing.assert_array_equal(gradient, expected)


@pytest.mark.parametrize("number", range(3))
def test_what_is_not_a_number_stays_so(number):
    arguments = [jnp.nan if at == number else jnp.asarray(value) for at, value in enumerate((0.5, 0.0, 1.0))]
    assert jnp.isnan(limited(*arguments))
