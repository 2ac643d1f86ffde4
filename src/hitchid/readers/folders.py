"""Find logs in folders, and their settings."""

from collections.abc import Iterable
from pathlib import Path

from hitchid._support.storage import inside_folder
from hitchid.data.signal_map import CAMPAIGN_FILE, CampaignFile, read_campaign_file
from hitchid.errors import InputError
from hitchid.readers.formats import format_of, known_format, known_suffixes

DATABASE_SUFFIX = ".dbc"


def find_logs(logs: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return every log among files and folders, sorted within each folder.

    Named files are returned whatever their format, if at least one format is known.

    Raises:
        InputError: a path does not exist, no file's format is known, a folder holds no log, or a link out
            of it.
    """
    inputs = [logs] if isinstance(logs, str | Path) else list(logs)
    paths: dict[Path, None] = {}
    for path in map(Path, inputs):
        if _is_folder(path):
            folder_logs = [
                inside_folder(child)
                for child in sorted(path.iterdir())
                if child.is_file() and known_format(child)
            ]
            if not folder_logs:
                raise InputError(
                    f"{path}: no log in this folder; expected files ending in {known_suffixes()}"
                )
            paths.update(dict.fromkeys(folder_logs))
        elif path.is_file():
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
        InputError: a folder's settings or databases are a link out of it.
        SettingsError: a settings file cannot be used.
    """
    shared_settings = (
        None if signals is None else _with_databases(read_campaign_file(Path(signals)), Path(signals).parent)
    )

    def for_folder(folder: Path) -> CampaignFile:
        settings_path = folder / CAMPAIGN_FILE
        settings = shared_settings or CampaignFile()
        if shared_settings is None and settings_path.is_file():
            settings = _with_databases(read_campaign_file(inside_folder(settings_path)), folder)
        return settings if settings.can.databases else _with_databases(settings, folder, _databases(folder))

    return {folder: for_folder(folder) for folder in dict.fromkeys(path.parent for path in paths)}


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def _databases(folder: Path) -> tuple[str, ...]:
    if not folder.is_dir():
        return ()
    return tuple(
        child.name
        for child in sorted(folder.iterdir())
        if child.suffix.lower() == DATABASE_SUFFIX and child.is_file()
    )


def _with_databases(
    settings: CampaignFile, folder: Path, names: tuple[str, ...] | None = None
) -> CampaignFile:
    """Return the settings with the paths of their databases."""
    database_names = settings.can.databases if names is None else names
    paths = tuple(str(inside_folder(folder / name)) for name in database_names)
    return settings.model_copy(update={"can": settings.can.model_copy(update={"databases": paths})})
