"""Lines of text that several measurements share."""

from typing import Any


def states(errors: dict[str, Any], per_metre: float) -> str:
    """Of every joint, in degrees or category units."""
    both = zip(errors["joint_state_error_deg"], errors["joint_state_error"], strict=True)
    return ", ".join(spread(angle, 1, "°") if angle else spread(length, per_metre, " u") for angle, length in both)


def spread(error: dict[str, float] | tuple[float, float], factor: float, unit: str) -> str:
    values, digits = error.values() if isinstance(error, dict) else error, 1 if unit == "°" else 3
    return " / ".join(f"{factor * value:.{digits}f}{unit}" for value in values)


def refused(answer: dict[str, Any]) -> list[str]:
    """A line for each input that could not be used."""
    return [f"refused {each['name']}: {each['reason']}" for each in answer["refused"]]
