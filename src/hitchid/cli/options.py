"""Arguments and options shared by several commands."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from hitchid.report import Format

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
