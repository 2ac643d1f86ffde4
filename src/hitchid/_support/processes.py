"""Processes of this package: how one is started, and messages that its sender never waits for."""

import contextlib
import os
import queue
import socket
import subprocess
import sys
import threading
from multiprocessing.connection import Connection


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module in another Python; what lies in its folder is no module there."""
    return [sys.executable, "-P", "-m", module, *arguments]


def module_environment() -> dict[str, str]:
    """Return the environment in which another Python finds the modules that this one finds."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def connected_module(
    module: str, *arguments: str, new_session: bool = False
) -> tuple[subprocess.Popen[bytes], Connection]:
    """Return a process that runs a module's `main`, and the connection to it.

    Args:
        module: its `main` is given the file descriptor of its end of the connection, and the arguments.
        arguments: further ones.
        new_session: whether a closed terminal or Ctrl-Z must not take it along.
    """
    # Not by `-m`: a package that imports the module would have it run a second time, of which Python warns.
    program = f"import sys; from {module} import main; main(sys.argv[1:])"
    own, other = socket.socketpair()
    # Closed here: otherwise the connection would not end with the process.
    with other:
        process = subprocess.Popen(  # noqa: S603 - this Python, a module of this package
            [sys.executable, "-P", "-c", program, str(other.fileno()), *arguments],
            pass_fds=(other.fileno(),),
            start_new_session=new_session,
            env=module_environment(),
        )
    return process, Connection(own.detach())


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
