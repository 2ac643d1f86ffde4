"""Lines of a text stream as they come, with something to do while none comes."""

import os
import select
from collections.abc import Callable, Iterable, Iterator
from io import TextIOWrapper

CHUNK_BYTES = 1 << 16  # read at once; the size of a pipe on Linux
MAX_LINE_BYTES = 1 << 20  # kept of a line, so that one without end does not fill the memory; chosen
CUT = "\N{HORIZONTAL ELLIPSIS}"  # ends a line of which the rest was left out: whoever reads it can tell


def lines(stream: Iterable[str], quiet_s: float, when_quiet: Callable[[], object]) -> Iterator[str]:
    """Yield the lines of a stream, each as soon as it is complete, without its end of line.

    Of a line beyond 1 MiB the rest is left out, and its last character is an ellipsis.

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
    if file is None:
        yield from (line.rstrip("\n") for line in stream)
        return
    begun = bytearray()
    while True:
        if quiet_s > 0 and not select.select([file], [], [], quiet_s)[0]:
            when_quiet()
        chunk = os.read(file, CHUNK_BYTES)
        *complete, rest = chunk.split(b"\n")
        for end in complete:
            _extend(begun, end)
            yield _text(begun)
            begun.clear()
        _extend(begun, rest)
        if not chunk:
            if begun:
                yield _text(begun)
            return


def _extend(line: bytearray, more: bytes) -> None:
    """Add bytes to a line, one more than are kept at most: each byte is copied once, however long it is."""
    line += more[: MAX_LINE_BYTES + 1 - len(line)]


def _text(line: bytearray) -> str:
    text = line[:MAX_LINE_BYTES].decode(errors="replace")
    return text if len(line) <= MAX_LINE_BYTES else f"{text}{CUT}"


def _descriptor(stream: Iterable[str]) -> int | None:
    """Return the number by which the system can wait for a stream; None where it cannot."""
    if os.name != "posix" or not isinstance(stream, TextIOWrapper):
        return None
    try:
        return stream.fileno()
    except OSError:
        return None
