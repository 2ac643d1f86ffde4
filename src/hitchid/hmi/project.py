"""The project folder: plain files that the command line reads and writes as well."""

import fcntl
import os
import re
from datetime import UTC, datetime
from pathlib import Path

from hitchid.errors import InputError, OutputError

CAMPAIGNS, MODELS, REPORTS, CONTROLLERS = "campaigns", "models", "reports", "controllers"
DRIVES, RECORDINGS, UPLOADS, CHANGES = "drives", "recordings", "uploads", "changes"
FOLDERS = (CAMPAIGNS, MODELS, REPORTS, CONTROLLERS, DRIVES, RECORDINGS, UPLOADS, CHANGES)
NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}"
NAME = re.compile(NAME_PATTERN)
CAMPAIGN_FILE, REPORT_FILE = "campaign.toml", "report.html"
LOCK_FILE = ".hmi.lock"  # held by the server of the project
MOST_ENTRIES = 1000  # of a folder that are shown; chosen: more than anybody looks through
MOST_LOGS = 200  # that are offered for a replay; chosen
LOG_FORMATS = (".csv", ".csv.gz", ".mf4", ".parquet", ".tdms", ".mat", ".h5", ".lvm", ".tsv")


def lock(project: Path, address: str) -> int | None:
    """Take a project for this process as long as it lives; return the descriptor of the file that says so.

    The file has the address at which it is served, for whoever comes second; None where the file system has
    no locks or takes no files.

    Raises:
        InputError: another process has it, with its address.
    """
    # Neither what a link leads to is written, nor the other end of a pipe waited for.
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        file = os.open(project / LOCK_FILE, flags, 0o600)
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        other = os.read(file, 1000).decode(errors="replace")
        os.close(file)
        raise InputError(f"{project}: is served already, at {other}; open that, or end it first") from error
    except OSError:
        os.close(file)
        return None
    os.ftruncate(file, 0)  # only now that it is ours: before, its content was another server's address
    os.write(file, address.encode())
    return file


def checked_name(name: object) -> str:
    """Return the name of a file or folder.

    Raises:
        InputError: it has other characters than letters, digits, dot, minus and underline, or is too long.
    """
    if not isinstance(name, str) or not NAME.fullmatch(name) or ".." in name:
        raise InputError(
            "name: expected at most 60 letters, digits, '.', '-' or '_', a letter or digit first, "
            f"got {name!r:.80}"
        )
    return name


def inside(project: Path, path: object) -> Path:
    """Return the path of an existing file or folder in one of the project's folders.

    Raises:
        InputError: there is none, or it is outside, also by a link.
    """
    # No part can be ".." or empty, as each begins with a letter or digit; what is left are links.
    parts = path.split("/") if isinstance(path, str) else []
    if len(parts) < 2 or parts[0] not in FOLDERS or not all(NAME.fullmatch(part) for part in parts):
        raise InputError(f"path: expected a file in {', '.join(FOLDERS)}, got {path!r:.80}")
    root = Path(os.path.realpath(project))  # the project itself may be a link
    target = Path(os.path.realpath(root.joinpath(*parts)))
    if not target.is_relative_to(root) or not target.exists():
        raise InputError(f"path: there is no {path!r:.80} in the project")
    return root.joinpath(*parts)


def file_inside(project: Path, path: object) -> Path:
    """Return the path of an existing file in one of the project's folders.

    Raises:
        InputError: there is none, or it is outside, or no regular file: a pipe could be waited for for ever.
    """
    file = inside(project, path)
    if not file.is_file():
        raise InputError(f"path: expected a file, got {path!r:.80}")
    return file


def place(project: Path, path: str) -> Path:
    """Return where something new goes in the project; its folder is made where there is none.

    Raises:
        OutputError: there is something already, or its folder cannot be made or is a link, by which what is
            written would land elsewhere.
    """
    # Links are looked at before anything is made: no folder should appear where one leads.
    target, folder = project / path, os.path.dirname(path)
    if os.path.realpath(target.parent) != os.path.join(os.path.realpath(project), folder).rstrip("/"):
        raise OutputError(f"{folder}: is a link; expected a folder of the project")
    if os.path.lexists(target):
        raise OutputError(f"{path}: exists already; choose another name")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from error
    return target


def write_new(project: Path, path: str, content: bytes) -> None:
    """Write a new file into the project.

    Raises:
        OutputError: it exists, cannot be written, or would land elsewhere by a link; no part of it is left.
    """
    target = place(project, path)
    try:
        with target.open("xb") as file:
            file.write(content)
    except FileExistsError as error:
        raise OutputError(f"{path}: exists already; choose another name") from error
    except OSError as error:
        target.unlink(missing_ok=True)  # a part of a file would be taken for all of it
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error


def contents(project: Path) -> dict[str, object]:
    """Return what the project holds, as content for JSON: the newest `MOST_ENTRIES` of each folder."""
    campaigns = [
        {**entry, "logs": sum(map(_is_log, os.scandir(project / entry["path"])))}
        for entry in _entries(project, CAMPAIGNS)
        if (project / entry["path"]).is_dir()
    ]
    reports = [
        {**entry, "report": f"/files/{entry['path']}/{REPORT_FILE}"}
        for folder in (REPORTS, CONTROLLERS)
        for entry in _entries(project, folder)
        if (project / entry["path"] / REPORT_FILE).is_file()
    ]
    models = [
        entry for entry in _entries(project, MODELS) if (project / entry["path"] / "model.json").is_file()
    ]
    controllers = [entry for entry in _entries(project, CONTROLLERS) if entry["name"].endswith(".toml")]
    return {
        "folder": project.resolve().name,  # "." has none
        "most": MOST_ENTRIES,
        CAMPAIGNS: campaigns,
        MODELS: models,
        REPORTS: reports,
        CONTROLLERS: controllers,
        **{folder: _entries(project, folder) for folder in (DRIVES, RECORDINGS, UPLOADS, CHANGES)},
    }


def logs(project: Path) -> list[str]:
    """Return the newest logs of campaigns, drives and recordings, relative to the project."""
    campaigns = [entry["path"] for entry in _entries(project, CAMPAIGNS)]
    dated = [
        (_changed_s(child), f"{folder}/{child.name}")
        for folder in (*campaigns, DRIVES, RECORDINGS)
        for child in _children(project, folder)
        if _is_log(child)
    ]
    return [path for _, path in sorted(dated, reverse=True)[:MOST_LOGS]]


def _is_log(child: os.DirEntry[str]) -> bool:
    # What is offered for a replay must pass `inside` when it is chosen.
    return child.name.endswith(LOG_FORMATS) and NAME.fullmatch(child.name) is not None


def _children(project: Path, folder: str) -> list[os.DirEntry[str]]:
    """Return what is in a folder, and in the project also where links lead to."""
    path, root = project / folder, os.path.realpath(project)
    if not path.is_dir() or not _is_inside(root, path):
        return []
    return [
        child
        for child in os.scandir(path)
        if NAME.fullmatch(child.name) and (not child.is_symlink() or _is_inside(root, Path(child.path)))
    ]


def _is_inside(root: str, path: Path) -> bool:
    return Path(os.path.realpath(path)).is_relative_to(root)


def _changed_s(child: os.DirEntry[str]) -> float:
    """Return when a file was changed, s; 0 where it has gone meanwhile."""
    try:
        return child.stat(follow_symlinks=False).st_mtime
    except OSError:
        return 0.0


def _entries(project: Path, folder: str) -> list[dict[str, str]]:
    newest = sorted(_children(project, folder), key=_changed_s, reverse=True)
    return [
        {
            "name": child.name,
            "path": f"{folder}/{child.name}",
            "changed": datetime.fromtimestamp(_changed_s(child), UTC).isoformat(timespec="seconds"),
        }
        for child in newest[:MOST_ENTRIES]
    ]
