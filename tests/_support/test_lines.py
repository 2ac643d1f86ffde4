"""Lines of a stream, each as soon as it is complete, and something to do while none comes."""

import io
import os
import threading

import pytest

from hitchid._support.files import CHUNK_BYTES, CUT, MAX_LINE_BYTES, lines

needs_posix = pytest.mark.skipif(os.name != "posix", reason="waiting for a stream needs POSIX")


@pytest.fixture
def pipe():
    """Return the text stream of a pipe, and a function that writes bytes to it, and closes it for None."""
    read, write = os.pipe()

    def send(content):
        if content is None:
            os.close(write)
        else:
            os.write(write, content)

    with os.fdopen(read, encoding="ascii") as stream:
        yield stream, send


def never():
    pytest.fail("nothing was to be done")


@pytest.mark.parametrize("quiet_s", [0.0, 60.0])
def test_lines_come_whole_and_in_order(pipe, quiet_s):
    stream, send = pipe
    expected = ["one", "", "three µ", "no text: \N{REPLACEMENT CHARACTER}", "x" * (2 * CHUNK_BYTES), "no end"]
    sent = "\n".join(expected).encode().replace("\N{REPLACEMENT CHARACTER}".encode(), b"\xff")
    sender = threading.Thread(target=lambda: [send(sent), send(None)])
    sender.start()
    assert list(lines(stream, quiet_s, never)) == expected
    sender.join()


def test_a_file_in_memory_has_no_quiet_times():
    assert list(lines(io.TextIOWrapper(io.BytesIO(b"one\ntwo")), 1e-3, never)) == ["one", "two"]


@needs_posix
def test_once_between_two_lines_that_are_apart_something_is_done(pipe):
    stream, send = pipe
    done = []

    def when_quiet():
        done.append(len(done))
        threading.Timer(0.2, send, [b"line\n" if len(done) < 3 else None]).start()

    assert list(lines(stream, 0.01, when_quiet)) == ["line", "line"]
    assert done == [0, 1, 2]


@needs_posix
def test_a_line_is_answered_before_the_next_one_begins(pipe):
    stream, send = pipe
    answers = lines(stream, 60.0, never)
    for number in range(3):
        send(f"{number}\n".encode())
        assert next(answers) == str(number)


@needs_posix
@pytest.mark.parametrize("quiet_s", [0.0, 60.0])
def test_a_line_without_end_is_cut_in_linear_time(pipe, quiet_s):
    """64 MiB: had each chunk copied what came before it, 30 GB would be copied."""
    stream, send = pipe
    chunk = b"9" * CHUNK_BYTES

    def send_all():
        for _ in range(1024):
            send(chunk)
        send(b"\nnext\n" + b"x" * MAX_LINE_BYTES + b"\n")
        send(None)

    sender = threading.Thread(target=send_all)
    sender.start()
    first, second, third = lines(stream, quiet_s, never)
    sender.join()
    assert first == "9" * MAX_LINE_BYTES + CUT
    assert (second, third) == ("next", "x" * MAX_LINE_BYTES)
