"""``omad serve`` in a process of its own, and requests to it as any program makes them."""

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

BOUNDARY = "a-boundary"
INTRINSICS = b"600,600,319.5,239.5"


@dataclass(frozen=True)
class Reply:
    """What came back."""

    status: int
    headers: http.client.HTTPMessage
    body: bytes

    @property
    def record(self) -> dict[str, Any]:
        return json.loads(self.body, parse_constant=lambda name: f"{name} is not JSON")


@dataclass(frozen=True)
class Running:
    """A service that listens."""

    process: subprocess.Popen[str]
    port: int
    said: list[str]
    """Its lines on stderr."""

    def ask(self, method: str, path: str, body: bytes | None = None, headers: dict[str, str] | None = None) -> Reply:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        try:
            connection.request(method, path, body, headers or {})
            answer = connection.getresponse()
            return Reply(answer.status, answer.headers, answer.read())
        finally:
            connection.close()

    def post(self, fields: dict[str, bytes], **headers: str) -> Reply:
        return self.ask("POST", "/estimate", form(fields), {"Content-Type": FORM, **headers})

    def raw(self, sent: bytes, wait: float = 20.0) -> bytes:
        """Whatever comes back for these bytes, until the connection is closed or nothing comes."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=wait) as connection:
            connection.sendall(sent)
            found = b""
            try:
                while more := connection.recv(65536):
                    found += more
            except (TimeoutError, ConnectionResetError):
                pass
            return found

    def begun(self) -> socket.socket:
        """A request whose body does not come."""
        connection = socket.create_connection(("127.0.0.1", self.port), timeout=60)
        head = (
            f"POST /estimate HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: {FORM}\r\nContent-Length: 1000\r\n\r\n--a-b"
        )
        connection.sendall(head.encode())
        return connection

    def ended(self) -> int:
        """The exit code after SIGTERM."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(120)


FORM = f"multipart/form-data; boundary={BOUNDARY}"


def form(fields: dict[str, bytes]) -> bytes:
    """As ``curl -F`` sends them."""
    parts = []
    for name, value in fields.items():
        file = "; filename=x" if name in ("depth", "mask") else ""
        head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"{file}\r\n\r\n'
        parts.append(head.encode() + value + b"\r\n")
    return b"".join(parts) + f"--{BOUNDARY}--\r\n".encode()


@contextmanager
def served(*options: str, **environment: str) -> Iterator[Running]:
    command = [sys.executable, "-m", "omad", "serve", "--port", "0", "--categories", "laptop", *options]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | environment
    )
    said: list[str] = []
    assert process.stderr is not None
    address = None
    for line in process.stderr:
        said.append(line)
        if address := re.search(r"http://127\.0\.0\.1:(\d+)", line):
            break
    assert address, said
    threading.Thread(target=lambda: said.extend(process.stderr or ()), daemon=True).start()
    try:
        yield Running(process, int(address[1]), said)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
