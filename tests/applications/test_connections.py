"""Connections of the service: who does not take an answer is not kept."""

import asyncio
import socket

import pytest

pytest.importorskip("uvicorn", reason="needs a server: pip install 'omad[serve]'")

import uvicorn
from uvicorn.server import ServerState

from omad.applications.service.server import patient

ANSWER = bytes(50_000_000)
"""More than the kernel's buffers hold of it."""


@pytest.mark.parametrize("requests", [1, 3])
def test_who_reads_no_answer_is_let_go(requests):
    async def answer(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": ANSWER})

    async def drill():
        state, config = ServerState(), uvicorn.Config(answer, lifespan="off", log_config=None)
        server = await asyncio.get_running_loop().create_server(lambda: patient(0.5)(config, state, {}), "127.0.0.1", 0)
        with socket.socket() as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            client.connect(server.sockets[0].getsockname())
            client.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n" * requests)
            while not state.connections:
                await asyncio.sleep(0.01)
            async with asyncio.timeout(15):
                while state.connections or state.tasks:
                    await asyncio.sleep(0.05)
        server.close()

    asyncio.run(drill())
