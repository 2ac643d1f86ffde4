"""Messages to another process, sent by a thread of their own so that the sender never waits."""

import contextlib
import queue
import threading
from multiprocessing.connection import Connection

MOST_BLOCKS = 200  # messages that wait before blocks of samples are dropped: eight seconds of them; chosen
MOST_WAITING = 2000  # messages before any are dropped: a process that has not read for minutes; chosen


class Outbox:
    """Messages that wait to be sent, in their order.

    Args:
        connection: to the other process.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._waiting: queue.Queue[bytes | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._send_all, daemon=True)
        self._thread.start()

    def put(self, message: bytes, *, is_block: bool = False) -> None:
        """Send a message as soon as the other process takes it; blocks of samples are dropped first."""
        if is_block and self._waiting.qsize() > MOST_BLOCKS:
            return
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(message)

    def close(self, longest_s: float = 0.0) -> None:
        """End the thread and close the connection, after what waits or when the other process is gone.

        Args:
            longest_s: to wait for that, s.
        """
        with contextlib.suppress(queue.Full):  # then the thread is sending, and fails
            self._waiting.put_nowait(None)
        self._thread.join(longest_s)

    def _send_all(self) -> None:
        with contextlib.suppress(OSError):  # the other process has ended
            while (message := self._waiting.get()) is not None:
                self._connection.send_bytes(message)
        with contextlib.suppress(OSError):
            self._connection.close()
