"""Ways that lead through a wall: a drawer's axis that points into its cabinet turns the whole back to front."""

import numpy as np

from omad.geometry.mesh import sample_triangles
from omad.geometry.rigid import across, box
from omad.objects.model import ObjectModel

SAMPLES = 8000
"""Points of a part's parent."""
CELLS = 6
"""Along each side of what a part shows in the direction of its way; so that a wall is told from its rim, ..."""
INNER = 0.8
"""... by the inner share of that ..."""
COVERED = 0.5
"""... of which a wall covers this share at least."""
CLEAR = 0.01
"""Share of the object's diagonal: what is nearer ahead of a part is its own frame."""


def through_walls(model: ObjectModel) -> list[str]:
    """Names of the parts that slide through a wall of their parent as they leave their rest."""
    return [
        model.part_names[joint + 1]
        for joint, turns in enumerate(model.tree.turning)
        if not turns and _covered(model, joint) > COVERED
    ]


def _covered(model: ObjectModel, joint: int) -> float:
    """Share of what a part shows in the direction of its way that its parent's surface lies in front of."""
    axis, (first, second) = model.axes[joint], across(model.axes[joint])
    frame = np.stack([first, second, axis], 1)
    low, high = box(model.parts[joint + 1].vertices @ frame)
    parent = model.parts[model.tree.parents[joint]]
    points = sample_triangles(parent.triangles, SAMPLES, np.random.default_rng(0))[0] @ frame
    middle, half = (low + high)[:2] / 2, INNER * (high - low)[:2] / 2
    ahead = points[:, 2] - high[2]
    inside = (np.abs(points[:, :2] - middle) < half).all(1)
    met = points[inside & (ahead > CLEAR * model.diagonal) & (ahead < model.limits[joint, 1])]
    cells = np.floor((met[:, :2] - middle + half) / (2 * half) * CELLS).astype(int)
    return len(np.unique(cells, axis=0)) / CELLS**2
