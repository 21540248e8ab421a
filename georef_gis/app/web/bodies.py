"""Bodies of requests: no larger than they may be, and heard to their end.

A server that answers and closes while the client is still sending makes the client's system throw
the answer away (a reset). So the last piece of an early answer waits until the client has sent what
it has, within bounds.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from anyio import move_on_after

Message = MutableMapping[str, Any]
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]

# bytes; a form of a tool or a polygon of 10 000 vertices takes far less
MOST_BODY = 1_000_000
# bytes and s for which a client is heard after its answer; beyond them it is cut off
_MOST_HEARD, _PATIENCE = 16_000_000, 5.0


class TooLargeError(Exception):
    """A body grew beyond what is taken, though it did not say so before."""


class Body:
    """The body of one request, between the server and what answers.

    Parameters
    ----------
    receive, send
        Of the server; `receive` and `send` of this object take their place.
    """

    def __init__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self._receive, self._send = receive, send
        self._taken = 0
        self._ended = not _comes_unasked(scope)

    async def receive(self) -> Message:
        """Take a piece.

        Raises
        ------
        TooLargeError
            If it is more than is taken.
        """
        message = await self._next()
        if self._taken > MOST_BODY:
            raise TooLargeError
        return message

    async def send(self, message: Message) -> None:
        """Send a piece of the answer; its end only when the client has sent what it has."""
        is_last = message["type"] == "http.response.body" and not message.get("more_body", False)
        if is_last and not self._ended:
            await self._send({**message, "more_body": True})
            await self._hear_out()
            message = {"type": "http.response.body", "body": b""}
        await self._send(message)

    async def _hear_out(self) -> None:
        with move_on_after(_PATIENCE):
            while not self._ended and self._taken < _MOST_HEARD:
                await self._next()

    async def _next(self) -> Message:
        message = await self._receive()
        self._ended = message["type"] != "http.request" or not message.get("more_body", False)
        self._taken += len(message.get("body", b""))
        return message


def _comes_unasked(scope: Scope) -> bool:
    """Whether a body is on its way; one who expects `100 Continue` sends none before it."""
    headers = {bytes(name).lower(): bytes(value).strip() for name, value in scope["headers"]}
    if b"expect" in headers:
        return False
    return headers.get(b"content-length", b"0") != b"0" or b"transfer-encoding" in headers
