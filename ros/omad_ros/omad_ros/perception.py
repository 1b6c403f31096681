"""From a depth image, its camera and maybe a mask to an estimate, frame after frame; no ROS needed."""

from typing import Any

from omad.applications.detection.cutting import ObjectFinder
from omad.applications.detection.detector import Detector
from omad.applications.tracking.tracker import Tracker
from omad.common.errors import NothingSeen
from omad.estimation.checks import depth_doubts, no_surer, warned
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.sensing.foreign.cameras import camera_from
from omad.sensing.observation import Observation

NANOSECONDS = 1e-9
BACK = 1.0
"""Seconds by which time has to go back for a recording or a simulation to have begun anew."""


class Perception:
    """Follows the object, or estimates each frame alone."""

    def __init__(self, estimator: Estimator, track: bool = True, rectified: bool = False) -> None:
        """``rectified``: images have no lens any more, and the camera that CameraInfo's P tells."""
        self.estimator, self.rectified = estimator, rectified
        self._find = ObjectFinder(Detector([estimator]))
        self._track = track
        self._begin()

    def _begin(self) -> None:
        self._tracker = Tracker(self.estimator) if self._track else None
        self._last = -1.0

    def is_late(self, depth: Any) -> bool:
        """Whether an image is no newer than the last: there is nothing to say of it."""
        return self._last - BACK < _taken(depth) <= self._last

    def __call__(self, depth: Any, info: Any, mask: Any = None) -> Estimate | None:
        """Of sensor_msgs Image or CompressedImage, CameraInfo and Image; None where the object is not seen, or not
        followed, or the image is late. Where time has gone back, all begins anew. Raises InputError for messages that
        are wrong."""
        if self.is_late(depth):
            return None
        time = _taken(depth)
        if time <= self._last:
            self._begin()
        self._last = time
        try:
            camera = camera_from(info)
            if camera is not None and self.rectified:
                camera = camera.without_lens()
            seen = Observation.from_depth(depth, camera, mask)
            seen = self._find(seen) if mask is None else seen
        except NothingSeen:
            seen = None
        if self._tracker is not None:
            return self._tracker(seen, time).estimate
        if seen is None:
            return None
        return warned(no_surer(self.estimator(seen), seen.likelihood), [*depth_doubts(seen)])


def _taken(image: Any) -> float:
    """Seconds."""
    return image.header.stamp.sec + image.header.stamp.nanosec * NANOSECONDS
