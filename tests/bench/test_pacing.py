"""Pacing by the wall clock: every sample begins at its time, and a late one does not delay the others."""

from itertools import islice

import pytest

from hitchid.bench import real_time


class Watch:
    """A clock that is set by sleeping and by work, and that sleeps a little too long."""

    def __init__(self):
        self.now, self.slept = 50.0, []

    def __call__(self):
        return self.now

    def sleep(self, duration_s):
        assert duration_s > 0
        self.slept.append(duration_s)
        self.now += duration_s + 1e-4


def paced(work_s):
    """Return when each sample begins since the first one, and how late it says to be."""
    watch, begun, late = Watch(), [], []
    for work, lateness in zip([*work_s, 0.0], real_time(clock=watch, sleep=watch.sleep), strict=False):
        begun.append(watch.now - 50.0)
        late.append(lateness)
        watch.now += work
    return begun, late


def test_errors_of_the_sleep_do_not_add_up() -> None:
    begun, _ = paced([0.002] * 200)
    assert begun == pytest.approx([0.0, *(0.01 * k + 1e-4 for k in range(1, 201))], abs=1e-9)


def test_samples_after_a_late_one_catch_up() -> None:
    begun, late = paced([0.002, 0.025, 0.002, 0.002])
    assert begun == pytest.approx([0.0, 0.0101, 0.0351, 0.0371, 0.0401], abs=1e-9)
    assert late == pytest.approx([0.0, 1e-4, 0.0151, 0.0071, 1e-4], abs=1e-9)


def test_the_machines_own_clock_is_the_default() -> None:
    late = list(islice(real_time(), 5))
    assert all(0 <= lateness < 1 for lateness in late)
