"""Messages to another process, sent by a thread of their own so that the sender never waits."""

import contextlib
import queue
import threading
from multiprocessing.connection import Connection

MOST_WAITING = 200  # messages; later ones are dropped: eight seconds of blocks; chosen


class Outbox:
    """Messages that wait to be sent; those that find it full are dropped.

    Args:
        connection: to the other process.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._waiting: queue.Queue[bytes] = queue.Queue(MOST_WAITING)
        threading.Thread(target=self._send_all, daemon=True).start()

    def put(self, message: bytes) -> None:
        """Send a message as soon as the other process takes it."""
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(message)

    def _send_all(self) -> None:
        with contextlib.suppress(OSError):  # the other process has ended
            while True:
                self._connection.send_bytes(self._waiting.get())
