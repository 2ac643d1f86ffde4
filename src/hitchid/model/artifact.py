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
from hitchid._support.storage import canonical_json, digest, inside_folder, write_folder
from hitchid.baselines.autoregression import Arx
from hitchid.baselines.black_box import BlackBox
from hitchid.baselines.narx import Narx
from hitchid.errors import InputError, ModelFolderError
from hitchid.model.channel import Channel
from hitchid.model.hitch import Hitch
from hitchid.model.limits import TravelLimits
from hitchid.model.migration import MIGRATIONS, SCHEMA, is_readable, migrate
from hitchid.model.provenance import Provenance, TwoModes
from hitchid.networks.error_compensator import FEATURES, Compensator
from hitchid.networks.lstm import Lstm
from hitchid.networks.operating_range import OperatingRange, SignalRange
from hitchid.networks.speed_compensator import INPUTS, SpeedCompensator
from hitchid.structures import (
    NONLINEARITY_PARAMETERS,
    PhysicalModel,
    Scales,
    StaticNonlinearity,
    structure_named,
)
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

    def write(target: Path) -> None:
        (target / WEIGHTS_FILE).write_bytes(weights)
        (target / TRACE_FILE).write_bytes(traces)
        (target / MODEL_FILE).write_bytes(canonical_json(content))

    write_folder(checks.path(folder, "folder"), write, result_kind=MODEL_FILE, force=force)


@double_precision
def load(folder: str | Path) -> Hitch:
    """Read a model folder, checking schema and digests.

    Raises:
        ModelFolderError: the folder or a file is missing, was cut short or edited, or is of a newer schema.
    """
    path = checks.path(folder, "folder")
    content = _read_description(path)
    weights = _read_checked(path / WEIGHTS_FILE, content)
    _read_checked(path / TRACE_FILE, content)
    try:
        tensors = load_tensors(weights)
        return _hitch(content, tensors)
    except Exception as error:  # whoever edits a description can put its digest right, too
        raise ModelFolderError(f"{path}: cannot be understood: {error!r}") from error


def load_trace(folder: str | Path) -> dict:
    """Return how a model in a folder was identified, mode to trace; empty where it was saved without.

    Raises:
        ModelFolderError: as `load`.
    """
    path = checks.path(folder, "folder")
    data = _read_checked(path / TRACE_FILE, _read_description(path))
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ModelFolderError(f"{path / TRACE_FILE}: cannot be understood: {error!r}") from error


def _description(hitch: Hitch) -> dict:
    provenance = hitch.provenance
    return {
        "schema": SCHEMA,
        "kind": "hitchid model",
        "step_s": hitch.step_s,
        "units": dict(hitch.units),
        "drift": hitch.drift,
        "two_modes": None if hitch.two_modes is None else asdict(hitch.two_modes),
        "uncertainty": {
            direction: uncertainty.describe() for direction, uncertainty in hitch.uncertainty.items()
        },
        "channels": {direction: _describe_channel(channel) for direction, channel in hitch.channels.items()},
        "split": {
            subset: {direction: list(names) for direction, names in getattr(provenance, subset).items()}
            for subset in ("identification", "validation", "held_out")
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
        "direction": channel.sign,
        "dead_zone": channel.dead_zone,
        "end_stop": channel.end_stop,
        "limits": None if channel.limits is None else channel.limits._asdict(),
        "structure": benchmark.structure.name,
        "values": [float(value) for value in benchmark.values],
        "dead_time_s": float(benchmark.dead_time_s),
        "load": benchmark.covariate,
        "shape": None
        if benchmark.nonlinearity is None
        else {
            "values": [float(value) for value in benchmark.nonlinearity.values],
            "scales": {
                field.name: float(getattr(benchmark.nonlinearity.scales, field.name))
                for field in fields(Scales)
            },
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
        described["speed_compensator"] = {"members": members, "hidden": hidden, "every": speed.block_size}
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
    for direction, channel in hitch.channels.items():
        owners = {direction: channel} | (
            {} if channel.paper is None else {f"{direction}/paper": channel.paper}
        )
        for owner, owner_channel in owners.items():
            for component in _TRAINED:
                for path, leaf in jax.tree_util.tree_leaves_with_path(getattr(owner_channel, component)):
                    tensors[_tensor_name(owner, component, path)] = np.array(leaf, order="C")
    return tensors


def _tensor_name(owner: str, component: str, path: tuple) -> str:
    return f"{owner}/{component}/{jax.tree_util.keystr(path, simple=True, separator='/')}"


def _hitch(content: dict, tensors: dict[str, np.ndarray]) -> Hitch:
    channels = {
        direction: _channel(direction, described, tensors, direction)
        for direction, described in content["channels"].items()
    }
    split = {
        subset: {direction: tuple(names) for direction, names in content["split"][subset].items()}
        for subset in ("identification", "validation", "held_out")
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
    two_modes = content["two_modes"]
    return Hitch(
        channels,
        content["step_s"],
        content["units"],
        provenance,
        content["drift"],
        None if two_modes is None else TwoModes(**two_modes),
        {direction: Uncertainty.of(uncertainty) for direction, uncertainty in content["uncertainty"].items()},
    )


def _channel(direction: str, described: dict, tensors: dict[str, np.ndarray], owner: str) -> Channel:
    def fill_arrays(component: str, skeleton):
        def leaf(path: tuple, like) -> object:
            name = _tensor_name(owner, component, path)
            stored = tensors[name]
            if stored.shape != like.shape or stored.dtype != like.dtype:
                raise ValueError(f"{name} has shape {stored.shape} and type {stored.dtype}")
            return stored if isinstance(like, np.ndarray) else jnp.asarray(stored)

        return jax.tree_util.tree_map_with_path(leaf, skeleton)

    structure = structure_named(described["structure"])
    if len(described["values"]) != len(structure.parameters):
        raise ValueError(f"{structure.name} has {len(structure.parameters)} parameters")
    channel = Channel(
        direction=direction,
        sign=int(described["direction"]),
        dead_zone=float(described["dead_zone"]),
        end_stop=described["end_stop"],
        benchmark=PhysicalModel(
            structure,
            jnp.asarray(described["values"]),
            jnp.asarray(float(described["dead_time_s"])),
            _shape(described["shape"]),
            described["load"],
        ),
        limits=_limits(described.get("limits")),
    )
    components: dict = {}
    if described["compensator"] is not None:
        compensator_settings = described["compensator"]
        if compensator_settings["features"] != list(FEATURES):
            raise ValueError("the compensator's features are not those of this version")
        _check_size(tensors, compensator_settings["hidden"] ** 2)
        components["compensator"] = fill_arrays(
            "compensator", _empty_compensator(compensator_settings["hidden"], compensator_settings["window"])
        )
    if "speed_compensator" in described:
        compensator_settings = described["speed_compensator"]
        _check_size(tensors, compensator_settings["members"] * compensator_settings["hidden"] ** 2)
        template = _empty_speed_compensator(sign=channel.sign, **compensator_settings)
        components["speed_compensator"] = fill_arrays("speed_compensator", template)
    if "envelope" in described:
        components["envelope"] = fill_arrays("envelope", _empty_operating_range())
    if "paper" in described:
        components["paper"] = _channel(direction, described["paper"], tensors, f"{owner}/paper")
    if "black_box" in described:
        hidden = described["black_box"]["hidden"]
        _check_size(tensors, hidden**2)
        components["black_box"] = fill_arrays("black_box", _empty_black_box(hidden))
    if "arx" in described:
        order = described["arx"]["order"]
        _check_size(tensors, order)
        components["arx"] = fill_arrays("arx", Arx(np.zeros(order), np.zeros(order)))
    if "narx" in described:
        _check_size(tensors, math.prod(described["narx"]["terms"]))
        terms = np.zeros(described["narx"]["terms"], dtype=np.int64)
        components["narx"] = fill_arrays(
            "narx", Narx(terms, np.zeros(len(terms)), np.zeros(()), np.zeros(()))
        )
    return eqx.tree_at(
        lambda tree: [getattr(tree, component) for component in components],
        channel,
        list(components.values()),
        is_leaf=lambda leaf: leaf is None,
    )


def _limits(described: dict | None) -> TravelLimits | None:
    return None if described is None else TravelLimits(**described)


def _check_size(tensors: Mapping[str, np.ndarray], count: int) -> None:
    """Refuse a size that all weights together do not have, before room is made for it."""
    if count > sum(stored.size for stored in tensors.values()):
        raise ValueError(f"the description has more weights than {WEIGHTS_FILE}")


def _shape(described: dict | None) -> StaticNonlinearity | None:
    if described is None:
        return None
    if len(described["values"]) != len(NONLINEARITY_PARAMETERS):
        raise ValueError(f"the curves have {len(NONLINEARITY_PARAMETERS)} parameters")
    scales = Scales(**{name: jnp.asarray(float(value)) for name, value in described["scales"].items()})
    return StaticNonlinearity(jnp.asarray(described["values"]), scales)


def _empty_compensator(hidden: int, window: int) -> Compensator:
    count = len(FEATURES)
    return Compensator(
        Lstm.init(jax.random.key(0), count, hidden),
        jnp.zeros(count),
        jnp.ones(count),
        jnp.ones(()),
        window,
    )


def _empty_speed_compensator(*, members: int, hidden: int, every: int, sign: int) -> SpeedCompensator:
    network = Lstm.init(jax.random.key(0), INPUTS, hidden)
    networks = jax.tree.map(lambda leaf: jnp.zeros((members, *leaf.shape), leaf.dtype), network)
    return SpeedCompensator(networks, jnp.ones(()), jnp.ones(()), _empty_operating_range(), sign, every)


def _empty_operating_range() -> OperatingRange:
    return OperatingRange(*(SignalRange(jnp.ones(()), jnp.ones(())) for _ in range(3)))


def _empty_black_box(hidden: int) -> BlackBox:
    return BlackBox(Lstm.init(jax.random.key(0), 2, hidden), *(jnp.ones(()) for _ in range(4)))


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
    if not is_readable(content.get("schema")):
        raise ModelFolderError(
            f"{path}: has schema {content.get('schema')!r}, required {min(MIGRATIONS)} to {SCHEMA}; "
            "was it written by another version of hitchid? Identify again"
        )
    claimed = content.pop("digest", "")
    if canonical != data or claimed != digest(canonical_json(content)):
        raise ModelFolderError(f"{path}: was edited: its digest does not match; identify again")
    if not isinstance(content.get("files"), dict):
        raise ModelFolderError(f"{path}: cannot be understood: it lists no files")
    return migrate({**content, "digest": claimed})


def _read(path: Path, required: str) -> bytes:
    try:
        if inside_folder(path).exists() and not path.is_file():  # a pipe would be waited for
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
