"""The pages that are connected: one operator, any number of viewers."""

import asyncio
import json
import secrets
from collections.abc import Iterator, Mapping

MOST_WAITING = 100  # messages to a page that does not read; then samples are dropped: four seconds; chosen


class Client:
    """A page that is connected.

    Attributes:
        name: of the page.
    """

    def __init__(self) -> None:
        self.name = secrets.token_hex(4)
        self._waiting: asyncio.Queue[str | bytes] = asyncio.Queue(MOST_WAITING)

    def put(self, message: Mapping[str, object] | bytes) -> None:
        """Send a message as soon as the page reads; of one that does not, the oldest are dropped."""
        if self._waiting.full():
            self._waiting.get_nowait()
        self._waiting.put_nowait(message if isinstance(message, bytes) else json.dumps(message))

    async def next(self) -> str | bytes:
        """Return the next message to send."""
        return await self._waiting.get()


class Clients:
    """All pages, and which one is the operator's."""

    def __init__(self) -> None:
        self._clients: dict[str, Client] = {}
        self.operator: str | None = None

    def __iter__(self) -> Iterator[Client]:
        return iter(tuple(self._clients.values()))

    def __len__(self) -> int:
        return len(self._clients)

    def add(self) -> Client:
        """Return a new client; the first one is the operator."""
        client = Client()
        self._clients[client.name] = client
        if self.operator is None:
            self.operator = client.name
        return client

    def remove(self, client: Client) -> None:
        """Remove a client; an operator's place stays empty until someone claims it."""
        del self._clients[client.name]
        self.release(client)

    def claim(self, client: Client) -> bool:
        """Return whether a client is the operator now."""
        if self.operator is None:
            self.operator = client.name
        return self.operator == client.name

    def release(self, client: Client) -> None:
        """Give up the place of the operator."""
        if self.operator == client.name:
            self.operator = None

    def publish(self, message: Mapping[str, object] | bytes) -> None:
        """Send a message to all pages."""
        for client in self:
            client.put(message)
