"""The pages that are connected: one operator, any number of viewers."""

import asyncio
import json
import secrets
from collections import deque
from collections.abc import Iterator, Mapping

from hitchid.errors import InputError

MOST_WAITING = 100  # frames to a page that does not read, then the oldest is dropped: four seconds; chosen
MOST_TEXTS = 1000  # messages likewise: minutes; chosen


class Client:
    """A page that is connected, with a name of its own and the session of its browser."""

    def __init__(self, session: str) -> None:
        self.session = session
        self.name = secrets.token_hex(4)
        self._texts: deque[str] = deque(maxlen=MOST_TEXTS)
        self._frames: deque[bytes] = deque(maxlen=MOST_WAITING)
        self._is_waiting = asyncio.Event()

    def put(self, message: Mapping[str, object] | str | bytes) -> None:
        """Send a message as soon as the page reads: a frame, or text, or content that becomes JSON."""
        if isinstance(message, bytes):
            self._frames.append(message)
        else:
            self._texts.append(message if isinstance(message, str) else json.dumps(message))
        self._is_waiting.set()

    async def next(self) -> str | bytes:
        """Return the next message to send: texts first."""
        while not self._texts and not self._frames:
            self._is_waiting.clear()
            await self._is_waiting.wait()
        # A state or an answer must not wait behind frames that a slow page has not drawn.
        return self._texts.popleft() if self._texts else self._frames.popleft()


class Clients:
    """All pages, and which one is the operator's."""

    def __init__(self) -> None:
        self._clients: dict[str, Client] = {}
        self.operator: str | None = None

    def __iter__(self) -> Iterator[Client]:
        return iter(tuple(self._clients.values()))  # a copy: a page may go while others are told

    def __len__(self) -> int:
        return len(self._clients)

    def add(self, session: str, *, may_operate: bool = True) -> Client:
        """Return a new client; where nothing may move and nobody operates it becomes the operator."""
        client = Client(session)
        self._clients[client.name] = client
        if self.operator is None and may_operate:
            self.operator = client.name
        return client

    def remove(self, client: Client) -> None:
        """Remove a client; an operator's place stays empty until someone claims it."""
        del self._clients[client.name]
        self.release(client)

    def claim(self, client: Client) -> bool:
        """Make a client the operator where there is none; return whether it is the operator now."""
        if self.operator is None:
            self.operator = client.name
        return self.operator == client.name

    def check_operates(self, session: str) -> None:
        """Check that a browser has the operator's page, or that nobody operates.

        Raises:
            InputError: another one has it.
        """
        if self.operator is not None and self._clients[self.operator].session != session:
            raise InputError("this page only watches; become the operator first")

    def release(self, client: Client) -> None:
        """Give up the place of the operator."""
        if self.operator == client.name:
            self.operator = None

    def publish(self, message: Mapping[str, object] | bytes) -> None:
        """Send a message to all pages."""
        encoded = message if isinstance(message, bytes) else json.dumps(message)  # once for all of them
        for client in self:
            client.put(encoded)


# Requests of pages that another process has not answered yet.


class Pending:
    """Which page waits for the answer to which request."""

    def __init__(self) -> None:
        self._waiting: dict[int, tuple[Client, object]] = {}
        self._number = 0

    def add(self, client: Client, request: object) -> int:
        """Return the number under which a page's request is passed on."""
        self._number += 1
        self._waiting[self._number] = client, request
        return self._number

    def answer(self, number: int, error: str | None) -> None:
        """Send the page its answer: an error, or None."""
        client, request = self._waiting.pop(number, (None, None))
        if client is not None:  # else answered before, as by the end of the process
            client.put({"type": "reply", "id": request, "error": error})

    def fail(self, error: str) -> None:
        """Answer all requests with one error."""
        for number in tuple(self._waiting):
            self.answer(number, error)
