"""The program: where it starts, what its exit codes mean."""

import shlex
import sys

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


def main() -> None:
    """Run the command line; exit 0 for success, 2 for wrong use or bad input, 1 for a run that failed.

    What is read and written for a user raises its own errors; any other OSError is an output that failed.
    """
    try:
        app()
    except InputError as error:
        sys.stderr.write(f"hitchid: {error}\n")
        sys.exit(2)
    except HitchError as error:
        sys.stderr.write(f"hitchid: {error}\n")
        sys.exit(1)
    except OSError as error:
        what = error.filename or "standard output: cannot be written"
        sys.stderr.write(f"hitchid: {what}: {error.strerror or error}\n")
        sys.exit(1)


def command_line() -> str:
    """Return the command as it was given, for who wants to give it again."""
    return shlex.join(["hitchid", *sys.argv[1:]])
