"""The program: where it starts, what its exit codes mean."""

import os
import shlex
import signal
import socket
import sys
import threading
import time
from types import FrameType

import typer

from hitchid.errors import HitchError, InputError

app = typer.Typer(
    name="hitchid",
    help="Grey-box models of lifting and lowering hydraulics, identified from bench logs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


PATIENCE_S = 0.6
STOPPED = 128 + signal.SIGINT


class Stopped(BaseException):
    """Somebody pressed Ctrl-C; no library on the way takes it for its own."""


def main() -> None:
    """Run the command line.

    Exit code 0 for success, 2 for wrong use or bad input, 1 for a run that failed, 130 for one that was
    stopped.
    """
    _heed_interrupts()
    try:
        app()
    except Stopped:
        sys.stderr.write(_farewell())
        sys.exit(STOPPED)
    except InputError as error:
        sys.stderr.write(f"hitchid: {error}\n")
        sys.exit(2)
    except HitchError as error:
        sys.stderr.write(f"hitchid: {error}\n")
        sys.exit(1)


def command_line() -> str:
    """Return the command as it was given, for who wants to give it again."""
    return shlex.join(["hitchid", *sys.argv[1:]])


def _heed_interrupts() -> None:
    """Have Ctrl-C end the program within a second, even in the middle of a compiled computation.

    Python hears a signal between two of its own steps only, and a computation may take many seconds. The
    system writes a byte for each signal at once; who reads it waits until the program should have ended.
    """
    heard, told = socket.socketpair()
    told.setblocking(False)
    signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)

    def stop(number: int, frame: FrameType | None) -> None:
        raise Stopped

    def watch() -> None:
        while heard.recv(1) != bytes([signal.SIGINT]):
            pass
        time.sleep(PATIENCE_S)
        told.close()
        os.write(sys.stderr.fileno(), _farewell().encode())
        os._exit(STOPPED)

    signal.signal(signal.SIGINT, stop)
    threading.Thread(target=watch, daemon=True).start()


def _farewell() -> str:
    further = "; the same command with --resume goes on" if sys.argv[1:2] == ["identify"] else ""
    return f"hitchid: stopped{further}\n"
