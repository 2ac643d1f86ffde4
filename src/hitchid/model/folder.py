"""Model folder: `model.json` (canonical JSON) with tensors and trace, and beside it the rivals.

The rivals have a description of their own, which names the digest of the model: training them later leaves
the model as it is, bit for bit.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from hitchid._support import checks
from hitchid._support.files import canonical_json, digest, inside_folder, write_folder
from hitchid._support.precision import double_precision
from hitchid._support.screen import shortened
from hitchid.errors import InputError, ModelFolderError
from hitchid.model.description import (
    Tensors,
    check_known,
    deployed_tensors,
    describe,
    describe_channel,
    fill,
    read_channel,
    read_hitch,
    shapes_of,
    tensors_of,
    trained_parts,
)
from hitchid.model.hitch import Hitch
from hitchid.model.rivals import Rivals
from hitchid.model.schema import (
    SCHEMA,
    AnySealed,
    Direction,
    ModelDescription,
    RivalsDescription,
    RivalsOfDirection,
    Sealed,
    parse,
)
from hitchid.model.schema_checks import named

# Conversion between the rivals of a model and JSON and tensors.


def describe_rivals(rivals: Mapping[str, Rivals]) -> dict[str, object]:
    """Return the rivals of each direction without their arrays as content for JSON."""
    return {
        direction: {
            "baselines": list(fitted.baselines),
            "covariates": list(fitted.covariates),
            "paper": None if fitted.paper is None else describe_channel(fitted.paper),
            "paper_parameters": None if fitted.paper_estimates is None else asdict(fitted.paper_estimates),
            "searches": [asdict(search) for search in fitted.searches],
            "notices": list(fitted.notices),
            "trained": fitted.trained,
        }
        for direction, fitted in rivals.items()
    }


def rivals_tensors(rivals: Mapping[str, Rivals]) -> dict[str, np.ndarray]:
    """Return the arrays of the rivals, `direction/baselines/…` and `direction/paper/…`."""
    return tensors_of(
        {
            direction: {
                "baselines": dict(fitted.baselines),
                "paper": None if fitted.paper is None else trained_parts(fitted.paper),
            }
            for direction, fitted in rivals.items()
        }
    )


def read_rivals(described: Mapping[Direction, RivalsOfDirection], tensors: Tensors) -> dict[str, Rivals]:
    """Return the rivals of each direction from their description and tensors.

    Raises:
        ValueError: the tensors are not those of rivals, or a number in them is none that a fit gives.
        InputError: a baseline is not installed.
    """
    # Imported here: baselines import global searches and optimisers, which a deployed model does not need.
    from hitchid.baselines.registry import baseline_named

    rivals = {}
    for direction, of_direction in described.items():
        baselines, paper = {}, of_direction.paper
        for name in of_direction.baselines:
            prefix = f"{direction}/baselines/{name}"
            baseline, shapes = baseline_named(name), shapes_of(tensors, prefix)
            with named(prefix):
                skeleton = baseline.skeleton(shapes)
            baselines[name] = fill(skeleton, tensors, prefix)
            with named(prefix):
                baselines[name].check(len(of_direction.covariates) or 1)
        rivals[direction] = Rivals(
            baselines,
            None if paper is None else read_channel(direction, paper, tensors, f"{direction}/paper"),
            of_direction.paper_parameters,
            of_direction.searches,
            of_direction.covariates,
            of_direction.notices,
            of_direction.trained,
        )
    return rivals


MODEL_FILE = "model.json"
WEIGHTS_FILE = "weights.safetensors"
TRACE_FILE = "trace.json"
RIVALS_FILE = "rivals.json"
RIVALS_WEIGHTS_FILE = "rivals.safetensors"
# Of a file; chosen: a hundred times the largest ones seen. A value of JSON takes a hundred times its text in
# memory; a trace grows with the budget of the search.
MAX_BYTES = {WEIGHTS_FILE: 2**28, RIVALS_WEIGHTS_FILE: 2**28, TRACE_FILE: 2**24}
MAX_DESCRIPTION_BYTES = 2**22


@checks.named_arguments
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
        TRACE_FILE: canonical_json(trace or {}),
    }
    # After the other files, whose digests its own digest seals.
    content = _sealed(describe(hitch), files)
    files[MODEL_FILE] = canonical_json(content)
    if hitch.rivals:
        weights = {RIVALS_WEIGHTS_FILE: save_tensors(rivals_tensors(hitch.rivals))}
        described = {
            "schema": SCHEMA,
            "kind": RivalsDescription.KIND,
            "model": content["digest"],
            "rivals": describe_rivals(hitch.rivals),
        }
        files |= weights | {RIVALS_FILE: canonical_json(_sealed(described, weights))}

    def write(target: Path) -> None:
        for name, data in files.items():
            (target / name).write_bytes(data)

    write_folder(checks.path(folder, "folder"), write, result_kind=MODEL_FILE, force=force)


@checks.named_arguments
@double_precision
def load(folder: str | Path) -> Hitch:
    """Read a model folder; digests, keys, types and bounds are checked, as it may come from a stranger.

    Raises:
        ModelFolderError: the folder or a file is missing, was cut short or edited, has an unknown schema, or
            a key, a value or an array that no identification writes.
        InputError: `folder` is not a path.
    """
    path = checks.path(folder, "folder")
    described = _read_description(path / MODEL_FILE, ModelDescription, "a model folder")
    weights = _read_checked(path / WEIGHTS_FILE, described)
    # Only checked: a report may show it later, and what was edited must not be believed then either.
    _read_checked(path / TRACE_FILE, described)
    with _refused(path / WEIGHTS_FILE):
        tensors = load_tensors(weights)
        hitch = read_hitch(described, tensors)
        # An array that nothing reads is none that `save` wrote.
        check_known(tensors, deployed_tensors(hitch))
    # Name and day are those of the folder and no part of the model: a copy of it is the same model.
    written = datetime.fromtimestamp((path / MODEL_FILE).stat().st_mtime, UTC)
    provenance = replace(hitch.provenance, name=path.resolve().name, date=f"{written:%Y-%m-%d}")
    return replace(hitch, provenance=provenance, rivals=_load_rivals(path, described))


def _load_rivals(folder: Path, model: ModelDescription) -> dict[str, Rivals]:
    """Return the rivals stored beside a model; none where it has none."""
    if not (folder / RIVALS_FILE).exists():
        return {}
    described = _read_description(folder / RIVALS_FILE, RivalsDescription, "rivals")
    if described.model != model.digest:
        raise ModelFolderError(
            f"{folder / RIVALS_FILE}: belongs to another model; remove it, and train the rivals again"
        )
    with _refused(folder / RIVALS_FILE):
        described.check_model(model)
    weights = _read_checked(folder / RIVALS_WEIGHTS_FILE, described)
    with _refused(folder / RIVALS_WEIGHTS_FILE):
        tensors = load_tensors(weights)
        rivals = read_rivals(described.rivals, tensors)
        check_known(tensors, rivals_tensors(rivals))
    return rivals


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
    described = _read_description(path / MODEL_FILE, ModelDescription, "a model folder")
    trace = _canonical(path / TRACE_FILE, _read_checked(path / TRACE_FILE, described))
    with _refused(path / TRACE_FILE):
        return TypeAdapter(dict[Direction, dict[str, Any]]).validate_python(trace, strict=True)


def _sealed(content: Mapping[str, object], files: Mapping[str, bytes]) -> dict[str, object]:
    """Return a description with the digests of its files and its own."""
    listed = {**content, "files": {name: digest(data) for name, data in files.items()}}
    return {**listed, "digest": digest(canonical_json(listed))}


def _read_description(path: Path, kind: type[AnySealed], required: str) -> AnySealed:
    """Return a description whose digest and schema are right.

    Args:
        path: its file.
        kind: its schema.
        required: what is expected, for the error of a missing file.
    """
    data = _read(path, required)
    content = _canonical(path, data)
    if not isinstance(content, dict) or content.get("kind") != kind.KIND:
        raise ModelFolderError(f"{path}: is not the description of {kind.KIND}")
    schema = content.get("schema")
    if type(schema) is not int or schema != SCHEMA:
        shown = shortened(repr(schema), checks.MAX_SHOWN)
        raise ModelFolderError(
            f"{path}: schema {shown}, expected {SCHEMA}: it is from another version of hitchid; "
            "identify again"
        )
    # The schema before the digest: of a folder of another version the message is to say so.
    claimed = content.pop("digest", "")
    if claimed != digest(canonical_json(content)):
        raise ModelFolderError(f"{path}: was edited: its digest does not match; identify again")
    return parse(kind, data, path)


def _canonical(path: Path, data: bytes) -> object:
    """Return the content of a file of canonical JSON: finite numbers, each key once.

    Raises:
        ModelFolderError: it is none.
    """
    try:
        content = json.loads(data)
        canonical = canonical_json(content)
    except (ValueError, RecursionError) as error:
        raise ModelFolderError(f"{path}: is truncated or was edited: {type(error).__name__}") from error
    # A key twice or a number written otherwise would be read by someone else as something else.
    if canonical != data:
        raise ModelFolderError(f"{path}: was edited: it is not as hitchid writes it; identify again")
    return content


def _read(path: Path, required: str) -> bytes:
    try:
        if inside_folder(path).exists() and not path.is_file():  # reading a pipe would block
            raise ModelFolderError(f"{path}: cannot be read: it is not a file; expected {required}")
        most = MAX_BYTES.get(path.name, MAX_DESCRIPTION_BYTES)
        if path.exists() and path.stat().st_size > most:
            raise ModelFolderError(
                f"{path}: has {path.stat().st_size / 2**20:.0f} MiB, expected at most {most >> 20}"
            )
        return path.read_bytes()
    except OSError as error:
        raise ModelFolderError(f"{path}: cannot be read: {error.strerror}; expected {required}") from error
    except ValueError as error:
        raise ModelFolderError(f"{path}: cannot be read: {error}; expected {required}") from error
    except InputError as error:
        raise ModelFolderError(str(error)) from error


def _read_checked(path: Path, described: Sealed) -> bytes:
    data = _read(path, "a model folder with model.json")
    claimed = described.files.get(path.name)
    if digest(data) != claimed:
        raise ModelFolderError(
            f"{path}: is truncated or was edited: its SHA-256 is {digest(data)[:12]}…, "
            f"expected {str(claimed)[:12]}…"
        )
    return data


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Refuse a file by whatever error its content causes: a baseline may be of another package.

    Raises:
        ModelFolderError: instead of the error.
    """
    try:
        yield
    except (InputError, ValueError) as error:
        raise ModelFolderError(f"{path}: cannot be parsed: {error}") from error
    except Exception as error:
        raise ModelFolderError(f"{path}: cannot be parsed: {error!r}") from error
