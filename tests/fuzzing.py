"""Damaged and hostile files of every kind, and the doors they are handed in at.

A seed is a folder of files as a user would have them. An input is a seed with one of its files changed: bytes
at random, words of texts, values of TOML and JSON. Each goes through the door a user would take; out may come
a result or an error of `hitchid`, nothing else.
"""

import gzip
import io
import json
import math
import re
import shutil
import signal
import struct
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import asammdf
import h5py
import jax.numpy as jnp
import numpy as np
from can_logs import frame, logged, message, write_dbc
from nptdms import ChannelObject, TdmsWriter
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors
from scipy.io import netcdf_file, savemat

import fleet_rows
from controllers import made_up_controller, made_up_model, made_up_tuning
from handmade import channel, hitch, hitch_of, with_bands
from hitchid._support.checkpoints import DIGEST_LENGTH, Checkpoints, Cube
from hitchid._support.files import canonical_json, digest
from hitchid._support.tables import DataTable
from hitchid.bench.parameter_files import load_rig
from hitchid.control.files import load_controller, save_controller
from hitchid.errors import HitchError, InputError
from hitchid.fleet import Store, compare_fleet
from hitchid.fleet.comparison import comparison_metrics
from hitchid.fleet.ledger import load_model, parquet, table_rows
from hitchid.fleet.row import Row
from hitchid.handover import step_responses
from hitchid.identification.settings_file import read_settings, settings_of_model
from hitchid.live import AdaptationSettings, Adapter, Event, read_events
from hitchid.live.parameters import Changes, changed_model
from hitchid.logs import ReaderProcess, assemble, find_logs, read_log, settings_of, write_table
from hitchid.logs.inspect import inspect_campaign
from hitchid.logs.record import LIFTING, Record
from hitchid.logs.signal_map import read_campaign_file
from hitchid.model import (
    Estimates,
    Hitch,
    Information,
    LoadOfTest,
    LoadScatter,
    Provenance,
    SearchSummary,
    TravelLimits,
    TwoModes,
    Uncertainty,
    load,
    load_trace,
    save,
)
from hitchid.model.provenance import DifferenceTest
from hitchid.model.rivals import Rivals
from hitchid.report import figures, read_trace
from hitchid.structures import PhysicalModel, structure_named
from hitchid.validation import read_limits
from hitchid.validation.channels import channel_result
from hitchid.validation.tables import search_table
from plotted import characteristics, estimate

SAMPLES, STEP_S = 60, 0.01
REFUSED, ACCEPTED = "refused", "accepted"
LONGEST_S = 10.0
HUNG_S = 30

Files = dict[str, bytes]
Door = Callable[[Path, ReaderProcess], object]
Change = Callable[[np.random.Generator, bytes], bytes]


class Seed(NamedTuple):
    """A folder that can be read.

    Attributes:
        name: of the kind of file.
        files: name to content.
        changed: names of those that are damaged.
        door: what reads the folder, and returns what tells one result from another.
        text: whether words may be changed, not bytes alone.
        sealed: whether a checksum tells every change, so that no other result may come out.
        changes: changes of this kind of file alone.
        costly: whether what is done with it is compiled for seconds.
    """

    name: str
    files: Files
    changed: tuple[str, ...]
    door: Door
    text: bool = False
    sealed: bool = False
    changes: tuple[Callable[[np.random.Generator, Files], Files], ...] = ()
    costly: bool = False


class Hung(BaseException):
    """An input that takes far too long; no error, so that no reader takes it for one of its own."""


# --- seeds ------------------------------------------------------------------------------------------------


def columns(samples: int = SAMPLES) -> dict[str, np.ndarray]:
    """Return a lifting log."""
    time_s = np.round(STEP_S * np.arange(samples), 4)
    up = np.where(np.arange(samples) > 5, 0.5, 0.0)
    moved = 7.0 + np.cumsum(0.3 * up) + 0.01 * np.sin(np.arange(samples))
    return {"time_s": time_s, "current_up_A": up, "current_down_A": 0 * up, "displacement_mm": moved}


CAMPAIGN = """[signals]
time = "time_s"
lifting_command = { column = "current_up_A", unit = "A" }
lowering_command = { column = "current_down_A", unit = "A" }
displacement = { column = "displacement_mm", unit = "mm" }
covariates = []

[split]
test = ["b*"]

[tests]
"b*" = "lifting"
"""
SETTINGS = """seed = 3
drift = true

[lifting]
structure = "integrator-second-order"
dead_time = true
dead_zone = 0.3
bounds = { gain = [1.0, 90.0] }

[lowering]
load = "pressure_bar"

[search]
method = "whale"
evaluations = 600
population = 12

[training]
hidden = 8
window = 20
learning_rate = 0.01
"""
LIMITS = """unit = "mm"

[lifting]
tests = 2
free_run = { rmse = 3.0, fit = 80 }
one_step = { max_abs = 1.5 }
horizon = { 10 = 0.5 }
coverage = [80, 100]
better_than = ["arx"]

[cycles]
free_run = { r2 = 0.9 }
"""
DBC = (
    message(
        0x100,
        "Valve",
        'current_up_A : 0|16@1+ (0.001,0) [0|0] "A" ECU',
        'current_down_A : 16|16@1+ (0.001,0) [0|0] "A" ECU',
    ),
    message(0x101, "Hitch", 'displacement_mm : 7|16@0- (0.01,0) [0|0] "mm" ECU'),
)


def seeds(folder: Path) -> list[Seed]:
    """Write a file of every kind and return them as seeds."""
    folder.mkdir(parents=True, exist_ok=True)
    return [
        *_texts(folder),
        *_tables(folder),
        *_containers(folder),
        *_buses(folder),
        *_settings(folder),
        *_kept(folder),
    ]


def _log(name: str, content: bytes, **options: Any) -> Seed:
    ending = name.partition(" ")[0]
    files = {f"a.{ending}": content, **options.pop("beside", {})}
    return Seed(name, files, (f"a.{ending}",), read_logs, **options)


def _texts(folder: Path) -> Iterator[Seed]:
    write_table(folder / "a.csv", columns())
    plain = (folder / "a.csv").read_bytes()
    rows = [line.split(",") for line in plain.decode().splitlines()]
    yield _log("csv", plain, text=True)
    yield _log("csv with another", plain, text=True, beside={"b.csv": plain})
    comma = "\n".join(";".join(cell.replace(".", ",") for cell in row) for row in rows)
    yield _log("csv semicolons", f"Logger 7;;;\n{comma}\n".replace("\n", "\r\n").encode("cp1252"), text=True)
    bracketed = ["time [s],up (A),down (A),moved [mm]", *(",".join(row) for row in rows[1:])]
    named = CAMPAIGN.replace("time_s", "time").replace("current_up_A", "up")
    named = named.replace("current_down_A", "down").replace("displacement_mm", "moved").replace("b*", "a*")
    yield _log(
        "csv brackets", "\n".join(bracketed).encode(), text=True, beside={"campaign.toml": named.encode()}
    )
    yield _log("csv utf-16", plain.decode().encode("utf-16"), text=True)
    yield _log("tsv", plain.replace(b",", b"\t"), text=True)
    measurement = b"LabVIEW Measurement\r\nSeparator\tTab\r\n***End_of_Header***\r\n"
    yield _log("lvm", measurement + plain.replace(b",", b"\t"), text=True)
    yield _log("csv.gz", gzip.compress(plain, mtime=0), sealed=True)


def _tables(folder: Path) -> Iterator[Seed]:
    for ending in ("tdms", "mf4", "parquet"):
        write_table(folder / f"a.{ending}", columns())
        yield _log(ending, (folder / f"a.{ending}").read_bytes(), sealed=ending == "parquet")
    waves = {name: values for name, values in columns().items() if name != "time_s"}
    stated = {"wf_increment": STEP_S, "wf_start_offset": 0.0, "wf_samples": SAMPLES}
    with TdmsWriter(folder / "w.tdms") as writer:
        for half in (slice(0, 30), slice(30, SAMPLES)):
            writer.write_segment([ChannelObject("Bench", n, v[half], stated) for n, v in waves.items()])
    yield _log("tdms waveforms", (folder / "w.tdms").read_bytes())
    for version, compression in (("3.30", 0), ("4.11", 2)):
        time_s = columns()["time_s"]
        with asammdf.MDF(version=version) as log:
            log.append([asammdf.Signal(v, time_s, name=n) for n, v in waves.items()], common_timebase=True)
            stored = log.save(folder / f"m{version}.mf4", overwrite=True, compression=compression)
        yield _log(f"mf4 {version}", Path(stored).read_bytes())


def _containers(folder: Path) -> Iterator[Seed]:
    for name, options in {
        "mat": {},
        "mat compressed": {"do_compression": True},
        "mat version 4": {"format": "4"},
    }.items():
        made = io.BytesIO()
        savemat(made, columns(), **options)
        yield _log(name, made.getvalue(), sealed=name == "mat compressed")
    export = {
        "X": {"Data": columns()["time_s"], "Unit": "s"},
        "Y": {"Name": "displacement_mm", "Data": columns()["displacement_mm"], "Unit": "mm"},
    }
    made = io.BytesIO()
    experiment = {"InputData": columns()["displacement_mm"], "InputName": "up", "InputUnit": "A", "Ts": 0.01}
    experiment |= {"OutputData": columns()["displacement_mm"], "SamplingInstants": columns()["time_s"]}
    savemat(made, {**columns(), "run": export, "data": experiment})
    yield _log("mat structs", made.getvalue())
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        for name, values in columns().items():
            dataset = file.create_dataset(name, data=values[None, :])
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + struct.pack("<H2s", 0x0200, b"IM")
    yield _log("mat 7.3", head.ljust(512, b"\0") + (folder / "a.mat").read_bytes()[512:])
    for name, options in {
        "h5": {},
        "h5 chunks": {"compression": "gzip", "chunks": (20,), "fletcher32": True},
    }.items():
        with h5py.File(folder / "a.h5", "w") as file:
            for column, values in columns().items():
                file.create_dataset(f"log/{column}", data=values, **options)
        yield _log(name, (folder / "a.h5").read_bytes())
    with h5py.File(folder / "a4.nc", "w", libver="latest") as file:
        scale = file.create_dataset("time_s", data=1e3 * columns()["time_s"])
        scale.make_scale("time_s")
        scale.attrs["units"] = np.bytes_("milliseconds since 2024-05-01 10:00:00")
        for name, values in columns().items():
            if name != "time_s":
                file.create_dataset(name, data=values).dims[0].attach_scale(scale)
    yield _log("nc 4", (folder / "a4.nc").read_bytes())
    with netcdf_file(folder / "a3.nc", "w") as file:
        file.createDimension("time_s", SAMPLES)
        for name, values in columns().items():
            file.createVariable(name, "d", ("time_s",))[:] = values
        file.variables["time_s"].units = "s"
    yield _log("nc 3", (folder / "a3.nc").read_bytes())


def _buses(folder: Path) -> Iterator[Seed]:
    database = write_dbc(folder / "bus.dbc", *DBC).read_bytes()
    grouped = database.replace(b"BO_ 256 ", b"BO_ 2566849278 ")
    log = columns()
    frames = []
    for number, stamp_s in enumerate(log["time_s"]):
        up, moved = round(1000 * log["current_up_A"][number]), 100 * log["displacement_mm"][number]
        frames += [
            frame(stamp_s, 0x100, struct.pack("<HHI", up, 0, 0)),
            frame(stamp_s, 0x101, struct.pack(">hHI", round(moved), 0, 0)),
        ]
    for ending in ("asc", "blf", "mf4"):
        content = logged(frames, folder / f"bus.{ending}").read_bytes()
        name = "mf4 bus" if ending == "mf4" else ending
        yield _log(name, content, text=ending == "asc", beside={"bus.dbc": database})
        if ending == "asc":
            packed = gzip.compress(content, mtime=0)
            yield _log("asc.gz", packed, sealed=True, beside={"bus.dbc": database})
            bus = {"a.asc": content, "bus.dbc": database}
            yield Seed("dbc", bus, ("bus.dbc",), read_logs, text=True)
            bus = {"a.asc": content, "bus.dbc": database, "of-a-tractor.dbc": grouped}
            yield Seed("dbc of two", bus, ("of-a-tractor.dbc",), read_logs, text=True)


def _settings(folder: Path) -> Iterator[Seed]:
    log = (folder / "a.csv").read_bytes()
    beside = {"campaign.toml": CAMPAIGN.encode(), "a.csv": log, "b.csv": log}
    nominal = resources.files("hitchid.bench") / "parameters" / "nominal.toml"
    for name, files, door in (
        ("campaign.toml", beside, read_campaign),
        ("settings", {"settings.toml": SETTINGS.encode()}, reading(read_settings, "settings.toml")),
        ("limits", {"limits.toml": LIMITS.encode()}, reading(read_limits, "limits.toml")),
        ("rig", {"rig.toml": nominal.read_bytes()}, reading(load_rig, "rig.toml")),
    ):
        named = next(iter(files))
        yield Seed(name, files, (named,), door, text=True, changes=(_toml_changed(named),))


def _kept(folder: Path) -> Iterator[Seed]:
    for name, model in _models():
        shutil.rmtree(folder / "model", ignore_errors=True)
        save(model, folder / "model", trace={LIFTING: TRACE})
        files = {path.name: path.read_bytes() for path in (folder / "model").iterdir() if path.name[0] != "."}
        if model.rivals:
            yield Seed("model", files, tuple(files), read_model, sealed=True)
            yield Seed("trace resealed", files, (), read_model_trace, changes=(_trace_resealed,))
            yield Seed("rivals resealed", files, (), use_rivals, changes=(_rivals_resealed,), costly=True)
        yield Seed(f"model {name} resealed", files, (), look_at_model, changes=(_resealed,))
        yield Seed(f"model {name} in use", files, (), use_model, changes=(_resealed,), costly=True)
    model = made_up_model(shape=True)
    tuning = made_up_tuning(made_up_controller(model), {"pressure": 125.0})
    save_controller(tuning, model, folder / CONTROLLER, force=True)
    controller, edits = {CONTROLLER: (folder / CONTROLLER).read_bytes()}, (_toml_changed(CONTROLLER),)
    yield Seed("controller", controller, (CONTROLLER,), use_controller, text=True, changes=edits)
    row = {ROW: fleet_rows.row("tractor-7", {LIFTING: fleet_rows.figures(LIFTING)}).as_json()}
    yield Seed("fleet row", row, tuple(row), compare_row, text=True, changes=(_json_changed(ROW),))
    log = {CHANGE_LOG: "".join(f"{event.to_json()}\n" for event in EVENTS).encode()}
    yield Seed("change log", log, tuple(log), resume_adaptation, text=True, changes=(_line_changed,))
    settings = {"settings.json": canonical_json(KEPT_SETTINGS)}
    yield Seed("kept settings", settings, (), read_kept_settings, changes=(_json_changed("settings.json"),))
    kept = {"values": np.arange(20.0), "number": np.array(3), "name": np.array("x")}
    Checkpoints(folder / "pieces").cached_arrays("piece", lambda: kept)
    (piece,) = (folder / "pieces").iterdir()
    yield Seed("checkpoint", {piece.name: piece.read_bytes()}, (piece.name,), read_checkpoint, sealed=True)
    piece.unlink()
    Checkpoints(folder / "pieces").cached("piece", Piece, lambda: PIECE, SHAPES)
    files = {piece.name: piece.read_bytes()}
    yield Seed("checkpoint resealed", files, (), use_checkpoint, changes=(_piece_resealed,))


def _models() -> Iterator[tuple[str, Hitch]]:
    """Yield models of several structures, with every part that a model may have."""
    whole = hitch(compensated=True, baselines=True, free_run=True, dead_time_s=0.03)
    search = SearchSummary("whale", (1.0, None), (600, 590), (0, 600), (None, 1.0), ((1.0,), (2.0,)))
    rivals = {
        direction: replace(own, searches=(search,), paper_estimates=GAIN_ESTIMATES)
        for direction, own in whole.rivals.items()
    }
    yield "whole", replace(with_bands(whole, *whole.channels), rivals=rivals)
    yield "curves", _assessed(hitch("integrator-second-order", shape=True, filtered=True))
    yield "one channel", hitch("first-order-lag", modes=(LIFTING,), end_stop=120.5)
    friction = jnp.array([100.0, 2.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    moved = PhysicalModel(structure_named("inertia-with-friction"), friction, jnp.zeros(()))
    limits = TravelLimits(0.0, 300.0, False, True)
    yield "nonlinear", hitch_of(replace(channel(LIFTING), benchmark=moved, dead_zone=0.0, limits=limits))


def _assessed(model: Hitch) -> Hitch:
    """Return a model with all that is known of its parameters."""
    uncertainty = {}
    for direction, described in model.channels.items():
        values = {
            name: described.benchmark.named_values()[name] for name in ("gain", "damping_ratio", "opening")
        }
        parameters = tuple(
            estimate(name, value, profile=((0.9 * value, 0.5), (value, 0.4)), linear=name == "opening")
            for name, value in values.items()
        )
        matrix = tuple(map(tuple, np.eye(3).tolist()))
        uncertainty[direction] = Uncertainty(
            Estimates(parameters, (), matrix, 8, 8),
            information=Information(
                tuple(values), (1.0, 2.0, 3.0), *[matrix] * 3, (1.0, 0.5), 10, True, 8, 400.0
            ),
            characteristics=characteristics("pressure"),
            load_scatter=LoadScatter(0.04, (0.01, None), 0.2, (LoadOfTest("a", 0.04, (0.0, 0.1)),)),
        )
    provenance = Provenance(
        {LIFTING: ("a", "b")}, {LIFTING: ("b",)}, {}, frozenset({"0f"}), settings=KEPT_SETTINGS
    )
    difference = DifferenceTest(3.2, ("gain",), 9.0, 0.1)
    return replace(
        model,
        units={**model.units, "pressure": "bar"},
        uncertainty=uncertainty,
        provenance=provenance,
        two_modes=TwoModes(True, 2.0, 1.0, 8, difference),
    )


CONTROLLER, ROW, CHANGE_LOG = "controller.toml", "row.json", "changes.jsonl"
GAIN_ESTIMATES = Estimates((estimate("gain", 30.0, profile=((29.0, 0.5), (31.0, 0.4))),), (), ((1.0,),), 8, 8)
TRACE = {
    "dead_zone": {"value": 0.35, "spread": 0.01, "count": 2, "origin": "ramps"},
    "phase1": {
        "uncertainty": asdict(GAIN_ESTIMATES),
        "rmse": 1.0,
        "fitness": [None, 3.0, 1.5],
        "searched": ["gain"],
        "values": [[20.0], [28.0], [30.0]],
    },
    "phase2": {"training_loss": [1.0, 0.5], "validation_loss": [None, 0.6], "best_epoch": 1},
    "candidates": [
        {"name": "plain", "rmse": 1.5, "held_out_rmse": None, "chosen": False},
        {"name": "curves", "rmse": 1.0, "held_out_rmse": 1.2, "chosen": True},
    ],
    "choice_held_out_rmse": 1.3,
    "notices": ["the search ended early"],
}
EVENTS = (
    Event("learned", 3.0, 1, LIFTING, "", Changes(0.01, 0.0, 0.0), (1,), {"band": 0.1}),
    Event("promoted", 6.0, 2, LIFTING, "smaller errors", Changes(0.02, 0.001, 0.0), (1, 2)),
    Event("refused", 9.0, 3, "", "both commands are active", Changes()),
    Event("rolled back", 12.0, 4, LIFTING, "larger errors", Changes()),
)
KEPT_SETTINGS = {
    "structure": {
        "lifting": {"automatic": True, "load": ["pressure"]},
        "lowering": {
            "structure": "integrator-second-order",
            "dead_time": True,
            "bounds": {"gain": [1.0, 90.0]},
        },
    },
    "search": {"method": "whale", "evaluations": 600, "population": 12, "stagnation": None},
    "training": {"hidden": 8, "window": 20, "learning_rate": 0.01, "free_run": True},
    "dead_zones": {"lifting": 0.3},
    "drift": True,
}


# --- doors ------------------------------------------------------------------------------------------------


def read_logs(folder: Path, process: ReaderProcess) -> object:
    """Look at a folder of logs as `hitchid inspect` does; return all that its records hold."""
    paths = find_logs(folder)
    settings = settings_of(paths)
    records = [record for path in paths for record in read_log(path, settings[path.parent], process)]
    campaign = assemble(records, settings, strict=True)
    canonical_json(inspect_campaign(campaign).describe())
    return [
        (record.step_s, record.fingerprint, record.units, {k: v.tobytes() for k, v in record.signals.items()})
        for record in campaign.records
    ]


def read_campaign(folder: Path, process: ReaderProcess) -> object:
    """Read the settings beside logs, then the logs."""
    read_campaign_file(folder / "campaign.toml")
    return read_logs(folder, process)


def reading(read: Callable[[Path], object], name: str) -> Door:
    """Return the door of a file that one call reads."""
    return lambda folder, _: read(folder / name)


def read_model(folder: Path, _: ReaderProcess) -> object:
    """Read a model."""
    return load(folder).provenance.digest


def look_at_model(folder: Path, _: ReaderProcess) -> object:
    """Read a model and look at what it says, without a simulation."""
    model = load(folder)
    load_trace(folder)
    repr(model)
    repr(model.parameters)
    model.segmentation_dead_zones(model.units)
    repr(model.command_thresholds(model.units))
    with suppress(HitchError):
        settings_of_model(model.provenance.settings)
    save(model, folder.with_name("again"), force=True)
    return model.provenance.digest


def use_model(folder: Path, process: ReaderProcess) -> object:
    """Take what anybody takes of a model; an offer that it does not make is refused by name."""
    seen = look_at_model(folder, process)
    model = load(folder)
    count = 3 * SAMPLES
    time = np.arange(count)
    signals = {"displacement": np.full(count, 100.0)}
    for number, direction in enumerate(model.channels):
        opened = (number * count < 2 * time) & (2 * time < (number + 1) * count) & (time % SAMPLES > 5)
        signals[f"{direction}_command"] = np.where(opened, 0.8, 0.0)
    units = {role: model.units[role] for role in signals}
    for name in model.channels[next(iter(model.channels))].benchmark.covariates:
        signals[name] = np.full(count, 110.0)
        units[name] = model.units.get(name, "bar")
    record = Record(name="a", step_s=model.step_s, signals=signals, units=units)
    simulated = model.simulate(record)
    rows = [simulated.displacement, model.predict(record, horizon=3)]
    state = model.init_state(100.0)
    for _step in range(3):
        state, moved = model.step(state, [0.8] * len(model.channels), 100.0)
        rows.append(np.asarray(moved))
    if not all(np.all(np.abs(row) < 1e300) for row in rows):
        raise ValueError("a displacement that is no number")
    if model.has_bands:
        simulated.band(0.9)
        model.band(record, horizon=5)
    for direction in model.channels:
        for offer in (model.speed, model.inverse_table, model.linearise, model.to_scipy):
            with suppress(HitchError):
                offer(*([0.7] if offer == model.speed else []), direction=direction)
        with suppress(HitchError):
            step_responses(model.channels[direction], (0.8,), 1.0)
    for rivals in model.rivals.values():
        for fitted in rivals.baselines.values():
            fitted.free_run(next(iter(model.channels.values())).batch([record]))
    return seen


def use_controller(folder: Path, _: ReaderProcess) -> object:
    """Read a controller and let it hold, and move."""
    controller = load_controller(folder / CONTROLLER).controller
    state = controller.initial_state(100.0)
    currents = []
    for target, measured in ((100.0, 100.0), (120.0, 100.1), (120.0, math.nan)):
        state, current = controller.step(state, target, measured)
        currents.append(np.asarray(current))
    if not np.all(np.isfinite(currents)):
        raise ValueError("a current that is no number")
    return currents


def read_model_trace(folder: Path, _: ReaderProcess) -> object:
    """Read the trace of a model, draw it, and save it again."""
    content = load_trace(folder)
    for trace in read_trace(content).values():
        search, training = trace.phase1, trace.phase2
        drawn = [
            figures.convergence("search", search, "mm", "", ""),
            figures.structures("structures", trace.candidates, "mm", trace.choice_held_out_rmse),
        ]
        if training is not None:
            drawn.append(figures.losses("losses", training))
        for picture in drawn:
            picture.figure.draw_without_rendering()
            DataTable.of_columns("figure", picture.data).csv()
        next((candidate for candidate in trace.candidates if candidate.chosen), None)
    save(load(folder), folder.with_name("again"), trace=content, force=True)
    return content


def use_rivals(folder: Path, _: ReaderProcess) -> object:
    """Compare a model with its rivals."""
    model = load(folder)
    signals = {"displacement": np.linspace(100.0, 120.0, SAMPLES), "lifting_command": np.full(SAMPLES, 0.8)}
    record = Record("a", model.step_s, signals, {role: model.units[role] for role in signals})
    rivals = model.rivals.get(LIFTING, Rivals())
    result = channel_result(model.channels[LIFTING], [record], 1.0, None, rivals)
    if rivals.searches:
        drawn = figures.searches("searches", rivals.searches, "mm")
        drawn.figure.draw_without_rendering()
        repr((search_table(LIFTING, rivals.searches, "mm"), drawn.data))
    return repr(result)


def compare_row(folder: Path, _: ReaderProcess) -> object:
    """Read the row of a machine, compare it with others, and put all into a table."""
    rows = [Row.from_json((folder / ROW).read_bytes(), ROW), *FLEET]
    comparison = compare_fleet(rows)
    canonical_json(comparison_metrics(comparison))
    parquet(DataTable.of_rows("fleet", table_rows(rows)))
    with suppress(InputError):
        load_model(Store(str(folder)), rows[0], folder)
    return rows[0]


FLEET = fleet_rows.fleet(6)


def resume_adaptation(folder: Path, _: ReaderProcess) -> object:
    """Go on from a change log."""
    model = made_up_model(shape=True)
    events = read_events(folder / CHANGE_LOG, model)
    state = Adapter(model, AdaptationSettings()).resumed(events)
    adapted = changed_model(model, state.changes, state.band_factors)
    repr(adapted)
    parameters = [own.benchmark.parameter_vector for own in adapted.channels.values()]
    if not np.isfinite(np.concatenate(parameters)).all():
        raise ValueError("a parameter that is no number")
    return [event.sentence for event in events]


def read_kept_settings(folder: Path, _: ReaderProcess) -> object:
    """Read what a model folder says of the settings of its identification."""
    content = json.loads((folder / "settings.json").read_bytes())
    return settings_of_model(content if isinstance(content, dict) else {"search": content})


@dataclass(frozen=True)
class Piece:
    """What some work found."""

    best: np.ndarray
    trace: np.ndarray
    loss: float
    count: int
    reason: str


PIECE = Piece(np.array([0.1, 0.9]), np.full((3, 2), 0.5), 0.3, 3, "enough")
SHAPES = {"best": Cube((2,)), "trace": Cube(("g", 2))}


def use_checkpoint(folder: Path, _: ReaderProcess) -> object:
    """Read a piece of a run as the work takes it that was stopped."""
    piece = Checkpoints(folder).cached("piece", Piece, lambda: PIECE, SHAPES)
    types = [type(piece.loss) in (int, float), type(piece.count) is int, type(piece.reason) is str]
    if not all(types) or piece.best.shape != (2,) or not np.isfinite([*piece.best, *piece.trace.flat]).all():
        raise ValueError("a piece that no work finds")
    return piece.count


class Redone(HitchError):
    """What was kept is not used."""


def read_checkpoint(folder: Path, _: ReaderProcess) -> object:
    """Read a piece of a run that was stopped."""

    def work() -> dict[str, np.ndarray]:
        raise Redone

    arrays = Checkpoints(folder).cached_arrays("piece", work)
    return {name: (values.dtype.str, values.tobytes()) for name, values in arrays.items()}


# --- changes ----------------------------------------------------------------------------------------------

BYTES = (0, 1, 0x7F, 0x80, 0xFF, 0x20, 0x0A)
SIZES = (0, 1, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**60, 2**63 - 1, 2**63, 2**64 - 1)
WORDS = (
    *("", "nan", "inf", "-inf", "1e999", "-1e308", "1e308", "5e-324", "1e-9", "0", "-0", "-1", "1_000"),
    *("0x10", "9" * 30, "9" * 5000, "0x" + "f" * 5000, "18446744073709551616", "1e-5000", "1,5", "1.5.2"),
    *('"', "'", "true", "[]", "{}", "[[", "\0", "\n", "\r", " " * 300, "(" * 300, "mm", "bar", "\u00b5"),
    *("\ufeff", "a" * 3000),
)
WORD = re.compile(r"[+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?|[A-Za-z_]+")


def _one_of(rng: np.random.Generator, choices: Sequence[Any]) -> Any:
    return choices[int(rng.integers(0, len(choices)))]


def _place(rng: np.random.Generator, data: bytes) -> int:
    return int(rng.integers(0, max(1, len(data))))


def _byte_changed(rng: np.random.Generator, data: bytes) -> bytes:
    """Return a content with some of its bytes changed, in one of eight ways."""
    at, to, end = _place(rng, data), _place(rng, data), max(len(data), 1)
    size = int(min(2 ** rng.uniform(0, 10), len(data)))
    piece = data[at : at + size]
    flipped = bytearray(data)
    for _ in range(int(rng.integers(1, 4)) if data else 0):
        flipped[_place(rng, data)] ^= 1 << int(rng.integers(0, 8))
    few = _one_of(rng, (1, 1, 2, 4, 8, 64))
    fresh = rng.bytes(few) if rng.random() < 0.3 else bytes([_one_of(rng, BYTES)]) * few
    # A length that nothing has, where a field of 2, 4 or 8 bytes may be.
    width = _one_of(rng, (2, 4, 8))
    field, order = at // width * width, "little" if rng.random() < 0.7 else "big"
    length = (_one_of(rng, SIZES) % 256**width).to_bytes(width, order)
    changes = (
        bytes(flipped),
        (data[:at] + fresh + data[at + few :])[:end],
        (data[:field] + length + data[field + width :])[:end],
        data[:at] + rng.bytes(size) + data[at:],
        data[:at] + data[at + size :],
        data[: at + size] + piece * _one_of(rng, (1, 1, 2, 50)) + data[at + size :],
        data[:at],
        data[:to] + piece + data[to + size :],
    )
    return _one_of(rng, (*changes[:3], *changes))


def _worded(rng: np.random.Generator, data: bytes) -> bytes:
    text = data.decode("latin-1")
    words = list(WORD.finditer(text))
    if not words:
        return data
    match, word = _one_of(rng, words), _one_of(rng, WORDS)
    return (text[: match.start()] + word + text[match.end() :]).encode(
        "utf-8" if "\ufeff" in word else "latin-1", "replace"
    )


def _separated(rng: np.random.Generator, data: bytes) -> bytes:
    marks = (b",", b";", b"\t", b" ", b"|", b".", b"\n", b"\r\n", b'"', b"=", b"[", b":")
    one, other = _one_of(rng, marks), _one_of(rng, marks)
    return data.replace(one, other, -1 if rng.random() < 0.5 else 1)


def _lined(rng: np.random.Generator, data: bytes) -> bytes:
    lines = data.split(b"\n")
    at, to = (int(rng.integers(0, len(lines))) for _ in range(2))
    way = int(rng.integers(0, 4))
    if way == 0:
        lines.insert(to, lines[0])
    elif way == 1:
        lines.insert(to, lines[at])
    elif way == 2:
        del lines[at]
    else:
        lines[at], lines[to] = lines[to], lines[at]
    return b"\n".join(lines)


TEXT_CHANGES: tuple[Change, ...] = (_worded, _worded, _worded, _separated, _lined)


def changed(rng: np.random.Generator, seed: Seed, every: list[Seed]) -> Files:
    """Return the files of a seed with one of them changed, once or a few times."""
    if seed.changes and (not seed.changed or rng.random() < 0.5):
        return _one_of(rng, seed.changes)(rng, seed.files)
    name = _one_of(rng, seed.changed)
    data = seed.files[name]
    if rng.random() < 0.04:
        foreign = next(iter(_one_of(rng, every).files.values()))
        return {**seed.files, name: data[: _place(rng, data)] + foreign[_place(rng, foreign) :]}
    ways = (_byte_changed,) if not seed.text or rng.random() < 0.3 else TEXT_CHANGES
    for _ in range(1 + min(int(rng.geometric(0.6)) - 1, 5)):
        data = _one_of(rng, ways)(rng, data)
    return {**seed.files, name: data}


VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 10**6, 10**9, 10**18, 10**400, 16**5000, 1e308, -1e308, 5e-324, 0.5),
    *(math.nan, math.inf, -math.inf, "", "x", "mm", "*", "\0", "../../x", "a" * 5000, "\U0001f600"),
    *([], {}, [[]], [1, 2], [2.0, 1.0], ["a", "a"], [math.nan, 1.0], {"x": 1}, {"column": "time_s"}),
    *({"value": 1}, "command", "time", "displacement", "lifting_command", "integrator", "automatic"),
    *("2024-05-01", [None] * 3, [["x"] * 50]),
)


def _node_changed(rng: np.random.Generator, content: object) -> object:
    """Return a tree of settings with one thing in it changed: a value, a key, or one more of them."""
    if isinstance(content, dict) and content and rng.random() < 0.85:
        key, way = _one_of(rng, list(content)), rng.random()
        if way < 0.7:
            return {**content, key: _node_changed(rng, content[key])}
        if way < 0.8:
            return {other: value for other, value in content.items() if other != key}
        if way < 0.9:
            return {(f"{key}s" if other == key else other): value for other, value in content.items()}
        return {**content, _one_of(rng, list(content)): content[key], "another": content[key]}
    if isinstance(content, list) and content and rng.random() < 0.7:
        at = int(rng.integers(0, len(content)))
        return [*content[:at], _node_changed(rng, content[at]), *content[at + 1 :]]
    if rng.random() < 0.03:
        nested: object = []
        for _ in range(_one_of(rng, (20, 200, 3000))):
            nested = [nested]
        return nested
    return _one_of(rng, VALUES)


def as_toml(value: object) -> str:
    """Return a value as TOML writes it in line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {as_toml(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        depth = 0  # an empty list deep in lists of one, without recursion
        while isinstance(value, list) and len(value) == 1:
            value, depth = value[0], depth + 1
        inner = "[" + ", ".join(map(as_toml, value)) + "]" if isinstance(value, list) else as_toml(value)
        return "[" * depth + inner + "]" * depth
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, int) and abs(value) > 10**4000:
        return hex(value)
    return json.dumps(value) if isinstance(value, str) else repr(value)


def _toml_changed(name: str) -> Callable[[np.random.Generator, Files], Files]:
    def change(rng: np.random.Generator, files: Files) -> Files:
        content: object = tomllib.loads(files[name].decode())
        for _ in range(int(rng.geometric(0.6))):
            content = _node_changed(rng, content)
        tables = content if isinstance(content, dict) else {"x": content}
        text = "".join(f"{json.dumps(key)} = {as_toml(value)}\n" for key, value in tables.items())
        return {**files, name: text.encode(errors="replace")}

    return change


def _json_changed(name: str) -> Callable[[np.random.Generator, Files], Files]:
    def change(rng: np.random.Generator, files: Files) -> Files:
        content = _node_changed(rng, json.loads(files[name]))
        try:
            return {**files, name: json.dumps(content).encode()}
        except (ValueError, RecursionError):  # what JSON does not hold
            return files

    return change


DESCRIBED = {"model.json": ("weights.safetensors", "trace.json"), "rivals.json": ("rivals.safetensors",)}


def resealed(files: Mapping[str, bytes], content: Mapping[str, Any], name: str = "model.json") -> Files:
    """Return a model folder with another description, of the model or its rivals, its digests put right."""
    listed = {described: digest(files[described]) for described in DESCRIBED[name]}
    described = {**content, "files": listed}
    described.pop("digest", None)
    described["digest"] = digest(canonical_json(described))
    changed = {**files, name: canonical_json(described)}
    if name == "rivals.json" or "rivals.json" not in files:
        return changed
    rivals = {**json.loads(files["rivals.json"]), "model": described["digest"]}
    return resealed(changed, rivals, "rivals.json")


def _resealed(rng: np.random.Generator, files: Files) -> Files:
    """Return a model folder with something in it changed, and all its digests put right."""
    name = "rivals.json" if "rivals.json" in files and rng.random() < 0.25 else "model.json"
    return _described_changed(rng, files, name)


def _rivals_resealed(rng: np.random.Generator, files: Files) -> Files:
    """Return a model folder with something in its rivals changed, and their digests put right."""
    return _described_changed(rng, files, "rivals.json", share=0.6)


def _described_changed(rng: np.random.Generator, files: Files, name: str, share: float = 0.25) -> Files:
    """Return a model folder with a description changed, or a share of times a file beside it."""
    data = dict(files)
    content = json.loads(files[name])
    if rng.random() < share:
        beside = _one_of(rng, DESCRIBED[name])
        is_array = beside.endswith("tensors") and rng.random() < 0.65
        data[beside] = (_array_changed if is_array else _byte_changed)(rng, data[beside])
    else:
        content = _node_changed(rng, content)
    try:
        return resealed(data, content if isinstance(content, dict) else {}, name)
    except (ValueError, RecursionError):  # what JSON does not hold
        return files


def _trace_resealed(rng: np.random.Generator, files: Files) -> Files:
    """Return a model folder with its trace changed, and all its digests put right."""
    content = json.loads(files["trace.json"])
    for _ in range(int(rng.geometric(0.6))):
        content = _node_changed(rng, content)
    try:
        data = json.dumps(content).encode() if rng.random() < 0.1 else canonical_json(content)
    except (ValueError, RecursionError):  # what JSON does not hold
        return files
    return resealed({**files, "trace.json": data}, json.loads(files["model.json"]))


def _piece_resealed(rng: np.random.Generator, files: Files) -> Files:
    """Return a piece of a run with an array changed, and its digest put right."""
    (name,) = files
    with np.load(io.BytesIO(files[name][DIGEST_LENGTH:])) as archive:
        arrays = dict(archive)
    changed = _one_of(rng, sorted(arrays))
    kinds = (np.float64, np.int64, np.complex128, np.dtype("U3"), np.dtype("M8[s]"), np.dtype("O"), np.bool_)
    way = int(rng.integers(0, 4))
    if way == 0:
        arrays[f"{changed}x"] = arrays.pop(changed)
    elif way == 1:
        arrays[changed] = np.zeros(rng.integers(0, 4, int(rng.integers(0, 4))))
    elif way == 2:
        arrays[changed] = np.full(arrays[changed].shape, rng.choice(NUMBERS))
    else:
        arrays[changed] = np.zeros(arrays[changed].shape, _one_of(rng, kinds))
    made = io.BytesIO()
    (np.savez_compressed if rng.random() < 0.1 else np.savez)(made, **arrays)
    data = made.getvalue()
    if rng.random() < 0.2:
        data = _byte_changed(rng, data)
    return {name: digest(data).encode() + data}


def _line_changed(rng: np.random.Generator, files: Files) -> Files:
    """Return a change log with one of its lines changed."""
    lines = files[CHANGE_LOG].decode().splitlines()
    at = int(rng.integers(0, len(lines)))
    content = _node_changed(rng, json.loads(lines[at]))
    with suppress(ValueError, RecursionError):  # what JSON does not hold
        lines[at] = json.dumps(content)
    return {CHANGE_LOG: "\n".join([*lines, ""]).encode()}


NUMBERS = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1.0, 1e-300, 1e6, 1e30, 1e308, 2.0**31)


def _array_changed(rng: np.random.Generator, data: bytes) -> bytes:
    """Return tensors with one of them changed: a number, the shape, the type, the name."""
    tensors = load_tensors(data)
    name = _one_of(rng, sorted(tensors))
    values = tensors[name].copy()
    way = int(rng.integers(0, 8))
    if way < 5 and values.size:
        with np.errstate(all="ignore"):
            number = np.asarray(_one_of(rng, NUMBERS)).astype(values.dtype)
        if way == 0:
            values[...] = number
        else:
            values.flat[int(rng.integers(0, values.size))] = number
        tensors[name] = values
    elif way == 5:
        tensors[name] = np.repeat(values[None], int(rng.choice([0, 1, 3])), axis=0)
    elif way == 6:
        tensors[name] = values.astype(np.int64 if values.dtype.kind == "f" else np.float64)
    else:
        tensors[f"{name}x"] = tensors.pop(name)
    return save_tensors(tensors)


# --- the run ----------------------------------------------------------------------------------------------


class Outcome(NamedTuple):
    """What became of an input: refused or accepted, or the fault it shows, and what it said."""

    verdict: str
    said: str = ""
    fault: BaseException | None = None


def put(folder: Path, files: Mapping[str, bytes]) -> None:
    """Fill a folder with these files and no others."""
    if folder.is_dir():
        for path in folder.iterdir():
            path.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)


@contextmanager
def hang_ends(after_s: int = HUNG_S) -> Iterator[None]:
    """End what computes longer in this process, or waits ten times as long, as it may on a busy machine.

    Raises:
        Hung: it did.
    """

    def end(*_: object) -> None:
        raise Hung

    numbers = (signal.SIGPROF, signal.SIGALRM)
    before = [signal.signal(number, end) for number in numbers]
    signal.setitimer(signal.ITIMER_PROF, after_s)
    signal.alarm(10 * after_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def told_apart(result: object) -> str:
    """Return what tells one result from another."""
    return sha256(repr(result).encode(errors="surrogateescape")).hexdigest()


def tried(seed: Seed, folder: Path, process: ReaderProcess, whole: str | None = None) -> Outcome:
    """Hand a folder in at the door of its seed.

    Args:
        seed: of which the folder holds a changed copy.
        folder: the files.
        process: that reads for it.
        whole: what tells the result of the seed; None where any result may come.
    """
    try:
        with hang_ends(), np.errstate(all="ignore"):
            result = seed.door(folder, process)
    except HitchError as error:
        return Outcome(REFUSED, str(error))
    except (Exception, Hung) as error:  # that anything else comes out is what this looks for
        return Outcome("fault", f"{type(error).__name__}: {error}"[:300], error)
    if whole is not None and told_apart(result) != whole:
        return Outcome("fault", "another result than that of the whole file")
    return Outcome(ACCEPTED)
