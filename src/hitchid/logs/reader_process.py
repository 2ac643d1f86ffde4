"""The reader process, in which third-party libraries read logs.

On a damaged file such a library may crash, hang or exhaust the memory; here that becomes an error message.
"""

import importlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import IO

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import MAX_UNPACK_RATIO, ChannelSelection, Content, LogChannel, max_unpacked_bytes
from hitchid.logs.formats import format_of

READY = b"begun\n"
# Time limits, chosen well above what intact files take: start of the child, s; reading a log, s, and bytes/s.
LONGEST_START_S, LONGEST_S, BYTES_PER_S = 120.0, 8.0, 2e6
LONGEST_DATABASES_S, DATABASE_BYTES_PER_S = 60.0, 1e5  # a database of 50 000 signals takes 10 s


class ReaderProcess(AbstractContextManager["ReaderProcess"]):
    """A process that reads logs one by one; it starts at the first log and ends with the context."""

    def __init__(self) -> None:
        """Leave the process to be started by the first log."""
        self._child: subprocess.Popen[bytes] | None = None

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self._end()

    def read(self, path: Path, selection: ChannelSelection) -> Content:
        """Read the selected channels of a log.

        Raises:
            LogError: the log cannot be read, or reading takes too long or too much memory.
        """
        try:
            size = sum(database.stat().st_size for database in selection.databases if database.is_file())
            databases_s = min(size / DATABASE_BYTES_PER_S, LONGEST_DATABASES_S)
            limit_s = LONGEST_S + path.stat().st_size / BYTES_PER_S + databases_s
        except OSError as error:
            raise LogError(path, f"cannot be read: {error.strerror}") from error
        if self._child is None:
            self._child = _start_child()
        request = {"path": str(path), "time": selection.time, "signals": selection.signals}
        request["databases"] = [str(database) for database in selection.databases]
        try:
            return _request_content(self._child, path, json.dumps(request).encode() + b"\n", limit_s)
        except LogError:  # a response like any other: the process goes on
            raise
        except (TimeoutError, EOFError, BrokenPipeError) as error:
            self._end()
            is_late = isinstance(error, TimeoutError)
            reason = f" within {limit_s:.0f} s" if is_late else ": its reader crashed"
            raise LogError(path, f"cannot be read{reason}; check whether the file is damaged") from None
        except BaseException:  # an interrupt: what is left of the response must not answer the next request
            self._end()
            raise

    def _end(self) -> None:
        if self._child is not None:
            self._child.kill()
            self._child.communicate()
            self._child = None


def _start_child() -> "subprocess.Popen[bytes]":
    # The child must find what this process has found, but no module in the working folder.
    paths = os.pathsep.join(path for path in sys.path if path)
    return subprocess.Popen(
        [sys.executable, "-c", "from hitchid.logs.reader_process import main; main()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": paths, "PYTHONSAFEPATH": "1"},
    )


def _request_content(child: "subprocess.Popen[bytes]", path: Path, request: bytes, limit_s: float) -> Content:
    stdin, stdout = child.stdin, child.stdout
    assert stdin is not None  # noqa: S101 - both are pipes
    assert stdout is not None  # noqa: S101
    # Two limits: to load a library takes longer than to read most logs with it.
    with _time_limit(child, LONGEST_START_S):
        stdin.write(request)
        stdin.flush()
        # Whatever a library prints goes elsewhere: anything but the agreed line is a child that failed.
        if stdout.readline() != READY:
            raise EOFError
    with _time_limit(child, limit_s):
        line = stdout.readline()
        if not line.endswith(b"\n"):
            raise EOFError
        response = json.loads(line)
        if "problem" in response:
            raise LogError(
                path, response["problem"], line=response.get("line"), column=response.get("column")
            )
        clocks = [_read_samples(stdout, size) for size in response["clocks"]]
        channels = {
            name: LogChannel(_read_samples(stdout, size), unit, None if clock is None else clocks[clock])
            for name, unit, size, clock in response["channels"]
        }
    return Content(path, channels, tuple(response["notices"]))


def _read_samples(stdout: IO[bytes], size: int) -> np.ndarray:
    # Into one buffer: a long log must not exist twice on its way through the pipe.
    samples = np.empty(size)
    view = samples.data.cast("B")
    while view:
        received = stdout.readinto(view)  # pyright: ignore[reportAttributeAccessIssue]
        if not received:
            raise EOFError
        view = view[received:]
    samples.setflags(write=False)
    return samples


@contextmanager
def _time_limit(child: "subprocess.Popen[bytes]", limit_s: float) -> Iterator[None]:
    """Kill the child if the body of the context takes longer.

    Raises:
        TimeoutError: the body took longer.
    """
    timed_out = threading.Event()

    def end() -> None:
        # Set before the kill: the reader of the pipe must see the reason when it finds the end.
        timed_out.set()
        child.kill()

    timer = threading.Timer(limit_s, end)
    timer.start()
    try:
        yield
    except (EOFError, BrokenPipeError):
        if timed_out.is_set():
            raise TimeoutError from None
        raise
    finally:
        timer.cancel()


# The program of the reader process. A request is a line of JSON. The response is a line once the format's
# libraries are loaded, a line of JSON, and the samples, float64 in the machine's byte order.

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
        with suppress(ImportError):  # the reader's error names the missing library
            for library in log_format.libraries:
                importlib.import_module(library)
        output.write(READY)
        output.flush()
        with suppress(ImportError):  # a system that can set no limit
            import resource

            # Anew for every log; the hard limit stays, or a larger file could never raise it again.
            limit_bytes = BASE_MEMORY_BYTES + MEMORY_PER_FILE_BYTE * path.stat().st_size
            hard_limit = resource.getrlimit(resource.RLIMIT_DATA)[1]
            resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, hard_limit))
        try:
            databases = tuple(map(Path, query["databases"]))
            signals = None if query["signals"] is None else tuple(query["signals"])
            content = log_format.read(path, ChannelSelection(query["time"], signals, databases))
        except LogError as error:
            _send(output, {"problem": error.problem, "line": error.line, "column": error.column})
        except MemoryError:
            _send(output, {"problem": "needs more memory than is allowed for its size; check the file"})
        except Exception as error:  # a library may raise anything on a damaged file
            _send(output, {"problem": f"cannot be read: {type(error).__name__}: {error}"})
        else:
            _send_content(output, content, max_unpacked_bytes(path))


def _send_content(output: IO[bytes], content: Content, max_bytes: int) -> None:
    clocks, channels = {}, []  # channels on one clock share one array
    for name, channel in content.channels.items():
        if channel.clock_s is not None:
            clocks.setdefault(id(channel.clock_s), channel.clock_s)
        number = None if channel.clock_s is None else list(clocks).index(id(channel.clock_s))
        channels.append([name, channel.unit, channel.values.size, number])
    sizes = [clock.size for clock in clocks.values()]
    # Told by the child: the parent must not allocate what a hostile file claims.
    if 8 * (sum(sizes) + sum(entry[2] for entry in channels)) > max_bytes:
        _send(output, {"problem": f"unpacks to more than {MAX_UNPACK_RATIO} times its size; check the file"})
        return
    _send(output, {"channels": channels, "clocks": sizes, "notices": content.notices})
    for samples in (*clocks.values(), *(channel.values for channel in content.channels.values())):
        output.write(np.ascontiguousarray(samples, dtype=np.float64).data)
    output.flush()


def _send(output: IO[bytes], response: Mapping[str, object]) -> None:
    output.write(json.dumps(response).encode() + b"\n")
    output.flush()
