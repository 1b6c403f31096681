"""An object's front where an estimate has it."""

import numpy as np

from omad.model.fronts.image import front_image

from ..estimate import Estimate


def front_of(estimate: Estimate) -> np.ndarray:
    """(5, ROWS, COLUMNS) image of the front of what was seen."""
    place = np.asarray(estimate.T_camera_base)
    of_body = np.array(estimate.category.part_of_keypoint) == 0
    body = (estimate.keypoints[of_body] - place[:3, 3]) @ place[:3, :3]
    return front_image(estimate.labelled.points, place, np.stack([body.min(0), body.max(0)]))
