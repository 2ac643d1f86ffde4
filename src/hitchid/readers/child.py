"""The program that reads logs for another process; see `process`.

A request is a line of JSON. The answer is a line once the format's libraries are loaded, then a line of JSON
and the samples behind it, float64 in the machine's byte order.
"""

import importlib
import json
import os
import signal
import sys
from pathlib import Path
from typing import IO, Any

import numpy as np

from hitchid.errors import LogError
from hitchid.readers.content import LARGEST_RATIO, Content, Wanted, largest
from hitchid.readers.formats import Format, format_of
from hitchid.readers.process import BEGUN

ROOM, ROOM_PER_BYTE = 3 * 2**29, 16


def main() -> None:
    """Answer requests from standard input until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not come between the answers
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that asks decides when this one ends
    for request in sys.stdin.buffer:
        asked = json.loads(request)
        path = Path(asked["path"])
        known = format_of(path)
        _load(known)
        answers.write(BEGUN)
        answers.flush()
        _limit_memory(path)
        try:
            databases = tuple(map(Path, asked["databases"]))
            signals = None if asked["signals"] is None else tuple(asked["signals"])
            content = known.read(path, Wanted(asked["time"], signals, databases))
        except LogError as error:
            _tell(answers, {"problem": error.problem, "line": error.line, "column": error.column})
        except MemoryError:
            _tell(answers, {"problem": "needs more memory than a log of its size may; refused"})
        except Exception as error:  # a library may raise anything on a damaged file
            _tell(answers, {"problem": f"cannot be read: {type(error).__name__}: {error}"})
        else:
            _hand_over(answers, content, largest(path))


def _load(known: Format) -> None:
    for library in known.libraries:
        try:
            importlib.import_module(library)
        except ImportError:  # the reader says what is missing
            return


def _hand_over(answers: IO[bytes], content: Content, most: int) -> None:
    clocks = {
        id(each.clock_s): each.clock_s for each in content.channels.values() if each.clock_s is not None
    }
    order = list(clocks)
    channels = [
        [name, each.unit, each.values.size, None if each.clock_s is None else order.index(id(each.clock_s))]
        for name, each in content.channels.items()
    ]
    sizes = [clock.size for clock in clocks.values()]
    if 8 * (sum(sizes) + sum(each[2] for each in channels)) > most:
        _tell(answers, {"problem": f"unpacks to more than {LARGEST_RATIO} times its size; refused"})
        return
    _tell(answers, {"channels": channels, "clocks": sizes, "notices": content.notices})
    for samples in (*clocks.values(), *(each.values for each in content.channels.values())):
        answers.write(np.ascontiguousarray(samples, dtype=np.float64).data)
    answers.flush()


def _tell(answers: IO[bytes], answer: dict[str, Any]) -> None:
    answers.write(json.dumps(answer).encode() + b"\n")
    answers.flush()


def _limit_memory(path: Path) -> None:
    """Bound what a damaged file may ask for by its size, where the system can."""
    try:
        import resource
    except ImportError:
        return
    room = ROOM + ROOM_PER_BYTE * path.stat().st_size
    resource.setrlimit(resource.RLIMIT_DATA, (room, resource.getrlimit(resource.RLIMIT_DATA)[1]))


if __name__ == "__main__":
    main()
