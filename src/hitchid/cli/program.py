"""Entry point of the program, and its exit codes."""

import shlex
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import hitchid
from hitchid._support.files import check_file, check_folder, check_inputs
from hitchid._support.inert import printable
from hitchid._support.jax_setup import cache_folder
from hitchid.errors import HitchError, InputError

if TYPE_CHECKING:
    from hitchid.estimation import SearchComparison
    from hitchid.identification import Settings
    from hitchid.report import Format


# Arguments and options shared by several commands.

ModelFolder = Annotated[Path, typer.Argument(help="Model folder.", show_default=False)]
ReportFolder = Annotated[
    Path, typer.Option("--out", help="Folder to write: report.html, figures, metrics.json.")
]
Accept = Annotated[
    Path | None, typer.Option("--accept", help="Acceptance limits in TOML; exit code 1 if one is violated.")
]
Rig = Annotated[str, typer.Option("--rig", help="Parameter set: a name or a TOML file.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of every random draw.")]
# Of an identification, whose settings file has a seed, too: without the option that one counts.
OptionalSeed = Annotated[
    int | None, typer.Option("--seed", min=0, max=2**32 - 1, help="Seed of every random draw [0].")
]
Logs = Annotated[list[Path], typer.Argument(help="Log files or folders of logs.", show_default=False)]
Signals = Annotated[
    Path | None,
    typer.Option("--signals", help="Signal map, as in campaign.toml [campaign.toml in each folder]."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of tables.")]
AsPdf = Annotated[bool, typer.Option("--pdf", help="Also write report.pdf; needs hitchid[pdf].")]
AsXlsx = Annotated[
    bool, typer.Option("--xlsx", help="Also write tables.xlsx, a sheet for each table; needs hitchid[xlsx].")
]
Interactive = Annotated[
    bool, typer.Option("--interactive", help="Also write interactive.html: tests with zoom and cursors.")
]
Strict = Annotated[bool, typer.Option("--strict", help="Fail if any log cannot be used.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing result.")]
Loads = Annotated[
    list[str] | None,
    typer.Option(
        "--load",
        help="Covariate before motion, in the model's unit; of several NAME=VALUE, once each "
        "[simulate: as measured in the log; run: mean of the identification tests].",
    ),
]


def loads_of(texts: list[str] | None) -> dict[str, float] | float | None:
    """Return the covariates of `--load`, one number or by name.

    Raises:
        InputError: a value is not a number, or only some have names.
    """
    if not texts:
        return None
    if len(texts) == 1 and "=" not in texts[0]:
        return _number(texts[0], texts[0])
    named = {}
    for text in texts:
        name, separator, value = text.rpartition("=")
        if not separator:
            raise InputError(f"--load: expected NAME=VALUE for each of several covariates, got {text}")
        named[name.strip()] = _number(value, text)
    return named


def _number(value: str, text: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"--load: expected a number or NAME=NUMBER, got {text}") from None


def check_output(out: Path, inputs: Iterable[Path | None], *, kind: str | None = None, force: bool) -> None:
    """Check before any work that a file may be written, or a folder that is known by its file `kind`.

    Raises:
        OutputError: another result or an input would be replaced, or it cannot be written.
    """
    if kind is None:
        check_file(out, force=force)
    else:
        check_folder(out, result_kind=kind, force=force)
    check_inputs(out, inputs)


def rig_files(rig: str) -> list[Path]:
    """Return the file of `--rig`, which no result may replace; none where it is a name."""
    return [Path(rig)] if rig.endswith(".toml") else []


def settings_of(config: Path | None, seed: int | None) -> "Settings":
    """Return the settings of a file, or those by default; a seed counts before that of the file."""
    from hitchid.identification import Settings, read_settings

    settings: Settings = {} if config is None else read_settings(config)
    if seed is not None:
        settings["seed"] = seed
    return settings


def report_formats(*, as_pdf: bool, as_xlsx: bool, interactive: bool) -> "list[Format]":
    """Return the requested formats of a report.

    Raises:
        InputError: a package that one of them requires is not installed.
    """
    from hitchid.report import check_renderers

    requested: dict[Format, bool] = {"pdf": as_pdf, "xlsx": as_xlsx, "interactive": interactive}
    formats: list[Format] = [name for name, is_requested in requested.items() if is_requested]
    check_renderers(formats)
    return formats


# User cache of finished searches.


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
