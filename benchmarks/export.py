"""Exported code on other compilers, processors and in Octave, and its cost on a Cortex-M4F.

    python -m benchmarks.export [MODEL …]

Uses what is installed of Octave, gcc, clang, ziglang, cross compilers for ARM with qemu-user,
arm-none-eabi-gcc with the package unicorn, and cppcheck; the rest is left out and named. Debian: octave clang
wine64 gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-user-static gcc-aarch64-linux-gnu
gcc-arm-linux-gnueabihf cppcheck.
"""

import argparse
import json
import re
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import hitchid
from hitchid.control import load_controller, save_controller, tune
from hitchid.export import to_c, to_matlab
from hitchid.export.c99 import MANIFEST, REPLAY, VerifiedSource, verified_source
from hitchid.export.matlab import find_octave
from hitchid.export.verification import compare, replay

from .gauntlet.measured import DATA

COMPILERS = {
    "gcc": (["gcc"], []),
    "clang": (["clang"], []),
    "zig": ([sys.executable, "-m", "ziglang", "cc"], []),
    "aarch64": (["aarch64-linux-gnu-gcc", "-static"], ["qemu-aarch64-static"]),
    "armhf": (["arm-linux-gnueabihf-gcc", "-static"], ["qemu-arm-static"]),
    "win64": ([sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu"], ["wine"]),
}
LEVELS = ("-O0", "-O2", "-O3")
FLAGS = ("-std=c99", "-ffp-contract=off")
CORTEX_M4F = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-Os", "-std=c99")
CODE, RAM, STACK = 0x0001_0000, 0x2000_0000, 0x3001_0000  # addresses of the simulated microcontroller
PAINT = 0xA5  # of the stack, to see how much of it was used
# Rules of MISRA C that the code departs from, and why.
DEVIATIONS = {
    "15.5": "early return keeps short functions readable",
    "12.1": "operator precedence as in the equations",
    "15.6": "one-line bodies without braces",
    "2.5": "constants of the header that a user may not need",
    "2.3": "the type of networks, unused in a model without",
    "8.7": "the interface is for other files",
    "14.4": "flags are numbers of C99",
    "10.1": "flags are numbers of C99",
    "10.4": "flags are numbers of C99",
    "13.4": "several states take one value",
    "17.8": "a value that is not valid is replaced at once",
    "18.4": "reading and writing bytes in order",
    "12.3": "loops over two counters",
    "13.3": "reading and writing bytes in order",
    "14.2": "loops that count down",
    "10.6": "1 and 0 of a condition, as int",
    "21.15": "the bits of a number as an integer: no other way is portable",
    "21.6": "replay program only",
}
BENCH = """
#include "hitch.h"
static hitch_state state;
static hitch_input input;
static hitch_output output;
void bench_init(void) { hitch_init(&state, START%LOAD%); }
void bench_step(void)
{
    input.lifting_command = COMMAND;
    input.displacement_measured = output.displacement;
    input.measurement_valid = MEASURED;
    hitch_step(&state, &input, &output);
}
"""


def main() -> int:
    """Print one line for each compiler, precision and check."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.export")
    parser.add_argument(
        "models", nargs="*", help="model folders; by default rig-a and excavator-boom are identified"
    )
    for folder in parser.parse_args().models:
        report(hitchid.load(folder))
    if not parser.parse_args().models:
        for name in ("rig-a", "excavator-boom"):
            say(f"{name}:")
            report(hitchid.identify(hitchid.read(DATA / name)).model)
    return 0


def report(model: hitchid.Hitch) -> None:
    """Print the lines of a model."""
    say(f"Octave: {of_octave(model)}")
    for compensators in (False, True):
        verified = verified_source(model, "hitch", precision="mixed", compensators=compensators)
        what = "with networks" if compensators else "physics alone"
        references: list[np.ndarray] = []
        for name, (command, runner) in COMPILERS.items():
            say(f"{what}, {name}: {of_compiler(verified, command, runner, references)}")
    for precision in ("mixed", "single"):
        for compensators in (True, False):
            verified = verified_source(model, "hitch", precision=precision, compensators=compensators)
            what = "with networks" if compensators else "physics alone"
            say(f"Cortex-M4F, {precision}, {what}: {cortex(verified)}")
    say(
        f"cppcheck with MISRA: {misra(verified_source(model, 'hitch', precision='mixed', compensators=True))}"
    )


def of_octave(model: hitchid.Hitch) -> str:
    """Return the largest differences of the functions of MATLAB, and of their controller beside that in C."""
    if find_octave() is None:
        return "not installed"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        model.save(folder / "model")
        save_controller(tune(model), model, folder / "controller.toml", model_folder="model")
        controller = load_controller(folder / "controller.toml")
        written = to_matlab(model, folder / "m", controller=controller)
        to_c(model, folder / "c", precision="double", controller=controller)
        differences = [
            json.loads((folder / target / MANIFEST).read_text())["controller"]["current_difference"]
            for target in ("m", "c")
        ]
    if (parity := written.parity) is None:
        return "not verified"
    return (
        f"{parity.measured:.1e}/{parity.free_run:.1e} modes {parity.modes}; controller, of the largest "
        f"current: {differences[0]:.1e}, in C {differences[1]:.1e}"
    )


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def of_compiler(
    verified: VerifiedSource, command: list[str], runner: list[str], references: list[np.ndarray]
) -> str:
    """Return the largest differences from the model, and in ulp from the first compiler, of a compiler."""
    if any(shutil.which(each) is None for each in (command[0], *runner)):
        return "not installed"
    texts = []
    with tempfile.TemporaryDirectory() as place:
        folder = write(verified, Path(place))
        for level in LEVELS:
            program = folder / f"replay{level}.exe"
            arguments = [*command, *FLAGS, level, "hitch.c", REPLAY, "-lm", "-o", program.name]
            done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603
            if done.returncode:
                return f"failed: {done.stderr[:200]}"
            rows = tuple(replay([*runner, str(program)], run, folder) for run in verified.runs)
            parity = compare(verified.runs, rows, verified.travel_range)
            shown = np.concatenate([each[:, 0] for each in rows])
            references.append(shown)
            ulp = np.max(np.abs(shown - references[0]) / np.spacing(np.abs(references[0])))
            texts.append(
                f"{level} {parity.measured:.1e}/{parity.free_run:.1e} modes {parity.modes} ulp {ulp:.0f}"
            )
    return "; ".join(texts)


def write(verified: VerifiedSource, folder: Path) -> Path:
    """Write the generated files of a model."""
    for name, text in verified.files.items():
        (folder / name).write_text(text)
    return folder


def cortex(verified: VerifiedSource) -> str:
    """Return instructions of a step with and without measurement, and memory."""
    if shutil.which("arm-none-eabi-gcc") is None:
        return "arm-none-eabi-gcc is not installed"
    covered = next(iter(verified.model.channels.values()))
    command = covered.dead_zone + 0.5 * float(covered.operating_range.command.highest)
    instructions, stack = {}, 0
    with tempfile.TemporaryDirectory() as place:
        folder = write(verified, Path(place))
        text = BENCH.replace("COMMAND", f"(hitch_real){command}").replace(
            "START", f"(hitch_real){verified.runs[0].start}"
        )
        text = text.replace("%LOAD%", ", 0" if verified.constants.covariates else "")
        for measured in (1, 0):
            (folder / "bench.c").write_text(text.replace("MEASURED", str(measured)))
            compile_for_cortex(folder)
            instructions[measured], used = count_instructions(folder / "bench.elf")
            stack = max(stack, used)
        rom, ram = memory_of(folder)
    return (
        f"{instructions[1]} instructions measured, {instructions[0]} in free run; ROM {rom[0]} bytes, "
        f"with the C library {rom[1]}; state {ram} bytes, stack {stack} bytes"
    )


def compile_for_cortex(folder: Path) -> None:
    """Compile the model and the loop around it without an operating system."""
    command = [
        "arm-none-eabi-gcc",
        *CORTEX_M4F,
        "-ffp-contract=off",
        "-fno-math-errno",
        "-ffunction-sections",
    ]
    command += ["-nostartfiles", "--specs=nosys.specs", "-Wl,--gc-sections", "-Wl,-e,bench_step"]
    command += [
        "-Wl,-u,bench_init",
        f"-Wl,-Ttext={CODE:#x}",
        f"-Wl,-Tdata={RAM:#x}",
        f"-Wl,-Tbss={RAM + 0x4000:#x}",
    ]
    command += ["hitch.c", "bench.c", "-lm", "-o", "bench.elf"]
    subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)  # noqa: S603


def memory_of(folder: Path) -> tuple[tuple[int, int], int]:
    """Return bytes of code and constants of the model and of the program, and of the state."""
    command = ["arm-none-eabi-gcc", *CORTEX_M4F, "-ffp-contract=off", "-fno-math-errno", "-c", "hitch.c"]
    subprocess.run(command, cwd=folder, capture_output=True, check=True)  # noqa: S603
    roms, state = [], 0
    for name in ("hitch.o", "bench.elf"):
        done = subprocess.run(  # noqa: S603
            ["arm-none-eabi-size", "-A", name],  # noqa: S607
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
        rows = [row for row in map(str.split, done.stdout.splitlines()) if row[1:] and row[1].isdigit()]
        sizes = {row[0]: int(row[1]) for row in rows}
        kept = (".text", ".rodata", ".ARM", ".data")
        roms.append(sum(size for section, size in sizes.items() if section.startswith(kept)))
        state = sizes.get(".bss", 0)
    return (roms[0], roms[1]), state


def symbols(path: Path) -> dict[str, int]:
    """Return name to address of the functions of a program."""
    done = subprocess.run(["arm-none-eabi-nm", path], capture_output=True, text=True, check=True)  # noqa: S603, S607
    return {name: int(address, 16) for address, _, name in re.findall(r"(\w+) (\w) (\w+)", done.stdout)}


def count_instructions(path: Path) -> tuple[int, int]:
    """Return instructions and bytes of stack of the last of a hundred steps."""
    from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_MODE_THUMB, Uc
    from unicorn.arm_const import UC_ARM_REG_C1_C0_2, UC_ARM_REG_FPEXC, UC_ARM_REG_LR, UC_ARM_REG_SP

    machine = Uc(UC_ARCH_ARM, UC_MODE_THUMB)
    for start, size in ((0, 0x20_0000), (RAM, 0x10_0000), (STACK - 0x1_0000, 0x2_0000)):
        machine.mem_map(start, size)
    content = path.read_bytes()
    offset, count = struct.unpack_from("<I", content, 28)[0], struct.unpack_from("<H", content, 44)[0]
    for number in range(count):
        kind, at, address, _, size = struct.unpack_from("<5I", content, offset + 32 * number)
        if kind == 1:
            machine.mem_write(address, content[at : at + size])
    machine.reg_write(UC_ARM_REG_C1_C0_2, machine.reg_read(UC_ARM_REG_C1_C0_2) | (0xF << 20))
    machine.reg_write(UC_ARM_REG_FPEXC, 0x4000_0000)
    known, stop, counted = symbols(path), 0x1000, [0]

    def call(name: str) -> None:
        machine.reg_write(UC_ARM_REG_SP, STACK)
        machine.reg_write(UC_ARM_REG_LR, stop | 1)
        machine.emu_start(known[name] | 1, stop)

    machine.hook_add(UC_HOOK_CODE, lambda *_: counted.__setitem__(0, counted[0] + 1))
    call("bench_init")
    for _ in range(99):
        call("bench_step")
    machine.mem_write(STACK - 0x8000, bytes([PAINT]) * 0x8000)
    counted[0] = 0
    call("bench_step")
    left = bytes(machine.mem_read(STACK - 0x8000, 0x8000))
    untouched = len(left) - len(left.lstrip(bytes([PAINT])))
    return counted[0], 0x8000 - untouched


def misra(verified: VerifiedSource) -> str:
    """Return the required rules that cppcheck's add-on finds broken, without the written deviations."""
    if shutil.which("cppcheck") is None:
        return "not installed"
    with tempfile.TemporaryDirectory() as place:
        folder = write(verified, Path(place))
        done = subprocess.run(
            ["cppcheck", "--addon=misra", "--enable=style", "--std=c99", "hitch.c"],  # noqa: S607
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
    found: dict[str, int] = {}
    for rule in re.findall(r"misra-c2012-([\d.]+)", done.stderr):
        found[rule] = found.get(rule, 0) + 1
    others = re.findall(r"hitch\.c:\d+:\d+: (?:error|warning): .*", done.stderr)
    open_rules = {rule: count for rule, count in sorted(found.items()) if rule not in DEVIATIONS}
    return f"without deviation {open_rules or 'none'}; other findings {others[:3] or 'none'}"


if __name__ == "__main__":
    raise SystemExit(main())
