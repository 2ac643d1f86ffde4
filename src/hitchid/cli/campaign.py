"""`hitchid campaign`: tests that choose themselves, until the model is as good as asked."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hitchid.cli import options
from hitchid.errors import InputError

Source = Annotated[
    str,
    typer.Option(
        "--source",
        help="Machine: rig:NAME (the virtual bench), serial:DEVICE, udp:PORT, can:FILE, or MODULE:OBJECT.",
    ),
]
Goal = Annotated[
    str | None,
    typer.Option("--goal", help="Ends once it is reached: 'free run 0.2 mm in 10 s', in the machine's unit."),
]


def campaign(
    project: Annotated[Path, typer.Argument(help="Project folder; campaigns/NAME holds the logs.")],
    source: Source = "rig:nominal",
    minutes: Annotated[float, typer.Option("--minutes", min=0.5, help="Bench time at most.")] = 15.0,
    goal: Goal = None,
    limits: Annotated[
        Path | None, typer.Option("--limits", help="Limits file of the machine: largest commands, travel.")
    ] = None,
    name: Annotated[str, typer.Option("--name", help="Name of the campaign.")] = "campaign",
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a campaign that was stopped.")] = False,
    seed: options.Seed = 0,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Test a machine: from a careful start on, each test the one that helps the model most for its time.

    Ctrl-C closes the valves and ends it; --resume goes on. The machine needs its own emergency stop.
    """
    from hitchid.hmi.headless import campaign as run

    shown: list[str] = []

    def progress(sentence: str, share: float) -> None:
        # One line a test: what it does next, and why.
        if not quiet and sentence != (shown or [""])[-1]:
            shown.append(sentence)
            typer.echo(f"{share:4.0%}  {sentence}", err=True)

    try:
        result = run(
            source,
            project,
            name=name,
            minutes=minutes,
            goal=goal,
            limits=limits,
            resume=resume,
            seed=seed,
            progress=progress,
        )
    except InputError as error:
        raise InputError(str(error).replace("go on with resume", "go on with --resume")) from error
    if as_json:
        typer.echo(json.dumps(result.describe(), indent=1))
        return
    typer.echo(f"{result.reason} ({result.minutes:.1f} min of bench time)")
    typer.echo(result.further)
    typer.echo(f"report: {project / result.report}" if result.report.endswith(".html") else result.report)
    config = f" --config {result.settings}" if result.settings else ""
    typer.echo(f"next: hitchid identify {result.folder} --out {project / 'models' / name}{config}")
