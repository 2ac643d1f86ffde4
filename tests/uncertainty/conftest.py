"""Tests that start at 80 mm, side by side."""

import pytest

from hitchid.logs.record import LIFTING
from hitchid.structures import Batch


@pytest.fixture(scope="session")
def batch_of(make_record):
    """Return a function that lays pairs of command and travel side by side."""

    def make(tests, *, dead_zone=0.0, start=80.0):
        records = [make_record(80.0 + travel, command) for command, travel in tests]
        initial = None if start is None else [start] * len(records)
        return Batch.of(records, LIFTING, dead_zone=dead_zone, sign=1, initial=initial)

    return make
