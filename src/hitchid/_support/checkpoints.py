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
Piece = TypeVar("Piece")
SUFFIX, OF, FAILED = ".npz", "run.json", "failed"
SEAL = 64
LEGIBLE, TOLD_APART = 80, 16


@dataclass(frozen=True)
class Checkpoints:
    """Where finished pieces are kept.

    Attributes:
        folder: of one run, or of pieces whose names say all that went into them; None keeps nothing.
        under: the parts of the work that the pieces belong to, from the largest.
    """

    folder: Path | None = None
    under: tuple[str, ...] = ()

    @classmethod
    def of_run(cls, folder: Path, content: Mapping[str, Any]) -> "Checkpoints":
        """Return the place where the pieces of one run are kept, and found again by the same run alone.

        Args:
            folder: where; made with the first piece.
            content: all that decides on the outcome, as JSON can hold it.

        Raises:
            InputError: the folder holds pieces of another run, or something else.
        """
        stamp, place = canonical_json(content), folder / OF
        if place.is_file():
            if place.read_bytes() != stamp:
                raise InputError(
                    f"{folder}: holds an unfinished run of other logs, other settings or another version; "
                    "required the same ones; --force without --resume begins anew"
                )
        elif folder.is_dir() and any(not each.name.startswith(f".{OF}-") for each in folder.iterdir()):
            raise InputError(f"{folder}: holds no unfinished run; required another place, or an empty folder")
        else:
            write_bytes(place, stamp, force=True)
        return cls(folder)

    def part(self, name: str) -> "Checkpoints":
        """Return the place of the pieces of a part of the work."""
        return replace(self, under=(*self.under, name))

    def arrays(self, name: str, work: Callable[[], Arrays]) -> Arrays:
        """Return what was kept under a name, or else do the work and keep what comes.

        Raises:
            OutputError: it cannot be written.
        """
        if self.folder is None:
            return work()
        path = self.folder / _file_name(*self.under, name)
        kept = _read(path)
        if kept is None:
            kept = dict(work())
            write_bytes(path, _sealed(kept), force=True)
        return kept

    def piece(self, name: str, kind: Callable[..., Piece], work: Callable[[], Piece]) -> Piece:
        """Return a record of numbers, texts and arrays kept under a name, or else do the work and keep it.

        Args:
            name: of the piece.
            kind: a dataclass of such fields.
            work: returns one.

        Raises:
            OutputError: it cannot be written.
        """

        def taken_apart() -> Arrays:
            found: Any = work()
            return {field.name: np.asarray(getattr(found, field.name)) for field in fields(found)}

        found = self.arrays(name, taken_apart)
        return kind(**{name: value if value.ndim else value.item() for name, value in found.items()})


NOWHERE = Checkpoints()


def holds_pieces(folder: Path) -> bool:
    """Tell whether anything was finished in a folder."""
    return any(folder.glob(f"*{SUFFIX}"))


def mark_failed(folder: Path, *, failed: bool) -> None:
    """Note whether the run in a folder ended with an error: the next one may then begin in its place."""
    with suppress(OSError):  # a full disk, mostly: the run can then be gone on with, as after a stop
        if failed:
            (folder / FAILED).touch()
        else:
            (folder / FAILED).unlink(missing_ok=True)


def has_failed(folder: Path) -> bool:
    """Tell whether the run in a folder ended with an error."""
    return is_run(folder) and (folder / FAILED).is_file()


def is_run(folder: Path) -> bool:
    """Tell whether a folder holds pieces of one run."""
    return (folder / OF).is_file()


def _file_name(*names: str) -> str:
    """Return a file name that tells the names, and differs for any others however alike."""
    legible = re.sub(r"[^a-z0-9]+", "-", "-".join(names).lower())[:LEGIBLE]
    return f"{legible}-{digest(repr(names).encode())[:TOLD_APART]}{SUFFIX}"


def _sealed(arrays: Arrays) -> bytes:
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
        if digest(data[SEAL:]).encode() != data[:SEAL]:
            return None
        with np.load(io.BytesIO(data[SEAL:]), allow_pickle=False) as kept:
            return dict(kept)
    except Exception:  # an archive may be sealed and yet none that numpy reads
        return None
