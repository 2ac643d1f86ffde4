"""Requests of pages that another process has not answered yet."""

from hitchid.hmi.clients import Client


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
        if client is not None:
            client.put({"type": "reply", "id": request, "error": error})

    def fail(self, error: str) -> None:
        """Answer all requests with one error."""
        for number in tuple(self._waiting):
            self.answer(number, error)
