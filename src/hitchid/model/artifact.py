"""Model folder: `model.json` (canonical JSON), tensors of model and baselines, `trace.json`."""

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.storage import canonical_json, digest, inside_folder, write_folder
from hitchid.errors import InputError, ModelFolderError
from hitchid.model.description import KIND, comparison_tensors, deployed_tensors, describe, read_hitch
from hitchid.model.hitch import Hitch
from hitchid.model.migration import MIGRATIONS, SCHEMA, is_readable, migrate

MODEL_FILE = "model.json"
WEIGHTS_FILE = "weights.safetensors"
BASELINES_FILE = "baselines.safetensors"
TRACE_FILE = "trace.json"


def save(
    hitch: Hitch, folder: str | Path, *, trace: Mapping[str, object] | None = None, force: bool = False
) -> None:
    """Write a model folder atomically.

    Args:
        hitch: the model.
        folder: folder to write; must not exist unless `force`.
        trace: search and training traces as content for JSON.
        force: replace an existing model folder.

    Raises:
        InputError: `hitch` is not a `Hitch`, or `folder` not a path.
        OutputError: the folder exists, or cannot be written.
    """
    checks.instance(hitch, Hitch, "model", "a model as hitchid.load returns it")
    files = {
        WEIGHTS_FILE: save_tensors(deployed_tensors(hitch)),
        BASELINES_FILE: save_tensors(comparison_tensors(hitch)),
        TRACE_FILE: canonical_json(trace or {}),
    }
    content = describe(hitch)
    content["files"] = {name: digest(data) for name, data in files.items()}
    content["digest"] = digest(canonical_json(content))

    def write(target: Path) -> None:
        for name, data in files.items():
            (target / name).write_bytes(data)
        (target / MODEL_FILE).write_bytes(canonical_json(content))

    write_folder(checks.path(folder, "folder"), write, result_kind=MODEL_FILE, force=force)


@double_precision
def load(folder: str | Path) -> Hitch:
    """Read a model folder; schema and digests are checked.

    Raises:
        ModelFolderError: the folder or a file is missing, was cut short or edited, or has an unknown schema.
        InputError: `folder` is not a path.
    """
    path = checks.path(folder, "folder")
    content = _read_description(path)
    stored = [
        _read_checked(path / name, content)
        for name in (WEIGHTS_FILE, BASELINES_FILE)
        if name == WEIGHTS_FILE or name in content["files"]
    ]
    _read_checked(path / TRACE_FILE, content)
    try:
        tensors = {name: array for data in stored for name, array in load_tensors(data).items()}
        hitch = read_hitch(*migrate(content, tensors))
        written = datetime.fromtimestamp((path / MODEL_FILE).stat().st_mtime, UTC)
    except Exception as error:  # an edited description may come with a recomputed digest
        raise ModelFolderError(f"{path}: cannot be parsed: {error!r}") from error
    provenance = replace(hitch.provenance, name=path.resolve().name, date=f"{written:%Y-%m-%d}")
    return replace(hitch, provenance=provenance)


def is_model_folder(path: Path) -> bool:
    """Return whether a path is a folder with a `model.json`, which may still be damaged."""
    try:
        return (path / MODEL_FILE).is_file()
    except OSError:  # a name that no file can have
        return False


def load_trace(folder: str | Path) -> dict:
    """Return the identification trace of a model folder, direction to trace; empty if saved without one.

    Raises:
        ModelFolderError, InputError: as `load`.
    """
    path = checks.path(folder, "folder")
    data = _read_checked(path / TRACE_FILE, _read_description(path))
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ModelFolderError(f"{path / TRACE_FILE}: cannot be parsed: {error!r}") from error


def _read_description(folder: Path) -> dict:
    path = folder / MODEL_FILE
    data = _read(path, "a model folder")
    try:
        content = json.loads(data)
        canonical = canonical_json(content)
    except (ValueError, RecursionError) as error:
        raise ModelFolderError(f"{path}: is truncated or was edited: {type(error).__name__}") from error
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise ModelFolderError(f"{path}: is not the description of a hitchid model")
    if not is_readable(content.get("schema")):
        raise ModelFolderError(
            f"{path}: has schema {content.get('schema')!r}, expected {min(MIGRATIONS)} to {SCHEMA}; "
            "it may be from another version of hitchid; identify again"
        )
    claimed = content.pop("digest", "")
    if canonical != data or claimed != digest(canonical_json(content)):
        raise ModelFolderError(f"{path}: was edited: its digest does not match; identify again")
    if not isinstance(content.get("files"), dict):
        raise ModelFolderError(f"{path}: cannot be parsed: it lists no files; identify again")
    return {**content, "digest": claimed}


def _read(path: Path, required: str) -> bytes:
    try:
        if inside_folder(path).exists() and not path.is_file():  # reading a pipe would block
            raise ModelFolderError(f"{path}: cannot be read: it is not a file; expected {required}")
        return path.read_bytes()
    except OSError as error:
        raise ModelFolderError(f"{path}: cannot be read: {error.strerror}; expected {required}") from error
    except ValueError as error:
        raise ModelFolderError(f"{path}: cannot be read: {error}; expected {required}") from error
    except InputError as error:
        raise ModelFolderError(str(error)) from error


def _read_checked(path: Path, content: dict) -> bytes:
    data = _read(path, "a model folder with model.json")
    claimed = content["files"].get(path.name)
    if digest(data) != claimed:
        raise ModelFolderError(
            f"{path}: is truncated or was edited: its SHA-256 is {digest(data)[:12]}…, "
            f"expected {str(claimed)[:12]}…"
        )
    return data
