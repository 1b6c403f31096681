"""An object's front where an estimate has it."""

import numpy as np

from omad.objects.category import Category

from ..fitting.posed_object import PosedObject
from .image import front_image


def front_of(posed: PosedObject, category: Category, points: np.ndarray) -> np.ndarray:
    """(5, ROWS, COLUMNS) image of the front of what was seen as ``points`` (N, 3), where an answer has it ``posed``."""
    place = np.asarray(posed.placed.T_camera_part[0])
    of_body = np.array(category.part_of_keypoint) == 0
    body = (posed.keypoints[of_body] - place[:3, 3]) @ place[:3, :3]
    return front_image(points, place, np.stack([body.min(0), body.max(0)]))
