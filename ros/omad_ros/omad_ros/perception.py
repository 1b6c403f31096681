"""From a depth image, its camera and maybe a mask to an estimate, frame after frame; no ROS needed."""

from typing import Any

from omad.applications.detection.cutting import ObjectFinder
from omad.applications.detection.detector import Detector
from omad.applications.tracking.tracker import Tracker
from omad.common.errors import NothingSeen
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.sensing.observation import Observation

NANOSECONDS = 1e-9


class Perception:
    """Follows the object, or estimates each frame alone."""

    def __init__(self, estimator: Estimator, track: bool = True) -> None:
        self.estimator = estimator
        self._find = ObjectFinder(Detector([estimator]))
        self._tracker = Tracker(estimator) if track else None
        self._last = -1.0

    def __call__(self, depth: Any, info: Any, mask: Any = None) -> Estimate | None:
        """Of sensor_msgs Image or CompressedImage, CameraInfo and Image; None where the object is not seen, or not
        followed, or the image is older than the last one. Raises InputError for messages that are wrong."""
        time = depth.header.stamp.sec + depth.header.stamp.nanosec * NANOSECONDS
        if time <= self._last:
            return None
        self._last = time
        try:
            seen = Observation.from_depth(depth, info, mask)
            seen = self._find(seen) if mask is None else seen
        except NothingSeen:
            seen = None
        if self._tracker is not None:
            return self._tracker(seen, time).estimate
        return None if seen is None else self.estimator(seen)
