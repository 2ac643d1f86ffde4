"""Results on disk: canonical JSON, digests, and atomic writing of files and folders."""

import hashlib
import json
import os
import select
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path

from hitchid.errors import InputError, OutputError

# Lines of a text stream as they come, with something to do while none comes.

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
    file = None
    if isinstance(stream, TextIOWrapper):
        stream.reconfigure(encoding="utf-8", errors="replace")
        with suppress(OSError):  # a stream by which the system cannot wait
            file = stream.fileno() if os.name == "posix" else None
    if file is None:
        yield from (line.rstrip("\n") for line in stream)
        return
    # Not by the lines of the stream: what its buffer holds already, `select` would wait for in vain.
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


MANIFEST_FILE = ".hitchid.json"  # kind of the result, and SHA-256 of its files
UNFINISHED = ".writing"  # end of the name of a folder in which a result is being written
MAX_NAMED = 3  # foreign files named in a message (chosen)


def canonical_json(content: object) -> bytes:
    """Return JSON with sorted keys and fixed formatting: equal content gives equal bytes.

    Raises:
        ValueError: a number is not finite.
    """
    text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False)
    return f"{text}\n".encode()


def inside_folder(path: Path) -> Path:
    """Return the path of a file in a folder, after a check that it is no link out of it.

    Raises:
        InputError: the path is a link out of the folder.
    """
    # Unlike Path.resolve, os.path.realpath accepts a link to itself.
    target = Path(os.path.realpath(path))
    if path.is_symlink() and not target.is_relative_to(os.path.realpath(path.parent)):
        raise InputError(
            f"{path}: is a link to {target}, outside its folder; "
            "expected a file inside the folder; name the target directly"
        )
    return path


def write_folder(folder: Path, write: Callable[[Path], None], *, result_kind: str, force: bool) -> None:
    """Write a folder atomically: `write` fills a temporary folder, which is then renamed.

    `.hitchid.json` in it lists its files with their SHA-256. `force` replaces an older result of the same
    kind, named after its main file, if no file in it was added or changed.

    Raises:
        OutputError: the folder exists already, or cannot be written.
    """
    check_folder(folder, result_kind=result_kind, force=force)
    target = Path(os.path.realpath(folder))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _temporary_folder(target) as temporary:
            write(temporary)
            write_files(
                temporary,
                {MANIFEST_FILE: canonical_json({"kind": result_kind, "files": _digests(temporary)})},
            )
            # `mkdtemp` lets nobody but its owner in.
            os.chmod(temporary, 0o755)  # noqa: S103
            # Contents reach the disk before the name does: after a power cut no result is empty.
            fsync(*temporary.rglob("*"), temporary)
            check_folder(folder, result_kind=result_kind, force=force)  # it may exist by now
            # The older result stays beside until the new one has its name: one of them is whole at any time.
            backup = temporary.with_name(f"{temporary.name}-older")
            if target.exists():
                target.rename(backup)
            try:
                temporary.rename(target)
            except BaseException:  # Ctrl-C too: restore the older result
                if backup.exists():
                    backup.rename(target)
                raise
            fsync(target.parent)
            shutil.rmtree(backup, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error}") from error


@contextmanager
def _temporary_folder(target: Path) -> Iterator[Path]:
    """Yield a folder beside a target to write that in; it is removed at the end, if it still has its name.

    The writer holds a lock on it until it ends, in whatever way. What killed writers of the same target left
    is no longer locked, and removed here. Where there are no locks, as on Windows, it stays.
    """
    prefix = f".{target.name}-"
    for left in target.parent.iterdir():
        if left.name.startswith(prefix) and left.name.endswith(UNFINISHED):
            lock = _lock(left)
            if lock is not None:
                shutil.rmtree(left, ignore_errors=True)
                os.close(lock)
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=target.parent))
    lock = _lock(folder)
    try:
        # Named only once it is locked: no other writer can take it for one that was left.
        folder = folder.rename(f"{folder}{UNFINISHED}")
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def _lock(folder: Path) -> int | None:
    """Return the handle by which this process alone holds a folder; None where it cannot."""
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except (ImportError, OSError):
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # another process has it, or the file system has no locks
        os.close(handle)
        return None
    return handle


def _digests(folder: Path) -> dict[str, str]:
    """Return path to SHA-256 of the files below a folder except its manifest; "" for no regular file."""
    paths = sorted(path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    # Where a link leads is none of the result: it counts as changed, and is never replaced.
    return {
        path.relative_to(folder).as_posix(): ""
        if path.is_symlink() or not path.is_file()
        else digest(path.read_bytes())
        for path in paths
        if path != folder / MANIFEST_FILE
    }


def fsync(*paths: Path) -> None:
    """Flush files and folders to disk, so that a renamed result is complete.

    Raises:
        OSError: the disk is full or fails.
    """
    for path in paths:
        if path.is_dir() and os.name == "nt":  # folders cannot be opened there
            continue
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files, path in the folder to content; their folders are created."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def digest(data: bytes) -> str:
    """Return the SHA-256 of bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def check_folder(folder: Path, *, result_kind: str, force: bool) -> None:
    """Check that `write_folder` may write a folder.

    Raises:
        OutputError: it exists and must not be replaced, or cannot be written.
    """
    _check_path(folder, Path(os.path.realpath(folder)))  # the target of a link is what is written
    occupied = folder.exists() and not (folder.is_dir() and not any(folder.iterdir()))
    if occupied and not force:
        raise OutputError(f"{folder}: exists already; use a new folder, or --force to replace it")
    if occupied:
        _check_replaceable(folder, result_kind)


def _check_replaceable(folder: Path, result_kind: str) -> None:
    """Raise `OutputError` unless a folder holds an unchanged older result of the same kind."""
    try:
        manifest = json.loads((folder / MANIFEST_FILE).read_bytes())
        kind, files = manifest["kind"], dict(manifest["files"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputError(
            f"{folder}: is not a result of hitchid (no {MANIFEST_FILE} lists its files), so --force does not "
            "replace it; choose another folder"
        ) from error
    if kind != result_kind:
        raise OutputError(
            f"{folder}: is a result with {kind}, not with {result_kind}, so --force does not replace it; "
            "choose another folder"
        )
    try:
        foreign = [name for name, checksum in _digests(folder).items() if files.get(name) != checksum]
    except OSError as error:
        raise OutputError(f"{folder}: cannot be read: {error}") from error
    if foreign:
        more = f" and {len(foreign) - MAX_NAMED} more" if len(foreign) > MAX_NAMED else ""
        names = f"{', '.join(foreign[:MAX_NAMED])}{more}"
        raise OutputError(
            f"{folder}: holds {len(foreign)} file{'s' if len(foreign) > 1 else ''} that the command did not "
            f"write or that changed since: {names}; --force does not replace it; choose another folder"
        )


def check_inputs(out: Path, inputs: Iterable[Path | None]) -> None:
    """Check that the output of a command replaces none of its inputs.

    The output must not be an input, contain one, or be a file in an input folder. The target of a link in an
    input folder is an input.

    Args:
        out: file or folder to write.
        inputs: files and folders that are read; None for one that is not given.

    Raises:
        OutputError: an input would be replaced.
    """
    if not out.exists():
        return
    for input_path in inputs:
        if input_path is None or not input_path.exists():
            continue
        real_path = Path(os.path.realpath(input_path))
        links = [file for file in real_path.iterdir() if file.is_symlink()] if real_path.is_dir() else []
        targets = [Path(os.path.realpath(link)) for link in links if link.exists()]
        for source in (real_path, *targets):
            if any(os.path.samefile(out, ancestor) for ancestor in (source, *source.parents)):
                raise OutputError(f"{out}: contains the input {input_path}; choose another folder")
        if (
            out.is_file()
            and real_path.is_dir()
            and os.path.samefile(Path(os.path.realpath(out)).parent, real_path)
        ):
            raise OutputError(f"{out}: is inside the input {input_path}; choose another folder")


def _check_path(path: Path, written: Path) -> None:
    """Check that a path, a link's target, may be written, before the work is done whose result it is to have.

    Raises:
        OutputError: the file name is invalid, the path is below a file, or its folder cannot be written.
    """
    try:
        ancestor = next(parent for parent in written.absolute().parents if parent.exists())
        path.exists()
        if ancestor.is_dir():
            # Permissions alone do not tell: of root, of a full disk.
            with tempfile.TemporaryFile(dir=ancestor):
                return
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    raise OutputError(f"{path}: cannot be written: {ancestor} is not a folder")


def check_file(path: Path, *, force: bool) -> None:
    """Check that `write_file` may write a file.

    Raises:
        OutputError: it exists and must not be replaced, or cannot be written.
    """
    _check_path(path, path)
    if path.exists() and not (force and path.is_file()):
        raise OutputError(f"{path}: exists already; use a new file, or --force to replace one")


def write_file(path: Path, write: Callable[[Path], object], *, force: bool) -> None:
    """Write a file atomically: `write` writes one of its name in a temporary folder, which is then renamed.

    Raises:
        OutputError: the file exists already, or cannot be written.
    """
    check_file(path, force=force)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _temporary_folder(path) as temporary:
            temporary_file = temporary / path.name
            write(temporary_file)
            fsync(temporary_file)
            temporary_file.replace(path)
            fsync(path.parent)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}") from error


def write_bytes(path: Path, content: bytes, *, force: bool) -> None:
    """Write bytes to a file atomically; see `write_file`."""
    write_file(path, lambda temporary_file: temporary_file.write_bytes(content), force=force)
