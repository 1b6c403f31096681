"""What a command answers: one JSON object for a program, and text for a person."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


def as_lines(record: dict[str, Any]) -> str:
    """A plain line a key."""
    return "\n".join(f"{key}: {_plain(value)}" for key, value in record.items())


def as_json(record: dict[str, Any]) -> str:
    """One JSON object on one line."""
    return json.dumps(known(record))


@dataclass(frozen=True)
class Answer:
    """What a command found."""

    record: dict[str, Any]
    """The JSON object, as plain values."""
    text: Callable[[dict[str, Any]], str] = as_lines
    """Makes the text for a person out of it."""
    code: int = 0
    """The exit code."""


def known(value: Any, digits: int | None = None) -> Any:
    """The same with null for what is unknown, as JSON has neither NaN nor infinity; ``digits``: of floats, those that
    are significant."""
    if isinstance(value, dict):
        return {key: known(inner, digits) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [known(inner, digits) for inner in value]
    if not isinstance(value, float):
        return value
    if not math.isfinite(value):
        return None
    return value if digits is None else float(f"{value:.{digits}g}")


def table(rows: list[list[str]]) -> str:
    """Columns padded to the same width; the first row is the head."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rows = [rows[0], ["-" * width for width in widths], *rows[1:]]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def state(joint: dict[str, Any], value: float | None) -> str:
    """A state of ``joint``, which is the joint of an estimate as JSON has it: degrees, or centimetres."""
    return amount(value, slides=joint["pivot"] is None)


def amount(value: float | None, slides: bool) -> str:
    """Radians as degrees, or of what ``slides`` metres as centimetres."""
    if value is None:
        return "-"
    return f"{100 * value:.1f} cm" if slides else f"{math.degrees(value):.1f}°"


def state_and_std(joint: dict[str, Any]) -> str:
    """The estimated state of a joint, and how sure it is."""
    return f"{state(joint, joint['state'])} ± {state(joint, joint['state_std'])}"


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key}={inner}" for key, inner in value.items()) or "-"
    if isinstance(value, list):
        return ", ".join(f"{v:.3f}" if isinstance(v, float) else _plain(v) for v in value) or "-"
    return f"{value:.4f}" if isinstance(value, float) else str(value)
