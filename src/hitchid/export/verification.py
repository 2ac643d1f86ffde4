"""Proof that generated code computes what the model does: reference runs, replayed through it."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hitchid._support.inert import printable
from hitchid.errors import HitchError
from hitchid.export.c_templates import Precision
from hitchid.export.compiler import Compiler
from hitchid.export.reference import ReferenceRun

COLUMNS = 4  # of a replay: displacement, mode, flags, half width
COMMAND_MISSING, BOTH_VALVES = 1, 4  # flags, as in the generated header
TIMEOUT_S = 60.0
CONFINED = Path(__file__).with_name("confined.py")  # not imported: it acts on the process that runs it
# Largest difference of the displacement as a share of its range in the tests, with measurements and in free
# run: double precision rounds at 1e-16, and 3000 steps add up.
ROUNDING: dict[Precision, tuple[float, float]] = {
    "double": (1e-12, 1e-10),
    "mixed": (1e-12, 1e-10),
    "single": (1e-4, 1e-3),
}
# Single precision rounds an innovation, or a factor on the speed, at 6e-8 of it.
NETWORK_ROUNDING = (4e-9, 4e-8)
INNOVATION_ROUNDING = 1e-5  # of the spread of innovations: 1e-6 each, and up to ten of them add up
MODES_SHARE = 1e-5  # of samples whose mode or flags may differ: a command within rounding of its threshold


class ParityError(HitchError):
    """Generated code differs from its model."""


@dataclass(frozen=True)
class Parity:
    """Largest differences between generated code and its model.

    Attributes:
        measured, free_run: of the displacement, as shares of its range in the tests.
        modes: number of samples with another mode or other flags.
        samples: compared.
    """

    measured: float
    free_run: float
    modes: int
    samples: int


class Tolerance(NamedTuple):
    """Largest differences that rounding explains, as shares of the range: with measurements, in free run."""

    measured: float
    free_run: float


def tolerance_of(precision: Precision, error_steps: Sequence[float] | None, travel_range: float) -> Tolerance:
    """Return the largest differences that rounding explains.

    Args:
        precision: of the code.
        error_steps: spread of the innovations of each network, in the displacement's unit; None for a model
            without networks.
        travel_range: range of displacement, in its unit.
    """
    measured, free_run = ROUNDING[precision]
    if error_steps is None:
        return Tolerance(measured, free_run)
    innovation = INNOVATION_ROUNDING * max(error_steps, default=0.0) / travel_range
    return Tolerance(max(measured, NETWORK_ROUNDING[0], innovation), max(free_run, NETWORK_ROUNDING[1]))


def replay(program: Sequence[str], run: ReferenceRun, folder: Path) -> Float[np.ndarray, "n 4"]:
    """Return displacement, mode, flags and half width of a run through a compiled replay program.

    Raises:
        ParityError: the program fails.
    """
    return run_replay(program, np.array([len(run.inputs), run.start, *run.load]), run.inputs, folder)


def run_replay(
    program: Sequence[str], head: Float[np.ndarray, " h"], inputs: Float[np.ndarray, "n c"], folder: Path
) -> Float[np.ndarray, "n 4"]:
    """Return the four numbers that a compiled replay program answers to each row of inputs.

    Args:
        program: and its first arguments.
        head: that it reads before the rows.
        inputs: the rows.
        folder: of the program and its files; where the system can, the program sees no others.

    Raises:
        ParityError: the program fails.
    """
    source, result = folder / "inputs.bin", folder / "outputs.bin"
    numbers = (np.ascontiguousarray(each, dtype="<f8").tobytes() for each in (head, inputs))
    source.write_bytes(b"".join(numbers))
    arguments = [*program, str(source), str(result)]
    environment = {name: os.environ[name] for name in ("SYSTEMROOT",) if name in os.environ}
    if os.name == "posix":
        arguments = [sys.executable, "-I", "-S", str(CONFINED), str(folder), *arguments]
    try:
        done = subprocess.run(  # noqa: S603
            arguments, cwd=folder, env=environment, capture_output=True, timeout=TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ParityError(f"the generated code ran for {TIMEOUT_S:g} s; please report this model") from error
    rows = np.fromfile(result, dtype="<f8") if done.returncode == 0 else np.zeros(0)
    if rows.size != COLUMNS * len(inputs):
        said = printable(done.stderr.decode(errors="replace")[-200:]).strip()
        raise ParityError(
            f"the generated code ended with code {done.returncode} after {rows.size // COLUMNS} of "
            f"{len(inputs)} samples{f' ({said})' if said else ''}; please report this model"
        )
    return rows.reshape(-1, COLUMNS)


def compare(
    runs: tuple[ReferenceRun, ReferenceRun],
    replayed: tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, "n 4"]],
    travel_range: float,
) -> Parity:
    """Return the differences of a free run and a run with measured displacements."""
    free, measured = (
        float(np.max(np.abs(rows[:, 0] - run.displacement)) / travel_range)
        for run, rows in zip(runs, replayed, strict=True)
    )
    modes = sum(
        int(np.sum((rows[:, 1] != run.mode) | (_flags(rows) != _expected_flags(run))))
        for run, rows in zip(runs, replayed, strict=True)
    )
    return Parity(measured, free, modes, sum(len(run.inputs) for run in runs))


def verify(
    compiler: Compiler,
    sources: Sequence[Path],
    runs: tuple[ReferenceRun, ReferenceRun],
    travel_range: float,
    tolerance: Tolerance,
    *,
    compare_modes: bool = True,
) -> Parity:
    """Compile the sources of a replay program, run it, and return its differences from the model.

    Args:
        compiler: that compiles it.
        sources: its files.
        runs: a free run, and one with measured displacements.
        travel_range: range of displacement, of which differences are shares.
        tolerance: the largest admissible ones.
        compare_modes: whether mode and flags must agree; in single precision a threshold may be elsewhere.

    Raises:
        ParityError: the differences are larger.
        InputError: the compiler fails.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        program = folder / "replay"
        compiler.compile(sources, program)
        free, measured = (replay([str(program)], run, folder) for run in runs)
    parity = compare(runs, (free, measured), travel_range)
    # Not "larger than": differences that are not numbers must not pass.
    if not (parity.measured <= tolerance.measured and parity.free_run <= tolerance.free_run):
        raise ParityError(
            f"the generated code differs from the model by {parity.measured:.2g} of the range with "
            f"measurements (expected at most {tolerance.measured:.2g}) and {parity.free_run:.2g} in free run "
            f"(expected at most {tolerance.free_run:.2g}); nothing was written; please report this model"
        )
    if compare_modes and parity.modes > MODES_SHARE * parity.samples:
        raise ParityError(
            f"the generated code differs from the model in mode or flags of {parity.modes} of "
            f"{parity.samples} samples; nothing was written; please report this model"
        )
    return parity


def _flags(rows: Float[np.ndarray, "n 4"]) -> np.ndarray:
    return rows[:, 2].astype(int) & (COMMAND_MISSING | BOTH_VALVES)


def _expected_flags(run: ReferenceRun) -> np.ndarray:
    return COMMAND_MISSING * run.command_missing + BOTH_VALVES * run.both_valves
