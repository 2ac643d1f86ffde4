"""The project folder: plain files that the command line reads and writes as well."""

import os
import re
from datetime import UTC, datetime
from pathlib import Path

from hitchid.errors import InputError

CAMPAIGNS, MODELS, REPORTS, CONTROLLERS = "campaigns", "models", "reports", "controllers"
DRIVES, RECORDINGS, UPLOADS, CHANGES = "drives", "recordings", "uploads", "changes"
FOLDERS = (CAMPAIGNS, MODELS, REPORTS, CONTROLLERS, DRIVES, RECORDINGS, UPLOADS, CHANGES)
NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}"
NAME = re.compile(NAME_PATTERN)
CAMPAIGN_FILE, REPORT_FILE = "campaign.toml", "report.html"
MOST_LOGS = 200  # that are offered for a replay; chosen
LOG_FORMATS = (".csv", ".csv.gz", ".mf4", ".parquet", ".tdms", ".mat", ".h5", ".lvm", ".tsv")


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
    parts = path.split("/") if isinstance(path, str) else []
    if len(parts) < 2 or parts[0] not in FOLDERS or not all(NAME.fullmatch(part) for part in parts):
        raise InputError(f"path: expected a file in {', '.join(FOLDERS)}, got {path!r:.80}")
    root = Path(os.path.realpath(project))
    target = Path(os.path.realpath(root.joinpath(*parts)))
    if not target.is_relative_to(root) or not target.exists():
        raise InputError(f"path: there is no {path!r:.80} in the project")
    return root.joinpath(*parts)


def contents(project: Path) -> dict[str, object]:
    """Return what the project holds, as content for JSON; newest first."""
    campaigns = [
        {**entry, "logs": sum(map(_is_log, (project / entry["path"]).iterdir()))}
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
        "folder": project.resolve().name,
        CAMPAIGNS: campaigns,
        MODELS: models,
        REPORTS: reports,
        CONTROLLERS: controllers,
        **{folder: _entries(project, folder) for folder in (DRIVES, RECORDINGS, UPLOADS, CHANGES)},
    }


def logs(project: Path) -> list[str]:
    """Return the newest logs of campaigns, drives and recordings, relative to the project."""
    patterns = (f"{CAMPAIGNS}/*/*", f"{DRIVES}/*", f"{RECORDINGS}/*")
    found = [place for pattern in patterns for place in project.glob(pattern)]
    places = [place for place in found if _is_log(place) and _is_inside(project, place)]
    places.sort(key=_changed_s, reverse=True)
    return [place.relative_to(project).as_posix() for place in places[:MOST_LOGS]]


def _is_log(place: Path) -> bool:
    return place.name.endswith(LOG_FORMATS) and all(NAME.fullmatch(part) for part in place.parts[-2:])


def _is_inside(project: Path, place: Path) -> bool:
    """Return whether a place is in the project, also where links lead to."""
    return Path(os.path.realpath(place)).is_relative_to(os.path.realpath(project))


def _changed_s(place: Path) -> float:
    """Return when a file was changed, s; 0 where it has gone meanwhile."""
    try:
        return place.lstat().st_mtime
    except OSError:
        return 0.0


def _entries(project: Path, folder: str) -> list[dict[str, str]]:
    place = project / folder
    if not place.is_dir():
        return []
    children = [
        child for child in place.iterdir() if NAME.fullmatch(child.name) and _is_inside(project, child)
    ]
    children.sort(key=_changed_s, reverse=True)
    return [
        {
            "name": child.name,
            "path": f"{folder}/{child.name}",
            "changed": datetime.fromtimestamp(_changed_s(child), UTC).isoformat(timespec="seconds"),
        }
        for child in children
    ]
