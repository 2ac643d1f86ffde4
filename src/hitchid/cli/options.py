"""Arguments and options shared by several commands, and what they mean."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hitchid._support.files import check_file, check_folder, check_inputs
from hitchid.errors import InputError

if TYPE_CHECKING:
    from hitchid.identification import Settings
    from hitchid.report import Format

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
