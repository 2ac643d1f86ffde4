"""Damaged and hostile files of every kind: refused by name, or read as they are; nothing else."""

import gzip
import json
import os
import pickle
import re
import sys
import warnings
import zlib
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

sys.path.insert(1, str(Path(__file__).parent / "logs"))

from can_logs import message, write_dbc

import fuzzing
from hitchid._support.files import canonical_json
from hitchid.errors import HitchError, InputError, LogError, ModelFolderError, SettingsError
from hitchid.fleet import Store, read_rows
from hitchid.fleet.ledger import load_model
from hitchid.identification.settings_file import read_settings
from hitchid.live import read_events
from hitchid.logs import ReaderProcess, find_logs, read, write_table
from hitchid.logs.signal_map import read_campaign_file
from hitchid.model import load
from hitchid.model.folder import load_trace

MOST_MEMORY_KB = 2 * 2**20
HEADER = b"time_s,current_up_A,current_down_A,displacement_mm\n"
NAMES = tuple(fuzzing.columns())


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """Return a seed of every kind."""
    return fuzzing.seeds(tmp_path_factory.mktemp("seeds") / "seeds")


@pytest.fixture(scope="module")
def every(seeds):
    """Return those that are handed in without being compiled."""
    return [seed for seed in seeds if not seed.costly]


@pytest.fixture(scope="module")
def process():
    """Return a process that reads for the whole file."""
    with ReaderProcess() as reader:
        yield reader


@pytest.fixture
def put(tmp_path):
    """Return a function that makes a folder of files: name to content."""

    def make(**files):
        fuzzing.put(tmp_path / "in", {name.replace("__", "."): content for name, content in files.items()})
        return tmp_path / "in"

    return make


def files_of(every, name):
    return next(seed.files for seed in every if seed.name == name)


def most_memory_kb(process_id="self"):
    status = Path(f"/proc/{process_id}/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])


def refused(folder, process, *, within_s=10):
    """Check that logs are refused in time, whatever they take; return what is said."""
    with fuzzing.hang_ends(within_s), pytest.raises(HitchError) as caught:
        fuzzing.read_logs(folder, process)
    return str(caught.value)


def rows(time_s):
    cells = zip(time_s, [0.0] * 6 + [0.5] * (len(time_s) - 6), range(len(time_s)), strict=True)
    return HEADER + b"".join(f"{t!r},{up},0,{moved}\n".encode() for t, up, moved in cells)


# --- at random --------------------------------------------------------------------------------------------


def test_every_seed_is_read(every, process, tmp_path):
    for seed in every:
        fuzzing.put(tmp_path / "in", seed.files)
        assert fuzzing.tried(seed, tmp_path / "in", process) == (fuzzing.ACCEPTED, "", None), seed.name


@pytest.mark.parametrize("inputs", [500, pytest.param(5000, marks=pytest.mark.long)])
def test_random_damage_is_refused_or_harmless(every, process, tmp_path, inputs):
    whole = {}
    for seed in (seed for seed in every if seed.sealed):
        fuzzing.put(tmp_path / "in", seed.files)
        whole[seed.name] = fuzzing.told_apart(seed.door(tmp_path / "in", process))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in range(inputs):
            rng = np.random.default_rng([23, number])
            seed = every[number % len(every)]
            fuzzing.put(tmp_path / "in", fuzzing.changed(rng, seed, every))
            outcome = fuzzing.tried(seed, tmp_path / "in", process, whole.get(seed.name))
            assert outcome.verdict != "fault", (seed.name, number, outcome.said)


USED = [
    pytest.param("one channel", 40, id="one channel"),
    pytest.param("curves", 60, id="curves", marks=pytest.mark.long),
]


@pytest.mark.parametrize(("name", "inputs"), USED)
def test_an_edited_model_is_refused_or_of_use(seeds, process, tmp_path, name, inputs):
    seed = next(seed for seed in seeds if seed.name == f"model {name} in use")
    for number in range(inputs):
        files = (
            seed.files if number == 0 else fuzzing.changed(np.random.default_rng([24, number]), seed, seeds)
        )
        fuzzing.put(tmp_path / "in", files)
        outcome = fuzzing.tried(seed, tmp_path / "in", process)
        assert outcome.verdict != "fault", (number, outcome.said)
        assert number or outcome.verdict == fuzzing.ACCEPTED, outcome.said


def test_the_process_that_reads_outlives_what_it_refuses(every, process, tmp_path):
    fuzzing.put(tmp_path / "in", files_of(every, "tdms"))
    fuzzing.read_logs(tmp_path / "in", process)
    child = process._child.pid
    fuzzing.put(tmp_path / "in", {"a.tdms": b"no log"})
    refused(tmp_path / "in", process)
    assert process._child.pid == child


# --- bombs ------------------------------------------------------------------------------------------------


def bomb(block, total):
    """Return a gzip file that unpacks to a header and a block over and over."""
    packer = zlib.compressobj(6, zlib.DEFLATED, 31)
    block = block * (2**22 // len(block))
    parts = [packer.compress(HEADER), *(packer.compress(block) for _ in range(total // len(block)))]
    return b"".join([*parts, packer.flush()])


@pytest.mark.parametrize("block", [b"\0", b"0,0,0,0\n"], ids=["zeros", "rows"])
def test_a_gzip_bomb_is_refused_before_its_rows_are_read(put, process, block):
    content = bomb(block, 2**29)
    assert len(content) < 3 * 2**20
    said = refused(put(a__csv__gz=content), process)
    assert "unpacks to more than 50 times its size" in said


CHUNK = 2**20


@pytest.mark.parametrize("count", [2**60, 300_000_000, 20_000_000], ids=["absurd", "10 GB", "640 MB"])
def test_datasets_far_larger_than_their_file_are_refused(tmp_path, process, count):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in NAMES:
            dataset = file.create_dataset(
                name, shape=(count,), chunks=(CHUNK,), dtype="f8", compression="gzip"
            )
            dataset[:CHUNK] = np.zeros(CHUNK)
    said = refused(tmp_path, process)
    assert re.search("too big|more memory|200 times its size", said)
    assert most_memory_kb(process._child.pid) < MOST_MEMORY_KB


def test_parquet_pages_far_larger_than_their_file_are_refused(tmp_path, process):
    ones = pyarrow.array(np.zeros(10**6))
    table = pyarrow.table(dict.fromkeys(NAMES, ones))
    with pyarrow.parquet.ParquetWriter(tmp_path / "a.parquet", table.schema, compression="gzip") as writer:
        for _ in range(100):
            writer.write_table(table)
    assert re.search("more memory|200 times its size", refused(tmp_path, process))
    assert most_memory_kb(process._child.pid) < MOST_MEMORY_KB


# --- text without measure ---------------------------------------------------------------------------------

LONG = {
    "white space within a name": b"a" + b" " * 120_000 + b"b,c\n1,2\n2,3\n",
    "a name": b"a" * 120_000 + b",c\n1,2\n2,3\n",
    "brackets": b"(" * 120_000 + b",c\n1,2\n2,3\n",
    "names": b",".join(b"c%d" % n for n in range(30_000)) + b"\n" + b",".join([b"1"] * 30_000) + b"\n",
    "white space below": HEADER.replace(b",", b" ") + b"1 2 3 4\n" * 30 + b" " * 10**6 + b"\n",
}


@pytest.mark.parametrize("content", LONG.values(), ids=LONG)
def test_text_of_any_length_is_told_in_time(put, process, content):
    refused(put(a__csv=content), process, within_s=5)


TOO_MUCH = {
    "nested lists": b"x = " + b"[" * 100_000 + b"]" * 100_000,
    "nested tables": b"x = " + b"{a=" * 5000 + b"1" + b"}" * 5000,
    "a dotted key": b"a." * 100_000 + b"b = 1",
    "a text of 10 MB": b'[signals]\ntime = "' + b"x" * 10**7 + b'"\n',
    "a huge number": b"[signals]\ncovariates = 0x" + b"f" * 5000,
    "a huge decimal number": b"[signals]\ncovariates = " + b"9" * 5000,
    "a long key": b"x" * 10**6 + b" = 1",
}


@pytest.mark.parametrize("content", TOO_MUCH.values(), ids=TOO_MUCH)
@pytest.mark.parametrize("door", ["campaign.toml", "settings", "limits", "rig"])
def test_settings_beyond_measure_are_refused_in_few_words(every, tmp_path, process, content, door):
    seed = next(seed for seed in every if seed.name == door)
    fuzzing.put(tmp_path / "in", {**seed.files, seed.changed[0]: content})
    with fuzzing.hang_ends(5), pytest.raises(SettingsError) as caught:
        seed.door(tmp_path / "in", process)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("key", ["evaluations", "population", "stagnation"])
def test_a_budget_without_measure_is_refused(tmp_path, key):
    path = tmp_path / "settings.toml"
    path.write_text(f"[search]\n{key} = 0x{'f' * 5000}\n")
    with pytest.raises(SettingsError, match=f"search.{key}.*got a huge number"):
        read_settings(path)


@pytest.mark.parametrize("name", ["time", "command", "displacement", "lifting_command", "lowering_command"])
def test_no_covariate_takes_the_name_of_a_role(tmp_path, name):
    path = tmp_path / "campaign.toml"
    path.write_text(f'[signals]\nlifting_command = "up_A"\ncovariates = ["{name}"]\n')
    with pytest.raises(SettingsError, match=f"'{name}' is the name of a signal"):
        read_campaign_file(path)


# --- clocks no logger has ---------------------------------------------------------------------------------

CLOCKS = {
    "tiny": 5e-324 * np.arange(40),
    "overflowing": np.concatenate([[-1.7e308], 1.7e308 * np.linspace(0.5, 1, 40)]),
}


@pytest.mark.parametrize("time_s", CLOCKS.values(), ids=CLOCKS)
@pytest.mark.filterwarnings("ignore:overflow")
def test_a_clock_no_logger_has_is_refused(put, process, time_s):
    assert "the sampling time is" in refused(put(a__csv=rows(time_s.tolist())), process)


def test_a_displacement_of_the_smallest_numbers_is_looked_at(put, process):
    time_s, up = np.arange(60) / 100, np.where(np.arange(60) > 5, 0.5, 0.0)
    moved = 5e-324 * (np.arange(60) * 37 % 50)
    cells = zip(time_s.tolist(), up.tolist(), moved.tolist(), strict=True)
    content = HEADER + b"".join(f"{t!r},{c!r},0,{d!r}\n".encode() for t, c, d in cells)
    assert fuzzing.read_logs(put(a__csv=content), process)


def test_logs_of_far_too_unlike_rates_are_refused(put, process):
    fast, slow = rows([1e-8 * n for n in range(40)]), rows([float(n) for n in range(40)])
    said = refused(put(a__csv=fast, b__csv=slow, c__csv=fast), process)
    assert "times longer or shorter than the median" in said
    assert "b.csv" in said


# --- links, pipes, names ----------------------------------------------------------------------------------


def test_pipes_and_devices_among_logs_are_passed_over(put, process):
    folder = put(a__csv=rows([n / 100 for n in range(40)]))
    for name in ("b.csv", "c.tdms", "d.dbc", "campaign.toml"):
        os.mkfifo(folder / name)
    (folder / "zero.csv").symlink_to("/dev/zero")
    with fuzzing.hang_ends(10):
        assert find_logs(folder) == [folder / "a.csv"]
        assert len(read(folder).records) == 1
        for name in ("b.csv", "zero.csv"):
            with pytest.raises(InputError, match="no such file"):
                find_logs(folder / name)


@pytest.mark.parametrize("name", ["a\nb", "a\x1b[2J", os.fsdecode(b"\xff\xfe"), "a'b\"c", "-rf", "a" * 200])
def test_any_name_of_a_log_is_read_and_told(tmp_path, name):
    for ending in ("csv", "parquet"):
        write_table(tmp_path / f"{name}.{ending}", fuzzing.columns())
        (record,) = read(tmp_path / f"{name}.{ending}").records
        assert record.name == name
        (tmp_path / f"{name}.{ending}").write_bytes(b"no log")
        with pytest.raises(LogError):
            read(tmp_path / f"{name}.{ending}")


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def model(every, tmp_path):
    """Return the folder of a model."""
    fuzzing.put(tmp_path / "model", files_of(every, "model whole resealed"))
    return tmp_path / "model"


PARTS = ("model.json", "weights.safetensors", "trace.json")


@pytest.mark.parametrize("name", PARTS)
def test_a_model_holds_no_link_out_of_its_folder(model, tmp_path, name):
    inside = model / "inside"
    (model / name).rename(inside)
    (model / name).symlink_to("inside")
    load(model)
    inside.rename(tmp_path / "outside")
    (model / name).unlink()
    (model / name).symlink_to(tmp_path / "outside")
    with pytest.raises(ModelFolderError, match="outside its folder"):
        load(model)


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("kind", ["pipe", "folder", "loop", "device"])
def test_a_model_of_anything_but_files_is_refused(model, name, kind):
    (model / name).unlink()
    if kind == "pipe":
        os.mkfifo(model / name)
    elif kind == "folder":
        (model / name).mkdir()
    else:
        (model / name).symlink_to(name if kind == "loop" else "/dev/zero")
    with fuzzing.hang_ends(10), pytest.raises(ModelFolderError, match=name):
        load(model)


# --- what was sealed by whoever changed it ----------------------------------------------------------------


def put_in(content, path, value):
    *way, last = path.split("/")
    for key in way:
        content = content[int(key) if isinstance(content, list) else key]
    content[last] = value


FORGED = [
    *((("step_s", value)) for value in ("0.01", None, [0.01], True, {}, 0, -1.0, 1e-300, 1e300, 10**400)),
    *(("channels/lifting/dead_time_s", value) for value in (1e6, -1, "x", None)),
    *(("channels/lifting/direction", value) for value in (0, 2, -3, 1.5, True, "1")),
    *(("channels/lifting/end_stop", value) for value in ("x", [], 1e300)),
    *(("channels/lifting/values", value) for value in ([0.0], [-1.0], [], [1.0, 2.0], ["1"], 1.0, [1e300])),
    *(("channels/lifting/dead_zone", value) for value in (-0.1, "x", 1e300)),
    ("channels/lifting/limits", {"lower": 2.0, "upper": 1.0, "lower_stop": True, "upper_stop": True}),
    ("channels/lifting/another", 1),
    ("channels/lifting", 3),
    ("channels/lifting/compensator/hidden", 10**9),
    ("channels/lifting/compensator/window", 10**12),
    ("channels/lifting/speed_compensator/members", 10**9),
    ("channels", []),
    ("channels", {}),
    ("channels/sideways", {}),
    ("units", {}),
    ("units/displacement", "furlong"),
    ("units/displacement", "bar"),
    ("units/lifting_command", None),
    ("drift", "x"),
    ("split/held_out", "x"),
    ("settings", []),
    ("settings/structure", {"lifting": 3}),
    ("uncertainty", [1]),
    ("uncertainty/lifting/bands/levels", []),
    ("uncertainty/lifting/bands/free_run", [1.0]),
    ("uncertainty/lifting/bands/ensemble/0/benchmark", [1.0]),
    ("uncertainty/lifting/bands/ensemble/0/network", 7),
    ("uncertainty/lifting/bands/predictions/horizons", [0, 10]),
    ("another", 1),
    ("seen", {}),
    ("rivals", []),
    ("rivals/lifting/paper/compensator/hidden", 2**62),
    ("rivals/lifting/paper/values", [0.0, 5.0]),
    ("rivals/lifting/another", 1),
    ("rivals/lifting/paper/dead_time_s", 2000.0),
    ("rivals/lifting/paper_parameters/parameters/0/error", -1.0),
    ("rivals/lifting/covariates", ["pressure", "oil"]),
    ("rivals/lifting/searches/0/evaluations", [600]),
    ("rivals/lifting/searches/0/median_values", [[1.0], [2.0, 3.0]]),
    ("trace/lifting/dead_zone/count", -1),
    ("trace/lifting/phase1/values", [[1.0]]),
    ("trace/lifting/phase1/fitness", ["x"] * 10**5),
    ("trace/lifting/phase1/searched", ["frequency"]),
    ("trace/lifting/phase1/uncertainty/parameters/0/value", "x"),
    ("trace/lifting/phase2/best_epoch", 10**400),
    ("trace/lifting/candidates", [{"name": "a", "rmse": 1.0, "held_out_rmse": None, "chosen": False}]),
    ("trace/sideways", {}),
    ("trace/lifting", []),
]


@pytest.mark.parametrize(
    ("path", "value"), FORGED, ids=[f"{path}={str(value)[:20]}" for path, value in FORGED]
)
def test_a_forged_description_is_refused_by_key(model, path, value):
    files = contents(model)
    part = path.partition("/")[0]
    name = f"{part}.json" if part in ("rivals", "trace") else "model.json"
    content = json.loads(files[name])
    put_in({"trace": content} if part == "trace" else content, path, value)
    if part == "trace":
        files[name], name = canonical_json(content), "model.json"
        content = json.loads(files[name])
    fuzzing.put(model, fuzzing.resealed(files, content, name))
    door = fuzzing.read_model_trace if part == "trace" else fuzzing.read_model
    with fuzzing.hang_ends(5), pytest.raises(ModelFolderError, match=path.rpartition("/")[2]) as caught:
        door(model, None)
    assert len(str(caught.value)) < 1000


ARRAYS = {
    "nan": ("lifting/compensator/network/cell/weight_hh", np.nan),
    "infinite": ("lifting/speed_compensator/networks/biases", np.inf),
    "no scale": ("lifting/speed_compensator/command_scale", 0.0),
    "falling range": ("lifting/operating_range/command/lowest", 7.0),
    "infinite the wrong way": ("lifting/load_filter/load_length", -np.inf),
    "another number of inputs": ("lifting/baselines/arx/gains", np.zeros((3, 2))),
    "another order": ("lifting/baselines/oe/past", np.zeros(3)),
    "a delay of days": ("lifting/baselines/oe/delay", 10**8),
    "no step": ("lifting/baselines/lstm/samples", 0),
    "no scale of a rival": ("lifting/baselines/lstm/increment_scale", 0.0),
    "two covariates": ("lifting/baselines/lstm/load_centre", np.zeros(2)),
    "an unknown factor": ("lifting/baselines/narx/terms", 500),
    "the lowest integer": ("lifting/baselines/narx/terms", -(2**63)),
    "no term": ("lifting/baselines/narx/coefficients", np.zeros(0)),
    "of no part": ("lifting/code", np.zeros(3)),
}


@pytest.mark.parametrize(("name", "number"), ARRAYS.values(), ids=ARRAYS)
def test_a_forged_array_is_refused_by_name(model, name, number):
    files = contents(model)
    stem = "rivals" if "/baselines/" in name else "weights"
    described = "rivals.json" if stem == "rivals" else "model.json"
    tensors = load_tensors(files[f"{stem}.safetensors"])
    like = tensors.get(name)
    tensors[name] = number if np.ndim(number) else np.full(like.shape, number, like.dtype)
    changed = {**files, f"{stem}.safetensors": save_tensors(tensors)}
    fuzzing.put(model, fuzzing.resealed(changed, json.loads(files[described]), described))
    with pytest.raises(ModelFolderError, match="/".join(name.split("/")[:3])):
        load(model)


ROWS = [
    *(("key", value) for value in ("../../x", "", None)),
    *(("date", value) for value in ("yesterday", "0001-01-01", 5)),
    ("units/displacement", "furlong"),
    ("directions/sideways", {}),
    *(("directions/lifting/gain", value) for value in (1e30, "60")),
    ("directions/lifting/dead_zone", -0.1),
    ("directions/lifting/correlation", 2.0),
    ("directions/lifting/tests", 10**30),
    ("cost/peak_bytes", -1),
    ("signature", "that-of-another"),
    ("notices", ["x" * 2**20]),
]


@pytest.mark.parametrize(("path", "value"), ROWS, ids=[f"{path}={str(value)[:20]}" for path, value in ROWS])
def test_a_forged_row_of_a_fleet_is_refused_by_key(every, tmp_path, path, value):
    content = json.loads(files_of(every, "fleet row")["row.json"]) | {"key": "0f" * 8}
    file = tmp_path / "rows" / content["machine"] / f"{content['signature']}.json"
    put_in(content, path, value)
    file.parent.mkdir(parents=True)
    file.write_text(json.dumps(content))
    store = Store(str(tmp_path))
    said = {"signature": "its own place", "notices": "1 MiB"}.get(path, path.rpartition("/")[2])
    with pytest.raises(InputError, match=said):
        load_model(store, read_rows(store)[0], tmp_path / "models")


@pytest.mark.parametrize(
    "edit", [{"changes": {"gain": 1e3, "dead_zone": 0.0, "lag": 0.0}}, {"strokes": [-1]}]
)
def test_a_forged_change_log_is_refused_by_key(tmp_path, edit):
    line = {**json.loads(fuzzing.EVENTS[0].to_json()), **edit}
    (tmp_path / "changes.jsonl").write_text(json.dumps(line) + "\n")
    with pytest.raises(InputError, match=next(iter(edit))):
        read_events(tmp_path / "changes.jsonl")


class Evil:
    """Leaves a file where it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


def test_nothing_is_unpickled(model, tmp_path):
    mark = tmp_path / "mark"
    code = pickle.dumps(Evil(mark))
    files = contents(model)
    content = json.loads(files["model.json"])
    for weights in (code, save_tensors({"x": np.frombuffer(code, np.uint8)})):
        fuzzing.put(model, fuzzing.resealed({**files, "weights.safetensors": weights}, content))
        with pytest.raises(ModelFolderError):
            load(model)
    fuzzing.put(model, fuzzing.resealed({**files, "trace.json": code}, content))
    with pytest.raises(ModelFolderError, match="was edited"):
        load_trace(model)
    assert not mark.exists()


def test_no_piece_of_a_run_is_unpickled(every, tmp_path, process):
    (name,) = files_of(every, "checkpoint")
    mark = tmp_path / "mark"
    np.savez(tmp_path / "evil.npz", allow_pickle=True, x=np.array([Evil(mark)], dtype=object))
    np.save(tmp_path / "plain.npy", np.arange(3.0))
    np.savez_compressed(tmp_path / "bomb.npz", x=np.zeros(10**6))
    for made in ("evil.npz", "plain.npy", "bomb.npz"):
        content = (tmp_path / made).read_bytes()
        fuzzing.put(tmp_path / "in", {name: fuzzing.digest(content).encode() + content})
        with pytest.raises(fuzzing.Redone):
            fuzzing.read_checkpoint(tmp_path / "in", process)
    assert not mark.exists()


def test_a_database_of_10_000_signals_is_read(every, tmp_path, process):
    files = files_of(every, "asc")
    signals = [f's{n} : {6 * n}|6@1+ (1,0) [0|0] "" ECU' for n in range(10)]
    database = write_dbc(
        tmp_path / "large.dbc", *fuzzing.DBC, *(message(2**31 + n, f"M{n}", *signals) for n in range(1000))
    )
    fuzzing.put(tmp_path / "in", {**files, "bus.dbc": database.read_bytes()})
    fuzzing.read_logs(tmp_path / "in", process)


def test_a_gzip_file_of_two_members_is_one_log(put, process):
    text = rows([n / 100 for n in range(40)])
    folder = put(a__csv__gz=gzip.compress(text[:500]) + gzip.compress(text[500:]))
    assert fuzzing.read_logs(folder, process)
