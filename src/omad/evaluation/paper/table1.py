"""The paper's Table 1: A-NCSH, OMAD's initial and its refined answer on the same views."""

from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np

from omad.objects.category import Category
from omad.objects.pose import ObjectPose

from ..metrics import bootstrap_interval, pose_errors
from .box_iou import box_iou
from .predictions import Predictions, Truths
from .published import TABLE1
from .released import known_means, released_errors

Metrics = Literal["ours", "released"]
"""``released``: as the authors' own evaluation counts, see ``released``."""


def rows(
    truths: Truths, said: dict[str, Predictions], category: Category, metrics: Metrics = "ours"
) -> list[dict[str, Any]]:
    """Lines of one category: ``ancsh`` (where it is among ``said``), ``omad_initial``, ``omad_refined``. Means over
    views, a number per joint or part; angles in degrees, lengths in category units."""
    omad = said["omad"]
    network, refinement, total = omad.seconds.T
    unrefined = np.stack([network, 0 * refinement, total - refinement], 1)
    initial = replace(omad, refined=omad.initial, seconds=unrefined)
    others = {"ancsh": said["ancsh"]} if "ancsh" in said else {}
    methods = others | {"omad_initial": initial, "omad_refined": omad}
    paper = {name: asdict(line) for name, line in TABLE1.get(category.name, {}).items()}
    lines = {name: row(name, truths, found, category, metrics) for name, found in methods.items()}
    return [line | {"paper": paper.get(name)} for name, line in lines.items()]


def row(
    method: str, truths: Truths, said: Predictions, category: Category, metrics: Metrics = "ours"
) -> dict[str, Any]:
    """One line; keys as in the JSON of the commands."""
    unit = category.metres_per_unit
    views = list(zip(said.refined.rows(), truths.poses.rows(), truths.boxes, strict=True))
    errors = [pose_errors(pose, true, boxes, category) for pose, true, boxes in views]
    states = np.stack([e.joint_state for e in errors])
    states = np.where(category.turning, np.degrees(states), states / unit)
    distance = np.stack([e.axis_distance for e in errors]) / unit
    pivot = np.stack([e.pivot_distance for e in errors]) / unit
    network, refinement, total = (None if np.isnan(c).all() else float(np.nanmedian(c)) for c in said.seconds.T)
    line = {
        "category": category.name,
        "method": method,
        "joint_state": _means(states),
        "joint_state_median": np.median(states, 0).tolist(),
        "joint_state_interval": [bootstrap_interval(column, truths.objects) for column in states.T],
        "axis_error_deg": _means(np.degrees([e.axis for e in errors])),
        "axis_distance": _of_turning(_means(distance), category),
        "pivot_distance": _of_turning(_means(pivot), category),
        "rotation_error_deg": _means(np.degrees([e.rotation for e in errors])),
        "translation_error": _means(np.stack([e.translation for e in errors]) / unit),
        "iou": _means([_iou(pose, true, boxes, category) for pose, true, boxes in views]),
        "missing": sum(e.missing for e in errors),
        "seconds": {"network": network, "refinement": refinement, "total": total, "machine": said.machine},
    }
    if metrics == "released":
        released = released_errors(said.refined, truths.poses, category)
        line |= {name: known_means(values) for name, values in released.items()}
        line |= dict.fromkeys(("joint_state_median", "joint_state_interval", "pivot_distance"))  # it has none
        line["axis_distance"] = _of_turning(line["axis_distance"], category)
    return line


def _iou(pose: ObjectPose, true: ObjectPose, boxes: np.ndarray, category: Category) -> np.ndarray:
    """(K,). Where either labelling of the parts is right, that with the larger overlap counts."""
    labellings = [pose, pose.swapped()] if category.swap_symmetry else [pose]
    return max((box_iou(each.T_camera_part, true.T_camera_part, boxes) for each in labellings), key=np.sum)


def comparison(lines: list[dict[str, Any]]) -> dict[str, Any] | None:
    """OMAD's refined answer against A-NCSH's in one category; None where A-NCSH is left out. Times are compared where
    they are of the same machine."""
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


def _of_turning(values: list[float], category: Category) -> list[float | None]:
    """None for joints that have no place."""
    return [value if turns else None for value, turns in zip(values, category.turning, strict=True)]
