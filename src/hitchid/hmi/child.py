"""A process of the server, and the messages to and from it; neither side waits for the other."""

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import threading
from collections.abc import Callable, Mapping

from hitchid._support.processes import Outbox, connected_module


class Child:
    """A module that runs in its own process, see `connected_module`, with settings as JSON.

    Each message of the child, and its end, are handed to functions that are called in the event loop.
    """

    def __init__(
        self,
        module: str,
        settings: Mapping[str, object],
        on_message: Callable[[bytes], None],
        on_end: Callable[[], None],
    ) -> None:
        self.process, self._connection = connected_module(module, json.dumps(settings), new_session=True)
        self.outbox = Outbox(self._connection)
        arguments = (asyncio.get_running_loop(), on_message, on_end)
        threading.Thread(target=self._receive, args=arguments, daemon=True).start()

    def send(self, content: Mapping[str, object]) -> None:
        """Send a message as JSON; one to a child that has ended is dropped."""
        self.outbox.put(json.dumps(content).encode())

    def end(self, longest_s: float = 5.0) -> None:
        """Close the connection, after which the child ends by itself, and wait; then kill it."""
        with contextlib.suppress(OSError):
            # A shut-down socket ends the reading thread here and the child there; closing alone does neither.
            socket.socket(fileno=os.dup(self._connection.fileno())).shutdown(socket.SHUT_RDWR)
        try:
            self.process.wait(longest_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):  # it hangs in a driver, or on a frozen disk
                self.process.wait(longest_s)

    def _receive(
        self, loop: asyncio.AbstractEventLoop, on_message: Callable[[bytes], None], on_end: Callable[[], None]
    ) -> None:
        with contextlib.suppress(EOFError, OSError, RuntimeError):  # RuntimeError: the event loop is closed
            while True:
                loop.call_soon_threadsafe(on_message, self._connection.recv_bytes())
        self.outbox.close()  # before others hear of the end: what they still send is dropped
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(on_end)
        self.process.wait()  # the system keeps a process until somebody has waited for it
