"""Find logs in folders, and their settings."""

import os
from collections.abc import Iterable
from pathlib import Path

from hitchid.data.signal_map import CAMPAIGN_FILE, CampaignFile, read_campaign_file
from hitchid.errors import InputError
from hitchid.readers.formats import format_of, known_format, known_suffixes

DATABASE_SUFFIX = ".dbc"


def find_logs(logs: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return every log among files and folders, sorted within each folder.

    Named files are returned whatever their format, if at least one format is known. Links to logs and to
    folders are followed.

    Raises:
        InputError: a path does not exist, a link to a log is broken, no file's format is known, or a folder
            holds no log.
    """
    inputs = [logs] if isinstance(logs, str | Path) else list(logs)
    paths: dict[Path, None] = {}
    for path in map(Path, inputs):
        if _is_folder(path):
            folder_logs = [
                child for child in sorted(path.iterdir()) if known_format(child) and _is_file(child)
            ]
            if not folder_logs:
                raise InputError(
                    f"{path}: no log in this folder; expected files ending in {known_suffixes()}"
                )
            paths.update(dict.fromkeys(folder_logs))
        elif _is_file(path):
            paths[path] = None
        else:
            raise InputError(f"{path}: there is no such file or folder")
    if not paths:
        raise InputError("no logs given; expected files or folders")
    if not any(map(known_format, paths)):
        format_of(next(iter(paths)))
    return list(paths)


def settings_of(paths: Iterable[Path], signals: str | Path | None = None) -> dict[Path, CampaignFile]:
    """Return folder to settings for the folders of logs: `signals`, else the folder's own, else the default.

    CAN databases are those named in the settings, relative to that file, else all in the folder of the logs.

    Raises:
        InputError: a folder's settings or databases are a broken link.
        SettingsError: a settings file cannot be used.
    """
    shared_settings = (
        None if signals is None else _with_databases(read_campaign_file(Path(signals)), Path(signals).parent)
    )

    def for_folder(folder: Path) -> CampaignFile:
        settings_path = folder / CAMPAIGN_FILE
        settings = shared_settings or CampaignFile()
        if shared_settings is None and _is_file(settings_path):
            settings = _with_databases(read_campaign_file(settings_path), folder)
        return settings if settings.can.databases else _with_databases(settings, folder, _databases(folder))

    return {folder: for_folder(folder) for folder in dict.fromkeys(path.parent for path in paths)}


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def _is_file(path: Path) -> bool:
    """Return whether a path is a file or a link to one; raises InputError for a broken link."""
    if path.is_symlink() and not path.exists():
        raise InputError(
            f"{path}: is a broken link to {os.readlink(path)}; expected a link to an existing file"
        )
    return path.is_file()


def _databases(folder: Path) -> tuple[str, ...]:
    if not folder.is_dir():
        return ()
    return tuple(
        child.name
        for child in sorted(folder.iterdir())
        if child.suffix.lower() == DATABASE_SUFFIX and _is_file(child)
    )


def _with_databases(
    settings: CampaignFile, folder: Path, names: tuple[str, ...] | None = None
) -> CampaignFile:
    """Return the settings with the paths of their databases."""
    database_names = settings.can.databases if names is None else names
    paths = tuple(str(folder / name) for name in database_names)
    return settings.model_copy(update={"can": settings.can.model_copy(update={"databases": paths})})
