"""Guard of the server: one-time links, session cookies, hosts and origins, headers of every answer."""

import http.cookies
import secrets
import time
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from starlette.responses import JSONResponse, Response

LINK_S = 3600.0  # s for which a link that was not used yet can be used; chosen
MOST_SESSIONS = 64  # and links, at the same time; the oldest ends with one more; chosen
TOKEN_BYTES = 32  # 256 bits: not to be guessed
PROTECTED = ("/api/", "/ws", "/files/")
SESSION_PATH = "/api/session"
SESSION = "hitchid.session"  # key of a request's session in its scope
PAGE_POLICY = "default-src 'self'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
FILE_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data: 'self'; frame-ancestors 'self'; sandbox"
)

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Message, Receive, Send], Awaitable[None]]


class Sessions:
    """Links that can be used once, and the sessions that came of them."""

    def __init__(self) -> None:
        self._links: dict[str, float] = {}
        self._pages: dict[str, int] = {}  # of each session, how many are connected; used last is last

    def new_link(self) -> str:
        """Return the token of a new link."""
        token = secrets.token_urlsafe(TOKEN_BYTES)
        self._links[token] = time.monotonic() + LINK_S
        if len(self._links) > MOST_SESSIONS:  # a page that asks for links over and over costs no memory
            del self._links[next(iter(self._links))]
        return token

    def redeem(self, token: object) -> str | None:
        """Return a new session for a token, which is used up by that; None for a wrong or old one.

        With one too many the session that was used longest ago ends, but none that has a connected page.
        """
        # Each is compared, in constant time: how long a refusal takes tells nothing of the links there are.
        matching = [link for link in self._links if isinstance(token, str) and _is_equal(link, token)]
        if not matching or self._links.pop(matching[0]) < time.monotonic():
            return None
        if len(self._pages) >= MOST_SESSIONS:
            unused = next((session for session, pages in self._pages.items() if not pages), None)
            if unused is None:
                return None
            del self._pages[unused]
        session = secrets.token_urlsafe(TOKEN_BYTES)
        self._pages[session] = 0
        return session

    def session_of(self, cookie: str) -> str | None:
        """Return the session of a cookie, which counts as used; None where there is none."""
        session = next((own for own in self._pages if _is_equal(own, cookie)), None)
        if session is not None:  # to the end of the order, whose first is ended where there is one too many
            self._pages[session] = self._pages.pop(session)
        return session

    def connect(self, session: str) -> None:
        """Count a page that is connected from now on."""
        self._pages[session] = self._pages.get(session, 0) + 1

    def disconnect(self, session: str) -> None:
        """Count a page that was connected until now."""
        self._pages[session] -= 1


def _is_equal(own: str, given: str) -> bool:
    # "replace": half a character, as JSON can carry it, has no bytes of its own
    return secrets.compare_digest(own.encode(), given.encode(errors="replace"))


class Guard:
    """Lets through to an application what comes from its page, on this machine and port, with a session."""

    def __init__(self, application: Application, sessions: Sessions, port: int) -> None:
        self._application, self._sessions = application, sessions
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self.cookie = cookie_name(port)

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it with 401 or 403."""
        if scope["type"] not in ("http", "websocket"):
            await self._application(scope, receive, send)
            return
        status, problem = self._refusal(scope)
        if not problem:
            await self._application(scope, receive, _with_headers(send, scope["path"]))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": problem})
        else:
            refusal: Response = JSONResponse({"error": problem}, status)
            await refusal(scope, receive, _with_headers(send, scope["path"]))

    def _refusal(self, scope: Message) -> tuple[int, str]:
        """Return status and reason of a refusal, or no reason; a session is noted in the scope."""
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        host, origin, path = headers.get("host", ""), headers.get("origin"), scope["path"]
        # A name of elsewhere that leads here (DNS rebinding) makes its page the same origin for a browser.
        if host not in self._hosts:
            return 403, "the page is open at 127.0.0.1 and localhost only"
        # Only the origin tells which page asks; where our own one reads, the browser gives none.
        is_change = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if (origin is not None or is_change) and origin != f"http://{host}":
            return 403, "the request comes from another page"
        if not path.startswith(PROTECTED) or path == SESSION_PATH:  # what opens a session cannot need one
            return 200, ""
        cookies = http.cookies.SimpleCookie()
        try:
            cookies.load(headers.get("cookie", ""))
        except http.cookies.CookieError:
            return 401, "open the link that hitchid printed"
        morsel = cookies.get(self.cookie)
        session = morsel and self._sessions.session_of(morsel.value)
        if not session:
            return 401, "open the link that hitchid printed"
        scope[SESSION] = session
        return 200, ""


def cookie_name(port: int) -> str:
    """Return the name of the session's cookie; cookies do not distinguish ports."""
    return f"hitchid_{port}"


def _with_headers(send: Send, path: str) -> Send:
    # A report of the project may hold anything: it is shown, but runs nothing and asks nobody.
    policy = FILE_POLICY if path.startswith("/files/") else PAGE_POLICY
    headers = [
        (b"content-security-policy", policy.encode()),
        (b"x-content-type-options", b"nosniff"),
        (b"referrer-policy", b"no-referrer"),
        (b"cross-origin-opener-policy", b"same-origin"),
        (b"cross-origin-resource-policy", b"same-origin"),
        (b"cache-control", b"no-store"),
    ]

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", []), *headers]
        await send(message)

    return send_with_headers
