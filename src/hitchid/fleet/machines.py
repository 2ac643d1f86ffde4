"""Machines of a store: each folder at its top is one machine, its files are the logs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from unicodedata import category

from hitchid._support.storage import canonical_json, digest
from hitchid.errors import InputError
from hitchid.fleet.store import Store, StoredFile

KEY_LENGTH = 16  # characters of a digest in the name of a file: 64 bits, no two of 10⁶ alike by chance
UNNAMEABLE = (
    "Cc",
    "Cs",
    "Zl",
    "Zp",
)  # control characters, bytes that are no UTF-8, line separators


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
    from hitchid.readers.formats import known_format

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
