"""Where output goes: encodings that lack characters, and a device that is full, of the real program."""

import os
import re
import subprocess
import sys

import pytest

PROGRAM = [sys.executable, "-m", "hitchid"]


def run(*arguments, **options):
    return subprocess.run([*PROGRAM, *map(str, arguments)], stderr=subprocess.PIPE, **options)  # noqa: S603


@pytest.mark.parametrize(("encoding", "ellipsis"), [("ascii", "..."), ("cp1252", "…")])
def test_what_an_encoding_lacks_is_written_plainly(bench_folder, encoding, ellipsis):
    env = {**os.environ, "PYTHONIOENCODING": encoding}
    done = run("inspect", bench_folder, stdout=subprocess.PIPE, env=env)
    assert (done.returncode, done.stderr) == (0, b"")
    said = done.stdout.decode(encoding)
    assert re.search(r"lifting .*\d (…|\.\.\.) \d+\.\d+ mm +lifting-01\n", said)[1] == ellipsis
    assert "?" not in said


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no such device")
@pytest.mark.parametrize("options", [("--json",), ()])
def test_a_full_device_is_told_in_one_line(bench_folder, options):
    with open("/dev/full", "wb") as full:
        done = run("inspect", bench_folder, *options, stdout=full)
    assert done.returncode == 1
    assert done.stderr.decode() == "hitchid: standard output: cannot be written: No space left on device\n"


def test_a_reader_that_leaves_ends_the_program_without_a_trace(bench_folder):
    read, write = os.pipe()
    os.close(read)
    done = run("inspect", bench_folder, "--json", stdout=write)
    os.close(write)
    assert done.returncode == 1
    assert b"Traceback" not in done.stderr
