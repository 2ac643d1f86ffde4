"""`hitchid export`: a model as code that runs without Python."""

import json
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.errors import InputError


class Target(Enum):
    """What a model is exported to."""

    C = "c"
    MATLAB = "matlab"
    FMU2 = "fmu2"
    FMU3 = "fmu3"
    ONNX = "onnx"


class Numbers(Enum):
    """Precision of the generated code."""

    MIXED = "mixed"
    DOUBLE = "double"
    SINGLE = "single"


To = Annotated[
    Target,
    typer.Option(
        "--to",
        help="C99 sources, functions of MATLAB and Octave, FMI 2.0 or 3.0 unit, or the networks as ONNX.",
    ),
]
Out = Annotated[Path, typer.Option("--out", help="Folder to write; of an FMU the file, NAME.fmu.")]
Precision = Annotated[
    Numbers,
    typer.Option("--precision", help="Physics in double and networks in single precision, or all in one."),
]
NoCompensators = Annotated[
    bool, typer.Option("--no-compensators", help="The physical model and its filter alone.")
]
Controller = Annotated[
    Path | None,
    typer.Option(
        "--controller", help="Controller file of `hitchid tune`, written beside it; with --to c and matlab."
    ),
]
Platforms = Annotated[
    list[str] | None,
    typer.Option(
        "--platforms",
        help="Of the FMU's binaries, once each: linux64, win64, darwin64, aarch64-linux, aarch64-darwin "
        "[all with hitchid[fmu]; else this one].",
    ),
]


def export(
    model: options.ModelFolder,
    to: To,
    out: Out,
    name: Annotated[str, typer.Option("--name", help="Prefix of all names in the code.")] = "hitch",
    precision: Precision = Numbers.MIXED,
    no_compensators: NoCompensators = False,
    controller: Controller = None,
    platforms: Platforms = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Export a model to code that runs without Python, and prove that it computes what the model does."""
    from hitchid._support.files import check_inputs
    from hitchid.cli import terminal as display

    check_inputs(out, [model, controller])
    if controller is not None and to not in (Target.C, Target.MATLAB):
        raise InputError(f"--controller: expected --to c or --to matlab, got --to {to.value}")
    prepare_jax()
    from hitchid.control import load_controller
    from hitchid.export import to_c, to_fmu, to_matlab, to_onnx
    from hitchid.model import load

    hitch = load(model)
    code = {"name": name, "precision": precision.value, "compensators": not no_compensators, "force": force}
    content = None if controller is None else load_controller(controller)
    if to is Target.C:
        done = to_c(hitch, out, controller=content, **code)
    elif to is Target.MATLAB:
        if precision is Numbers.SINGLE:
            raise InputError(
                "--precision: expected mixed or double with --to matlab, which computes in double"
            )
        code.pop("precision")
        done = to_matlab(hitch, out, controller=content, **code)
    elif to is Target.ONNX:
        done = to_onnx(hitch, out, name=name, force=force)
    else:
        version = "fmi2" if to is Target.FMU2 else "fmi3"
        done = to_fmu(hitch, out, version=version, platforms=platforms, **code)
    if as_json:
        parity = None if done.parity is None else asdict(done.parity)
        content = {"parity": parity, "compiler": done.compiler, "notices": done.notices}
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        display.show_export(done)
