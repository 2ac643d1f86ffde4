"""The C compiler of this machine, or the one of the package ziglang."""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from hitchid.errors import InputError

COMMANDS = ("cc", "gcc", "clang")
STANDARD = ("-std=c99", "-O2", "-ffp-contract=off")
TIMEOUT_S = 300.0  # the first program for another platform takes ziglang 90 s


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
        place = sources[0].parent
        # Relative names: libraries for some platforms hold them, and must not depend on the folder.
        names = [path.name if path.parent == place else str(path) for path in (*sources, out)]
        arguments = [*self.command, *STANDARD, *options, "-o", names[-1], *names[:-1], "-lm"]
        # The sources are our own, the compiler is the user's.
        done = subprocess.run(  # noqa: S603
            arguments, cwd=place, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        if done.returncode:
            first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
            raise InputError(
                f"{shlex.join(self.command)}: cannot compile the generated code: {first.strip()}"
            )


def find_compiler() -> Compiler | None:
    """Return the compiler of `CC`, else the first of cc, gcc, clang and ziglang; None where there is none."""
    candidates = [shlex.split(os.environ.get("CC", ""))] + [[name] for name in COMMANDS]
    candidates.append(zig() or [])
    for candidate in candidates:
        if candidate and (program := shutil.which(candidate[0])):
            version = _version((program, *candidate[1:]))
            if version:
                return Compiler((program, *candidate[1:]), version)
    return None


def zig() -> list[str] | None:
    """Return the command of ziglang's C compiler; None where the package is not installed."""
    return [sys.executable, "-m", "ziglang", "cc"] if find_spec("ziglang") else None


def zig_compiler() -> Compiler | None:
    """Return ziglang's compiler, which compiles for other platforms; None where it is not installed."""
    command = zig()
    return None if command is None else Compiler(tuple(command), "ziglang")


def _version(command: Sequence[str]) -> str:
    """Return the first line of a compiler's version; empty where it does not run."""
    try:
        done = subprocess.run(  # noqa: S603
            [*command, "--version"], capture_output=True, text=True, timeout=TIMEOUT_S, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.partition("\n")[0].strip()
