"""Finished pieces of long work: found again bit for bit, done anew where they are not whole."""

import errno
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock

import numpy as np
import pytest

import hitchid
from hitchid._support.checkpoints import (
    DISABLED,
    RUN_FILE,
    SUFFIX,
    Checkpoints,
    Cube,
    has_results,
    is_empty,
    is_run,
    remove_run,
)
from hitchid._support.progress import attempt
from hitchid.errors import InputError, OutputError
from hitchid.estimation import MultiStart
from hitchid.identification.selection import AutoStructure
from hitchid.structures import ModelSpec, structure_named

ARRAYS = {
    "doubles": np.array([np.nan, np.inf, -0.0, 5e-324, 0.1]),
    "singles": np.float32([[0.1, 2.0]]),
    "whole": np.arange(6, dtype=np.int16).reshape(1, 2, 3),
    "turned": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "flags": np.array([True, False]),
    "nothing": np.zeros((0, 4)),
    "number": np.asarray(0.1),
    "count": np.asarray(7),
    "text": np.asarray("größer als ≤"),
    "weights 0": np.ones(3),
}


@dataclass(frozen=True)
class Piece:
    """What some work found."""

    best: np.ndarray
    loss: float
    count: int
    open: bool
    reason: str


PIECE = Piece(np.array([0.1, -0.0]), 0.1 + 0.2, 3, True, "enough — ≤")


BEST = {"best": (2,)}


def never():
    raise AssertionError("this was done already")


class Work:
    """Work that counts how often it was done."""

    def __init__(self, arrays=ARRAYS):
        self.arrays, self.done = arrays, 0

    def __call__(self):
        self.done += 1
        return self.arrays


def assert_bits(one, other):
    assert one.keys() == other.keys()
    for name, array in one.items():
        assert isinstance(array, np.ndarray)
        assert (array.dtype, array.shape) == (other[name].dtype, other[name].shape), name
        assert array.tobytes() == other[name].tobytes(), name


def files(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


def test_kept_arrays_come_back_bit_for_bit(tmp_path):
    kept = Checkpoints(tmp_path / "run")
    assert_bits(dict(kept.cached_arrays("search", Work())), ARRAYS)
    assert_bits(dict(Checkpoints(tmp_path / "run").cached_arrays("search", never)), ARRAYS)


def test_a_record_comes_back_as_it_was(tmp_path):
    kept = Checkpoints(tmp_path / "run")
    for work in (lambda: PIECE, never):
        record = kept.cached("best", Piece, work, BEST)
        assert record.best.tobytes() == PIECE.best.tobytes()
        # `repr` tells 3 from 3.0, and True from 1.
        assert repr(replace(record, best=None)) == repr(replace(PIECE, best=None))


MISFITS = {
    "another size": {"best": np.zeros(3)},
    "another number of axes": {"trace": np.zeros(4)},
    "sizes that differ": {"trace": np.zeros((3, 2))},
    "no number": {"best": np.array([np.nan, 0.0])},
    "text": {"best": np.array(["a", "b"])},
    "beyond the cube": {"trace": np.full((4, 2), 1e6)},
    "missing": {"trace": None},
    "more": {"other": np.zeros(1)},
    "text for a count": {"count": np.array("3")},
    "less than nothing": {"count": np.array(-1)},
    "half of one": {"count": np.array(0.5)},
    "a list for a text": {"reason": np.array(["a"])},
}
SHAPES = {"best": (2,), "trace": Cube(("g", 2)), "losses": ("g",), "count": int, "reason": str}


def kept_arrays(size=4):
    """Return arrays of those shapes."""
    arrays = {"best": np.ones(2), "trace": np.full((size, 2), 0.5), "losses": np.full(size, np.inf)}
    return {**arrays, "count": np.array(3), "reason": np.array("enough")}


@pytest.mark.parametrize("arrays", MISFITS.values(), ids=MISFITS)
def test_arrays_that_are_not_those_of_the_task_are_computed_anew(tmp_path, arrays):
    kept = Checkpoints(tmp_path / "run")
    forged = {name: array for name, array in {**kept_arrays(), **arrays}.items() if array is not None}
    kept.cached_arrays("search", Work(forged))
    assert_bits(dict(kept.cached_arrays("search", Work(kept_arrays(5)), SHAPES)), kept_arrays(5))
    assert_bits(dict(kept.cached_arrays("search", never, SHAPES)), kept_arrays(5))


def test_without_a_folder_nothing_is_kept_and_all_is_done(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    work = Work()
    for kept in (DISABLED, DISABLED.child("lifting"), Checkpoints()):
        assert kept.cached_arrays("search", work) is ARRAYS
        assert kept.cached("best", Piece, lambda: PIECE, BEST).loss == PIECE.loss
    assert work.done == 3
    assert list(tmp_path.iterdir()) == []


def test_work_that_failed_is_not_kept(tmp_path):
    kept = Checkpoints(tmp_path / "run")
    with pytest.raises(AssertionError, match="already"):
        kept.cached_arrays("search", never)
    assert files(tmp_path) == []
    assert_bits(dict(kept.cached_arrays("search", Work())), ARRAYS)


# --- names --------------------------------------------------------------------------------------------------

ALIKE = {
    "part and name": [(["a"], "b-c"), (["a-b"], "c"), (["a", "b"], "c"), ([], "a-b-c"), ([], "a/b/c")],
    "signs": [([], "p 1"), ([], "p-1"), ([], "p_1"), ([], "p  1"), ([], "ä"), ([], "ö"), ([], "")],
    "cases": [([], "Oil"), ([], "oil"), (["Oil"], "x"), (["oil"], "x")],
    "places": [([], "../x"), ([], "x"), (["..", ".."], "x"), ([], "/x"), ([], "x\0y"), ([], "x\ny")],
    "length": [([], "x" * 300), ([], "x" * 301), (["x" * 300], "x")],
}


@pytest.mark.parametrize("names", ALIKE.values(), ids=ALIKE.keys())
def test_no_two_pieces_share_a_file_however_alike_their_names(tmp_path, names):
    folder = tmp_path / "run"
    for number, (parts, name) in enumerate(names):
        kept = Checkpoints(folder)
        for part in parts:
            kept = kept.child(part)
        (array,) = kept.cached_arrays(name, Work({"x": np.asarray(number)})).values()
        assert array == number
    assert len(files(folder)) == len(names)
    assert files(folder) == files(tmp_path)
    assert len({path.name.lower() for path in files(folder)}) == len(names)


# --- damage -------------------------------------------------------------------------------------------------

DAMAGE = {
    "emptied": lambda data: b"",
    "cut": lambda data: data[:-1],
    "cut to half": lambda data: data[: len(data) // 2],
    "cut to its seal": lambda data: data[:64],
    "longer": lambda data: data + b"\0",
    "of zeros": lambda data: bytes(len(data)),
    "something else": lambda data: b"Let there be light",
    "without its seal": lambda data: data[64:],
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE.keys())
def test_a_piece_that_is_not_whole_is_done_again_and_replaced(tmp_path, damage):
    kept, work = Checkpoints(tmp_path / "run"), Work()
    kept.cached_arrays("search", work)
    (path,) = files(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert_bits(dict(kept.cached_arrays("search", work)), ARRAYS)
    assert work.done == 2
    assert files(tmp_path) == [path]
    assert_bits(dict(kept.cached_arrays("search", never)), ARRAYS)


def test_any_changed_byte_is_noticed(tmp_path):
    kept, work = Checkpoints(tmp_path / "run"), Work({"x": np.arange(3)})
    kept.cached_arrays("search", work)
    (path,) = files(tmp_path)
    whole = path.read_bytes()
    places = range(0, len(whole), 7)
    for at in places:
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        kept.cached_arrays("search", work)
    assert work.done == 1 + len(places)


# --- runs ---------------------------------------------------------------------------------------------------


def test_a_run_finds_its_pieces_whatever_the_settings_order(tmp_path):
    Checkpoints.of_run(tmp_path / "run", {"seed": 1, "logs": "abc"}).cached_arrays("search", Work())
    assert is_run(tmp_path / "run")
    again = Checkpoints.of_run(tmp_path / "run", {"logs": "abc", "seed": 1})
    assert_bits(dict(again.cached_arrays("search", never)), ARRAYS)


@pytest.mark.parametrize("other", [{"seed": 2}, {"seed": 1.5}, {}, {"seed": 1, "logs": "abc"}])
def test_the_folder_of_another_run_is_refused_and_left_alone(tmp_path, other):
    Checkpoints.of_run(tmp_path / "run", {"seed": 1}).cached_arrays("search", Work())
    before = {path: path.read_bytes() for path in files(tmp_path)}
    with pytest.raises(InputError, match=r"run: holds an unfinished run with other.*--force"):
        Checkpoints.of_run(tmp_path / "run", other)
    assert {path: path.read_bytes() for path in files(tmp_path)} == before


def test_a_folder_of_something_else_is_refused_and_left_alone(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "precious").write_text("mine")
    assert not is_run(tmp_path / "run")
    with pytest.raises(InputError, match=r"run: holds no unfinished run.*empty folder"):
        Checkpoints.of_run(tmp_path / "run", {"seed": 1})
    assert [path.name for path in files(tmp_path)] == ["precious"]


def test_a_run_stopped_before_its_folder_was_whole_is_begun(tmp_path):
    run = tmp_path / "run"
    # What a kill in the middle of writing the first file leaves.
    (run / f".{RUN_FILE}-x1y2").mkdir(parents=True)
    (run / f".{RUN_FILE}-x1y2" / RUN_FILE).write_text("{")
    assert is_empty(run)
    Checkpoints.of_run(run, {"seed": 1})
    assert is_run(run)


def test_a_run_half_removed_is_still_a_run(tmp_path, monkeypatch):
    run = tmp_path / "run"
    removed = []

    def remove_until_stopped(path):
        if len(removed) == stopped_after:
            raise KeyboardInterrupt
        removed.append(path.name)
        real_unlink(path)

    real_unlink = Path.unlink
    for stopped_after in range(5):
        removed.clear()
        checkpoints = Checkpoints.of_run(run, {"seed": 1})
        for name in ("search", "training", "weights"):
            checkpoints.cached_arrays(name, Work())
        (run / f".{RUN_FILE}-x1y2").mkdir(exist_ok=True)
        with monkeypatch.context() as patched:
            patched.setattr(Path, "unlink", remove_until_stopped)
            if stopped_after < 4:  # three results and run.json
                with pytest.raises(KeyboardInterrupt):
                    remove_run(run)
                assert is_run(run)
            else:
                remove_run(run)
                assert not run.exists()
    assert removed[-1] == RUN_FILE


# --- a disk that is full ------------------------------------------------------------------------------------


def test_a_full_disk_leaves_what_was_kept(tmp_path, monkeypatch):
    kept = Checkpoints.of_run(tmp_path / "run", {"seed": 1})
    kept.cached_arrays("search", Work())
    before = {path: path.read_bytes() for path in files(tmp_path)}
    write = Path.write_bytes

    def full(path, data):
        write(path, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(OutputError, match=r"run/.*cannot be written.*No space left") as caught:
            kept.cached_arrays("training", Work())
        assert str(caught.value).startswith(str(tmp_path / "run"))
        with pytest.raises(OutputError, match="No space left"):
            Checkpoints.of_run(tmp_path / "other", {"seed": 1})
    assert {path: path.read_bytes() for path in files(tmp_path)} == before
    assert_bits(dict(kept.cached_arrays("search", never)), ARRAYS)
    assert_bits(dict(kept.cached_arrays("training", Work())), ARRAYS)


def test_a_part_that_fails_is_left_out_unless_the_disk_is_full():
    def full():
        raise OutputError("No space left")

    notices = []
    with pytest.raises(OutputError, match="No space left"):
        attempt("bands", full, notices)
    assert attempt("bands", lambda: 1 / 0, notices) is None
    assert notices == ["could not be computed: bands (ZeroDivisionError: division by zero)"]


# --- identify, stopped and gone on with ---------------------------------------------------------------------


class Stop(KeyboardInterrupt):
    """Somebody stops the run; no error, so that no optional part is left out for it."""


@pytest.fixture(scope="module")
def campaign(bench):
    # As in `test_whole`, so that a run of all tests compiles its programs once.
    return hitchid.read(bench)


@pytest.fixture(scope="module")
def whole(identified):
    """Return the folder of a model identified in one go, and the names of the pieces that were kept."""
    assert is_run(identified / "kept")
    return identified / "model", sorted(path.name for path in (identified / "kept").glob(f"*{SUFFIX}"))


def stopped_after(count, campaign, settings, folder):
    """Identify until so many pieces have been kept, and return how many were done."""
    keep, done, one_at_a_time = Checkpoints.cached_arrays, [], Lock()

    def arrays(self, name, work, shapes=None):
        def counted():
            # Both directions are worked on at the same time.
            with one_at_a_time:
                if len(done) == count:
                    raise Stop
                done.append(name)
            return work()

        return keep(self, name, counted, shapes)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Checkpoints, "cached_arrays", arrays)
        try:
            hitchid.identify(campaign, **settings, checkpoints=folder / "kept").save(folder / "model")
        except Stop:
            assert not (folder / "model").exists()
    return len(done)


def assert_same_model(one, other):
    assert files(one) != []
    assert [path.name for path in files(one)] == [path.name for path in files(other)]
    for path in files(one):
        assert path.read_bytes() == (other / path.name).read_bytes(), path.name


@pytest.mark.long
def test_a_resumed_run_ends_in_the_same_model(whole, campaign, quick_settings, tmp_path):
    model, pieces = whole
    done = sum(stopped_after(count, campaign, quick_settings, tmp_path) for count in (1, 6))
    assert done == 7 < len(pieces)
    assert len(list((tmp_path / "kept").glob(f"*{SUFFIX}"))) == done
    assert done + stopped_after(1000, campaign, quick_settings, tmp_path) == len(pieces)
    assert sorted(path.name for path in (tmp_path / "kept").glob(f"*{SUFFIX}")) == pieces
    assert_same_model(tmp_path / "model", model)


@pytest.fixture(scope="module")
def begun(campaign, quick_settings, tmp_path_factory):
    """Return the folder of a run that was stopped before anything was found."""
    folder = tmp_path_factory.mktemp("begun")
    stopped_after(0, campaign, quick_settings, folder)
    assert not has_results(folder / "kept")
    return folder / "kept"


BEGUN_FROM = AutoStructure(ModelSpec(structure_named("integrator"), bounds={"gain": (1.0, 2.0)}))


@pytest.mark.parametrize(
    "change",
    [
        {"structure": {"lifting": ModelSpec(structure_named("integrator"))}},
        {"structure": {"lifting": BEGUN_FROM, "lowering": BEGUN_FROM}},
        {"search": MultiStart(evaluations=61)},
        {"training": None},
        {"dead_zones": {"lifting": 0.35}},
        {"drift": True},
        {"rivals": None},
        {"seed": 1},
        {"logs": "fewer"},
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_run_of_other_settings_or_logs_is_refused(campaign, quick_settings, begun, change):
    if "logs" in change:
        campaign = campaign.without({campaign.records[0].fingerprint})
    settings = quick_settings | {name: value for name, value in change.items() if name != "logs"}
    with pytest.raises(InputError, match=r"with other logs, settings.*--force"):
        hitchid.identify(campaign, **settings, checkpoints=begun)
