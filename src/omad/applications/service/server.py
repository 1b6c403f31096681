"""A server for the service: patient with nobody, and gone when it is told to, after what it has begun."""

import asyncio
import logging
import math
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from omad.common.processes.signals import NAMES

from ..own_address import is_loopback, is_own_name

GRACE = 1.0
"""Seconds for who answers to tell that something came too late, before its connection is closed."""
HEAD_BYTES = 16_384
"""Of a request's first line and headers."""
CONNECTIONS = 512
"""At a time; further requests are turned away."""
KEPT = 5
"""Seconds that a connection is kept where nothing comes."""


class Own:
    """Only requests that call the service by a name of its own: a page of another site in the browser of a user of this
    machine has another origin, or reaches it by a name that was made to point here."""

    def __init__(self, app: Any, host: str) -> None:
        """``host``: the address that is listened at. At another than the machine's own, who asks knows its name."""
        self._app, self._host = app, host

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """As ASGI has it."""
        if scope["type"] == "http" and not self._may_ask(scope["headers"]):
            head = [(b"content-type", b"application/json")]
            await send({"type": "http.response.start", "status": 403, "headers": head})
            await send({"type": "http.response.body", "body": b'{"error": "not by this name or from this page"}'})
            return
        await self._app(scope, receive, send)

    def _may_ask(self, headers: list[tuple[bytes, bytes]]) -> bool:
        told = {
            key: [value.decode("latin-1").lower() for k, value in headers if k == key] for key in (b"host", b"origin")
        }
        hosts, origins = told[b"host"], told[b"origin"]
        if is_loopback(self._host) and not all(is_own_name(name, self._host) for name in hosts):
            return False
        return all(origin in (f"http://{name}", f"https://{name}") for origin in origins for name in hosts)


def patient(seconds: float) -> type[H11Protocol]:
    """Connections whose requests have to be there, head and body, so long after they began, and whose answers have to
    be taken so long after they were given."""

    class Patient(H11Protocol):
        late: asyncio.TimerHandle | None = None
        unread: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore
            super().connection_made(transport)
            transport.set_write_buffer_limits(0)  # writing pauses as soon as something is not taken
            self.late = self.loop.call_later(seconds + GRACE, self.transport.close)

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            coming = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
            if coming and self.late is None:
                self.late = self.loop.call_later(seconds + GRACE, self.transport.close)
            elif not coming:
                self.in_time()

        def send_400_response(self, msg: str) -> None:
            if self.cycle is not None:
                self.cycle.disconnected = True  # what answers it would find the connection closed
            if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
                super().send_400_response(msg)
            else:
                self.transport.close()

        def pause_writing(self) -> None:
            super().pause_writing()
            self.unread = self.loop.call_later(seconds, self.transport.abort)  # close() would wait for the reader

        def resume_writing(self) -> None:
            super().resume_writing()
            self.taken()

        def connection_lost(self, exc: Exception | None) -> None:
            self.in_time()
            self.taken()
            super().connection_lost(exc)

        def in_time(self) -> None:
            if self.late is not None:
                self.late.cancel()
                self.late = None

        def taken(self) -> None:
            if self.unread is not None:
                self.unread.cancel()
                self.unread = None

    return Patient


class _Server(uvicorn.Server):
    """Ends without raising the signal again that asked for it: what was begun is done."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], Any]) -> None:
        super().__init__(config)
        self._ready = ready

    async def startup(self, sockets: Any = None) -> None:
        await super().startup(sockets)
        if self.started:
            self._ready()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        before = {number: signal.signal(number, self.handle_exit) for number in NAMES}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def run_server(app: Any, host: str, port: int, seconds: float, ready: Callable[[], Any]) -> None:
    """Listen until SIGTERM or Ctrl-C; then no more requests are taken, and those that are here are answered. ``ready``
    is called when it listens; ``seconds``: what a request has to be there in, and may take at the end."""
    config = uvicorn.Config(
        Own(app, host),
        host,
        port,
        http=patient(seconds),
        loop="asyncio",
        ws="none",
        lifespan="off",
        log_config=None,
        log_level="error",  # a stranger's bad requests are not to fill the log
        access_log=False,
        server_header=False,
        proxy_headers=False,
        limit_concurrency=CONNECTIONS,
        timeout_keep_alive=KEPT,
        timeout_graceful_shutdown=math.ceil(seconds + GRACE),
        h11_max_incomplete_event_size=HEAD_BYTES,
    )
    logging.getLogger("python_multipart").setLevel(logging.ERROR)
    server = _Server(config, ready)
    server.run()
    if not server.started:
        sys.exit(1)
