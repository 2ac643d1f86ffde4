"""`hitchid drive`: proof of a position controller in closed loop on the virtual bench."""

import importlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.cli.program import command_line
from hitchid.errors import InputError

if TYPE_CHECKING:
    from hitchid.control import ControllerFile
    from hitchid.model import Hitch

Controller = Annotated[
    Path, typer.Argument(help="Controller file, as hitchid tune writes it.", show_default=False)
]
Plant = Annotated[
    str | None,
    typer.Option(
        "--plant",
        help="Plant to drive instead of the bench: MODULE:OBJECT with `reset` and `step`, or `model`, "
        "the identified model itself. In the units of the controller.",
    ),
]
Heavier = Annotated[
    float,
    typer.Option("--heavier", min=-50, max=100, help="Load of `--plant model` beyond that of the tests, %."),
]
OwnController = Annotated[
    str | None,
    typer.Option(
        "--controller", help="Controller to drive instead, MODULE:OBJECT; baselines and bands stay."
    ),
]
Draws = Annotated[int, typer.Option("--draws", min=1, max=10000, help="Closed loops of each scenario.")]


def drive(
    controller: Controller,
    out: options.ReportFolder,
    rig: options.Rig = "nominal",
    plant: Plant = None,
    heavier: Heavier = 0.0,
    own: OwnController = None,
    load: options.Loads = None,
    draws: Draws = 20,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of loads and noise.")] = 0,
    accept: options.Accept = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Drive a controller through steps, ramps, ploughing, changes of load and oil on the virtual bench."""
    from hitchid._support.files import canonical_json
    from hitchid.cli import terminal as display

    options.check_output(out, [controller, accept, *options.rig_files(rig)], kind="metrics.json", force=force)
    prepare_jax()
    from hitchid._support.progress import ProgressUpdate
    from hitchid.control import load_controller
    from hitchid.control.drive import drive as run
    from hitchid.control.drive_report import check_drive, drive_report, read_drive_limits
    from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT
    from hitchid.report import write_report

    limits = None if accept is None else read_drive_limits(accept)
    content = load_controller(controller)
    tested = None if own is None else _imported(own, "--controller", ("initial_state", "step"))
    model, notices = _model(content, controller.parent)
    units = (content.units[DISPLACEMENT], content.units[COMMAND[DIRECTIONS[0]]])
    drawn: dict[str, Any] = {
        "load": options.loads_of(load) if load else content.load or None,
        "draws": draws,
        "seed": seed,
    }
    if plant is not None and model is None:
        raise InputError(f"--plant: the travel of the model is needed; {notices[0]}")
    driven, travel = _driven(content, rig, plant, model, {"heavier": heavier / 100, **drawn})
    with display.progress(quiet=quiet) as report:
        proof: dict[str, Any] = {"model": model, "travel": travel, "units": units}
        result = run(content.controller, driven, tested=tested, **proof, **drawn, progress=report)
        acceptance = None if limits is None else check_drive(result.metrics, limits)
        report(ProgressUpdate("report", 0.98))
        document = drive_report(
            result,
            rig=f"bench {rig}" if plant is None else f"plant {plant}",
            margins=content.margins,
            acceptance=acceptance,
            notices=notices,
            command=command_line(),
        )
    accepted = {} if acceptance is None else {"acceptance": acceptance.describe()}
    files = {"metrics.json": canonical_json({**result.metrics, **accepted})}
    write_report(out, document, files, mark="metrics.json", force=force)
    display.end_with_verdict(document, result.metrics, notices, acceptance, out, quiet=quiet, as_json=as_json)


def _driven(
    content: "ControllerFile", rig: str, plant: str | None, model: "Hitch | None", drawn: dict[str, Any]
) -> tuple[Any, tuple[float, float] | None]:
    """Return the bench, or a plant and the travel of the model within which it is driven.

    Raises:
        InputError: the controller is in other units than the bench, or there is no such plant.
    """
    from hitchid.bench import load_rig
    from hitchid.control import ModelPlant
    from hitchid.control.drive import travel_of

    if plant is None or model is None:
        if set(content.units.values()) != {"mm", "A"}:
            own_units = " and ".join(dict.fromkeys(content.units.values()))
            raise InputError(
                f"--rig: the bench is in mm and A, the controller in {own_units}; "
                "expected --plant model or --plant MODULE:OBJECT"
            )
        return load_rig(rig), None
    travel = travel_of(model)
    if plant == "model":
        return ModelPlant.of(content.controller, model, **drawn), travel
    return _imported(plant, "--plant", ("reset", "step")), travel


def _model(content: "ControllerFile", folder: Path) -> "tuple[Hitch | None, tuple[str, ...]]":
    """Return the model that a controller was tuned for, or None and the reason why bands are missing."""
    from hitchid.errors import ModelFolderError
    from hitchid.model import load as load_model

    try:
        model = load_model(folder / content.model)
    except ModelFolderError as error:
        return None, (f"no band is predicted: {error}",)
    if model.provenance.digest == content.digest:
        return model, ()
    reason = f"{folder / content.model} is not the model that the controller was tuned for"
    return None, (f"no band is predicted: {reason}",)


def _imported(name: str, option: str, functions: tuple[str, ...]) -> Any:
    """Return an object by MODULE:OBJECT; modules of the current folder are found, too.

    Raises:
        InputError: the name has another form, there is no such object, or it lacks one of the functions.
    """
    module_name, separator, object_name = name.partition(":")
    if not separator or not module_name or not object_name:
        raise InputError(f"{option}: expected MODULE:OBJECT, got {name}")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)
    try:
        imported = getattr(importlib.import_module(module_name), object_name)
    except Exception as error:  # whatever a foreign module raises
        raise InputError(f"{option}: {name} cannot be imported: {error}") from error
    if not all(callable(getattr(imported, function, None)) for function in functions):
        raise InputError(f"{option}: {name} has no functions `{'` and `'.join(functions)}`")
    return imported
