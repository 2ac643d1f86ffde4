"""The change log of an adaptation that runs, as a file to which each event is added at once."""

import contextlib
from pathlib import Path

from hitchid.adaptation import Event, read_events
from hitchid.adaptation.log_file import digest_line
from hitchid.errors import OutputError
from hitchid.model import Hitch


class ChangeLog:
    """A change log that goes on from an existing one.

    Its first line is the digest of its model, so that it is not gone on from with another one.

    Args:
        path: JSON lines; made where there is none, and removed at the end where nothing happened.
        model: that is adapted.

    Attributes:
        earlier: events that it had before.

    Raises:
        InputError: an existing file is no change log, or that of another model.
        OutputError: it cannot be written.
    """

    def __init__(self, path: Path, model: Hitch) -> None:
        self._path, self._first = path, digest_line(model)
        # Read before anything of it is changed.
        self.earlier = read_events(path, model) if path.exists() else ()
        self._made = [] if path.exists() else [path, *(each for each in path.parents if not each.exists())]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("ab")
            self._file.seek(self._file.truncate(_complete_bytes(path)))
        except OSError as error:
            raise self._failure(error) from error

    def write(self, event: Event) -> None:
        """Add an event.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            if not self._file.tell():
                self._file.write(self._first.encode())
            self._file.write(f"{event.to_json()}\n".encode())
            self._file.flush()
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Close the file; one that was made, and the folders for it, are removed where nothing happened."""
        is_empty = not self._file.tell()
        self._file.close()
        if self._made and is_empty:
            file, *folders = self._made
            file.unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # another program has put something into a folder
                for folder in folders:
                    folder.rmdir()

    def _failure(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path}: cannot be written: {error.strerror}")


def _complete_bytes(path: Path) -> int:
    """Return the size of a file up to its last complete line: a process that was killed may have cut one."""
    content = path.read_bytes()
    return content.rfind(b"\n") + len(b"\n")
