"""By which names a server on this machine may be called by a browser."""

import contextlib
import ipaddress
import socket
from urllib.parse import urlsplit


def is_own_name(name: str, host: str) -> bool:
    """Whether ``name`` (with a port, as a Host header has it) is one of a server that listens at ``host``. An address
    in numbers cannot be a stranger's name for this machine."""
    with contextlib.suppress(ValueError):
        found = urlsplit(f"//{name}").hostname or ""
        if found in {"localhost", host.lower(), socket.gethostname().lower()} - {""}:
            return True
        ipaddress.ip_address(found)
        return True
    return False


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens at ``host``."""
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"
