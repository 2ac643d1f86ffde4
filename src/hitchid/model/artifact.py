"""A model as a folder: `model.json` (canonical JSON), `weights.safetensors`, `trace.json`."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.storage import canonical_json, digest, own, write_folder
from hitchid.baselines.autoregression import Arx
from hitchid.baselines.black_box import BlackBox
from hitchid.baselines.narx import Narx
from hitchid.errors import InputError, ModelFolderError
from hitchid.model.channel import Channel
from hitchid.model.hitch import Hitch
from hitchid.model.limits import TravelLimits
from hitchid.model.migration import SCHEMA, STEPS, migrated, readable
from hitchid.model.provenance import Provenance, TwoModes
from hitchid.networks.error_compensator import FEATURES, Compensator
from hitchid.networks.lstm import Lstm
from hitchid.networks.operating_range import Envelope, Range
from hitchid.networks.speed_compensator import INPUTS, SpeedCompensator
from hitchid.structures import SHAPE, Benchmark, Scales, Shape, structure_named
from hitchid.uncertainty import Uncertainty

MODEL_FILE = "model.json"
WEIGHTS_FILE = "weights.safetensors"
TRACE_FILE = "trace.json"


def save(
    hitch: Hitch, folder: str | Path, *, trace: Mapping[str, object] | None = None, force: bool = False
) -> None:
    """Write a model folder, whole or not at all.

    Args:
        hitch: the model.
        folder: where to; must not exist unless `force`.
        trace: search and training traces, as JSON can hold them.
        force: replace a model folder that is there.

    Raises:
        OutputError: the folder exists, or cannot be written.
    """
    checks.instance(hitch, Hitch, "model", "a model as hitchid.load returns it")
    weights = save_tensors(_tensors(hitch))
    traces = canonical_json(trace or {})
    content = _description(hitch)
    content["files"] = {WEIGHTS_FILE: digest(weights), TRACE_FILE: digest(traces)}
    content["digest"] = digest(canonical_json(content))

    def write(place: Path) -> None:
        (place / WEIGHTS_FILE).write_bytes(weights)
        (place / TRACE_FILE).write_bytes(traces)
        (place / MODEL_FILE).write_bytes(canonical_json(content))

    write_folder(checks.path(folder, "folder"), write, mark=MODEL_FILE, force=force)


@double_precision
def load(folder: str | Path) -> Hitch:
    """Read a model folder, checking schema and digests.

    Raises:
        ModelFolderError: the folder or a file is missing, was cut short or edited, or is of a newer schema.
    """
    place = checks.path(folder, "folder")
    content = _read_description(place)
    weights = _read_checked(place / WEIGHTS_FILE, content)
    _read_checked(place / TRACE_FILE, content)
    try:
        tensors = load_tensors(weights)
        return _hitch(content, tensors)
    except Exception as error:  # whoever edits a description can put its digest right, too
        raise ModelFolderError(f"{place}: cannot be understood: {error!r}") from error


def load_trace(folder: str | Path) -> dict:
    """Return how a model in a folder was identified, mode to trace; empty where it was saved without.

    Raises:
        ModelFolderError: as `load`.
    """
    place = checks.path(folder, "folder")
    data = _read_checked(place / TRACE_FILE, _read_description(place))
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ModelFolderError(f"{place / TRACE_FILE}: cannot be understood: {error!r}") from error


def _description(hitch: Hitch) -> dict:
    provenance = hitch.provenance
    return {
        "schema": SCHEMA,
        "kind": "hitchid model",
        "step_s": hitch.step_s,
        "units": dict(hitch.units),
        "drift": hitch.drift,
        "two_modes": None if hitch.two_modes is None else asdict(hitch.two_modes),
        "uncertainty": {mode: each.describe() for mode, each in hitch.uncertainty.items()},
        "channels": {mode: _describe_channel(channel) for mode, channel in hitch.channels.items()},
        "split": {
            part: {mode: list(names) for mode, names in getattr(provenance, part).items()}
            for part in ("identification", "validation", "held_out")
        },
        "seen": sorted(provenance.seen),
        "cut_at": dict(provenance.cut_at),
        "seed": provenance.seed,
        "settings": dict(provenance.settings),
        "versions": dict(provenance.versions),
    }


def _describe_channel(channel: Channel) -> dict:
    benchmark = channel.benchmark
    described: dict = {
        "direction": channel.direction,
        "dead_zone": channel.dead_zone,
        "end_stop": channel.end_stop,
        "limits": None if channel.limits is None else channel.limits._asdict(),
        "structure": benchmark.structure.name,
        "values": [float(value) for value in benchmark.values],
        "dead_time_s": float(benchmark.dead_time_s),
        "load": benchmark.load,
        "shape": None
        if benchmark.shape is None
        else {
            "values": [float(value) for value in benchmark.shape.values],
            "scales": {f.name: float(getattr(benchmark.shape.scales, f.name)) for f in fields(Scales)},
        },
        "compensator": None,
    }
    if channel.compensator is not None:
        described["compensator"] = {
            "window": channel.compensator.window,
            "hidden": channel.compensator.network.cell.hidden_size,
            "features": list(FEATURES),
        }
    speed = channel.speed_compensator
    if speed is not None:
        members, hidden = speed.networks.cell.weight_hh.shape[0], speed.networks.cell.hidden_size
        described["speed_compensator"] = {"members": members, "hidden": hidden, "every": speed.every}
    if channel.envelope is not None:
        described["envelope"] = {}
    if channel.black_box is not None:
        described["black_box"] = {"hidden": channel.black_box.network.cell.hidden_size}
    if channel.arx is not None:
        described["arx"] = {"order": channel.arx.past.size}
    if channel.narx is not None:
        described["narx"] = {"terms": list(channel.narx.terms.shape)}
    if channel.paper is not None:
        described["paper"] = _describe_channel(channel.paper)
    return described


_TRAINED = ("compensator", "speed_compensator", "envelope", "black_box", "arx", "narx")


def _tensors(hitch: Hitch) -> dict[str, np.ndarray]:
    """Return every array of the trained parts under `mode/part/path`, of the paper's under `mode/paper/…`."""
    tensors = {}
    for mode, channel in hitch.channels.items():
        owners = {mode: channel} | ({} if channel.paper is None else {f"{mode}/paper": channel.paper})
        for owner, each in owners.items():
            for part in _TRAINED:
                for path, leaf in jax.tree_util.tree_leaves_with_path(getattr(each, part)):
                    tensors[_tensor_name(owner, part, path)] = np.array(leaf, order="C")
    return tensors


def _tensor_name(owner: str, part: str, path: tuple) -> str:
    return f"{owner}/{part}/{jax.tree_util.keystr(path, simple=True, separator='/')}"


def _hitch(content: dict, tensors: dict[str, np.ndarray]) -> Hitch:
    channels = {
        mode: _channel(mode, described, tensors, mode) for mode, described in content["channels"].items()
    }
    split = {
        part: {mode: tuple(names) for mode, names in content["split"][part].items()}
        for part in ("identification", "validation", "held_out")
    }
    provenance = Provenance(
        **split,
        seen=frozenset(content["seen"]),
        cut_at=content["cut_at"],
        seed=content["seed"],
        settings=content["settings"],
        versions=content["versions"],
        digest=content["digest"],
    )
    compared = content["two_modes"]
    return Hitch(
        channels,
        content["step_s"],
        content["units"],
        provenance,
        content["drift"],
        None if compared is None else TwoModes(**compared),
        {mode: Uncertainty.of(each) for mode, each in content["uncertainty"].items()},
    )


def _channel(mode: str, described: dict, tensors: dict[str, np.ndarray], owner: str) -> Channel:
    def filled(part: str, skeleton):
        def leaf(path: tuple, like) -> object:
            name = _tensor_name(owner, part, path)
            stored = tensors[name]
            if stored.shape != like.shape or stored.dtype != like.dtype:
                raise ValueError(f"{name} has shape {stored.shape} and type {stored.dtype}")
            return stored if isinstance(like, np.ndarray) else jnp.asarray(stored)

        return jax.tree_util.tree_map_with_path(leaf, skeleton)

    structure = structure_named(described["structure"])
    if len(described["values"]) != len(structure.parameters):
        raise ValueError(f"{structure.name} has {len(structure.parameters)} parameters")
    channel = Channel(
        mode=mode,
        direction=int(described["direction"]),
        dead_zone=float(described["dead_zone"]),
        end_stop=described["end_stop"],
        benchmark=Benchmark(
            structure,
            jnp.asarray(described["values"]),
            jnp.asarray(float(described["dead_time_s"])),
            _shape(described["shape"]),
            described["load"],
        ),
        limits=_limits(described.get("limits")),
    )
    parts: dict = {}
    if described["compensator"] is not None:
        asked = described["compensator"]
        if asked["features"] != list(FEATURES):
            raise ValueError("the compensator's features are not those of this version")
        _check_room(tensors, asked["hidden"] ** 2)
        parts["compensator"] = filled("compensator", _blank_compensator(asked["hidden"], asked["window"]))
    if "speed_compensator" in described:
        asked = described["speed_compensator"]
        _check_room(tensors, asked["members"] * asked["hidden"] ** 2)
        blank = _blank_speed_compensator(direction=channel.direction, **asked)
        parts["speed_compensator"] = filled("speed_compensator", blank)
    if "envelope" in described:
        parts["envelope"] = filled("envelope", _blank_envelope())
    if "paper" in described:
        parts["paper"] = _channel(mode, described["paper"], tensors, f"{owner}/paper")
    if "black_box" in described:
        hidden = described["black_box"]["hidden"]
        _check_room(tensors, hidden**2)
        parts["black_box"] = filled("black_box", _blank_black_box(hidden))
    if "arx" in described:
        order = described["arx"]["order"]
        _check_room(tensors, order)
        parts["arx"] = filled("arx", Arx(np.zeros(order), np.zeros(order)))
    if "narx" in described:
        _check_room(tensors, math.prod(described["narx"]["terms"]))
        terms = np.zeros(described["narx"]["terms"], dtype=np.int64)
        parts["narx"] = filled("narx", Narx(terms, np.zeros(len(terms)), np.zeros(()), np.zeros(())))
    return eqx.tree_at(
        lambda c: [getattr(c, part) for part in parts],
        channel,
        list(parts.values()),
        is_leaf=lambda leaf: leaf is None,
    )


def _limits(described: dict | None) -> TravelLimits | None:
    return None if described is None else TravelLimits(**described)


def _check_room(tensors: Mapping[str, np.ndarray], count: int) -> None:
    """Refuse a size that all weights together do not have, before room is made for it."""
    if count > sum(stored.size for stored in tensors.values()):
        raise ValueError(f"the description has more weights than {WEIGHTS_FILE}")


def _shape(described: dict | None) -> Shape | None:
    if described is None:
        return None
    if len(described["values"]) != len(SHAPE):
        raise ValueError(f"the curves have {len(SHAPE)} parameters")
    scales = Scales(**{name: jnp.asarray(float(value)) for name, value in described["scales"].items()})
    return Shape(jnp.asarray(described["values"]), scales)


def _blank_compensator(hidden: int, window: int) -> Compensator:
    count = len(FEATURES)
    return Compensator(
        Lstm.fresh(jax.random.key(0), count, hidden),
        jnp.zeros(count),
        jnp.ones(count),
        jnp.ones(()),
        window,
    )


def _blank_speed_compensator(*, members: int, hidden: int, every: int, direction: int) -> SpeedCompensator:
    fresh = Lstm.fresh(jax.random.key(0), INPUTS, hidden)
    networks = jax.tree.map(lambda leaf: jnp.zeros((members, *leaf.shape), leaf.dtype), fresh)
    return SpeedCompensator(networks, jnp.ones(()), jnp.ones(()), _blank_envelope(), direction, every)


def _blank_envelope() -> Envelope:
    return Envelope(*(Range(jnp.ones(()), jnp.ones(())) for _ in range(3)))


def _blank_black_box(hidden: int) -> BlackBox:
    return BlackBox(Lstm.fresh(jax.random.key(0), 2, hidden), *(jnp.ones(()) for _ in range(4)))


def _read_description(folder: Path) -> dict:
    path = folder / MODEL_FILE
    data = _read(path, "a model folder")
    try:
        content = json.loads(data)
        canonical = canonical_json(content)
    except (ValueError, RecursionError) as error:
        raise ModelFolderError(f"{path}: was cut short or edited: {type(error).__name__}") from error
    if not isinstance(content, dict) or content.get("kind") != "hitchid model":
        raise ModelFolderError(f"{path}: is not the description of a hitchid model")
    if not readable(content.get("schema")):
        raise ModelFolderError(
            f"{path}: has schema {content.get('schema')!r}, required {min(STEPS)} to {SCHEMA}; "
            "was it written by another version of hitchid? Identify again"
        )
    claimed = content.pop("digest", "")
    if canonical != data or claimed != digest(canonical_json(content)):
        raise ModelFolderError(f"{path}: was edited: its digest does not match; identify again")
    if not isinstance(content.get("files"), dict):
        raise ModelFolderError(f"{path}: cannot be understood: it lists no files")
    return migrated({**content, "digest": claimed})


def _read(path: Path, required: str) -> bytes:
    try:
        if own(path).exists() and not path.is_file():  # a pipe would be waited for
            raise ModelFolderError(f"{path}: cannot be read: it is no file; required {required}")
        return path.read_bytes()
    except OSError as error:
        raise ModelFolderError(f"{path}: cannot be read: {error.strerror}; required {required}") from error
    except ValueError as error:
        raise ModelFolderError(f"{path}: cannot be read: {error}; required {required}") from error
    except InputError as error:
        raise ModelFolderError(str(error)) from error


def _read_checked(path: Path, content: dict) -> bytes:
    data = _read(path, "it with model.json")
    claimed = content["files"].get(path.name)
    if digest(data) != claimed:
        raise ModelFolderError(
            f"{path}: was cut short or edited: its SHA-256 is {digest(data)[:12]}…, "
            f"required {str(claimed)[:12]}…"
        )
    return data
