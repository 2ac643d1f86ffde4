"""How long whole runs take, ours and others in turn, kept for the page of results."""

import json
import os
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

OURS = "hitchid"
COMPILED = "JAX_COMPILATION_CACHE_DIR"


@dataclass(frozen=True)
class Timing:
    """Times of one piece of work done by one program.

    Attributes:
        part: the comparison it belongs to.
        what: the work, the same words for all who do it.
        by: who did it; a bar is by what sets it.
        seconds: of each run, s.
        note: what a reader should know of it.
    """

    part: str
    what: str
    by: str
    seconds: Sequence[float]
    note: str = ""


class TimingLog:
    """Collects timings of one part and keeps them with those of all others."""

    def __init__(self, part: str, timings: list[Timing]) -> None:
        self._part, self._timings = part, timings

    def note(self, what: str, times: Mapping[str, Sequence[float]], note: str = "") -> None:
        """Take in the seconds of each who did a piece of work."""
        self._timings += [Timing(self._part, what, by, list(seconds), note) for by, seconds in times.items()]

    def interleave(
        self, what: str, work: Mapping[str, Callable[[], object]], runs: int, note: str = ""
    ) -> None:
        """Run the work of each in turn, so that whatever slows the machine slows all alike.

        Args:
            what: the work.
            work: name to a function that does it; where it returns a float, these are the seconds.
            runs: of each.
            note: what a reader should know.
        """
        seconds: dict[str, list[float]] = {by: [] for by in work}
        for _ in range(runs):
            for by, do in work.items():
                started = time.perf_counter()
                result = do()
                seconds[by].append(result if isinstance(result, float) else time.perf_counter() - started)
        self.note(what, seconds, note)


def write_timings(path: Path, timings: Sequence[Timing]) -> None:
    """Write timings as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps([asdict(timing) for timing in timings], indent=1), encoding="utf-8")


def process(command: Sequence[str | Path], cache: Path | None = None) -> str:
    """Run a program to its end and return what it said.

    Args:
        command: program and arguments.
        cache: folder that stands for the user's cache; None for the user's own.

    Raises:
        RuntimeError: it failed; its last words are told.
    """
    completed = subprocess.run(  # noqa: S603
        list(map(str, command)), capture_output=True, text=True, env=environment(cache)
    )
    if completed.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}: {completed.stderr[-2000:]}")
    return completed.stdout


def environment(cache: Path | None) -> dict[str, str]:
    """Return the environment of a program whose user's cache is a folder."""
    variables = dict(os.environ)
    if cache is not None:
        variables.pop(COMPILED, None)
        variables["XDG_CACHE_HOME"] = str(cache)
    return variables
