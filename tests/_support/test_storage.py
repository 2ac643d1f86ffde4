"""Results on disk: one form for equal content, whole or not at all, nothing replaced unasked."""

import errno
import json
import os
import subprocess
import sys
import tempfile
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.files import (
    MANIFEST_FILE,
    canonical_json,
    check_file,
    check_folder,
    check_inputs,
    digest,
    write_file,
    write_folder,
)
from hitchid.errors import OutputError

with suppress(ImportError):  # Windows
    import fcntl

characters = st.text(st.characters(codec="utf-8"))
numbers = st.floats(allow_nan=False, allow_infinity=False) | st.integers()
contents = st.recursive(
    st.none() | st.booleans() | numbers | characters,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(characters, inner, max_size=4),
    max_leaves=12,
)


def turned_round(content):
    """Return equal content whose keys stand in the reverse order."""
    if isinstance(content, dict):
        return {key: turned_round(content[key]) for key in reversed(content)}
    return [turned_round(item) for item in content] if isinstance(content, list) else content


@given(contents)
def test_equal_content_gives_equal_bytes(content):
    assert canonical_json(turned_round(content)) == canonical_json(content)


@given(contents)
def test_what_was_written_reads_back_as_it_was(content):
    assert json.loads(canonical_json(content)) == content
    assert canonical_json(json.loads(canonical_json(content))) == canonical_json(content)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
def test_a_number_that_is_not_finite_is_no_json(number):
    with pytest.raises(ValueError, match="JSON"):
        canonical_json({"a": [number]})


def test_the_digest_is_sha_256():
    assert digest(b"abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def fill(text):
    return lambda folder: (folder / "mark.json").write_text(text) and None


def fail(folder):
    (folder / "mark.json").write_text("half")
    raise RuntimeError("stopped half-way")


def left_in(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def write_result(folder, work, *, force=False):
    write_folder(folder, work, result_kind="mark.json", force=force)


def write_text(path, text, *, force=False):
    write_file(path, lambda fresh: fresh.write_text(text) and None, force=force)


@pytest.mark.parametrize("before", ["nothing", "empty folder", "missing parents"])
def test_a_folder_appears_with_what_was_written(tmp_path, before):
    folder = tmp_path / "a" / "b" if before == "missing parents" else tmp_path / "a"
    if before == "empty folder":
        folder.mkdir()
    write_result(folder, fill("new"))
    assert (folder / "mark.json").read_text() == "new"
    assert left_in(folder.parent) == [
        folder.name,
        f"{folder.name}/{MANIFEST_FILE}",
        f"{folder.name}/mark.json",
    ]


def test_a_folder_that_is_there_is_replaced_whole_and_only_by_force(tmp_path):
    folder = tmp_path / "a"
    write_result(folder, fill("old"))
    with pytest.raises(OutputError, match=r"a: exists already.*--force"):
        write_result(folder, fill("new"))
    assert (folder / "mark.json").read_text() == "old"
    write_result(folder, fill("new"), force=True)
    assert left_in(tmp_path) == ["a", f"a/{MANIFEST_FILE}", "a/mark.json"]
    assert (folder / "mark.json").read_text() == "new"


def no_manifest(folder):
    (folder / MANIFEST_FILE).unlink()


@pytest.mark.parametrize(
    ("touch", "said"),
    [
        (lambda folder: (folder / "deep" / "my.csv").write_text("mine"), r"1 file .*: deep/my\.csv;"),
        (lambda folder: (folder / "mark.json").write_text("edited"), r"1 file .*: mark\.json;"),
        (lambda folder: (folder / "link").symlink_to(folder / "mark.json"), r"1 file .*: link;"),
        (lambda folder: [(folder / f"{n}").touch() for n in range(5)], r"5 files .*: 0, 1, 2 and 2 more;"),
        (no_manifest, rf"no \{MANIFEST_FILE}"),
        (lambda folder: (folder / MANIFEST_FILE).write_text("[]"), rf"no \{MANIFEST_FILE}"),
    ],
    ids=["added", "edited", "linked", "many", "of no version that lists its files", "manifest damaged"],
)
def test_force_replaces_nothing_that_was_added_or_changed(tmp_path, touch, said):
    folder = tmp_path / "a"
    write_result(folder, fill("old"))
    (folder / "deep").mkdir()
    touch(folder)
    before = left_in(folder)
    with pytest.raises(OutputError, match=said):
        write_result(folder, fill("new"), force=True)
    assert left_in(folder) == before
    assert (folder / "mark.json").read_text() != "new"


def test_force_replaces_no_result_of_another_kind(tmp_path):
    folder = tmp_path / "study"
    write_folder(folder, fill("old"), result_kind="study.md", force=False)
    with pytest.raises(OutputError, match=r"study\.md, not with mark\.json"):
        write_result(folder, fill("new"), force=True)


def test_what_is_put_there_during_the_work_stays(tmp_path):
    folder = tmp_path / "a"
    write_result(folder, fill("old"))

    def slow(place):
        (place / "mark.json").write_text("new")
        (folder / "notes.txt").write_text("mine")

    with pytest.raises(OutputError, match=r"notes\.txt"):
        write_result(folder, slow, force=True)
    assert left_in(tmp_path) == ["a", f"a/{MANIFEST_FILE}", "a/mark.json", "a/notes.txt"]


def test_what_a_link_points_to_is_replaced_and_the_link_stays(tmp_path):
    write_result(tmp_path / "a", fill("old"))
    (tmp_path / "link").symlink_to(tmp_path / "a")
    write_result(tmp_path / "link", fill("new"), force=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "a" / "mark.json").read_text() == "new"


@pytest.mark.parametrize("force", [False, True])
def test_work_that_failed_leaves_all_as_it_was(tmp_path, force):
    def half(path):
        path.write_text("half")
        raise RuntimeError("stopped half-way")

    if force:
        write_result(tmp_path / "a", fill("old"))
        write_text(tmp_path / "b", "old")
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    with pytest.raises(RuntimeError, match="half-way"):
        write_result(tmp_path / "a", fail, force=force)
    with pytest.raises(RuntimeError, match="half-way"):
        write_file(tmp_path / "b", half, force=force)
    assert {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize(("name", "message"), [("file/a", "file"), ("a" * 300, "aaa")])
def test_an_impossible_place_is_refused(tmp_path, name, message):
    (tmp_path / "file").write_text("mine")
    for work in (
        lambda path: check_folder(path, result_kind="mark.json", force=False),
        lambda path: check_file(path, force=False),
        lambda path: write_result(path, fill("new")),
        lambda path: write_text(path, "new"),
    ):
        with pytest.raises(OutputError, match=message) as caught:
            work(tmp_path / name)
        assert str(caught.value).startswith(str(tmp_path))


def test_an_input_is_never_an_output(tmp_path):
    logs = tmp_path / "real" / "logs"
    logs.mkdir(parents=True)
    log, link = logs / "1.csv", tmp_path / "link.csv"
    log.touch()
    link.symlink_to(log)
    (logs / "out.csv").touch()
    for out, source in [(log, log), (link, log), (log, link), (logs, log), (tmp_path, link), (logs, logs)]:
        with pytest.raises(OutputError, match=f"contains the input .*{source.name}"):
            check_inputs(out, [None, source])
    with pytest.raises(OutputError, match=r"out\.csv: is inside the input .*logs"):
        check_inputs(logs / "out.csv", [logs])
    check_inputs(logs / "out.csv", [log])
    check_inputs(logs / "model", [logs, log])


def test_the_target_of_an_input_link_is_never_an_output(tmp_path):
    logs, elsewhere = tmp_path / "logs", tmp_path / "elsewhere"
    logs.mkdir()
    elsewhere.mkdir()
    (elsewhere / "1.csv").touch()
    (logs / "1.csv").symlink_to(elsewhere / "1.csv")
    (logs / "broken.csv").symlink_to("nothing")
    for out in (elsewhere / "1.csv", elsewhere):
        with pytest.raises(OutputError, match=r"contains the input .*logs"):
            check_inputs(out, [logs])
    check_inputs(elsewhere / "2.csv", [logs])


@pytest.mark.parametrize("foreign", ["a folder", "a file"])
def test_force_replaces_nothing_of_another_kind(tmp_path, foreign):
    precious = tmp_path / "a" / "precious" if foreign == "a folder" else tmp_path / "a"
    precious.parent.mkdir(exist_ok=True)
    precious.write_text("mine")
    with pytest.raises(OutputError, match=r"no .hitchid.json.*another folder"):
        write_result(tmp_path / "a", fill("new"), force=True)
    assert precious.read_text() == "mine"


def test_a_file_appears_with_what_was_written_and_keeps_its_ending(tmp_path):
    seen = []
    path = tmp_path / "deep" / "log.csv.gz"
    write_file(path, lambda fresh: (seen.append(fresh.name), fresh.write_text("new"))[0], force=False)
    assert seen == ["log.csv.gz"]
    assert path.read_text() == "new"
    assert left_in(tmp_path) == ["deep", "deep/log.csv.gz"]


def test_a_file_that_is_there_is_replaced_only_by_force(tmp_path):
    path = tmp_path / "a"
    path.write_text("old")
    with pytest.raises(OutputError, match=r"a: exists already.*--force"):
        write_text(path, "new")
    assert path.read_text() == "old"
    write_text(path, "new", force=True)
    assert path.read_text() == "new"
    with pytest.raises(OutputError, match="exists already"):
        write_text(tmp_path, "new", force=True)


@pytest.mark.skipif(os.name == "nt", reason="there are no such locks")
@pytest.mark.parametrize("name", ["a", "file [1]*"])
def test_leftovers_of_killed_writers_are_removed(tmp_path, name):
    """A writer holds a lock on its folder, which ends with it."""
    left, written, mine = (
        tmp_path / f".{name}-{end}" for end in ("0123abcd.writing", "4567abcd.writing", "mine")
    )
    for folder in (left, written, mine):
        folder.mkdir()
        (folder / "mark.json").write_text("half")
    writer = os.open(written, os.O_RDONLY)
    fcntl.flock(writer, fcntl.LOCK_EX)
    write_result(tmp_path / name, fill("new"))
    assert {path.name for path in tmp_path.iterdir()} == {written.name, mine.name, name}
    os.close(writer)
    write_result(tmp_path / name, fill("newer"), force=True)
    assert {path.name for path in tmp_path.iterdir()} == {mine.name, name}


def test_a_writer_leaves_alone_what_another_one_of_its_target_writes(tmp_path):
    def slow(path):
        write_text(tmp_path / "a", "first", force=True)
        path.write_text("second")

    write_file(tmp_path / "a", slow, force=True)
    assert (tmp_path / "a").read_text() == "second"
    assert left_in(tmp_path) == ["a"]


def test_a_result_within_a_result_is_written(tmp_path):
    """As a study writes its models: the writer of the outer folder does not wait for itself."""

    def outer(folder):
        write_result(folder / "inner", fill("new"))
        fill("outer")(folder)

    write_result(tmp_path / "out", outer)
    assert (tmp_path / "out" / "inner" / "mark.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EACCES])
def test_a_place_that_cannot_be_written_is_refused_before_any_work(tmp_path, monkeypatch, number):
    def refuse(*_, dir):
        assert dir == tmp_path
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    said = f"a: cannot be written: {os.strerror(number)}"
    with pytest.raises(OutputError, match=said):
        check_folder(tmp_path / "new" / "a", result_kind="mark.json", force=False)
    with pytest.raises(OutputError, match=said):
        check_file(tmp_path / "new" / "a", force=False)


# --- a disk that is full, a folder that is read-only --------------------------------------------------------

WRITE_TOO_MUCH = """
import resource, sys
from pathlib import Path
from hitchid.errors import OutputError
from hitchid._support.files import write_bytes, write_files, write_folder

resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
place, much = Path(sys.argv[1]), bytes(10000)
for write in (
    lambda: write_bytes(place / "file", much, force=True),
    lambda: write_folder(place / "folder", lambda beside: write_files(beside, {"mark": b"", "much": much}),
                         result_kind="mark", force=True),
):
    try:
        write()
    except OutputError as error:
        print(error)
"""


@pytest.mark.skipif(os.name == "nt", reason="there are no such limits")
def test_a_file_that_cannot_grow_leaves_all_as_it_was(tmp_path):
    folder = tmp_path / "place"
    write_folder(folder / "folder", lambda beside: (beside / "mark").touch(), result_kind="mark", force=False)
    (folder / "file").write_text("old")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    command = [sys.executable, "-c", WRITE_TOO_MUCH, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    of_file, of_folder = done.stdout.splitlines()
    assert of_file.startswith(f"{folder / 'file'}: cannot be written: ")
    assert of_folder.startswith(f"{folder / 'folder'}: cannot be written: ")
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert left_in(folder) == ["file", "folder", f"folder/{MANIFEST_FILE}", "folder/mark"]
