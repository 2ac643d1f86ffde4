"""Where logs lie, and the settings beside them."""

from collections.abc import Iterable
from pathlib import Path

from hitchid._support.storage import own
from hitchid.data.signal_map import CAMPAIGN_FILE, CampaignFile, read_campaign_file
from hitchid.errors import InputError
from hitchid.readers.formats import endings, format_of, known_format

DATABASE = ".dbc"


def find_logs(logs: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return every log among files and folders, sorted within each folder.

    Files that are named are taken whatever their format, as long as that of one is known.

    Raises:
        InputError: a path does not exist, no file's format is known, a folder holds no log, or a link out
            of it.
    """
    given = [logs] if isinstance(logs, str | Path) else list(logs)
    found: dict[Path, None] = {}
    for path in map(Path, given):
        if _is_folder(path):
            inside = [
                own(child) for child in sorted(path.iterdir()) if child.is_file() and known_format(child)
            ]
            if not inside:
                raise InputError(f"{path}: no log in this folder; required files ending in {endings()}")
            found.update(dict.fromkeys(inside))
        elif path.is_file():
            found[path] = None
        else:
            raise InputError(f"{path}: there is no such file or folder")
    if not found:
        raise InputError("no logs were named; required files or folders")
    if not any(map(known_format, found)):
        format_of(next(iter(found)))
    return list(found)


def settings_of(paths: Iterable[Path], signals: str | Path | None = None) -> dict[Path, CampaignFile]:
    """Return folder to settings for the folders of some logs: those given, else its own, else the default.

    CAN databases are those the settings name, beside the file that names them, else all in the logs' folder.

    Raises:
        InputError: a folder's settings or databases are a link out of it.
        SettingsError: a settings file cannot be used.
    """
    given = (
        None if signals is None else _with_databases(read_campaign_file(Path(signals)), Path(signals).parent)
    )

    def of(folder: Path) -> CampaignFile:
        beside = folder / CAMPAIGN_FILE
        settings = given or CampaignFile()
        if given is None and beside.is_file():
            settings = _with_databases(read_campaign_file(own(beside)), folder)
        return settings if settings.can.databases else _with_databases(settings, folder, _databases(folder))

    return {folder: of(folder) for folder in dict.fromkeys(path.parent for path in paths)}


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
        if child.suffix.lower() == DATABASE and child.is_file()
    )


def _with_databases(
    settings: CampaignFile, folder: Path, names: tuple[str, ...] | None = None
) -> CampaignFile:
    """Return the settings with their databases where they lie."""
    listed = settings.can.databases if names is None else names
    paths = tuple(str(own(folder / name)) for name in listed)
    return settings.model_copy(update={"can": settings.can.model_copy(update={"databases": paths})})
