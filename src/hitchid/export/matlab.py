"""Export to MATLAB and Octave: plain functions that need no toolbox, proved against the model in Octave."""

import math
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from jinja2 import Environment
from scipy.signal import ss2tf

from hitchid._support import checks
from hitchid._support.files import canonical_json, check_folder, write_files, write_folder
from hitchid._support.inert import comment
from hitchid._support.precision import double_precision
from hitchid.control import ControllerFile
from hitchid.errors import InputError
from hitchid.export.c99 import (
    MANIFEST,
    SAMPLES,
    SELF_TEST_SAMPLES,
    Export,
    check_name,
    exported_model,
    statement,
)
from hitchid.export.c_templates import c_templates, number, template_environment
from hitchid.export.constants import constants_of
from hitchid.export.controller_code import (
    check_controller,
    controller_run,
    controller_templates,
    current_difference,
)
from hitchid.export.error_constants import rows
from hitchid.export.verification import (
    Tolerance,
    check_parity,
    compare,
    displacement_range,
    reference_runs,
    run_replay,
)
from hitchid.model import Channel, Hitch
from hitchid.structures import NonlinearStructure

PER_LINE = 6  # numbers of a row in a line
CURVE_POINTS = 41  # of the valve's curve; chosen
PARITY = 1e-9  # of the range of displacement: rounding of 3000 steps, the order of sums included
# Names that the generated functions call, and words of the language.
RESERVED = frozenset(
    [
        *("break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function"),
        *("global", "if", "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while"),
        *("abs", "any", "clip", "diag", "diff", "double", "exist", "exp", "expm1", "eye", "find", "flush"),
        *("floor", "fprintf", "golden", "inputs", "isempty", "isfinite", "isnan", "legend", "log", "logical"),
        *("max", "min", "mod", "model", "nargin", "nargout", "numel", "output", "plot", "sigmoid", "sign"),
        *("size", "sqrt", "state", "struct", "sum", "tanh", "tf", "turned", "xlabel", "ylabel", "zeros"),
    ]
)
PROGRAMS = ("octave-cli", "octave")
OPTIONS = ("--quiet", "--norc", "--no-history", "--no-gui")
UNVERIFIED = "not verified: there is no Octave (octave-cli)"


@dataclass(frozen=True)
class Octave:
    """The program that runs generated code.

    Attributes:
        program: its path.
        version: the first line that it prints of itself.
    """

    program: str
    version: str

    @property
    def readable(self) -> tuple[str, ...]:
        """What it reads beside the folder of the code: itself, and its own functions."""
        prefix = Path(self.program).resolve().parents[1]
        return (self.program, str(Path(self.program).resolve()), str(prefix / "share" / "octave"))


def find_octave() -> Octave | None:
    """Return the Octave of `OCTAVE`, else of this machine; None where there is none."""
    for name in (os.environ.get("OCTAVE", ""), *PROGRAMS):
        if not name or not (program := shutil.which(name)):
            continue
        # One that is in the path may still not start.
        with suppress(OSError, subprocess.SubprocessError):
            done = subprocess.run(  # noqa: S603
                [program, "--version"],
                capture_output=True,
                text=True,
                errors="replace",
                timeout=60.0,
                check=True,
            )
            if version := done.stdout.partition("\n")[0].strip():
                return Octave(program, version)
    return None


@checks.named_arguments
@double_precision
def to_matlab(
    model: Hitch,
    folder: str | Path,
    *,
    name: str = "hitch",
    compensators: bool = True,
    controller: ControllerFile | None = None,
    force: bool = False,
) -> Export:
    """Write a model as functions of MATLAB and Octave: identified numbers, steps and transfer functions.

    The functions replay random commands in Octave; nothing is written where they differ from the model by
    more than rounding.

    Args:
        model: the model.
        folder: folder to write.
        name: prefix of all functions, an identifier of C.
        compensators: False for the physical model and its filter alone.
        controller: a position controller for the model, as `hitchid.control.load_controller` reads it, to be
            written beside it.
        force: replace an earlier export.

    Raises:
        InputError: the name is no identifier, the controller is for another model, or the model has a
            structure that the export does not know.
        ParityError: the generated functions differ from the model.
        OutputError: the folder exists, or cannot be written.
    """
    out = checks.path(folder, "folder")
    check_folder(out, result_kind=MANIFEST, force=force)
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    if check_name(name) in RESERVED:
        raise InputError(f"name: expected one that MATLAB has no function of, got '{name}'")
    exported, octave = exported_model(model, compensators=compensators), find_octave()
    constants, runs = constants_of(exported), reference_runs(exported, SAMPLES)
    context = c_templates(constants, name, "double").context
    texts = {f"{name}_{part}.m": rendered(context, f"model_{part}.m") for part in ("init", "step")}
    travel_range, parity = displacement_range(exported, runs[0]), None
    if octave is not None:
        with tempfile.TemporaryDirectory() as temporary:
            replayed = [
                _replayed(octave, {**texts, "replay.m": rendered(context, "replay.m")}, Path(temporary),
                          np.array([len(run.inputs), run.start, *run.load]), run.inputs)
                for run in runs
            ]  # fmt: skip
        parity = compare(runs, (replayed[0], replayed[1]), travel_range)
        check_parity(parity, Tolerance(PARITY, PARITY))
    described = {"described": [_description(own, exported) for own in exported.channels.values()]}
    sample = slice(None, SELF_TEST_SAMPLES)
    golden = np.column_stack([_last_valid(runs[1].inputs[sample, :-1]), runs[1].inputs[sample, -1:],
                              runs[1].displacement[sample]])  # fmt: skip
    texts |= {
        f"{name}.m": rendered(context, "model.m", **described),
        f"{name}_tf.m": rendered(context, "model_tf.m", **described),
        f"{name}_demo.m": rendered(
            context, "model_demo.m", rows=rows(golden), start=runs[1].start, load=runs[1].load
        ),
    }
    stated = statement(constants, "matlab", parity, "" if octave is None else octave.version)
    if controller is not None:
        code, difference = _controller_files(controller, model, name, octave)
        texts |= code
        stated |= {"controller": {"current_difference": difference, "load": dict(controller.load)}}
    texts["README.md"] = rendered(context, "README.matlab.md", parity=parity, octave=octave)
    files = {file: text.encode() for file, text in texts.items()} | {MANIFEST: canonical_json(stated)}
    write_folder(out, lambda target: write_files(target, files), result_kind=MANIFEST, force=force)
    notices = () if octave is not None else (UNVERIFIED,)
    return Export(out, parity, "" if octave is None else octave.version, notices)


def _replayed(
    octave: Octave,
    texts: Mapping[str, str],
    folder: Path,
    head: Float[np.ndarray, " h"],
    inputs: Float[np.ndarray, "n c"],
) -> Float[np.ndarray, "n 4"]:
    """Return the four numbers that the functions answer to each row of inputs, after the head."""
    write_files(folder, {file: text.encode() for file, text in texts.items()})
    return run_replay([octave.program, *OPTIONS, "replay.m"], head, inputs, folder, readable=octave.readable)


def _controller_files(
    content: ControllerFile, model: Hitch, name: str, octave: Octave | None
) -> tuple[dict[str, str], float | None]:
    """Return the functions of a controller, and its largest difference as a share of the largest current.

    Raises:
        InputError: the controller is for another model.
        ParityError: the functions differ from the controller.
    """
    check_controller(content, model)
    name = f"{name}_controller"
    templates, more = controller_templates(
        content.controller, name, "double", content.digest, dict(content.units)
    )
    texts = {
        f"{name}_{part}.m": rendered(templates.context, f"controller_{part}.m", **more)
        for part in ("init", "step")
    }
    if octave is None:
        return texts, None
    run = controller_run(content.controller, model)
    replay = rendered(templates.context, "controller_replay.m", **more)
    with tempfile.TemporaryDirectory() as temporary:
        head = np.array([len(run.inputs), run.start])
        answered = _replayed(octave, {**texts, "replay.m": replay}, Path(temporary), head, run.inputs)
    return texts, current_difference(content, answered[:, :2], run, "double")


def _last_valid(commands: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n c"]:
    """Return commands of which a missing one is its last value, which is what the model takes."""
    result, last = [], np.zeros(commands.shape[1])
    for row in commands:
        last = np.where(np.isfinite(row), row, last)
        result.append(last)
    return np.array(result)


@double_precision
def _description(channel: Channel, model: Hitch) -> dict[str, Any]:
    """Return what was identified of a direction, as numbers and inert texts."""
    benchmark, structure = channel.benchmark, channel.benchmark.structure
    uncertainty = model.uncertainty.get(channel.direction)
    estimates = () if uncertainty is None else uncertainty.benchmark.parameters
    highest = float(channel.operating_range.command.highest)
    size = highest if math.isfinite(highest) and highest > 0 else max(float(channel.dead_zone), 1.0)
    excess = np.linspace(0.0, size, CURVE_POINTS)
    curve = benchmark.nonlinearity
    numerator, denominator = (), ()
    if not isinstance(structure, NonlinearStructure):
        a, b = (np.asarray(part) for part in structure.require_linear().state_space(benchmark.values))
        # The displacement is the first state, times the sign.
        top, bottom = ss2tf(a, b[:, None], np.eye(1, b.size), np.zeros((1, 1)))
        numerator, denominator = rows(channel.sign * np.trim_zeros(top[0], "f")), rows(bottom)
    described = {
        "name": channel.direction,
        "sign": channel.sign,
        "dead_zone": float(channel.dead_zone),
        "structure": comment(structure.name),
        "dead_time_s": float(benchmark.dead_time_s),
        "names": [estimate.name for estimate in estimates],
        "parameter_units": [estimate.unit for estimate in estimates],
        "values": tuple(estimate.value for estimate in estimates),
        "intervals": tuple(
            tuple(math.nan if end is None else end for end in estimate.interval) for estimate in estimates
        ),
        "determined": tuple(float(estimate.determined) for estimate in estimates),
        "commands": rows(channel.dead_zone + excess),
        "flows": rows(excess if curve is None else curve.flow(jnp.asarray(excess))),
        "numerator": numerator,
        "denominator": denominator,
        "speed_map": None,
    }
    if uncertainty is not None and uncertainty.characteristics is not None:
        points = uncertainty.characteristics.speed_map
        described["speed_map"] = {
            "command": tuple(point.command for point in points),
            "speed": tuple(point.speed for point in points),
            "interval": tuple(
                tuple(math.nan if end is None else end for end in point.interval) for point in points
            ),
            "load": tuple(math.nan if point.load is None else point.load for point in points),
        }
    return described


def rendered(context: Mapping[str, Any], template: str, **more: object) -> str:
    """Return the text of a template, such as `model_step.m`."""
    text = _environment().get_template(f"{template}.jinja").render({**context, **more})
    # No trailing blanks, and at most one empty line at a time.
    text = re.sub(r"[ \t]+\n", "\n", text)
    return re.sub(r"\n{3,}", "\n\n", text).strip("\n") + "\n"


@cache
def _environment() -> Environment:
    return template_environment(
        real=_number,
        matrix=matrix,
        column=lambda rows, index: tuple(row[index] for row in rows),
        cells=lambda texts: "{" + ", ".join(f"'{comment(text)}'" for text in texts) + "}",
    )


def _number(value: float | int) -> str:
    """Return a number with all its digits; one that is not finite as MATLAB writes it."""
    if math.isnan(value):
        return "NaN"
    return number(value, "double") if math.isfinite(value) else "Inf" if value > 0 else "-Inf"


def matrix(values: Iterable[Any]) -> str:
    """Return nested numbers as a row or matrix; of a stack of matrices, one below the other."""
    values = tuple(values)
    while values and isinstance(values[0], tuple) and isinstance(values[0][0], tuple):
        values = tuple(row for stacked in values for row in stacked)
    if not values or not isinstance(values[0], tuple):
        return f"[{_row(values)}]"
    lines = "; ...\n        ".join(map(_row, values))
    return f"[ ...\n        {lines}]"


def _row(values: Iterable[Any]) -> str:
    texts = list(map(_number, values))
    lines = [", ".join(texts[start : start + PER_LINE]) for start in range(0, len(texts), PER_LINE)]
    return ", ...\n            ".join(lines)
