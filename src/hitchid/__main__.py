"""Entry of the program: Ctrl-C is handled before anything large is imported."""

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

GRACE_PERIOD_S = 0.5  # from Ctrl-C to the end of a compiled computation that cannot be interrupted
EXIT_INTERRUPTED = 128 + signal.SIGINT  # as shells report it
EXIT_FAILURE = 1  # see `hitchid.cli.program`
GC_THRESHOLD = 100_000  # new objects between collections; the default of 700 takes a tenth of a run
ASCII_REPLACEMENTS = {
    "…": "...",
    "─": "-",  # a rule below the header of a table
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
    """Ctrl-C was pressed. Not a KeyboardInterrupt, which libraries catch."""


def main() -> None:
    """Run the command line; exit code 130 where Ctrl-C ended it, for the others see `hitchid.cli`."""
    _handle_interrupts()
    _replace_unencodable()
    # Both directions are identified in parallel: further threads of NumPy would compete for the same cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(GC_THRESHOLD)
    try:
        try:
            from hitchid.cli import main as run
        except ModuleNotFoundError as error:
            if (error.name or "hitchid").partition(".")[0] == "hitchid":
                raise
            sys.stderr.write(
                f"hitchid: the package {error.name} is missing; run: pip install --upgrade hitchid\n"
            )
            sys.exit(EXIT_FAILURE)
        run()
    except Interrupted:
        _exit_interrupted()
    except SystemExit as exit_request:
        if not _flush_outputs():
            exit_request.code = exit_request.code or EXIT_FAILURE
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        # Measured: the last collection over the objects of JAX takes 0.8 s, all else at the end 0.2 s.
        gc.freeze()
        gc.disable()
        raise


def _handle_interrupts() -> None:
    """Let Ctrl-C end the program within a second, even during a compiled computation.

    Python runs signal handlers between two bytecodes only, and a compiled computation may take many seconds.
    The wakeup descriptor gets a byte at once; a thread that reads it ends the program after a grace period.
    """
    read_socket, write_socket = socket.socketpair()
    write_socket.setblocking(False)
    signal.set_wakeup_fd(write_socket.fileno(), warn_on_full_buffer=False)

    def stop(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not interrupt the clean-up
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
    """Replace characters that the encoding of an output lacks; discard what goes to a missing output."""
    codecs.register_error("plain", _encode_plain)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - open until the end
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="plain")


def _encode_plain(error: UnicodeError) -> tuple[str, int]:
    """Return the replacement of characters that cannot be encoded, and the position after them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    unencodable = error.object[error.start : error.end]
    return "".join(ASCII_REPLACEMENTS.get(character, "?") for character in unencodable), error.end


def _flush_outputs() -> bool:
    """Flush both outputs; return whether all was written. One that fails is closed with a message."""
    written = True
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            written = False
            # The interpreter flushes once more.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            if stream is sys.stdout:
                sys.stderr.write(f"hitchid: standard output: cannot be written: {error.strerror}\n")
    return written


def _exit_interrupted() -> NoReturn:
    """End at once, without waiting for computations in other threads; unfinished files have been removed."""
    hint = "; --resume continues this run" if sys.argv[1:2] == ["identify"] else ""
    os.write(2, f"hitchid: stopped{hint}\n".encode())
    os._exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
