"""Arguments and options shared by several commands."""

from pathlib import Path
from typing import Annotated

import typer

Logs = Annotated[list[Path], typer.Argument(help="Log files or folders of logs.", show_default=False)]
Signals = Annotated[
    Path | None,
    typer.Option("--signals", help="Signal map, as in campaign.toml [campaign.toml in each folder]."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of tables.")]
AsPdf = Annotated[bool, typer.Option("--pdf", help="Also write report.pdf; needs hitchid[pdf].")]
Strict = Annotated[bool, typer.Option("--strict", help="Fail if any log cannot be used.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing result.")]
