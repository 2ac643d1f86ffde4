"""Where the program starts: Ctrl-C is heeded from the first moment, before anything large is imported."""

import codecs
import gc
import os
import signal
import socket
import sys
import threading
import time
from io import TextIOWrapper
from types import FrameType
from typing import NoReturn

PATIENCE_S = 0.5
STOPPED = 128 + signal.SIGINT
OBJECTS = 100_000
FAILED = 1
PLAIN = {"…": "...", "→": "->", "±": "+/-", "·": "*", "−": "-", "≥": ">=", "≤": "<=", "²": "^2", "³": "^3"}  # noqa: RUF001


class Stopped(BaseException):
    """Somebody pressed Ctrl-C; no library on the way takes it for its own."""


def main() -> None:
    """Run the command line; exit code 130 where Ctrl-C ended it, for the others see `hitchid.cli`."""
    _heed_interrupts()
    _write_what_can_be_written()
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


def _write_what_can_be_written() -> None:
    """Have characters that the encoding of an output lacks written in plain ones; no output, no words."""
    codecs.register_error("plain", _plain)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - to the end
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="plain")


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Return what stands for characters that cannot be encoded, and where to go on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(PLAIN.get(character, "?") for character in lacking), error.end


def _leave(code: object) -> NoReturn:
    """End without the goodbyes of libraries, which take a second: whatever was to be written is written."""
    status = code if isinstance(code, int) else 0 if code is None else FAILED
    try:
        sys.stdout.flush()
    except OSError as error:
        if status == 0:
            os.write(2, f"hitchid: standard output: cannot be written: {error.strerror}\n".encode())
        os._exit(status or FAILED)
    try:
        sys.stderr.flush()
    except OSError:
        os._exit(status or FAILED)
    os._exit(status)


def _end() -> NoReturn:
    """End at once: what was being written has been cleared up, and libraries take seconds to say goodbye."""
    further = "; the same command with --resume goes on" if sys.argv[1:2] == ["identify"] else ""
    os.write(2, f"hitchid: stopped{further}\n".encode())
    os._exit(STOPPED)


if __name__ == "__main__":
    main()
