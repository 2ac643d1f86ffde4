"""Finished pieces of long work, each kept in a file of its own and found again after a stop."""

import io
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hitchid._support.storage import canonical_json, digest, write_bytes
from hitchid.errors import InputError

Arrays = Mapping[str, np.ndarray]
Cached = TypeVar("Cached")
SUFFIX, RUN_FILE, FAILED_FILE = ".npz", "run.json", "failed"
DIGEST_LENGTH = 64  # characters of a SHA-256 in hexadecimal
MAX_READABLE, HASH_LENGTH = 80, 16  # characters of a file name: legible part, and digest of the names


@dataclass(frozen=True)
class Checkpoints:
    """Where finished pieces are kept.

    Attributes:
        folder: of one run, or of pieces whose names say all that went into them; None keeps nothing.
        parents: the parts of the work that the pieces belong to, from the largest.
    """

    folder: Path | None = None
    parents: tuple[str, ...] = ()

    @classmethod
    def of_run(cls, folder: Path, content: Mapping[str, Any]) -> "Checkpoints":
        """Return the place where the pieces of one run are kept, and found again by the same run alone.

        Args:
            folder: where; made with the first piece.
            content: all that decides on the outcome, as JSON can hold it.

        Raises:
            InputError: the folder holds pieces of another run, or something else.
        """
        stamp, run_file = canonical_json(content), folder / RUN_FILE
        if run_file.is_file():
            if run_file.read_bytes() != stamp:
                raise InputError(
                    f"{folder}: holds an unfinished run of other logs, other settings or another version; "
                    "required the same ones; --force without --resume begins anew"
                )
        elif folder.is_dir() and any(
            not child_path.name.startswith(f".{RUN_FILE}-") for child_path in folder.iterdir()
        ):
            raise InputError(f"{folder}: holds no unfinished run; required another place, or an empty folder")
        else:
            write_bytes(run_file, stamp, force=True)
        return cls(folder)

    def child(self, name: str) -> "Checkpoints":
        """Return the place of the pieces of a part of the work."""
        return replace(self, parents=(*self.parents, name))

    def cached_arrays(self, name: str, work: Callable[[], Arrays]) -> Arrays:
        """Return what was kept under a name, or else do the work and keep what comes.

        Raises:
            OutputError: it cannot be written.
        """
        if self.folder is None:
            return work()
        path = self.folder / _file_name(*self.parents, name)
        arrays = _read(path)
        if arrays is None:
            arrays = dict(work())
            write_bytes(path, _with_digest(arrays), force=True)
        return arrays

    def cached(self, name: str, kind: Callable[..., Cached], work: Callable[[], Cached]) -> Cached:
        """Return a record of numbers, texts and arrays kept under a name, or else do the work and keep it.

        Args:
            name: of the piece.
            kind: a dataclass of such fields.
            work: returns one.

        Raises:
            OutputError: it cannot be written.
        """

        def as_arrays() -> Arrays:
            record: Any = work()
            return {field.name: np.asarray(getattr(record, field.name)) for field in fields(record)}

        arrays = self.cached_arrays(name, as_arrays)
        return kind(**{name: value if value.ndim else value.item() for name, value in arrays.items()})


DISABLED = Checkpoints()


def has_results(folder: Path) -> bool:
    """Tell whether anything was finished in a folder."""
    return any(folder.glob(f"*{SUFFIX}"))


def mark_failed(folder: Path, *, failed: bool) -> None:
    """Note whether the run in a folder ended with an error: the next one may then begin in its place."""
    with suppress(OSError):  # a full disk, mostly: the run can then be gone on with, as after a stop
        if failed:
            (folder / FAILED_FILE).touch()
        else:
            (folder / FAILED_FILE).unlink(missing_ok=True)


def has_failed(folder: Path) -> bool:
    """Tell whether the run in a folder ended with an error."""
    return is_run(folder) and (folder / FAILED_FILE).is_file()


def is_run(folder: Path) -> bool:
    """Tell whether a folder holds pieces of one run."""
    return (folder / RUN_FILE).is_file()


def _file_name(*names: str) -> str:
    """Return a file name that tells the names, and differs for any others however alike."""
    legible = re.sub(r"[^a-z0-9]+", "-", "-".join(names).lower())[:MAX_READABLE]
    return f"{legible}-{digest(repr(names).encode())[:HASH_LENGTH]}{SUFFIX}"


def _with_digest(arrays: Arrays) -> bytes:
    """Return arrays as they lie on disk, behind a digest that tells whether they are whole."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    return digest(content.getvalue()).encode() + content.getvalue()


def _read(path: Path) -> dict[str, np.ndarray] | None:
    """Return arrays from disk; None where there are none, or they are not whole."""
    if not path.is_file():
        return None
    try:
        data = path.read_bytes()
        if digest(data[DIGEST_LENGTH:]).encode() != data[:DIGEST_LENGTH]:
            return None
        with np.load(io.BytesIO(data[DIGEST_LENGTH:]), allow_pickle=False) as archive:
            return dict(archive)
    except Exception:  # an archive may be sealed and yet none that numpy reads
        return None
