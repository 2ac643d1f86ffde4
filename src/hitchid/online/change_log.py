"""The change log of an adaptation that runs, as a file to which each event is added at once."""

from pathlib import Path

from hitchid.adaptation import Event, read_events
from hitchid.errors import OutputError


class ChangeLog:
    """A change log that goes on from an existing one.

    Args:
        path: JSON lines; made where there is none.

    Attributes:
        earlier: events that it had before.

    Raises:
        InputError: an existing file is no change log.
        OutputError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.earlier = read_events(path) if path.exists() else ()  # before anything of it is changed
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("ab")
            self._file.truncate(_complete_bytes(path))
        except OSError as error:
            raise self._failure(error) from error

    def write(self, event: Event) -> None:
        """Add an event.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            self._file.write(f"{event.to_json()}\n".encode())
            self._file.flush()
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _failure(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path}: cannot be written: {error.strerror}")


def _complete_bytes(path: Path) -> int:
    """Return the size of a file up to its last complete line: a process that was killed may have cut one."""
    content = path.read_bytes()
    return content.rfind(b"\n") + len(b"\n")
