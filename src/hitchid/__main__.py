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

GRACE_PERIOD_S = 0.5
EXIT_INTERRUPTED = 128 + signal.SIGINT
GC_THRESHOLD = 100_000
EXIT_FAILURE = 1
ASCII_REPLACEMENTS = {
    "…": "...",
    "→": "->",
    "±": "+/-",
    "·": "*",
    "−": "-",  # noqa: RUF001
    "≥": ">=",
    "≤": "<=",
    "²": "^2",
    "³": "^3",
}


class Interrupted(BaseException):
    """Somebody pressed Ctrl-C; no library on the way takes it for its own."""


def main() -> None:
    """Run the command line; exit code 130 where Ctrl-C ended it, for the others see `hitchid.cli`."""
    _handle_interrupts()
    _replace_unencodable()
    # Both directions are worked on at once: further threads of NumPy would wait, busily, on cores in use.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Libraries hold hundreds of thousands of objects to the end: looking through them for garbage every few
    # hundred new ones takes a tenth of the time.
    gc.set_threshold(GC_THRESHOLD)
    try:
        from hitchid.cli import main as run

        run()
    except Interrupted:
        _exit_interrupted()
    except SystemExit as exit_request:
        _exit(exit_request.code)


def _handle_interrupts() -> None:
    """Have Ctrl-C end the program within a second, even in the middle of a compiled computation.

    Python hears a signal between two of its own steps only, and a computation may take many seconds. The
    system writes a byte for each signal at once; who reads it waits until the program should have ended.
    """
    read_socket, write_socket = socket.socketpair()
    write_socket.setblocking(False)
    signal.set_wakeup_fd(write_socket.fileno(), warn_on_full_buffer=False)

    def stop(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one must not come between the clearing up
        raise Interrupted

    def watch() -> None:
        while read_socket.recv(1) != bytes([signal.SIGINT]):
            pass
        time.sleep(GRACE_PERIOD_S)
        write_socket.close()
        _exit_interrupted()

    signal.signal(signal.SIGINT, stop)
    threading.Thread(target=watch, daemon=True).start()


def _replace_unencodable() -> None:
    """Have characters that the encoding of an output lacks written in plain ones; no output, no words."""
    codecs.register_error("plain", _encode_plain)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - to the end
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="plain")


def _encode_plain(error: UnicodeError) -> tuple[str, int]:
    """Return what stands for characters that cannot be encoded, and where to go on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    unencodable = error.object[error.start : error.end]
    return "".join(ASCII_REPLACEMENTS.get(character, "?") for character in unencodable), error.end


def _exit(code: object) -> NoReturn:
    """End without the goodbyes of libraries, which take a second: whatever was to be written is written."""
    status = code if isinstance(code, int) else 0 if code is None else EXIT_FAILURE
    try:
        sys.stdout.flush()
    except OSError as error:
        if status == 0:
            os.write(2, f"hitchid: standard output: cannot be written: {error.strerror}\n".encode())
        os._exit(status or EXIT_FAILURE)
    try:
        sys.stderr.flush()
    except OSError:
        os._exit(status or EXIT_FAILURE)
    os._exit(status)


def _exit_interrupted() -> NoReturn:
    """End at once: what was being written has been cleared up, and libraries take seconds to say goodbye."""
    hint = "; the same command with --resume goes on" if sys.argv[1:2] == ["identify"] else ""
    os.write(2, f"hitchid: stopped{hint}\n".encode())
    os._exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
