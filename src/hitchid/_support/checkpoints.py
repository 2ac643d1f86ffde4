"""Checkpoints: intermediate results of a long run, one file each, to resume it after a stop."""

import io
import re
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hitchid._support.files import canonical_json, digest, write_bytes
from hitchid.errors import InputError

Arrays = Mapping[str, np.ndarray]
# Of arrays by name: a shape, in which a letter is any size, the same everywhere; or the type of a scalar, int
# for a count.
Shapes = Mapping[str, tuple[int | str, ...] | type]
KINDS = {bool: "b", int: "iu", float: "iuf", str: "U"}  # type of a scalar to the kinds of NumPy's types
MOST = 2**53  # of a count, which is shown and kept in JSON
BEYOND_CUBE = 1.0  # by which a position may be outside, where its gain was calibrated since; chosen
Cached = TypeVar("Cached")
SUFFIX, RUN_FILE, FAILED_FILE = ".npz", "run.json", "failed"
DIGEST_LENGTH = 64  # characters of a SHA-256 in hexadecimal
MAX_READABLE, HASH_LENGTH = 80, 16  # characters of a file name: legible part, digest (chosen)


class Cube(tuple[int | str, ...]):
    """Shape of an array of positions in the unit cube."""


@dataclass(frozen=True)
class Checkpoints:
    """Folder of cached results, and the task they belong to.

    Attributes:
        folder: of one run, or of results named by the digest of their inputs; None disables the cache.
        parents: names of the enclosing tasks, outermost first.
    """

    folder: Path | None = None
    parents: tuple[str, ...] = ()

    @classmethod
    def of_run(cls, folder: Path, content: Mapping[str, object]) -> "Checkpoints":
        """Return the checkpoints of one run, readable only for the same run.

        Args:
            folder: created if it does not exist.
            content: all inputs that determine the outcome, as JSON values.

        Raises:
            InputError: the folder holds results of another run, or other files.
            OutputError: it cannot be written.
        """
        stamp, run_file = canonical_json(content), folder / RUN_FILE
        if run_file.is_file():
            if run_file.read_bytes() != stamp:
                raise InputError(
                    f"{folder}: holds an unfinished run with other logs, settings or version; "
                    "use the same ones, or start again with --force and without --resume"
                )
        elif folder.is_dir() and not is_empty(folder):
            raise InputError(f"{folder}: holds no unfinished run; choose an empty folder")
        else:
            write_bytes(run_file, stamp, force=True)
        return cls(folder)

    def child(self, name: str) -> "Checkpoints":
        """Return the checkpoints of a subtask."""
        return replace(self, parents=(*self.parents, name))

    def cached_arrays(self, name: str, work: Callable[[], Arrays], shapes: Shapes | None = None) -> Arrays:
        """Return the arrays cached under a name, or compute and cache them.

        Args:
            name: of the result.
            work: computes it.
            shapes: of its arrays; those of a known size are finite, and those of a `Cube` near it. A file
                with others, whose digest was put right, is computed anew. None for any.

        Raises:
            OutputError: it cannot be written.
        """
        if self.folder is None:
            return work()
        names = (*self.parents, name)
        # A legible file name, unique by a digest of the names.
        legible = re.sub(r"[^a-z0-9]+", "-", "-".join(names).lower())[:MAX_READABLE]
        path = self.folder / f"{legible}-{digest(repr(names).encode())[:HASH_LENGTH]}{SUFFIX}"
        arrays = _read(path)
        if arrays is None or (shapes is not None and not _has_shapes(arrays, shapes)):
            # A damaged or foreign file is no error: what can be computed anew is.
            arrays = dict(work())
            content = io.BytesIO()
            np.savez(content, allow_pickle=False, **arrays)
            write_bytes(path, digest(content.getvalue()).encode() + content.getvalue(), force=True)
        return arrays

    def cached(
        self, name: str, kind: Callable[..., Cached], work: Callable[[], Cached], shapes: Shapes
    ) -> Cached:
        """Return the dataclass instance cached under a name, or compute and cache it.

        Args:
            name: of the result.
            kind: a dataclass whose fields are numbers, strings and arrays.
            work: computes an instance.
            shapes: of its fields that are arrays, as for `cached_arrays`; the others are scalars.

        Raises:
            OutputError: it cannot be written.
        """

        def as_arrays() -> Arrays:
            record: Any = work()
            return {field.name: np.asarray(getattr(record, field.name)) for field in fields(record)}

        record_type: Any = kind
        scalars: dict[str, Any] = {field.name: field.type for field in fields(record_type)}
        arrays = self.cached_arrays(name, as_arrays, {**scalars, **shapes})
        return kind(**{name: value if value.ndim else value.item() for name, value in arrays.items()})


DISABLED = Checkpoints()


def has_results(folder: Path) -> bool:
    """Return whether a folder holds a result."""
    return any(folder.glob(f"*{SUFFIX}"))


def mark_failed(folder: Path, *, failed: bool) -> None:
    """Mark whether the run in a folder ended with an error; the next run may then replace it."""
    with suppress(OSError):  # such as a full disk: the run can then be resumed, as after a stop
        if failed:
            (folder / FAILED_FILE).touch()
        else:
            (folder / FAILED_FILE).unlink(missing_ok=True)


def has_failed(folder: Path) -> bool:
    """Return whether the run in a folder ended with an error."""
    return is_run(folder) and (folder / FAILED_FILE).is_file()


def is_run(folder: Path) -> bool:
    """Return whether a folder holds a run."""
    return (folder / RUN_FILE).is_file()


def is_empty(folder: Path) -> bool:
    """Return whether a folder holds nothing, or what a kill while `run.json` was written left."""
    return all(path.name.startswith(f".{RUN_FILE}-") for path in folder.iterdir())


def remove_run(folder: Path) -> None:
    """Remove a run, `run.json` last: what a stop leaves is still a run, or an empty folder.

    Raises:
        OSError: a file cannot be removed.
    """
    run_file = folder / RUN_FILE
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path != run_file:
            path.unlink()
    run_file.unlink()
    folder.rmdir()


def _has_shapes(arrays: Arrays, shapes: Shapes) -> bool:
    """Return whether arrays have the names and the shapes, and those of a known size finite numbers."""
    if arrays.keys() != shapes.keys():
        return False
    sizes: dict[str, int] = {}
    for name, shape in shapes.items():
        array = arrays[name]
        kinds, axes = (KINDS[shape], 0) if isinstance(shape, type) else ("iuf", len(shape))
        if array.ndim != axes or array.dtype.kind not in kinds:
            return False
        if isinstance(shape, type):
            if shape is int and not 0 <= array <= MOST:
                return False
            continue
        for expected, size in zip(shape, array.shape, strict=True):
            if size != (sizes.setdefault(expected, size) if isinstance(expected, str) else expected):
                return False
        if isinstance(shape, Cube) and not np.all(np.abs(array - 0.5) <= 0.5 + BEYOND_CUBE):
            return False
        is_known = all(isinstance(expected, int) for expected in shape)
        if is_known and not np.all(np.isfinite(array)):
            return False
    return True


def _read(path: Path) -> dict[str, np.ndarray] | None:
    """Return arrays from disk; None where the file is missing or damaged."""
    if not path.is_file():
        return None
    try:
        data = path.read_bytes()
        if digest(data[DIGEST_LENGTH:]).encode() != data[:DIGEST_LENGTH]:
            return None
        with np.load(io.BytesIO(data[DIGEST_LENGTH:]), allow_pickle=False) as archive:
            # Nothing is compressed where it is written: what unpacks to more than its file is no result.
            unpacked = sum(member.file_size for member in archive.zip.infolist())
            return dict(archive) if unpacked <= len(data) else None
    except Exception:  # numpy may reject an archive although its digest is right
        return None
