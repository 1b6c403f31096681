"""Whether a person's truth puts each part where its pixels are: wrong signs, zeros and orders show there."""

import numpy as np

from omad.geometry.back_projection import back_projected
from omad.geometry.rigid import carry
from omad.objects.category import Category

from .standard_views import View, true_pose

FEWEST = 100
"""Pixels of a part that say something."""
OUTSIDE = 0.1
"""Diagonals of the object: noise, and truth that is a little wrong, put pixels less far outside."""
CHECK = "signs and zero of states, the order of joints and parts, axes and pivots, labels, the camera's focal length"
"""What may then be wrong."""


def is_misplaced(view: View, category: Category) -> bool:
    """Whether half of a part's pixels, or more, lie farther than that outside of its box, which stands where pose and
    states put it."""
    pose = true_pose(view, category)
    for part, (low, high) in enumerate(view.truth.part_boxes):
        _, points = back_projected(view.camera, view.depth, (view.labels == part) & (view.depth > 0))
        if len(points) >= FEWEST:
            there = carry(np.linalg.inv(pose.T_camera_part[part]), points)
            outside = np.linalg.norm(np.maximum(np.maximum(low - there, there - high), 0), axis=1)
            if np.median(outside) > OUTSIDE * view.truth.diagonal:
                return True
    return False
