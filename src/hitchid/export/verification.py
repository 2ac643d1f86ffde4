"""Proof that generated code computes what the model does: reference runs, replayed through it."""

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from hitchid._support.inert import printable
from hitchid.errors import HitchError, InputError
from hitchid.export.c_templates import Precision
from hitchid.logs import DIRECTIONS
from hitchid.model import Hitch, covariates_of, mean_load

# Runs of a model that generated code must repeat: random commands, changes of direction, gaps.

SEED = 20_251  # of the commands; any
LEVEL_S = (0.05, 1.5)  # shortest and longest time of a level of command, s
GAIN_ERROR = 1.01  # of the measured displacement, so that the filter of the load has something to find
MISSING, NOT_A_NUMBER = 0.02, 0.005  # shares of samples without measurement and without command
BOTH = 0.15  # share of the levels at which the other direction has a command, too, and of those with none
START_SHARE = 0.5  # of the range of displacement, for the start


@dataclass(frozen=True)
class ReferenceRun:
    """A run of a model through its public step.

    Attributes:
        start: displacement before the first sample.
        load: covariates.
        inputs: commands of the channels and measured displacement, NaN where there is none, shape [N, C + 1].
        displacement: one sample later, shape [N].
        mode: direction in charge, 0 lifting, 1 lowering, −1 none yet, shape [N].
        both_valves: whether both commands acted, shape [N].
        command_missing: whether a command was not finite, shape [N].
    """

    start: float
    load: tuple[float, ...]
    inputs: Float[np.ndarray, "n c"]
    displacement: Float[np.ndarray, " n"]
    mode: Int[np.ndarray, " n"]
    both_valves: np.ndarray
    command_missing: np.ndarray


def reference_runs(model: Hitch, samples: int) -> tuple[ReferenceRun, ReferenceRun]:
    """Return a free run, and a run with measured displacements, each of a number of samples."""
    rng = np.random.default_rng(SEED)
    commands = _commands(model, samples, rng)
    covariates = covariates_of(model.channels.values())
    # Beside the mean load, at which covariates change nothing that a run could show.
    load = tuple((mean_load(model.channels.values()) * 1.02).tolist()) if covariates else ()
    covered = next(iter(model.channels.values())).operating_range.displacement
    ends = float(covered.lowest), float(covered.highest)
    start = ends[0] + START_SHARE * (ends[1] - ends[0]) if np.all(np.isfinite(ends)) else 100.0
    nothing = np.full(samples, np.nan)
    # The free run first: measured displacements are to be near what the model predicts.
    free = _run(model, start, load, np.column_stack([commands, nothing]))
    travel = np.concatenate([[0.0], free.displacement[:-1] - start])
    noise = 1e-4 * (np.ptp(travel) + 1e-9) * rng.standard_normal(samples)
    measured = start + GAIN_ERROR * travel + noise
    # A while without a measurement: before the first one the band is unknown, and the code must say so.
    measured[: samples // 20] = np.nan
    gaps = rng.random(samples) < MISSING
    measured[gaps | np.roll(gaps, 1) | np.roll(gaps, 2)] = np.nan
    middle = samples // 2
    measured[middle : middle + samples // 12] = np.nan  # longer than the network's innovations are used
    commands = commands.copy()
    commands[rng.random(commands.shape) < NOT_A_NUMBER] = np.nan
    return free, _run(model, start, load, np.column_stack([commands, measured]))


def displacement_range(model: Hitch, run: ReferenceRun) -> float:
    """Return the widest range of displacement in the tests; that of a run where it is not known."""
    ranges = [channel.operating_range.displacement for channel in model.channels.values()]
    widths = [float(covered.highest) - float(covered.lowest) for covered in ranges]
    bounded = [width for width in widths if np.isfinite(width) and width > 0]
    return max(bounded, default=float(np.ptp(run.displacement)) or 1.0)


def _commands(model: Hitch, samples: int, rng: np.random.Generator) -> Float[np.ndarray, "n c"]:
    """Return levels of one direction at a time, at times of both, from below the dead zone to the largest."""
    channels = tuple(model.channels.values())
    commands = np.zeros((samples, len(channels)))
    shortest, longest = (max(1, round(length / model.step_s)) for length in LEVEL_S)
    # At least twenty levels, however fast the clock.
    longest = min(longest, max(shortest, samples // 20))
    largest = [
        channel.dead_zone + (highest if np.isfinite(highest) else max(channel.dead_zone, 1.0))
        for channel in channels
        for highest in (float(channel.operating_range.command.highest),)
    ]
    at = 0
    while at < samples:
        length = int(rng.integers(shortest, longest + 1))
        active = int(rng.integers(len(channels)))
        for number, most in enumerate(largest):
            if number == active or rng.random() < BOTH:
                commands[at : at + length, number] = rng.uniform(-0.1, 1.1) * most
        if rng.random() < BOTH:
            commands[at : at + length] = 0.0
        at += length
    return commands


def _run(
    model: Hitch, start: float, load: tuple[float, ...], inputs: Float[np.ndarray, "n c"]
) -> ReferenceRun:
    names = covariates_of(model.channels.values())
    state = model.init_state(start, dict(zip(names, load, strict=True)) or None)
    columns = [DIRECTIONS.index(direction) for direction in model.channels]
    states, displacements = [], []
    for row in inputs:
        commands = np.zeros(len(DIRECTIONS))
        commands[columns] = row[:-1]
        state, displacement = model.step(state, commands, row[-1])
        states.append(state)
        displacements.append(float(displacement))
    # Stacked by NumPy: JAX would compile a program with an argument for each sample, which takes seconds.
    unpacked = jax.vmap(model.unpack_state)(jax.tree.map(lambda *arrays: np.stack(arrays), *states))
    modes = np.asarray(unpacked.mode)
    return ReferenceRun(
        start,
        load,
        inputs,
        np.array(displacements),
        np.where(modes < 0, modes, np.array(columns)[modes]),
        np.asarray(unpacked.both_valves_active),
        np.asarray(unpacked.command_missing),
    )


# The C compiler of this machine, or the one of the package ziglang.

COMMANDS = ("cc", "gcc", "clang")
STANDARD = ("-std=c99", "-O2", "-ffp-contract=off")
START_TIMEOUT_S = 30.0  # a compiler says its version at once; chosen
COMPILE_TIMEOUT_S = 300.0  # the first program for another platform takes ziglang 90 s


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C, such as `gcc`.

    Attributes:
        command: program and its first arguments.
        version: the first line that it prints of itself.
    """

    command: tuple[str, ...]
    version: str

    def compile(self, sources: Sequence[Path], out: Path, *options: str) -> None:
        """Compile sources to a program or a library, in the folder of the first of them.

        Raises:
            InputError: the compiler fails; its first message is shown.
        """
        folder = sources[0].parent
        # Relative names: libraries for some platforms hold them, and must not depend on the folder.
        names = [path.name if path.parent == folder else str(path) for path in (*sources, out)]
        arguments = [*self.command, *STANDARD, *options, "-o", names[-1], *names[:-1], "-lm"]
        # The sources are our own, the compiler is the user's.
        done = subprocess.run(  # noqa: S603
            arguments, cwd=folder, capture_output=True, text=True, timeout=COMPILE_TIMEOUT_S, check=False
        )
        if done.returncode:
            first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
            raise InputError(
                f"{shlex.join(self.command)}: cannot compile the generated code: {first.strip()}"
            )


def find_compiler() -> Compiler | None:
    """Return the compiler of `CC`, else the first of cc, gcc, clang and ziglang; None where there is none."""
    candidates = [_words(os.environ.get("CC", "")), *([name] for name in COMMANDS)]
    # Ziglang last: its first program takes a minute, that of a compiler of the system a moment.
    candidates.append(list(zig.command) if (zig := zig_compiler()) else [])
    for candidate in candidates:
        if not candidate or not (program := shutil.which(candidate[0])):
            continue
        command = (program, *candidate[1:])
        # One that is in the path may still not start.
        with suppress(OSError, subprocess.SubprocessError):
            done = subprocess.run(  # noqa: S603
                [*command, "--version"],
                capture_output=True,
                text=True,
                errors="replace",
                timeout=START_TIMEOUT_S,
                check=True,
            )
            if version := done.stdout.partition("\n")[0].strip():
                return Compiler(command, version)
    return None


def _words(command: str) -> list[str]:
    """Return program and arguments of a command line: all of it a path, or words as a shell has them."""
    if shutil.which(command):
        return [command]
    try:
        return shlex.split(command)
    except ValueError:  # a quotation that is never closed
        return []


def zig_compiler() -> Compiler | None:
    """Return ziglang's compiler, which compiles for other platforms; None where it is not installed."""
    command = (sys.executable, "-m", "ziglang", "cc")
    return Compiler(command, "ziglang") if find_spec("ziglang") else None


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
    """Return the largest differences that rounding explains, as shares of a range of displacement.

    The spread of each network's innovations is in the displacement's unit; it is None without networks.
    """
    measured, free_run = ROUNDING[precision]
    if error_steps is None:
        return Tolerance(measured, free_run)
    # Innovations are in units of their spread, whatever the hitch travels; the tolerance is of the range.
    innovation = INNOVATION_ROUNDING * max(error_steps, default=0.0) / travel_range
    return Tolerance(max(measured, NETWORK_ROUNDING[0], innovation), max(free_run, NETWORK_ROUNDING[1]))


def replay(program: Sequence[str], run: ReferenceRun, folder: Path) -> Float[np.ndarray, "n 4"]:
    """Return displacement, mode, flags and half width of a run through a compiled replay program."""
    return run_replay(program, np.array([len(run.inputs), run.start, *run.load]), run.inputs, folder)


def run_replay(
    program: Sequence[str],
    head: Float[np.ndarray, " h"],
    inputs: Float[np.ndarray, "n c"],
    folder: Path,
    *,
    readable: Sequence[str] = (),
) -> Float[np.ndarray, "n 4"]:
    """Return the four numbers that a replay program answers to each row of inputs, after the head.

    Where the system can, the program sees no files but those of its folder, and readable ones.

    Raises:
        ParityError: the program fails.
    """
    # Binary: the code is compared to the last bits of a double.
    source, result = folder / "inputs.bin", folder / "outputs.bin"
    numbers = (np.ascontiguousarray(array, dtype="<f8").tobytes() for array in (head, inputs))
    source.write_bytes(b"".join(numbers))
    arguments = [*program, str(source), str(result)]
    # Nothing of the user's environment: the model, and so its code, may be a stranger's.
    environment = {name: os.environ[name] for name in ("SYSTEMROOT",) if name in os.environ}
    if os.name == "posix":
        arguments = [
            sys.executable,
            "-I",
            "-S",
            str(CONFINED),
            os.pathsep.join([str(folder), *readable]),
            *arguments,
        ]
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
    modes = 0
    for run, rows in zip(runs, replayed, strict=True):
        flags = rows[:, 2].astype(int) & (COMMAND_MISSING | BOTH_VALVES)
        expected = COMMAND_MISSING * run.command_missing + BOTH_VALVES * run.both_valves
        modes += int(np.sum((rows[:, 1] != run.mode) | (flags != expected)))
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

    Mode and flags need not agree in single precision, where a threshold may be elsewhere.

    Raises:
        ParityError: the differences are larger than rounding explains.
        InputError: the compiler fails.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        program = folder / "replay"
        compiler.compile(sources, program)
        free, measured = (replay([str(program)], run, folder) for run in runs)
    parity = compare(runs, (free, measured), travel_range)
    check_parity(parity, tolerance, compare_modes=compare_modes)
    return parity


def check_parity(parity: Parity, tolerance: Tolerance, *, compare_modes: bool = True) -> None:
    """Raise ParityError for differences that are larger than rounding explains."""
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
