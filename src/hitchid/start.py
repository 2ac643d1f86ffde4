"""Where the program starts: Ctrl-C is heeded from the first moment, before anything large is imported."""

import gc
import os
import signal
import socket
import sys
import threading
import time
from types import FrameType
from typing import NoReturn

PATIENCE_S = 0.5
STOPPED = 128 + signal.SIGINT
OBJECTS = 100_000
UNHEARD = 120  # as Python ends where the last words cannot be said


class Stopped(BaseException):
    """Somebody pressed Ctrl-C; no library on the way takes it for its own."""


def main() -> None:
    """Run the command line; exit code 130 where Ctrl-C ended it, for the others see `hitchid.cli`."""
    _heed_interrupts()
    # Both directions are worked on at once: further threads of NumPy would wait, busily, on cores in use.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Libraries hold hundreds of thousands of objects to the end: looking through them for garbage every few
    # hundred new ones takes a tenth of the time.
    gc.set_threshold(OBJECTS)
    try:
        from hitchid.cli import main as run

        run()
    except Stopped:
        _end()
    except SystemExit as ended:
        _leave(ended.code)


def _heed_interrupts() -> None:
    """Have Ctrl-C end the program within a second, even in the middle of a compiled computation.

    Python hears a signal between two of its own steps only, and a computation may take many seconds. The
    system writes a byte for each signal at once; who reads it waits until the program should have ended.
    """
    heard, told = socket.socketpair()
    told.setblocking(False)
    signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)

    def stop(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one must not come between the clearing up
        raise Stopped

    def watch() -> None:
        while heard.recv(1) != bytes([signal.SIGINT]):
            pass
        time.sleep(PATIENCE_S)
        told.close()
        _end()

    signal.signal(signal.SIGINT, stop)
    threading.Thread(target=watch, daemon=True).start()


def _leave(code: object) -> NoReturn:
    """End without the goodbyes of libraries, which take a second: whatever was to be written is written."""
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:
        os._exit(UNHEARD)
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


def _end() -> NoReturn:
    """End at once: what was being written has been cleared up, and libraries take seconds to say goodbye."""
    further = "; the same command with --resume goes on" if sys.argv[1:2] == ["identify"] else ""
    os.write(2, f"hitchid: stopped{further}\n".encode())
    os._exit(STOPPED)
