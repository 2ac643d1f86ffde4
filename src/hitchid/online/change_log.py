"""The change log of an adaptation that runs, as a file to which each event is added at once."""

import contextlib
import errno
import os
from pathlib import Path

from hitchid.adaptation import Event
from hitchid.adaptation.log_file import digest_line, read_log
from hitchid.errors import InputError, OutputError
from hitchid.model import Hitch


class ChangeLog:
    """A change log that goes on from an existing one, and that no other process writes meanwhile.

    Its first line is the digest of its model, so that it is not gone on from with another one.

    Args:
        path: JSON lines; made where there is none, and removed at the end where nothing happened.
        model: that is adapted.

    Attributes:
        earlier: events that it had before.

    Raises:
        InputError: an existing file is no change log, or that of another model.
        OutputError: it cannot be written, or another process writes it.
    """

    def __init__(self, path: Path, model: Hitch) -> None:
        self._path, self._first = path, digest_line(model)
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: cannot be a change log: expected a file")
        self._made = [] if path.exists() else [path, *(each for each in path.parents if not each.exists())]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("ab", buffering=0)
        except OSError as error:
            raise self._failure(error) from error
        try:
            self._lock()
            # Read before anything of it is changed.
            self.earlier, size = read_log(path, model)
            self._file.seek(self._file.truncate(size))
            if size and not _ends_line(path):
                self._append(b"\n")
        except OSError as error:
            self._file.close()
            raise self._failure(error) from error
        except BaseException:
            self._file.close()
            raise

    def write(self, event: Event) -> None:
        """Add an event.

        Raises:
            OutputError: it cannot be written.
        """
        first = "" if self._file.tell() else self._first
        try:
            self._append(f"{first}{event.to_json()}\n".encode())
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Close the file; one that was made, and the folders for it, are removed where nothing happened."""
        if self._made and not self._file.tell():
            file, *folders = self._made
            file.unlink(missing_ok=True)  # before the lock is given up: another process may wait for it
            with contextlib.suppress(OSError):  # another program has put something into a folder
                for folder in folders:
                    folder.rmdir()
        self._file.close()

    def _append(self, line: bytes) -> None:
        """Add a line whole or not at all."""
        before = self._file.tell()
        try:
            if self._file.write(line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            with contextlib.suppress(OSError):
                self._file.seek(self._file.truncate(before))
            raise

    def _lock(self) -> None:
        """Let no other process write the file until this one closes it or ends; Windows has no such lock.

        Raises:
            OutputError: another process writes it.
        """
        with contextlib.suppress(ImportError):
            import fcntl

            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                is_there = os.path.samestat(os.fstat(self._file.fileno()), os.stat(self._path))
            except (BlockingIOError, FileNotFoundError):
                is_there = False  # another process has it, or has just removed it
            if not is_there:
                raise OutputError(
                    f"{self._path}: another process writes this change log; end it, or give another file"
                )

    def _failure(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path}: cannot be written: {error.strerror}")


def _ends_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read() == b"\n"
