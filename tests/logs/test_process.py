"""Readers that misbehave in the process that runs them: each costs a message, and the next log is read."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import hitchid.logs
from hitchid.errors import LogError
from hitchid.logs import ReaderProcess, reader_process
from hitchid.logs.content import ChannelSelection

ALL = ChannelSelection("time_s", None)
VALUES = np.array([np.nan, np.inf, -np.inf, -0.0, 0.0, 5e-324, -5e-324, 1.7976931348623157e308, 0.1])
# Read by the child as it starts: there, a log is a script that the "reader" of its format runs.
PLUGIN = """
import sys

class Patched:
    def find_spec(self, name, path=None, target=None):
        if name != "hitchid.logs.reader_process":
            return None
        sys.meta_path.remove(self)
        import os, time
        import numpy as np
        from hitchid.errors import LogError
        from hitchid.logs import formats, reader_process
        from hitchid.logs.content import LogChannel, Content

        def read(path, wanted):
            here = {"np": np, "os": os, "sys": sys, "time": time, "path": path, "wanted": wanted}
            here |= {"LogChannel": LogChannel, "LogError": LogError}
            here |= {"channels": {}, "notices": ()}
            exec(path.read_text(), here)
            return Content(path, here["channels"], here["notices"])

        formats.BUILT_IN = (*formats.BUILT_IN, formats.Format("script", (".log",), read, None, ("json",)))
        del sys.modules["hitchid.logs.reader_process"]
        return None

sys.meta_path.insert(0, Patched())
"""
GOOD = "channels = {'x': LogChannel(np.arange(5.0), 'mm')}"


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """Return a process whose child runs logs as scripts."""
    folder = tmp_path_factory.mktemp("plugin")
    (folder / "sitecustomize.py").write_text(PLUGIN)
    with pytest.MonkeyPatch.context() as patch, ReaderProcess() as reader:
        patch.syspath_prepend(folder)
        yield reader


@pytest.fixture
def read(reader, tmp_path):
    """Return a function that writes a script as a log and has it read."""

    def read(script, name="odd.log"):
        path = tmp_path / name
        path.write_text(script)
        return reader.read(path, ALL)

    return read


def assert_next_is_read(read):
    content = read(GOOD, "good.log")
    np.testing.assert_array_equal(content.channels["x"].values, np.arange(5.0))
    assert content.channels["x"].unit == "mm"


def refused(read, script, name="odd.log"):
    with pytest.raises(LogError) as caught:
        read(script, name)
    assert f"/{name}: " in str(caught.value)
    return caught.value


MISBEHAVING = {
    "crashes": ("os.abort()", "its reader crashed"),
    "ends": ("os._exit(0)", "its reader crashed"),
    "is killed": ("os.kill(os.getpid(), 9)", "its reader crashed"),
    "leaves": ("sys.exit(3)", "its reader crashed"),
    "is interrupted": ("raise KeyboardInterrupt", "its reader crashed"),
    # The answers go through a copy of standard output that only the child knows.
    "dies within its answer": (
        "import gc, io\nout = [o for o in gc.get_objects() if type(o) is io.BufferedWriter][-1]\n"
        'out.write(b\'{"channels": [["x"\'); out.flush(); os.abort()',
        "its reader crashed",
    ),
    "eats memory": ("np.ones(2**33)", "needs more memory than is allowed for its size"),
    "recurses": ("def f(): f()\nf()", "RecursionError"),
    "raises anything": ("class Odd(Exception): pass\nraise Odd('\\udcff \\u2028 line\\nline')", "Odd"),
    "raises nothing": ("raise ValueError", "cannot be read: ValueError"),
}


@pytest.mark.parametrize(("script", "said"), MISBEHAVING.values(), ids=MISBEHAVING.keys())
def test_a_reader_that_misbehaves_costs_a_message(read, script, said):
    assert said in str(refused(read, script))
    assert_next_is_read(read)


def test_what_the_reader_says_of_line_and_column_comes_through(read):
    error = refused(read, "raise LogError(path, 'is upside down', line=7, column='x')")
    assert (error.problem, error.line, error.column) == ("is upside down", 7, "x")
    assert str(error).endswith("odd.log: line 7: column 'x': is upside down")


def test_a_reader_that_hangs_is_given_up_after_its_time(reader, read, monkeypatch):
    assert_next_is_read(read)
    hung = reader._child
    monkeypatch.setattr(reader_process, "LONGEST_S", 0.2)
    assert "cannot be read within 0 s" in str(refused(read, "time.sleep(600)"))
    assert hung.returncode is not None
    monkeypatch.setattr(reader_process, "LONGEST_S", 30.0)
    assert_next_is_read(read)


def test_a_reader_that_does_not_start_is_given_up(reader, read, monkeypatch):
    reader._end()
    monkeypatch.setattr(reader_process, "LONGEST_START_S", 0.0)
    assert "cannot be read" in str(refused(read, GOOD))


def test_what_a_library_prints_does_not_come_between(read):
    printed = (
        "print('{}' * 100)\nos.write(1, b'begun\\n' * 99)\nsys.stdout.flush()\nprint('x', file=sys.stderr)"
    )
    content = read(f"{printed}\n{GOOD}")
    np.testing.assert_array_equal(content.channels["x"].values, np.arange(5.0))
    assert_next_is_read(read)


def test_memory_is_bounded_by_the_size_of_the_file(read):
    script = "channels = {'x': LogChannel(np.ones(2**28))}\n#"  # 2 GiB
    assert "memory" in str(refused(read, script))
    content = read("channels = {'x': LogChannel(np.ones(2**20))}")
    assert content.channels["x"].values.sum() == 2**20


def test_one_child_reads_all_logs(reader, read):
    assert_next_is_read(read)
    first = reader._child.pid
    assert_next_is_read(read)
    assert reader._child.pid == first


# --- the child is gone --------------------------------------------------------------------------------------


def is_there(pid):
    """Tell whether a process is there, as a zombie or alive."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def log(tmp_path):
    """Return a small log that the child reads."""
    path = tmp_path / "log.parquet"
    hitchid.logs.write_table(path, {"time_s": np.arange(9) / 100, "x": VALUES})
    return path


@pytest.mark.parametrize("raised", [None, RuntimeError, KeyboardInterrupt])
def test_the_child_ends_with_the_context(log, raised):
    try:
        with ReaderProcess() as reader:
            reader.read(log, ALL)
            child = reader._child
            assert is_there(child.pid)
            if raised is not None:
                raise raised
    except (RuntimeError, KeyboardInterrupt) as error:
        assert type(error) is raised  # noqa: PT017
    assert not is_there(child.pid)
    assert child.stdin.closed
    assert child.stdout.closed


def test_a_context_in_which_nothing_is_read_starts_no_child(log):
    with ReaderProcess() as reader:
        pass
    assert reader._child is None


def test_an_interrupt_while_waiting_ends_the_child(reader, read, monkeypatch):
    assert_next_is_read(read)
    child = reader._child

    def interrupted(line):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(reader_process.json, "loads", interrupted)
        with pytest.raises(KeyboardInterrupt):
            read(GOOD)
    assert not is_there(child.pid)
    assert_next_is_read(read)


def test_a_child_whose_parent_was_killed_ends():
    program = (
        "import sys; from hitchid.logs import reader_process; child = reader_process._start_child()\n"
        "print(child.pid, flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", program]
    parent = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603
    child = int(parent.stdout.readline())
    parent.kill()
    parent.communicate()
    stat = Path(f"/proc/{child}/stat")
    for _ in range(600):
        # Its new parent may leave it as a zombie; then its state is Z.
        if not is_there(child) or (stat.exists() and stat.read_text().rpartition(")")[2].split()[0] == "Z"):
            return
        time.sleep(0.1)
    pytest.fail("the child outlives its parent")


# --- what comes over ----------------------------------------------------------------------------------------


def test_numbers_arrive_bit_for_bit(read):
    odd = np.frombuffer(np.arange(1, 4, dtype=np.uint64) + np.uint64(0x7FF8_0000_0000_0000), float)
    sent = np.concatenate([VALUES, odd])
    content = read(
        f"sent = np.frombuffer(bytes.fromhex('{sent.tobytes().hex()}'))\n"
        "clock, other = np.arange(12) / 3, np.arange(12) / 3\n"
        "channels = {'a': LogChannel(sent, None, clock), 'b': LogChannel(sent[::-2], 'µm', None),\n"
        "            'c/ä\\udcff': LogChannel(sent.astype('>f8'), '', clock),\n"
        "            'd': LogChannel(sent, 'V', other)}\n"
        "notices = ('one', 'two ≤')"
    )
    assert list(content.channels) == ["a", "b", "c/ä\udcff", "d"]
    a, b, c, d = content.channels.values()
    for channel in (a, c, d):
        assert channel.values.tobytes() == sent.tobytes()
        assert channel.values.dtype == np.float64
    assert b.values.tobytes() == sent[::-2].tobytes()
    assert [channel.unit for channel in (a, b, c, d)] == [None, "µm", "", "V"]
    assert a.clock_s is c.clock_s
    assert b.clock_s is None
    assert d.clock_s is not a.clock_s
    assert a.clock_s.tobytes() == d.clock_s.tobytes() == (np.arange(12) / 3).tobytes()
    assert content.notices == ("one", "two ≤")
    assert content.source.name == "odd.log"


def test_channels_without_samples_and_no_channels_arrive(read):
    content = read(
        "none = np.zeros(0)\n"
        "channels = {'a': LogChannel(none, 'mm', none), 'b': LogChannel(np.ones(3)), 'c': LogChannel(none)}"
    )
    assert [channel.values.size for channel in content.channels.values()] == [0, 3, 0]
    assert content.channels["a"].clock_s.size == 0
    assert read("channels = {}").channels == {}
    assert_next_is_read(read)


def test_more_than_a_pipe_holds_arrives(read):
    content = read("channels = {str(n): LogChannel(np.arange(30000.0) + n) for n in range(8)}")
    for number, channel in enumerate(content.channels.values()):
        np.testing.assert_array_equal(channel.values, np.arange(30000.0) + number)


def test_the_wish_arrives_as_it_was(reader, tmp_path):
    path = tmp_path / "wish.log"
    path.write_text("notices = (repr((wanted.time, wanted.signals, [str(d) for d in wanted.databases])),)")
    databases = (tmp_path / "b us.dbc", Path(os.fsdecode(b"/x/\xff.dbc")))
    wanted = ChannelSelection('t"\n', ("ä", "\udcff", "x"), databases)
    (notice,) = reader.read(path, wanted).notices
    assert notice == repr((wanted.time, wanted.signals, list(map(str, databases))))
    (notice,) = reader.read(path, ALL).notices
    assert notice == repr(("time_s", None, []))


def test_a_name_that_is_no_text_is_read_and_named(reader, tmp_path):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/odd\xff\n \xc3.log"))
    try:
        path.write_text(GOOD)
    except OSError:
        pytest.skip("such names are not allowed here")
    content = reader.read(path, ALL)
    assert content.source == path
    assert content.channels["x"].values.size == 5
    path.write_text("raise ValueError")
    with pytest.raises(LogError, match="ValueError") as caught:
        reader.read(path, ALL)
    assert "odd\\udcff" in str(caught.value)


def test_a_log_that_is_gone_or_a_folder_is_refused(reader, read, tmp_path):
    (tmp_path / "folder.log").mkdir()
    for path in (tmp_path / "gone.log", tmp_path / "folder.log"):
        with pytest.raises(LogError, match=f"^{path}: "):
            reader.read(path, ALL)
    assert_next_is_read(read)
