"""The disk as the bench loop sees it: a thread writes, so that nothing in a tick waits for a file."""

import threading
import time
from collections import deque
from collections.abc import Callable

from hitchid.errors import OutputError

# s that a write may wait. Chosen: a disk that is merely busy takes some kilobytes sooner, and what waits in
# memory stays small; beyond it, a run would go on without its log.
LONGEST_WAIT_S = 1.0


class Disk:
    """Writes that were handed over, carried out in their order by a thread of its own."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[float, Callable[[], None]]] = deque()
        self._handed_over = threading.Semaphore(0)
        self._errors: deque[OutputError] = deque()
        # A process that ends does not wait for a frozen disk: a daemon.
        threading.Thread(target=self._carry_out, daemon=True).start()

    def put(self, write: Callable[[], None]) -> None:
        """Hand over a write, which may raise `OutputError`; returns at once."""
        self._waiting.append((time.monotonic(), write))
        self._handed_over.release()

    def check(self) -> None:
        """Check that what was handed over is written.

        Raises:
            OutputError: a write has failed, or waits for longer than `LONGEST_WAIT_S`; each failure once.
        """
        if self._errors:  # before what waits: an error says more
            raise self._errors.popleft()
        try:
            waits_s = time.monotonic() - self._waiting[0][0]
        except IndexError:
            return
        if waits_s > LONGEST_WAIT_S:
            raise OutputError(f"the disk has taken nothing for {waits_s:.2g} s; look at the project's disk")

    def finish(self) -> bool:
        """Wait for what was handed over, `LONGEST_WAIT_S` at most; return whether all was carried out."""
        finished = threading.Event()
        self.put(finished.set)  # in its turn, behind all that was handed over
        return finished.wait(LONGEST_WAIT_S)

    def _carry_out(self) -> None:
        while True:
            self._handed_over.acquire()
            try:
                self._waiting[0][1]()
            except OutputError as error:
                self._errors.append(error)
            self._waiting.popleft()  # only now: what is being written still waits
