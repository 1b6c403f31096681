"""The paper's Table 1: A-NCSH, OMAD's initial and its refined answer on the same views."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np

from ..categories import Category
from ..metrics import ObjectPose, PoseErrors, bootstrap_interval, pose_errors
from .box_iou import box_iou
from .paper import TABLE1
from .predictions import Predictions, Truths
from .released import known_means, released_errors

Metrics = Literal["ours", "released"]
"""``released``: as the authors' own evaluation counts, see ``released``."""


def rows(
    truths: Truths, said: dict[str, Predictions], category: Category, metrics: Metrics = "ours"
) -> list[dict[str, Any]]:
    """Lines of one category: ``ancsh`` (where it is among ``said``), ``omad_initial``, ``omad_refined``.

    Means over views, a number per joint or part; angles in degrees, lengths in category units.
    """
    omad = said["omad"]
    network, refinement, total = omad.seconds.T
    unrefined = np.stack([network, 0 * refinement, total - refinement], 1)
    methods = {
        "ancsh": said.get("ancsh"),
        "omad_initial": replace(omad, refined=omad.initial, seconds=unrefined),
        "omad_refined": omad,
    }
    return [
        row(name, truths, found, category, metrics) | {"paper": _paper(name, category)}
        for name, found in methods.items()
        if found is not None
    ]


def _paper(method: str, category: Category) -> dict[str, Any] | None:
    found = TABLE1.get(category.name, {}).get(method)
    return asdict(found) if found else None


def row(
    method: str, truths: Truths, said: Predictions, category: Category, metrics: Metrics = "ours"
) -> dict[str, Any]:
    """One line; keys as in the JSON of the commands."""
    unit = category.metres_per_unit
    turns = np.array(category.revolute)
    errors: list[PoseErrors] = [
        pose_errors(pose, true, boxes, category)
        for pose, true, boxes in zip(said.refined, truths.poses, truths.boxes, strict=True)
    ]
    states = np.stack([e.joint_state for e in errors])
    states = np.where(turns, np.degrees(states), states / unit)
    distance = np.stack([e.axis_distance for e in errors]) / unit
    pivot = np.stack([e.pivot_distance for e in errors]) / unit
    network, refinement, total = (None if np.isnan(c).all() else float(np.nanmedian(c)) for c in said.seconds.T)
    line = {
        "category": category.name,
        "method": method,
        "joint_state": _means(states),
        "joint_state_median": np.median(states, 0).tolist(),
        "joint_state_interval": [list(bootstrap_interval(column, truths.objects)) for column in states.T],
        "axis_error_deg": _means(np.degrees([e.axis for e in errors])),
        "axis_distance": [d if turn else None for d, turn in zip(_means(distance), turns, strict=True)],
        "pivot_distance": [d if turn else None for d, turn in zip(_means(pivot), turns, strict=True)],
        "rotation_error_deg": _means(np.degrees([e.rotation for e in errors])),
        "translation_error": _means(np.stack([e.translation for e in errors]) / unit),
        "iou": _means(_ious(truths, said.refined, category)),
        "missing": sum(e.missing for e in errors),
        "seconds": {"network": network, "refinement": refinement, "total": total, "machine": said.machine},
    }
    return line | _released(truths, said, category) if metrics == "released" else line


def _released(truths: Truths, said: Predictions, category: Category) -> dict[str, Any]:
    unit, turns = category.metres_per_unit, np.array(category.revolute)
    errors = released_errors(said.refined, truths.poses)
    distance = known_means(errors.axis_distance / unit)
    return {
        "joint_state": known_means(np.where(turns, np.degrees(errors.joint_state), errors.joint_state / unit)),
        "axis_error_deg": known_means(np.degrees(errors.axis)),
        "axis_distance": [d if turn else None for d, turn in zip(distance, turns, strict=True)],
        "rotation_error_deg": known_means(np.degrees(errors.rotation)),
        "translation_error": known_means(errors.translation / unit),
    }


def _ious(truths: Truths, poses: tuple[ObjectPose, ...], category: Category) -> np.ndarray:
    """(V, K). Where either labelling of the parts is right, that with the larger overlap counts."""
    every = []
    for pose, true, boxes in zip(poses, truths.poses, truths.boxes, strict=True):
        labellings = [pose, pose.swapped()] if category.swap_symmetry else [pose]
        every.append(max((box_iou(p.T_camera_part, true.T_camera_part, boxes) for p in labellings), key=np.sum))
    return np.stack(every)


def comparison(lines: list[dict[str, Any]]) -> dict[str, Any] | None:
    """OMAD's refined answer against A-NCSH's in one category; None where A-NCSH is left out.

    Times are compared where they are of the same machine.
    """
    by_method = {line["method"]: line for line in lines}
    if "ancsh" not in by_method:
        return None
    other, ours = by_method["ancsh"], by_method["omad_refined"]
    distances = [d for d in zip(ours["axis_distance"], other["axis_distance"], strict=True) if None not in d]

    def ratio(key: str) -> float | None:
        theirs, mine = other["seconds"][key], ours["seconds"][key]
        return theirs / mine if theirs and mine else None

    same = other["seconds"]["machine"] == ours["seconds"]["machine"]
    return {
        "ahead_on_joint_state": all(a < b for a, b in zip(ours["joint_state"], other["joint_state"], strict=True)),
        "ahead_on_axis_distance": all(a < b for a, b in distances) if distances else None,
        "alignment_over_refinement": ratio("refinement") if same else None,
        "end_to_end": ratio("total") if same else None,
    }


def _means(values: np.ndarray | list[np.ndarray]) -> list[float]:
    return np.asarray(values).mean(0).tolist()
