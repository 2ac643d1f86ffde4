"""The server: who may, may; everybody else is refused, and whatever is sent, nothing moves by itself."""

import contextlib
import http.client
import json
import os
import re
import signal
import socket
import struct
import time
from pathlib import Path

import pytest
from operated import resident_mb, served

from fake_bench import LIMITS_FILE

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
pytest.importorskip("websockets")

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from hitchid.hmi.console import BESIDE, OPERATED

LONGEST_S = 60.0  # s, for a start on a machine that does much else
PLAN = {"kind": "campaign", "name": "monday", "ramps": 1, "ramp_s": 600, "tests": 0, "unattended": True}


HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


class Session:
    """A server in its own process, and a browser that it knows."""

    def __init__(self, root, link, process):
        self.root, self.process = root, process
        self.token = link.partition("#token=")[2]
        self.port = int(re.search(r":(\d+)/", link)[1])
        self.origin = f"http://127.0.0.1:{self.port}"
        self.cookie = self.opened(self.token)

    def ask(self, method, path, body=None, **headers):
        """Return status, headers and content of an answer to this page, or to what other headers say."""
        sent = {"Origin": self.origin, "Cookie": getattr(self, "cookie", ""), **headers}
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=LONGEST_S)
        with contextlib.closing(connection):
            sent = {name.replace("_", "-"): value for name, value in sent.items() if value is not None}
            connection.request(method, path, body, sent)
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()

    def refusal(self, method, path, body=None, **headers):
        """Return status and error of an answer."""
        status, _, content = self.ask(method, path, body, **headers)
        return status, json.loads(content)["error"]

    def new_token(self):
        """Return the token of a new link."""
        status, _, content = self.ask("POST", "/api/link")
        assert status == 200
        return json.loads(content)["link"].partition("#token=")[2]

    def opened(self, token):
        """Return the cookie that a token is given."""
        status, headers, _ = self.ask("POST", "/api/session", json.dumps({"token": token}))
        return headers["set-cookie"].partition(";")[0] if status == 204 else None

    def page(self, **headers):
        """Return a connected page."""
        sent = {"Cookie": self.cookie, **headers}
        origin = sent.pop("Origin", self.origin)
        address = f"ws://127.0.0.1:{self.port}/ws"
        options = {"open_timeout": LONGEST_S, "close_timeout": 0.2, "proxy": None, "max_size": None}
        return connect(address, origin=origin, additional_headers=sent, **options)

    def children(self, module):
        """Return the processes of the server that run a module."""
        numbers = []
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError, IndexError):
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                if parent == self.process.pid and module in (entry / "cmdline").read_text():
                    numbers.append(int(entry.name))
        return numbers

    def memory_mb(self):
        return resident_mb(self.process.pid)


@contextlib.contextmanager
def serving(root):
    """Yield a session in a new project, beside a secret."""
    for folder in ("uploads", "reports/r"):
        (root / folder).mkdir(parents=True)
    (root / "uploads" / "a.csv").write_text("a")
    (root / "reports" / "r" / "report.html").write_text("<script>alert(1)</script>")
    (root.parent / "secret.txt").write_text("secret")
    (root.parent / "limits.toml").write_text(LIMITS_FILE)
    with served(root, "--source", "fake_bench:Plant", "--limits", "../limits.toml") as started:
        yield Session(root, *started)


def said(page, wanted, longest_s=LONGEST_S):
    """Return the next message of a page that is wanted."""
    end_s = time.monotonic() + longest_s
    while True:
        message = page.recv(timeout=max(0.0, end_s - time.monotonic()))
        if isinstance(message, str) and wanted(content := json.loads(message)):
            return content


def error_of(page, kind, **content):
    """Return the error that a request is answered with, or None."""
    error_of.number += 1
    page.send(json.dumps({"id": error_of.number, "type": kind, **content}))
    return said(page, lambda message: message.get("id") == error_of.number)["error"]


error_of.number = 0


def run(page, name, *, unattended=True, **options):
    """Connect a plant and start a plan on it."""
    assert error_of(page, "connect", source="fake_bench:Plant", options=options) is None
    assert error_of(page, "arm", plan={**PLAN, "name": name, "unattended": unattended}) is None
    done(page, "start")
    in_state(page, "running")


def done(page, *kinds):
    """Check that requests are carried out."""
    assert [error_of(page, kind) for kind in kinds] == [None] * len(kinds)


def in_state(page, state):
    return said(page, lambda message: message["type"] == "status" and message["state"] == state)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("hmi") / "project") as started:
        yield started


@pytest.fixture(autouse=True)
def server_lives(session):
    """The server is alive after each test, and nothing was armed by it that was not error_of for."""
    yield
    status, _, content = session.ask("GET", "/api/project")
    assert status == 200
    assert json.loads(content)["folder"] == "project"


def test_a_link_gives_a_safe_cookie_once(session):
    assert session.opened(session.token) is None
    token = session.new_token()
    assert len(token) >= 40
    _, headers, _ = session.ask("POST", "/api/session", json.dumps({"token": token}))
    assert {"httponly", "samesite=strict"} <= set(headers["set-cookie"].lower().split("; "))
    assert session.opened(token) is None


@pytest.mark.parametrize("token", ["", "guess", "0" * 43, None, 3, [], {}, "é", "\ud800", "a" * 60_000])
def test_a_guessed_token_is_refused(session, token):
    status, headers, content = session.ask("POST", "/api/session", json.dumps({"token": token}))
    assert status == 401
    assert "set-cookie" not in headers
    assert "link" in json.loads(content)["error"]


@pytest.mark.parametrize(
    ("method", "path", "body", "message"),
    [
        *(
            ("POST", "/api/session", body, "the request is no JSON")
            for body in ("", "nonsense", "[]", "3", "[" * 50_000, b"\xff\xfe", '{"token"')
        ),
        *(
            ("GET", f"/api/history?{query}", None, "expected a number")
            for query in ("", "from=a&to=1&points=2", "from=0&to=nan&points=2", "from=0&to=1")
        ),
        *(
            ("POST", "/api/jobs", json.dumps(content), "job|kind|path")
            for content in (
                {},
                {"kind": "rm"},
                {"kind": "inspect", "logs": "../.."},
                {"kind": "inspect", "logs": "--help"},
                {"kind": "\ud800", "logs": "\ud800"},  # half a character, which the answer repeats
            )
        ),
        *(
            ("POST", f"/api/upload?name={name}", "time_s\n", "^name: ")
            for name in ("", "../b.csv", "a/b.csv", ".b", "b.csv%00", "%2e%2e%2fb.csv", 70 * "b")
        ),
        ("POST", "/api/upload?name=a.csv", "b", "exists already"),
    ],
    ids=range(24),
)
def test_a_request_that_cannot_be_used_is_refused(session, method, path, body, message):
    status, error = session.refusal(method, path, body)
    assert status == 400
    assert re.search(message, error)
    assert [file.name for file in (session.root / "uploads").iterdir()] == ["a.csv"]
    assert (session.root / "uploads" / "a.csv").read_text() == "a"


NEEDS_COOKIE = [
    ("GET", "/api/project"),
    ("GET", "/api/history?from=0&to=1&points=2"),
    ("POST", "/api/jobs"),
    ("DELETE", "/api/jobs/1"),
    ("POST", "/api/upload?name=b.csv"),
    ("POST", "/api/link"),
    ("GET", "/api/nothing"),
    ("GET", "/files/uploads/a.csv"),
    ("GET", "/ws"),
]


@pytest.mark.parametrize("cookie", [None, "", "wrong", "{name}=wrong", "{name}=", "a=b; {name}=\x7f", ";=;,"])
def test_nothing_is_told_without_the_cookie(session, cookie):
    cookie = cookie and cookie.format(name=session.cookie.partition("=")[0])
    for method, path in NEEDS_COOKIE:
        refusal = session.refusal(method, path, "{}", Cookie=cookie)
        assert refusal == (401, "open the link that hitchid printed"), path
    assert not (session.root / "uploads" / "b.csv").exists()
    if cookie is None or cookie.isprintable():  # the client of this test sends no other as a websocket
        with pytest.raises(InvalidStatus) as refused, session.page(Cookie=cookie or ""):
            pass
        assert refused.value.response.status_code in (401, 403)


FOREIGN = [
    "evil.example",
    "127.0.0.1",
    "localhost",
    "127.0.0.1:1",
    "evil.example:{port}",
    "[::1]:{port}",
    "",
    "127.0.0.1:{port}.evil.example",
    "0.0.0.0:{port}",
]


@pytest.mark.parametrize("host", FOREIGN)
def test_another_host_is_refused(session, host):
    """Also one that a name server led here."""
    host = host.format(port=session.port)
    for path in ("/", "/api/project", "/api/session"):
        for origin in (None, f"http://{host}"):
            status, error = session.refusal("GET", path, Host=host, Origin=origin)
            assert status == 403
            assert "127.0.0.1 and localhost" in error


EVIL = [
    "http://evil.example",
    "null",
    "",
    "http://127.0.0.1",
    "http://127.0.0.1:1",
    "https://127.0.0.1:{port}",
    "http://127.0.0.1:{port}.evil.example",
    "http://localhost:{port}",
    "file://",
]


@pytest.mark.parametrize("origin", [*EVIL, None])
def test_a_request_or_websocket_of_another_page_is_refused(session, origin):
    origin = origin and origin.format(port=session.port)
    for method, path in (
        ("POST", "/api/link"),
        ("POST", "/api/upload?name=b.csv"),
        ("DELETE", "/api/jobs/1"),
        *([("GET", "/api/project")] if origin is not None else []),  # which changes nothing
    ):
        assert session.ask(method, path, Origin=origin)[0] == 403
    with pytest.raises(InvalidStatus) as refused, session.page(Origin=origin):
        pass
    assert refused.value.response.status_code == 403


PATHS = [
    "/files/../secret.txt",
    "/files/uploads/../../secret.txt",
    "/files/uploads/..%2f..%2fsecret.txt",
    "/files/uploads/%2e%2e/%2e%2e/secret.txt",
    "/files/uploads/..%252f..%252fsecret.txt",
    "/files/uploads/..%5c..%5csecret.txt",
    "/files/uploads/%c0%ae%c0%ae/%c0%ae%c0%ae/secret.txt",
    "/files/uploads/a.csv%00",
    "/files//etc/passwd",
    "/files/%2fetc%2fpasswd",
    "/files/hmi.log",
    "/files/uploads",
    "/files/uploads/",
    "/files/",
    "/files/link",
    "/../secret.txt",
    "/%2e%2e/server.py",
    "/..%2fserver.py",
    "//etc/passwd",
    "/x",
]


@pytest.mark.parametrize("path", PATHS)
def test_no_path_leads_out_of_the_project_or_the_page(session, path):
    status, _, content = session.ask("GET", path)
    assert status in (400, 404)
    assert b"secret" not in content.replace(b"secret.txt", b"")
    assert b"root:" not in content


def test_neither_files_nor_the_page_run_scripts_from_elsewhere(session):
    status, headers, content = session.ask("GET", "/files/reports/r/report.html")
    assert (status, content) == (200, b"<script>alert(1)</script>")
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "sandbox" in policy
    assert "script" not in policy
    status, headers, _ = session.ask("GET", "/")
    policy = headers["content-security-policy"]
    assert status == 200
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy


@pytest.mark.parametrize(
    ("method", "path", "headers"),
    [
        ("GET", "/", {}),
        ("GET", "/nothing", {}),
        ("GET", "/api/project", {}),
        ("GET", "/api/project", {"Cookie": None}),
        ("GET", "/", {"Host": "evil.example"}),
        ("POST", "/api/link", {"Origin": "http://evil.example"}),
        ("PUT", "/api/project", {}),
        ("POST", "/api/jobs", {}),
        ("GET", "/files/uploads/a.csv", {}),
        ("GET", "/files/uploads/b.csv", {}),
    ],
)
def test_every_answer_has_its_headers(session, method, path, headers):
    _, given, _ = session.ask(method, path, "{}", **headers)
    assert {name: given.get(name) for name in HEADERS} == HEADERS
    assert "content-security-policy" in given
    assert "access-control-allow-origin" not in given
    assert "server" not in given


def test_an_upload_never_leaves_the_project(session, tmp_path):
    uploads = session.root / "uploads"
    (uploads / "link.csv").symlink_to(tmp_path / "link.csv")
    assert session.ask("POST", "/api/upload?name=link.csv", "x")[0] == 400
    (uploads / "link.csv").unlink()
    uploads.rename(session.root / "kept")
    uploads.symlink_to(tmp_path)
    try:
        refusal = session.refusal("POST", "/api/upload?name=b.csv", "x")
    finally:
        uploads.unlink()
        (session.root / "kept").rename(uploads)
    assert refusal == (400, "uploads: is a link; expected a folder of the project")
    assert list(tmp_path.iterdir()) == []


def test_a_pipe_is_no_file_to_read_from(session):
    pipe = session.root / "uploads" / "pipe.csv"
    os.mkfifo(pipe)
    try:
        assert session.ask("GET", "/files/uploads/pipe.csv")[0] == 400
        with session.page() as operator:
            assert error_of(operator, "connect", source="fake_bench:Plant") is None
            for kind, name in (("file", "file"), ("drive", "controller")):
                plan = {"kind": kind, "name": "pipe", name: "uploads/pipe.csv"}
                assert error_of(operator, "arm", plan=plan) == "path: expected a file, got 'uploads/pipe.csv'"
            done(operator, "disconnect")
            replay = {"log": "uploads/pipe.csv"}
            assert "expected a file" in error_of(operator, "connect", source="replay", options=replay)
    finally:
        pipe.unlink()


def test_a_huge_upload_is_refused_early_and_costs_no_memory(session):
    before, piece, sent, answer = session.memory_mb(), b"x" * 2**16, 0, b""
    with socket.create_connection(("127.0.0.1", session.port), timeout=20) as raw:
        raw.sendall(
            f"POST /api/upload?name=b.csv HTTP/1.1\r\nHost: 127.0.0.1:{session.port}\r\n"
            f"Origin: {session.origin}\r\nCookie: {session.cookie}\r\n"
            f"Content-Length: {10**8}\r\n\r\n".encode()
        )
        raw.settimeout(0.5)
        with contextlib.suppress(OSError):
            while sent < 10**8 and not answer:
                sent += raw.send(piece)
                raw.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    answer = raw.recv(1000)
                raw.settimeout(0.5)
        raw.settimeout(20)
        with contextlib.suppress(OSError):
            answer = answer or raw.recv(1000)
    assert answer.startswith(b"HTTP/1.1 4")
    assert sent < 3 * 10**7
    assert session.memory_mb() - before < 20
    assert not (session.root / "uploads" / "b.csv").exists()


JUNK = [
    b"\r\n\r\n",
    b"\0" * 1000,
    b"GET\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"GET / HTTP/1.1\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    b"POST /api/session HTTP/1.1\r\nHost: {host}\r\nContent-Length: -1\r\n\r\n",
    b"POST /api/session HTTP/1.1\r\nHost: {host}\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
    b"POST / HTTP/1.1\r\nHost: {host}\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n",
    b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 20_000 + b"\r\n",
    b"GET /ws HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\r\n",
]


@pytest.mark.parametrize("junk", JUNK, ids=range(len(JUNK)))
def test_junk_is_refused(session, junk):
    with (
        socket.create_connection(("127.0.0.1", session.port), timeout=5) as raw,
        contextlib.suppress(OSError),
    ):
        raw.sendall(junk.replace(b"{host}", b"127.0.0.1:%d" % session.port))
        raw.shutdown(socket.SHUT_WR)
        answer = raw.recv(1000)
        assert not answer.startswith(b"HTTP/1.1 2")


def test_only_this_machine_can_connect(session):
    listening = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    port = f"{session.port:04X}"
    addresses = {entry[1] for entry in listening if entry[3] == "0A" and entry[1].endswith(f":{port}")}
    assert addresses == {f"0100007F:{port}"}


def test_a_viewer_from_elsewhere_starts_stops_and_uploads_nothing(session):
    viewer = session.opened(session.new_token())
    inspect = json.dumps({"kind": "inspect", "logs": "uploads/a.csv"})
    with session.page() as operator:
        said(operator, lambda message: message["type"] == "hello")
        for method, path in (
            ("POST", "/api/jobs"),
            ("DELETE", "/api/jobs/1"),
            ("POST", "/api/upload?name=v.csv"),
        ):
            status, error = session.refusal(method, path, inspect, Cookie=viewer)
            assert (status, error[:20]) == (400, "this page only watch")
    assert not (session.root / "uploads" / "v.csv").exists()


@pytest.mark.long
def test_requests_that_never_end_are_ended_and_cost_no_memory(session):
    before = session.memory_mb()
    head = f"POST /api/upload?name={{}}.csv HTTP/1.1\r\nHost: 127.0.0.1:{session.port}\r\n"
    body = f"Origin: {session.origin}\r\nCookie: {session.cookie}\r\nContent-Length: 4000000\r\n\r\n"
    with contextlib.ExitStack() as stack:
        raws = [
            stack.enter_context(socket.create_connection(("127.0.0.1", session.port), timeout=LONGEST_S))
            for _ in range(100)
        ]
        for number, raw in enumerate(raws):
            raw.sendall(head.format(number).encode())
            raw.setblocking(False)
            if number % 2:
                with contextlib.suppress(BlockingIOError):
                    raw.sendall(body.encode() + b"x" * 3_000_000)
            raw.settimeout(LONGEST_S)
        assert session.ask("GET", "/api/project")[0] == 200
        for raw in raws:
            with contextlib.suppress(ConnectionResetError):
                assert raw.recv(1000)[:12] in (b"", b"HTTP/1.1 400")
        assert session.memory_mb() - before < 100  # of 150 MB that were sent
    assert {path.name for path in (session.root / "uploads").iterdir()} == {"a.csv"}


@pytest.mark.parametrize("number", ["1", "99999999999999999999", "-1", "a"])
def test_a_job_that_does_not_run_cannot_be_stopped(session, number):
    assert session.ask("DELETE", f"/api/jobs/{number}")[0] in (400, 404, 405)


def code_after(page, *messages):
    """Return with which code a page is disconnected because of messages; None where there was none."""
    try:
        for message in messages:
            page.send(message)
        while True:
            page.recv(timeout=LONGEST_S)
    except ConnectionClosed as closed:
        return closed.rcvd and closed.rcvd.code


JUNK_FRAMES = [b"\0\xff", "nonsense", "[]", '{"type": 3}', '{"id": 1}', "[" * 30_000]


def test_ten_thousand_junk_frames_are_refused_and_nothing_moves(session):
    before = session.memory_mb()
    with session.page() as page:
        assert code_after(page, *(JUNK_FRAMES[number % 6] for number in range(10_000))) in (1008, None)
    assert session.memory_mb() - before < 20
    with session.page() as page:
        assert said(page, lambda message: message["type"] == "status")["state"] == "disconnected"


def test_a_message_that_is_too_large_ends_its_page_alone(session):
    with session.page() as other, session.page() as page:
        assert code_after(page, json.dumps({"type": "marker", "text": "x" * 10**6})) in (1009, None)
        assert error_of(other, "nothing") == "'nothing' is no request"


@pytest.mark.parametrize(
    "content",
    [
        {"type": "connect", "source": "os:getcwd"},
        {"type": "connect", "source": "udp:9999"},
        {"type": "connect", "source": ["rig"]},
        {"type": "connect", "source": "rig", "options": []},
        {"type": "connect", "source": "replay", "options": {"log": "../secret.txt"}},
        {"type": "arm", "plan": PLAN},
        {"type": "start"},
        {"type": "reset"},
        {"type": "target", "mm": "NaN"},
        {"type": "record", "on": True},
        {"type": "monitor", "model": "../secret.txt"},
        {"type": "monitor", "model": {"a": 1}},
        {"type": "monitor_restart"},
        {"type": "adapt", "on": True},
        {"type": "roll_back", "direction": "lifting"},
        {"type": "save_adapted", "name": "../../a"},
        {"type": "marker", "text": {"a": []}},
        {"type": "server_alive"},
        {"type": "page_alive"},
        {"type": "__init__"},
    ],
)
def test_what_cannot_be_done_is_refused_with_a_sentence(session, content):
    with session.page() as page:
        kind, *_ = content.values()
        error = error_of(page, kind, **{name: value for name, value in content.items() if name != "type"})
        assert len(error) > 9
        assert said(page, lambda message: message["type"] == "status")["state"] == "disconnected"


def test_a_viewer_can_stop_but_nothing_else(session):
    with session.page() as operator, session.page() as viewer:
        assert said(operator, lambda message: message["type"] == "hello")
        assert error_of(operator, "connect", source="fake_bench:Plant") is None
        in_state(viewer, "idle")
        for kind in (*OPERATED, *BESIDE, "monitor", "marker"):
            assert error_of(viewer, kind, plan=PLAN) == "this page only watches; become the operator first"
        assert "another page is the operator" in error_of(viewer, "claim")
        assert error_of(operator, "arm", plan=PLAN) is None
        done(operator, "start")
        in_state(viewer, "running")
        done(viewer, "stop")
        assert in_state(operator, "stopped")["reason"] == "stopped by a viewer"
        assert error_of(operator, "arm", plan={**PLAN, "name": "tuesday"}).endswith("then reset")
        done(operator, "reset", "disconnect")
        in_state(operator, "disconnected")
    entries = [json.loads(line) for line in (session.root / "hmi.log").read_text().splitlines()]
    logged = [(entry["event"], entry["page"]) for entry in entries][-8:]
    events = ["connect", "arm", "start", "stop", "stopped", "arm", "reset", "disconnect"]
    assert [event for event, _ in logged] == events
    pages = dict(logged)
    assert pages["stopped"] is None  # said by the bench loop itself
    assert pages["stop"] not in (None, pages["connect"])
    assert len({page for _, page in logged if page}) == 2


def test_a_page_that_does_not_read_holds_up_no_other(session):
    with session.page() as operator, session.page(), session.page():
        run(operator, "fast", speed=20)
        before, newest, end_s = session.memory_mb(), 0.0, time.monotonic() + 2.0
        while time.monotonic() < end_s:
            message = operator.recv(timeout=LONGEST_S)
            if isinstance(message, bytes):
                newest = struct.unpack_from("<d", message, 24)[0]
        assert newest > 12.0  # of 40 s in which the bench has run; on a slow machine it runs slower
        assert session.memory_mb() - before < 30
        done(operator, "stop", "reset", "disconnect")


def test_the_loop_stops_when_the_operator_s_page_falls_silent(session):
    with session.page() as operator:
        run(operator, "attended", unattended=False)
        begin_s = time.monotonic()
        assert "page gave no sign of life" in in_state(operator, "stopped")["reason"]
        assert time.monotonic() - begin_s > 0.3
        done(operator, "reset", "disconnect")


def test_after_a_killed_bench_loop_another_can_be_started(session):
    with session.page() as operator:
        run(operator, "killed")
        (bench,) = session.children("bench_process")
        os.kill(bench, signal.SIGKILL)
        reason = in_state(operator, "disconnected")["reason"]
        assert reason == "the bench loop has ended; its watchdog has sent zero to the machine"
        assert "connect a source to start it again" in error_of(operator, "start")
        assert error_of(operator, "connect", source="fake_bench:Plant") is None
        assert in_state(operator, "idle")["source"]["label"] == "plant"
        done(operator, "disconnect")


def test_a_bench_loop_that_was_frozen_is_stopped(session):
    with session.page() as operator:
        run(operator, "frozen")
        (bench,) = session.children("bench_process")
        os.kill(bench, signal.SIGSTOP)
        status = said(operator, lambda message: "does not answer" in message.get("reason", ""))
        assert status["reason"].endswith("use its own emergency stop")
        os.kill(bench, signal.SIGCONT)
        # Where in its tick it was frozen decides which is seen first: its own lateness or the silent server.
        reason = in_state(operator, "stopped")["reason"]
        assert "late" in reason or "no sign of life" in reason
        done(operator, "reset", "disconnect")


def test_a_killed_server_takes_the_bench_loop_along(tmp_path):
    with serving(tmp_path / "project") as session, session.page() as operator:
        run(operator, "monday")
        assert error_of(operator, "record", on=True) is None
        (bench,) = session.children("bench_process")
        time.sleep(1.0)
        os.kill(session.process.pid, signal.SIGKILL)
        session.process.wait()
        end_s = time.monotonic() + LONGEST_S
        while Path(f"/proc/{bench}").exists() and time.monotonic() < end_s:
            time.sleep(0.02)
        with contextlib.suppress(OSError):  # it may wait for whoever adopted it to take note
            assert (Path(f"/proc/{bench}") / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    (log,) = (session.root / "recordings").iterdir()
    text = log.read_text()
    assert text.endswith("\n")
    times = [float(line.partition(",")[0]) for line in text.splitlines()[1:]]
    assert len(times) > 50
    assert times == pytest.approx([0.01 * k for k in range(len(times))], abs=1e-9)
