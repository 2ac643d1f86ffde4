"""The reader process, in which third-party libraries read logs.

On a damaged file such a library may crash, hang or exhaust the memory; here that becomes an error message.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from hitchid.data.content import Content, LogChannel
from hitchid.errors import LogError
from hitchid.readers.content import ChannelSelection

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
            limit_s = (
                LONGEST_S + path.stat().st_size / BYTES_PER_S + _database_time_limit_s(selection.databases)
            )
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
        except TimeoutError:
            self._end()
            raise LogError(path, f"cannot be read within {limit_s:.0f} s: it is damaged") from None
        except (EOFError, BrokenPipeError):
            self._end()
            raise LogError(path, "cannot be read: it is damaged, and its reader crashed") from None
        except BaseException:
            self._end()
            raise

    def _end(self) -> None:
        if self._child is not None:
            self._child.kill()
            self._child.communicate()
            self._child = None


def _database_time_limit_s(databases: Sequence[Path]) -> float:
    """Return the longest time that reading databases may take, s."""
    size = sum(database.stat().st_size for database in databases if database.is_file())
    return min(size / DATABASE_BYTES_PER_S, LONGEST_DATABASES_S)


def _start_child() -> "subprocess.Popen[bytes]":
    paths = os.pathsep.join(path for path in sys.path if path)
    return subprocess.Popen(
        [sys.executable, "-m", "hitchid.readers.child"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": paths, "PYTHONSAFEPATH": "1"},
    )


def _request_content(child: "subprocess.Popen[bytes]", path: Path, request: bytes, limit_s: float) -> Content:
    stdin, stdout = child.stdin, child.stdout
    assert stdin is not None  # noqa: S101 - both are pipes
    assert stdout is not None  # noqa: S101
    with _time_limit(child, LONGEST_START_S):
        stdin.write(request)
        stdin.flush()
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
