"""A store of logs or results: a local folder, or a bucket such as `s3://fleet/logs`, by fsspec."""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unicodedata import category

from hitchid._support.files import canonical_json, digest, write_bytes
from hitchid.errors import InputError, OutputError

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem


# Fields of a listing, by the names that file systems give them.
DIGEST_FIELDS = ("ETag", "etag", "md5", "md5Hash")
TIME_FIELDS = ("mtime", "LastModified", "last_modified", "updated", "created")

PROBE = ".writable"


class StoreError(OutputError):
    """A store cannot be reached, read or written; the work can be repeated later."""


@dataclass(frozen=True)
class StoredFile:
    """One file as a listing shows it, without its content.

    Attributes:
        name: path in the store.
        size: bytes.
        version: changes with the content: ETag of an object store, otherwise time of modification.
        modified: time of modification, in ISO 8601 and UTC; empty where the store has none.
    """

    name: str
    size: int
    version: str
    modified: str


@dataclass(frozen=True)
class Store:
    """Files below a URL. Each is written whole or not at all.

    What cannot be reached, listed, read or written raises StoreError.

    Attributes:
        url: as given; a local path or a URL that fsspec knows.
    """

    url: str

    @property
    def is_local(self) -> bool:
        """Whether it is a folder of this machine."""
        return "://" not in self.url or self.url.startswith("file://")

    def is_inside(self, other: "Store") -> bool:
        """Return whether it is another store, or a folder in it."""
        (own_system, own), (system, root) = self._root(), other._root()
        return own_system == system and f"{own}/".startswith(f"{root}/")

    def below(self, folder: str) -> "Store":
        """Return the store of a folder in this one."""
        return Store(f"{self.url.rstrip('/')}/{folder}")

    def files(self, *, hidden: bool = False) -> tuple[StoredFile, ...]:
        """Return all files, sorted by name; none where the folder does not exist.

        Args:
            hidden: whether those whose name, or a folder's, begins with a dot are among them.
        """
        details = self._call("list", "", lambda system, root: system.find(root, detail=True))
        root, files = self._root()[1], []
        for path, info in dict(details).items():
            name = path.removeprefix(root).lstrip("/")
            if hidden or not _is_hidden(name):
                # In a bucket the ETag tells a changed log, in a folder its time.
                digests = (str(info[field]) for field in DIGEST_FIELDS if info.get(field) is not None)
                time = next((info[field] for field in TIME_FIELDS if info.get(field) is not None), None)
                version = next(digests, str(time))
                files.append(StoredFile(name, int(info.get("size") or 0), version, _iso(time)))
        return tuple(sorted(files, key=lambda file: file.name))

    def local_folders(self) -> tuple[str, ...]:
        """Return the folders at the top of a local store, also empty ones; an object store has none."""
        top = Path(self._root()[1])
        if not self.is_local or not top.is_dir():
            return ()
        return tuple(
            sorted(path.name for path in top.iterdir() if path.is_dir() and not _is_hidden(path.name))
        )

    def has(self, name: str) -> bool:
        """Return whether a file exists."""
        return self._call("find", name, lambda system, path: system.exists(path))

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        return self._call("read", name, lambda system, path: system.cat_file(path))

    def read_many(self, names: Sequence[str], most: int | None = None) -> dict[str, bytes]:
        """Return the content of several files, read at the same time where the store can do so.

        Args:
            names: of the files.
            most: bytes of each that are read at most; None for all.
        """
        if not names:
            return {}
        root = self._root()[1]
        paths = [f"{root}/{name}" for name in names]
        # Not `cat`: it reads `rig [1]`, `rig ?` and `rig *` as patterns, which other machines match.
        contents = self._call(
            "read", "", lambda system, _: system.cat_ranges(paths, None, most, on_error="raise")
        )
        return dict(zip(names, contents, strict=True))

    def write(self, name: str, content: bytes) -> None:
        """Write a file whole: no reader sees a part of it, whenever this process ends."""
        # An object store shows an object when all of it has arrived; a folder needs a second name until then.
        if self.is_local:
            try:
                write_bytes(Path(self._root()[1]) / name, content, force=True)
            except OutputError as error:
                raise StoreError(str(error)) from error
        else:
            self._call("write", name, lambda system, path: system.pipe_file(path, content))

    def check_writable(self) -> None:
        """Write a file without content and remove it, before work is done whose results are to be written."""
        self.write(PROBE, b"")
        with suppress(StoreError):  # a store may allow to write, and not to remove
            self._call("remove", PROBE, lambda system, path: system.rm_file(path))

    def write_folder(self, name: str, files: Mapping[str, bytes], *, last: str) -> None:
        """Write the files of a folder one by one; the folder is complete when the file `last` exists."""
        # `last` tells that all are there: a run may be killed between any two.
        for file in (*sorted(set(files) - {last}), last):
            self.write(f"{name}/{file}", files[file])

    def _root(self) -> tuple["AbstractFileSystem", str]:
        try:
            from fsspec.core import url_to_fs
        except ImportError as error:
            raise InputError("fsspec is required for fleets: pip install 'hitchid[fleet]'") from error
        try:
            # Without a cache of listings: other workers write to the bucket meanwhile.
            system, root = url_to_fs(self.url, **({} if self.is_local else {"use_listings_cache": False}))
        except (ImportError, ValueError) as error:
            raise InputError(
                f"{self.url}: cannot be used as a store: {error}; expected a folder or a URL such as s3://…"
            ) from error
        return system, str(root).rstrip("/")

    def _call(self, verb: str, name: str, work: Any) -> Any:
        """Return what a call of the file system returns, with errors that name the store."""
        system, root = self._root()
        try:
            return work(system, f"{root}/{name}".rstrip("/"))
        except Exception as error:  # each file system has exceptions of its own
            place = f"{self.url.rstrip('/')}/{name}".rstrip("/")
            reason = str(error) or type(error).__name__
            raise StoreError(f"{place}: cannot {verb}: {reason}") from error


def _iso(time: object) -> str:
    """Return seconds since 1970, a datetime or a text in ISO 8601 as the latter; empty for anything else."""
    try:
        if isinstance(time, str):
            time = datetime.fromisoformat(time)
        elif isinstance(time, int | float):
            time = datetime.fromtimestamp(time, UTC)
    except (ValueError, OverflowError, OSError):
        return ""
    return time.astimezone(UTC).isoformat(timespec="seconds") if isinstance(time, datetime) else ""


def _is_hidden(name: str) -> bool:
    """Return whether a part of a path starts with a dot, such as files that are just being written."""
    return any(part.startswith(".") for part in name.split("/"))


def download(store: Store, files: Iterable[StoredFile], folder: Path) -> dict[str, bytes]:
    """Write files of a store into a local folder, flat, and return their contents by file name.

    Raises:
        StoreError: one cannot be read.
    """
    contents = store.read_many([file.name for file in files])
    # Flat, as on a bench: readers take a folder's files, and a machine has no folders below it.
    by_name = {re.sub(r"^.*/", "", name): content for name, content in contents.items()}
    for name, content in by_name.items():
        (folder / name).write_bytes(content)
    return by_name


# Machines of a store: each folder at its top is one machine, its files are the logs.

KEY_LENGTH = 16  # characters of a digest in the name of a file: 64 bits, no two of 10⁶ alike by chance
UNNAMEABLE = ("Cc", "Cs", "Zl", "Zp")  # control characters, bytes that are no UTF-8, line separators


@dataclass(frozen=True)
class Machine:
    """One machine and its logs, as a listing of the store shows them.

    Attributes:
        name: of its folder at the top of the store.
        files: all files directly in it.
    """

    name: str
    files: tuple[StoredFile, ...]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)

    def signature(self, stamp: str) -> str:
        """Return a digest of the listing and of what is to be done; it changes when either does.

        Args:
            stamp: digest of all that the outcome depends on beside the logs.
        """
        listing = [[file.name, file.size, file.version] for file in self.files]
        return digest(canonical_json({"files": listing, "stamp": stamp}))[:KEY_LENGTH]

    @property
    def date(self) -> str:
        """Time of the newest file, in ISO 8601 and UTC; empty where the store has no times."""
        return max((file.modified for file in self.files), default="")


def machines_of(store: Store) -> tuple[Machine, ...]:
    """Return the machines of a store, sorted by name.

    Raises:
        InputError: there is none, or a folder with logs has a name that a machine cannot have.
        StoreError: the store cannot be listed.
    """
    from hitchid.logs import known_format

    folders: dict[str, list[StoredFile]] = {name: [] for name in store.local_folders()}
    hidden_logs: set[str] = set()
    for file in store.files(hidden=True):
        folder, *below = file.name.split("/")
        if folder.startswith("."):
            # What an editor or a version control keeps is passed over, but a machine never without a word.
            hidden_logs |= {folder} if len(below) == 1 and known_format(Path(file.name)) else set()
            continue
        if below:
            folders.setdefault(folder, [])
        if len(below) == 1 and not below[0].startswith("."):
            folders[folder].append(file)
    # Refused before any work: such a name is lost in a listing of results, or cannot be written to a table.
    refused = sorted(hidden_logs | {name for name in folders if any(category(c) in UNNAMEABLE for c in name)})
    if refused:
        raise InputError(
            f"{store.url}: no machine can be called {', '.join(map(ascii, refused))}; expected names in "
            "UTF-8 without control characters that do not begin with a dot: rename or move these folders"
        )
    if not folders:
        raise InputError(f"{store.url}: there is no folder with logs; expected one folder for each machine")
    return tuple(Machine(name, tuple(files)) for name, files in sorted(folders.items()))


def content_key(contents: Mapping[str, bytes], stamp: str) -> str:
    """Return the key of a result: a digest of the content of all logs and of the stamp of its job."""
    digests = {name: digest(content) for name, content in contents.items()}
    return digest(canonical_json({"files": digests, "stamp": stamp}))[:KEY_LENGTH]
