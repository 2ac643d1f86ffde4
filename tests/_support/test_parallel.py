"""Works on all cores: in their order, in double precision, none lost by another's failure."""

import threading

import jax
import jax.numpy as jnp
import pytest

from hitchid._support.precision import parallel
from hitchid.errors import FitError


def test_results_come_in_order_and_double_precision():
    with jax.enable_x64(False):
        results = parallel(lambda name: (name, jnp.ones(2).dtype), ["b", "a", "c"])
        assert jnp.ones(2).dtype == jnp.float32
    assert list(results) == ["b", "a", "c"]
    assert results["a"] == ("a", jnp.float64)


def test_works_do_not_wait_for_each_other():
    meeting = threading.Barrier(2, timeout=60)
    assert parallel(lambda name: meeting.wait() in (0, 1), ["lifting", "lowering"]) == {
        "lifting": True,
        "lowering": True,
    }


def test_a_failure_is_raised_after_the_others_are_done():
    done = []

    def work(name):
        if name == "lifting":
            raise FitError("nothing moves")
        done.append(name)

    with pytest.raises(FitError, match="nothing moves"):
        parallel(work, ["lifting", "lowering"])
    assert done == ["lowering"]
