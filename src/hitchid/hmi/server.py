"""The server of the page: HTTP and websocket on the loopback interface."""

import asyncio
import contextlib
import errno
import json
import resource
import socket
import sys
import time
from collections.abc import AsyncIterator
from importlib import resources
from mimetypes import guess_type
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from hitchid.errors import HitchError, InputError
from hitchid.hmi import project
from hitchid.hmi.console import MEASURED, Console, Settings
from hitchid.hmi.guard import SESSION, Guard, Sessions, cookie_name
from hitchid.hmi.recorder import packed_rows

HOST = "127.0.0.1"
MOST_JSON = 65_536  # bytes of a request, and of a message of a page; chosen
MOST_UPLOAD = 5_000_000  # bytes of an uploaded file
MOST_BODIES = 4  # requests with content that are read at once, to bound their memory; chosen
LONGEST_REQUEST_S = 10.0  # s that headers, and again a body, may take to arrive on this machine; chosen
MOST_WAITING = 64  # connections that the system keeps until they are accepted; chosen
TOLD_EVERY_S = 10.0  # s between two messages that there are too many connections; chosen
MOST_WRONG = 20  # messages of a page that are not understood, after which it is disconnected; chosen
MOST_POINTS = 20_000  # rows of an answer with history; chosen
PAGE = resources.files("hitchid.hmi") / "page"
INDEX = "index.html"


class Answer(JSONResponse):
    """Content as JSON in ASCII: also half a character, as a request may carry it, can be sent back."""

    def render(self, content: Any) -> bytes:
        """Return the bytes of the answer."""
        return json.dumps(content, allow_nan=False).encode()


class Server:
    """The server of one session, at a port; 0 for a free one.

    Raises:
        InputError: the port is taken, or the project is served already.
    """

    def __init__(self, settings: Settings, port: int = 0) -> None:
        with contextlib.ExitStack() as refused:
            self._socket = refused.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                self._socket.bind((HOST, port))
                self._socket.listen()  # from now on: whoever opens the link early waits, and is not refused
            except OSError as error:
                raise InputError(f"port {port}: {error.strerror}; choose another --port") from error
            self.port = self._socket.getsockname()[1]
            # Only now is the address known that the lock names for whoever comes second.
            self._lock = project.lock(settings.root, f"http://{HOST}:{self.port}/")
            refused.pop_all()
        self._sessions = Sessions()
        self._console = Console(settings)
        self._pages = _page_files()
        self._bodies = asyncio.Semaphore(MOST_BODIES)
        self._told_s = -TOLD_EVERY_S

    def new_link(self) -> str:
        """Return a link that opens the page once."""
        return f"http://{HOST}:{self.port}/#token={self._sessions.new_link()}"

    def run(self) -> None:
        """Serve until interrupted."""
        application = Starlette(
            routes=[
                Route("/api/session", self._open_session, methods=["POST"]),
                Route("/api/project", self._project),
                Route("/api/history", self._history),
                Route("/api/jobs", self._start_job, methods=["POST"]),
                Route("/api/jobs/{number:int}", self._stop_job, methods=["DELETE"]),
                Route("/api/upload", self._upload, methods=["POST"]),
                Route("/api/link", self._link, methods=["POST"]),
                Route("/files/{path:path}", self._file),
                WebSocketRoute("/ws", self._websocket),
                Route("/{path:path}", self._page),
            ],
            lifespan=self._lifespan,
            exception_handlers={InputError: _refused},
        )
        config = uvicorn.Config(
            Guard(application, self._sessions, self.port),  # pyright: ignore[reportArgumentType]
            log_level="warning",
            access_log=False,
            http="h11",  # whose connections `_end_unfinished` looks into
            ws="websockets-sansio",
            backlog=MOST_WAITING,
            ws_max_size=MOST_JSON,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=2,  # pages keep their websocket open: Ctrl-C does not wait for them
            server_header=False,
        )
        # A connection is an open file: as many as the system lets this process have.
        _, most_files = resource.getrlimit(resource.RLIMIT_NOFILE)
        with contextlib.suppress(ValueError):  # of a system that has no number for it
            resource.setrlimit(resource.RLIMIT_NOFILE, (most_files, most_files))
        self._uvicorn = uvicorn.Server(config)
        self._uvicorn.run(sockets=[self._socket])

    @contextlib.asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        asyncio.get_running_loop().set_exception_handler(self._tell_problem)
        tasks = [asyncio.create_task(self._console.keep_alive()), asyncio.create_task(self._end_unfinished())]
        try:
            with contextlib.suppress(asyncio.CancelledError):  # by a second Ctrl-C, which is no failure
                yield
        finally:
            for task in tasks:
                task.cancel()
            await self._console.end()

    async def _end_unfinished(self) -> None:
        """Close each connection that takes too long for the headers of its first, or of a further request."""
        since_s: dict[tuple[H11Protocol, object], float] = {}
        while True:
            await asyncio.sleep(1.0)
            now_s = time.monotonic()
            waiting = [
                (connection, connection.cycle)
                for connection in self._uvicorn.server_state.connections
                if isinstance(connection, H11Protocol)
                and (connection.cycle is None or connection.cycle.response_complete)
            ]
            # By request: the time counts anew for each further one of a connection that is kept.
            since_s = {request: since_s.get(request, now_s) for request in waiting}
            for (connection, _), begun_s in since_s.items():
                if now_s - begun_s > LONGEST_REQUEST_S:
                    connection.transport.abort()

    def _tell_problem(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Tell what nobody has caught; of connections beyond the limit of open files one line is enough."""
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in (errno.EMFILE, errno.ENFILE):
            loop.default_exception_handler(context)
        elif time.monotonic() - self._told_s > TOLD_EVERY_S:
            self._told_s = time.monotonic()
            sys.stderr.write("hitchid hmi: too many connections are open; new ones have to wait\n")

    async def _open_session(self, request: Request) -> Response:
        content = await self._json(request)
        session = self._sessions.redeem(content.get("token"))
        if session is None:
            error = "this link was used already or is too old; ask for another, or start hitchid hmi again"
            return Answer({"error": error}, 401)
        response = Response(status_code=204)
        response.set_cookie(cookie_name(self.port), session, httponly=True, samesite="strict")
        return response

    async def _project(self, _: Request) -> Response:
        # In a thread: what the bench loop hears from this process must not wait for thousands of files.
        return Answer(await asyncio.to_thread(project.contents, self._console.settings.root))

    async def _history(self, request: Request) -> Response:
        begin_s, end_s, points = (_number(request, name) for name in ("from", "to", "points"))
        history = self._console.history
        if history is None:
            raise InputError("history: there is no source; connect one first")
        # Whatever the page asks for, the answer stays small and the server free for the next.
        rows = history.decimated(begin_s, end_s, int(min(max(points, 2), MOST_POINTS)))
        return Response(packed_rows(MEASURED, rows, 1e3 * time.time()), media_type="application/octet-stream")

    async def _start_job(self, request: Request) -> Response:
        self._console.clients.check_operates(request.scope[SESSION])
        return Answer({"id": self._console.jobs.start(await self._json(request))})

    async def _stop_job(self, request: Request) -> Response:
        self._console.clients.check_operates(request.scope[SESSION])
        self._console.jobs.stop(request.path_params["number"])
        return Response(status_code=204)

    async def _upload(self, request: Request) -> Response:
        self._console.clients.check_operates(request.scope[SESSION])
        # The name first: what cannot be written is refused before its bytes are read.
        path = f"{project.UPLOADS}/{project.checked_name(request.query_params.get('name'))}"
        content = await self._body(request, MOST_UPLOAD)
        await asyncio.to_thread(project.write_new, self._console.settings.root, path, content)
        self._console.clients.publish({"type": "project_changed"})
        return Answer({"path": path})

    async def _link(self, _: Request) -> Response:
        return Answer({"link": self.new_link()})

    async def _json(self, request: Request) -> dict[str, Any]:
        try:
            content = json.loads(await self._body(request, MOST_JSON))
        except (ValueError, RecursionError) as error:
            raise InputError("the request is no JSON") from error
        if not isinstance(content, dict):
            raise InputError("the request is no JSON object")
        return content

    async def _body(self, request: Request, most: int) -> bytes:
        """Return the content of a request; of many at once some wait unread, and none waits for ever."""
        content = bytearray()
        try:
            async with asyncio.timeout(LONGEST_REQUEST_S), self._bodies:
                async for chunk in request.stream():
                    content += chunk
                    if len(content) > most:  # counted as it comes: the length that is announced may be wrong
                        raise InputError(f"the request is larger than {most / 1e6:g} MB")
        except ClientDisconnect as error:
            raise InputError("the request ended early; send it again") from error
        except TimeoutError as error:
            raise InputError("the request took too long to arrive; send it again") from error
        return bytes(content)

    async def _file(self, request: Request) -> Response:
        return FileResponse(project.file_inside(self._console.settings.root, request.path_params["path"]))

    async def _page(self, request: Request) -> Response:
        # From memory, by names that are known: no path of a request reaches the disk here.
        name = request.path_params["path"] or INDEX
        if name not in self._pages:
            return Answer({"error": "there is no such page"}, 404)
        return Response(self._pages[name], media_type=guess_type(name)[0] or "text/plain")

    async def _websocket(self, websocket: WebSocket) -> None:
        session = websocket.scope[SESSION]
        await websocket.accept()
        self._sessions.connect(session)
        client = self._console.welcome(session)

        async def send() -> None:
            while True:
                message = await client.next()
                if isinstance(message, bytes):
                    await websocket.send_bytes(message)
                else:
                    await websocket.send_text(message)

        sending = asyncio.create_task(send())
        try:
            await self._console.greet(client)
            self._console.publish_status()
            await self._receive(websocket, client)
        except (WebSocketDisconnect, RuntimeError):  # RuntimeError: closed while a message was sent
            pass
        finally:
            sending.cancel()
            # The operator's page that goes, however it does, stops what it moves.
            self._console.part(client)
            self._sessions.disconnect(session)

    async def _receive(self, websocket: WebSocket, client: Any) -> None:
        wrong = 0
        while wrong < MOST_WRONG:
            request = _parsed(await websocket.receive())
            try:
                if request is None:
                    wrong += 1
                    raise InputError("not understood: expected JSON with a type")
                self._console.handle(client, request)
            except HitchError as error:
                number = request.get("id") if request else None
                client.put({"type": "reply", "id": number, "error": str(error)})
        await websocket.close(1008, "too many messages that are not understood")


def _page_files() -> dict[str, bytes]:
    """Return the files of the page, by their path in it."""
    files, folders = {}, [("", PAGE)]
    while folders:
        prefix, folder = folders.pop()
        for child in folder.iterdir():
            if child.is_dir():
                folders.append((f"{prefix}{child.name}/", child))
            else:
                files[f"{prefix}{child.name}"] = child.read_bytes()
    return files


def _parsed(message: Any) -> dict[str, Any] | None:
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    try:
        content = json.loads(message.get("text") or "")
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and isinstance(content.get("type"), str) else None


def _number(request: Request, name: str) -> float:
    text = request.query_params.get(name, "")
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not abs(number) < 1e12:  # nor is it no number
        raise InputError(f"{name}: expected a number, got {text!r:.40}")
    return number


async def _refused(_: Request, error: Exception) -> Response:
    return Answer({"error": str(error)}, 400)
