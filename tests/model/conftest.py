"""What the tests of models share: whether something is compiled."""

from contextlib import contextmanager

import jax.monitoring
import pytest


@pytest.fixture
def compilations():
    """Return a context that gives the names of what JAX traces and compiles in it."""

    @contextmanager
    def listen():
        names = []
        jax.monitoring.register_event_duration_secs_listener(
            lambda name, *_, **__: names.append(name) if "compile" in name or "trace" in name else None
        )
        try:
            yield names
        finally:
            jax.monitoring.clear_event_listeners()

    return listen
