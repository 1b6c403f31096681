"""What a person is told of what was fitted to a network: its surfaces, and how far to believe it."""

from __future__ import annotations

import math
from typing import Any

from omad.common.lazy import lazy_imports

from ..answer import table

with lazy_imports():
    from omad.objects.category import Category

NOT_MEASURED = (
    "how far --to-surface goes was not measured: few views were answered, or --source is a folder without --unseen"
)


def surface_text(category: Category, answer: dict[str, Any]) -> str:
    """A line for the base and each joint: degrees of what turns, category units of all else."""
    made = f"{answer['file']}: {answer['objects']} objects, {answer['bytes'] / 1000:.0f} kB"
    if answer["shares"] is None:
        return f"{made}\n{NOT_MEASURED}"
    rows = [["mean error", "of keypoints' answers", "of fits to the surface", "with --to-surface", "share of the way"]]
    names = ["base's ends", *(joint.name for joint in category.joints)]
    for row, name in enumerate(names):
        turns = row > 0 and category.turning[row - 1]
        errors = (of_all[row] for of_all in answer["errors"])
        told = [f"{math.degrees(error):.1f}°" if turns else f"{error:.3f} u" for error in errors]
        rows.append([name, *told, f"{answer['shares'][row]:.0%}"])
    follows = f"surfaces follow what is seen: {'yes' if answer['follows'] else 'no'}"
    return "\n".join([made, table(rows), f"on {answer['views']} views of unseen objects; {follows}"])


def confidence_text(answer: dict[str, Any]) -> str:
    """What it promises, and how it keeps that on views that it was not fitted to."""
    promised = {
        "joint states in their 50 % interval": ("covered_50", "50%"),
        "joint states in their 90 % interval": ("covered_90", "90%"),
        "base's rotation within one deviation": ("rotation_covered_68", "68%"),
        "base's translation within one deviation": ("translation_covered_68", "68%"),
    }
    rows = [["on other views", "promised", "measured"]]
    rows += [[name, share, f"{answer[key]:.0%}"] for name, (key, share) in promised.items()]
    error, area = answer["calibration_error"], answer["area_under_roc"]
    told = f"{answer['right']:.0%} of the answers are right; their probability: calibration error {error:.3f}"
    asked = {"what the front looks like": answer["asks_front"], "what the surface explains": answer["asks_surface"]}
    asks = "; ".join(f"asks {what}: {'yes' if does else 'no'}" for what, does in asked.items())
    made = f"{answer['checkpoint']}: confidence.json, fitted to {answer['views']} views"
    return "\n".join([made, table(rows), f"{told}, area under the ROC {area:.3f}", asks])
