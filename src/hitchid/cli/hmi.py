"""`hitchid hmi`: the operator's page."""

from pathlib import Path
from typing import Annotated

import typer

from hitchid.cli import options
from hitchid.errors import InputError


def hmi(
    project: Annotated[Path, typer.Argument(help="Project folder: campaigns, models, reports.")] = Path("."),
    source: Annotated[
        str,
        typer.Option(
            "--source",
            help="Source beside the virtual bench and replay: stdin, serial:DEVICE, udp:PORT, can:FILE, or "
            "MODULE:OBJECT.",
        ),
    ] = "",
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="Port on this machine; 0 for a free one.")
    ] = 0,
    allow_output: Annotated[
        bool, typer.Option("--allow-output", help="Allow commands to a real machine; requires --limits.")
    ] = False,
    limits: Annotated[
        Path | None, typer.Option("--limits", help="Limits file of the machine: largest commands, travel.")
    ] = None,
    silence_ms: Annotated[
        int,
        typer.Option(
            "--silence-ms", min=200, max=5000, help="Silence of the operator's page that stops, ms."
        ),
    ] = 500,
    quiet: options.Quiet = False,
) -> None:
    """Serve the operator's page on this machine and print its link; Ctrl-C ends it."""
    if allow_output and limits is None:
        raise InputError("--allow-output: requires --limits FILE, the limits of the machine")
    if not project.is_dir():
        raise InputError(f"{project}: is no folder; create it first")
    try:
        from hitchid.hmi.console import Settings
        from hitchid.hmi.server import Server
    except ModuleNotFoundError as error:
        raise InputError(f"the page needs {error.name}; install hitchid[hmi]") from error
    from hitchid.hmi.plans import read_limits

    # A file that cannot be used is refused before the page is served.
    if limits is not None:
        read_limits(limits)
    settings = Settings(
        root=project.resolve(),
        source=source,
        allow_output=allow_output,
        limits_file=limits and limits.resolve(),
        longest_silence_s=silence_ms / 1000,
    )
    server = Server(settings, port)
    typer.echo(server.new_link())
    if not quiet:
        typer.echo("Open this link in a browser on this machine; it can be used once. Ctrl-C ends.", err=True)
    server.run()
