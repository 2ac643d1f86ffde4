"""Lines of a text stream as they come, with something to do while none comes."""

import os
import select
from collections.abc import Callable, Iterable, Iterator
from io import TextIOWrapper

CHUNK_BYTES = 1 << 16  # read at once; the size of a pipe on Linux


def lines(stream: Iterable[str], quiet_s: float, when_quiet: Callable[[], object]) -> Iterator[str]:
    """Yield the lines of a stream, each as soon as it is complete, without its end of line.

    Where none came for a time, something is done once, before waiting for the next one. That is left out
    where the system cannot tell whether a stream has something to read: for files in memory, and on Windows.

    Args:
        stream: a text file is read as UTF-8; what is not becomes U+FFFD.
        quiet_s: time, s; never where it is not positive.
        when_quiet: what to do.
    """
    if isinstance(stream, TextIOWrapper):
        stream.reconfigure(encoding="utf-8", errors="replace")
    file = _descriptor(stream)
    if file is None or quiet_s <= 0:
        yield from (line.rstrip("\n") for line in stream)
        return
    begun = b""
    while True:
        if not select.select([file], [], [], quiet_s)[0]:
            when_quiet()
        chunk = os.read(file, CHUNK_BYTES)
        *complete, begun = (begun + chunk).split(b"\n")
        yield from (line.decode(errors="replace") for line in complete)
        if not chunk:
            if begun:
                yield begun.decode(errors="replace")
            return


def _descriptor(stream: Iterable[str]) -> int | None:
    """Return the number by which the system can wait for a stream; None where it cannot."""
    if os.name != "posix" or not isinstance(stream, TextIOWrapper):
        return None
    try:
        return stream.fileno()
    except OSError:
        return None
