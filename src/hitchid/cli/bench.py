"""`hitchid bench`: tests on the virtual test bench."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options


class Protocol(Enum):
    """Kinds of tests on the virtual bench."""

    PRBS = "prbs"
    RAMP = "ramp"
    CYCLE = "cycle"


class TestedDirections(Enum):
    """Directions that the virtual bench excites."""

    LIFTING = "lifting"
    LOWERING = "lowering"
    BOTH = "both"


class LogFormat(Enum):
    """Formats of the logs that the virtual bench writes."""

    CSV = "csv"
    GZIP = "csv.gz"
    MDF = "mf4"
    PARQUET = "parquet"
    TDMS = "tdms"


Out = Annotated[Path, typer.Argument(help="Folder to write.", show_default=False)]
Tests = Annotated[
    int | None,
    typer.Option(
        "--tests",
        min=1,
        max=10_000,
        help="Number of tests per direction, or of cycles [20]; of ramps per direction [3].",
    ),
]
Mode = Annotated[TestedDirections, typer.Option("--mode", help="Direction to excite.")]
Implements = Annotated[
    list[float] | None,
    typer.Option("--implement-kg", help="Mass of the implement; several, once each [that of the rig]."),
]
Oil = Annotated[
    list[float] | None,
    typer.Option("--oil-c", help="Oil temperature; several, once each [that of the rig]."),
]
Consumer = Annotated[
    list[float] | None,
    typer.Option("--consumer-l-min", help="Flow that a second consumer takes from the pump [0]."),
]


def bench(
    out: Out,
    tests: Tests = None,
    protocol: Annotated[Protocol, typer.Option("--protocol", help="Kind of test.")] = Protocol.PRBS,
    mode: Mode = TestedDirections.BOTH,
    rig: options.Rig = "nominal",
    implements_kg: Implements = None,
    oil_c: Oil = None,
    consumer_l_min: Consumer = None,
    log_format: Annotated[LogFormat, typer.Option("--format", help="Format of the logs.")] = LogFormat.CSV,
    seed: options.Seed = 0,
    force: options.Force = False,
) -> None:
    """Run tests on the virtual test bench; write one log a test and campaign.toml.

    With operating conditions all tests are run in every combination of them, and the logs have cylinder
    pressure, oil temperature and consumer flow, too.
    """
    from hitchid.cli import terminal as display

    options.check_output(out, options.rig_files(rig), kind="campaign.toml", force=force)
    prepare_jax()
    from hitchid.bench.virtual_campaign import REPEATS, TESTS, Conditions, write_campaign
    from hitchid.logs.record import DIRECTIONS

    conditions = None
    if implements_kg or oil_c or consumer_l_min:
        given = (implements_kg or (), oil_c or (), consumer_l_min or (0.0,))
        conditions = Conditions(*map(tuple, given))
    if tests is None:
        tests = REPEATS if protocol is Protocol.RAMP else TESTS["prbs"]
    logs = write_campaign(
        out,
        rig,
        tests={protocol.value: tests},
        directions=DIRECTIONS if mode is TestedDirections.BOTH else (mode.value,),
        conditions=conditions,
        suffix=log_format.value,
        seed=seed,
        force=force,
    )
    display.write_result(out, f"{logs} logs and campaign.toml")
