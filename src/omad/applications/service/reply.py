"""What is sent back."""

import json
from dataclasses import dataclass
from typing import Any, Self

from omad.estimation.estimate import plain


@dataclass(frozen=True)
class Reply:
    """A status of HTTP and what goes with it."""

    status: int
    body: bytes
    media_type: str = "application/json"

    @classmethod
    def of(cls, status: int, record: dict[str, Any]) -> Self:
        """One JSON object."""
        return cls(status, json.dumps(plain(record), allow_nan=False).encode())

    @classmethod
    def failed(cls, status: int, message: str) -> Self:
        """An error's one line."""
        return cls.of(status, {"error": message})
