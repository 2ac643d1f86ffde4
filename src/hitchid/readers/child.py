"""The program of the reader process; see `process`.

A request is a line of JSON. The response is a line once the format's libraries are loaded, a line of JSON,
and the samples, float64 in the machine's byte order.
"""

import importlib
import json
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np

from hitchid.data.content import Content
from hitchid.errors import LogError
from hitchid.readers.content import MAX_UNPACK_RATIO, ChannelSelection, max_unpacked_bytes
from hitchid.readers.formats import Format, format_of
from hitchid.readers.process import READY

# Memory limit, bytes: a part for the interpreter and libraries, and bytes a byte of the file; chosen.
BASE_MEMORY_BYTES, MEMORY_PER_FILE_BYTE = 3 * 2**29, 16


def main() -> None:
    """Answer requests from standard input until it ends."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of a library must not mix with the responses
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process decides when this one ends
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
            _send(output, {"problem": "needs more memory than allowed for its size; refused"})
        except Exception as error:  # a library may raise anything on a damaged file
            _send(output, {"problem": f"cannot be read: {type(error).__name__}: {error}"})
        else:
            _send_content(output, content, max_unpacked_bytes(path))


def _load_libraries(log_format: Format) -> None:
    for library in log_format.libraries:
        try:
            importlib.import_module(library)
        except ImportError:  # the reader's error names the missing library
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


def _send(output: IO[bytes], response: Mapping[str, object]) -> None:
    output.write(json.dumps(response).encode() + b"\n")
    output.flush()


def _limit_memory(path: Path) -> None:
    """Limit the memory by the size of the file, on systems that can."""
    try:
        import resource
    except ImportError:
        return
    limit_bytes = BASE_MEMORY_BYTES + MEMORY_PER_FILE_BYTE * path.stat().st_size
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, resource.getrlimit(resource.RLIMIT_DATA)[1]))


if __name__ == "__main__":
    main()
