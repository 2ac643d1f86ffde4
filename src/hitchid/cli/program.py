"""Entry point of the program, and its exit codes."""

import shlex
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

import hitchid
from hitchid._support.inert import printable
from hitchid._support.jax_setup import cache_folder
from hitchid.errors import HitchError, InputError

if TYPE_CHECKING:
    from hitchid.estimation import SearchComparison


def with_search_cache(comparison: "SearchComparison | None") -> "SearchComparison | None":
    """Return a comparison that caches finished searches for the user, to resume a stopped run."""
    from hitchid._support.checkpoints import Checkpoints

    return comparison and replace(comparison, checkpoints=Checkpoints(cache_folder() / "searches"))


app = typer.Typer(
    name="hitchid",
    help="Grey-box models of lifting and lowering hydraulics, identified from bench logs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _print_version(requested: bool) -> bool:
    if requested:
        typer.echo(f"hitchid {hitchid.__version__}")
        raise typer.Exit
    return requested


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Options of the program itself."""


def main() -> None:
    """Run the command line; exit code 0 for success, 2 for wrong use or bad input, 1 for a failed run.

    Readers and writers raise errors of this package; any other `OSError` is a failed output.
    """
    try:
        app(prog_name="hitchid")
    except InputError as error:
        sys.stderr.write(f"hitchid: {error}\n")
        sys.exit(2)
    except HitchError as error:
        sys.stderr.write(f"hitchid: {error}\n")
        sys.exit(1)
    except OSError as error:
        what = error.filename or "standard output: cannot be written"
        sys.stderr.write(printable(f"hitchid: {what}: {error.strerror or error}\n"))
        sys.exit(1)


def command_line() -> str:
    """Return the command line of this run, as a shell command."""
    return shlex.join(["hitchid", *sys.argv[1:]])
