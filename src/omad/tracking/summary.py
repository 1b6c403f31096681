"""Numbers of a whole track: how long the object was followed, and where truth is known how well."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..categories import Category
from .tracker import TrackedEstimate


def summarise(
    category: Category, tracked: Sequence[TrackedEstimate], truth: Sequence[list[float] | None] | None = None
) -> dict[str, Any]:
    """Frames by status, the last joint states, and their range; with ``truth`` the errors of tracked and single
    answers on the same frames. Radians and metres."""
    statuses = [one.status for one in tracked]
    seen = [one.estimate for one in tracked if one.estimate is not None]
    joints = []
    for j, spec in enumerate(category.joints):
        states = np.array([estimate.joints[j].state for estimate in seen])
        joints.append(
            {
                "name": spec.name,
                "type": spec.type,
                "last_state": states[-1].item() if len(states) else None,
                "lowest_state": states.min().item() if len(states) else None,
                "highest_state": states.max().item() if len(states) else None,
            }
        )
    answer: dict[str, Any] = {
        "frames": len(tracked),
        "status": {status: statuses.count(status) for status in ("tracking", "coasting", "lost")},
        "tracks": sum(one.restarted for one in tracked),
        "last_status": statuses[-1] if statuses else None,
        "joint_states": joints,
    }
    if truth is not None:
        answer["errors"] = _errors(category, tracked, truth)
    return answer


def _errors(
    category: Category, tracked: Sequence[TrackedEstimate], truth: Sequence[list[float] | None]
) -> list[dict[str, Any]]:
    used = [
        (one.estimate.joint_states, one.single.joint_states, np.array(true))
        for one, true in zip(tracked, truth, strict=True)
        if one.status == "tracking" and one.estimate is not None and one.single is not None and true is not None
    ]
    answers = []
    for j, spec in enumerate(category.joints):
        kinds = {}
        for kind in ("tracked", "single"):
            error = np.array([row[kind == "single"][j] - row[2][j] for row in used])
            kinds[kind] = spread(error)
        answers.append({"name": spec.name, "frames": len(used), **kinds})
    return answers


def spread(error: np.ndarray) -> dict[str, float | None]:
    """Mean and 95th percentile of |error| (frames,), and its jitter: the standard deviation of its differences from
    frame to frame."""
    if len(error) < 2:
        return {"mean": None, "p95": None, "jitter": None}
    size = np.abs(error)
    return {
        "mean": float(size.mean()),
        "p95": float(np.percentile(size, 95)),
        "jitter": float(np.diff(error).std()),
    }
