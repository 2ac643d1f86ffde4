"""Memory of a worker: programs are dropped above a limit, and what was freed goes back to the system."""

import sys

import jax
import numpy as np
import pytest

from hitchid.fleet import task

ARRAYS, VALUES = 1000, 8000  # of 64 kB each: below what the C library takes from the system one by one
BYTES = 8 * ARRAYS * VALUES


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a process is read from /proc")
def test_memory_that_was_freed_goes_back_to_the_system(monkeypatch):
    dropped = []
    monkeypatch.setattr(jax, "clear_caches", lambda: dropped.append(True))
    monkeypatch.setattr(task, "PROGRAMS_DROPPED_ABOVE", 0)
    arrays = [np.ones(VALUES) for _ in range(ARRAYS)]
    last = np.ones(VALUES)  # keeps the C library from giving back what lies before it by itself
    full = task.resident_bytes()
    del arrays
    task.bound_memory()
    assert dropped == [True]
    assert full - task.resident_bytes() > BYTES / 2
    assert last.sum() == VALUES


def test_below_the_limit_programs_stay(monkeypatch):
    monkeypatch.setattr(jax, "clear_caches", lambda: pytest.fail("programs were dropped"))
    monkeypatch.setattr(task, "PROGRAMS_DROPPED_ABOVE", 1 << 60)
    task.bound_memory()
