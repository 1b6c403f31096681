"""What to look at where a result is doubtful: each item says what is wrong, why that may be, and what to do."""

from .check import Check, believed, if_also, is_doubtful, no_surer, warned
from .one_answer import (
    HARDLY_SEEN,
    SURE_OF_HAND,
    depth_doubts,
    doubts,
    hand_doubts,
    network_doubts,
    part_doubts,
    size_doubts,
)
from .other_answers import camera_doubts, gravity_doubts, scale_doubts, scaled

__all__ = [
    "HARDLY_SEEN",
    "SURE_OF_HAND",
    "Check",
    "believed",
    "camera_doubts",
    "depth_doubts",
    "doubts",
    "gravity_doubts",
    "hand_doubts",
    "if_also",
    "is_doubtful",
    "network_doubts",
    "no_surer",
    "part_doubts",
    "scale_doubts",
    "scaled",
    "size_doubts",
    "warned",
]
