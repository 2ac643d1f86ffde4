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
from hitchid.readers.content import MAX_UNPACK_RATIO, ChannelSelection, Content, max_unpacked_bytes
from hitchid.readers.formats import Format, format_of
from hitchid.readers.process import READY

BASE_MEMORY_BYTES, MEMORY_PER_FILE_BYTE = 3 * 2**29, 16


def main() -> None:
    """Answer requests from standard input until it ends."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not come between the answers
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that asks decides when this one ends
    for request in sys.stdin.buffer:
        query = json.loads(request)
        path = Path(query["path"])
        log_format = format_of(path)
        _load_libraries(log_format)
        output.write(READY)
        output.flush()
        _limit_memory(path)
        try:
            databases = tuple(map(Path, query["databases"]))
            signals = None if query["signals"] is None else tuple(query["signals"])
            content = log_format.read(path, ChannelSelection(query["time"], signals, databases))
        except LogError as error:
            _send(output, {"problem": error.problem, "line": error.line, "column": error.column})
        except MemoryError:
            _send(output, {"problem": "needs more memory than a log of its size may; refused"})
        except Exception as error:  # a library may raise anything on a damaged file
            _send(output, {"problem": f"cannot be read: {type(error).__name__}: {error}"})
        else:
            _send_content(output, content, max_unpacked_bytes(path))


def _load_libraries(log_format: Format) -> None:
    for library in log_format.libraries:
        try:
            importlib.import_module(library)
        except ImportError:  # the reader says what is missing
            return


def _send_content(output: IO[bytes], content: Content, max_bytes: int) -> None:
    clocks = {
        id(channel.clock_s): channel.clock_s
        for channel in content.channels.values()
        if channel.clock_s is not None
    }
    order = list(clocks)
    channels = [
        [
            name,
            channel.unit,
            channel.values.size,
            None if channel.clock_s is None else order.index(id(channel.clock_s)),
        ]
        for name, channel in content.channels.items()
    ]
    sizes = [clock.size for clock in clocks.values()]
    if 8 * (sum(sizes) + sum(entry[2] for entry in channels)) > max_bytes:
        _send(output, {"problem": f"unpacks to more than {MAX_UNPACK_RATIO} times its size; refused"})
        return
    _send(output, {"channels": channels, "clocks": sizes, "notices": content.notices})
    for samples in (*clocks.values(), *(channel.values for channel in content.channels.values())):
        output.write(np.ascontiguousarray(samples, dtype=np.float64).data)
    output.flush()


def _send(output: IO[bytes], response: dict[str, Any]) -> None:
    output.write(json.dumps(response).encode() + b"\n")
    output.flush()


def _limit_memory(path: Path) -> None:
    """Bound what a damaged file may ask for by its size, where the system can."""
    try:
        import resource
    except ImportError:
        return
    limit_bytes = BASE_MEMORY_BYTES + MEMORY_PER_FILE_BYTE * path.stat().st_size
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, resource.getrlimit(resource.RLIMIT_DATA)[1]))


if __name__ == "__main__":
    main()
