"""Results on disk: canonical JSON, digests, and folders that appear whole or not at all."""

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from hitchid.errors import InputError, OutputError


def canonical_json(content: object) -> bytes:
    """Return JSON with sorted keys and one form for each value: equal content gives equal bytes.

    Raises:
        ValueError: a number is not finite.
    """
    text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False)
    return f"{text}\n".encode()


def own(path: Path) -> Path:
    """Return a file found in a folder, unless it is a link out of it.

    Raises:
        InputError: it is one.
    """
    # A link to itself leads nowhere; unlike Path.resolve, os.path.realpath says so without an error.
    target = Path(os.path.realpath(path))
    if path.is_symlink() and not target.is_relative_to(os.path.realpath(path.parent)):
        raise InputError(
            f"{path}: is a link out of its folder, to {target}; "
            "required a file of the folder, or the target itself"
        )
    return path


def write_folder(folder: Path, write: Callable[[Path], None], *, mark: str, force: bool) -> None:
    """Write a folder beside its place and move it there, so that it appears whole or not at all.

    Args:
        folder: where to.
        write: fills a folder.
        mark: a file that an older result of this kind holds; `force` replaces nothing else.
        force: replace an older result.

    Raises:
        OutputError: something stands there already, or it cannot be written.
    """
    check_folder(folder, mark=mark, force=force)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            write(beside)
            os.chmod(beside, 0o755)  # noqa: S103
            _settle(*beside.rglob("*"), beside)
            older = beside.with_name(f"{beside.name}-older")
            if folder.exists():
                folder.rename(older)
            try:
                beside.rename(folder)
            except BaseException:  # Ctrl-C among them: what was there comes back
                if older.exists():
                    older.rename(folder)
                raise
            _settle(folder.parent)
            shutil.rmtree(older, ignore_errors=True)
        finally:
            shutil.rmtree(beside, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error}") from error


def _settle(*places: Path) -> None:
    """Have files and folders written out to the disk, so that what is renamed afterwards is whole.

    Raises:
        OSError: the disk is full or fails.
    """
    for place in places:
        if place.is_dir() and os.name == "nt":  # folders cannot be opened there
            continue
        handle = os.open(place, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def put(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder that is being filled: name to content."""
    for name, content in files.items():
        (folder / name).write_bytes(content)


def digest(data: bytes) -> str:
    """Return the SHA-256 of some bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def check_folder(folder: Path, *, mark: str, force: bool) -> None:
    """Complain early about a place where `write_folder` would not write.

    Raises:
        OutputError: something stands there that must not be replaced.
    """
    _check_place(folder)
    occupied = folder.exists() and not (folder.is_dir() and not any(folder.iterdir()))
    if occupied and not force:
        raise OutputError(f"{folder}: exists already; required a new folder, or --force to replace it")
    if occupied and not (folder / mark).is_file():
        raise OutputError(
            f"{folder}: holds no {mark}, so --force does not replace it; required another place"
        )


def _check_place(path: Path) -> None:
    """Refuse a name no file can have, and a place inside something that is no folder."""
    try:
        ancestor = next(parent for parent in path.absolute().parents if parent.exists())
        path.exists()
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    if not ancestor.is_dir():
        raise OutputError(f"{path}: cannot be written: {ancestor} is not a folder")


def check_file(path: Path, *, force: bool) -> None:
    """Complain early about a place where `write_file` would not write.

    Raises:
        OutputError: something stands there that must not be replaced.
    """
    _check_place(path)
    if path.exists() and not (force and path.is_file()):
        raise OutputError(f"{path}: exists already; required a new file, or --force to replace one")


def write_file(path: Path, write: Callable[[Path], None], *, force: bool) -> None:
    """Write a file beside its place and move it there, so that it appears whole or not at all.

    Args:
        path: where to.
        write: writes the file it is given, whose name ends as `path` does.
        force: replace a file that is there.

    Raises:
        OutputError: something stands there already, or it cannot be written.
    """
    check_file(path, force=force)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as beside:
            fresh = Path(beside) / path.name
            write(fresh)
            _settle(fresh)
            fresh.replace(path)
            _settle(path.parent)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}") from error


def write_bytes(path: Path, content: bytes, *, force: bool) -> None:
    """Write a file whole or not at all; see `write_file`."""

    def write(beside: Path) -> None:
        beside.write_bytes(content)

    write_file(path, write, force=force)
