"""Who may speak to the explorer's server: the page that it serves itself, at an address that is this machine's.

A browser opens a WebSocket for any page that asks for one, also for a stranger's. It tells where that page comes from
(Origin), and by which name it knows this server (Host): a stranger's page has another origin, and one whose name was
made to point at this machine calls it by that name.
"""

import functools
import http
import threading
from collections.abc import Callable
from typing import Any

import viser
import websockets.asyncio.server as websockets
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from omad.common.errors import WorkError

from ..own_address import is_own_name

_starting = threading.Lock()


def start_server(host: str, port: int, label: str) -> viser.ViserServer:
    """viser's server, which answers to its own page alone. Raises WorkError where that cannot be made sure."""
    served, guarded = websockets.serve, list[bool]()

    @functools.wraps(served)
    def serve(*args: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
        guarded.append(True)

        def check(connection: Any, request: Request) -> Any:
            if not may_speak(request.headers, host):
                text = b"this address, or the page that asks, is not the explorer's own\n"
                return Response(
                    http.HTTPStatus.FORBIDDEN, "Forbidden", Headers({"Content-Length": str(len(text))}), text
                )
            return None if process_request is None else process_request(connection, request)

        return served(*args, process_request=check, **options)

    with _starting:  # viser takes no checks of its own, and asks for ``serve`` when it starts
        websockets.serve = serve
        try:
            server = viser.ViserServer(host, port, label=label, verbose=False)
        finally:
            websockets.serve = served
    if not guarded:
        server.stop()
        raise WorkError("this version of viser cannot be guarded against other pages; install viser 1.1")
    return server


def may_speak(headers: Headers, host: str) -> bool:
    """Whether a request comes from the explorer's own page, or opens it; ``host``: the address that is listened at."""
    hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(hosts) != 1 or not is_own_name(hosts[0], host):
        return False
    if "websocket" in headers.get("Upgrade", "").lower():
        return len(origins) == 1 and origins[0].lower() in (
            f"{scheme}://{hosts[0].lower()}" for scheme in ("http", "https")
        )
    return True
