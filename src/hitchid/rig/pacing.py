"""Pacing of the stepping bench by the wall clock, for a controller that runs beside it in real time."""

import time
from collections.abc import Callable, Iterator
from itertools import count

from hitchid.rig.simulation import SAMPLE_S


def real_time(
    *, clock: Callable[[], float] = time.perf_counter, sleep: Callable[[float], object] = time.sleep
) -> Iterator[float]:
    """Yield at the start of every sample of 10 ms how late it is, s; without end.

    Sample k begins at t₀ + k h of the clock, t₀ being the first one's: a sample that is late does not delay
    those that follow, and none is left out.

    Args:
        clock: monotonic time, s.
        sleep: waits for a time, s.
    """
    start = clock()
    for sample in count():
        early = start + sample * SAMPLE_S - clock()
        if early > 0:
            sleep(early)
        yield max(clock() - start - sample * SAMPLE_S, 0.0)
