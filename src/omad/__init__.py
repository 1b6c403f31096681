"""OMAD: shape, pose, joint states and joint axes of unseen articulated objects from one depth view.

estimator = omad.Estimator.from_pretrained("laptop")
view = omad.Observation.from_depth(depth_m, K, mask)
estimate = estimator(view)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = [
    "Detection",
    "Detector",
    "Estimate",
    "Estimator",
    "EstimatorConfig",
    "Frame",
    "InputError",
    "Known",
    "Observation",
    "ShapeIndex",
    "Tracker",
    "detect",
    "estimate_stream",
    "get_category",
    "show",
]

_HOMES = {
    "Detection": "applications.detection.detector",
    "Detector": "applications.detection.detector",
    "Estimate": "estimation.estimate",
    "Estimator": "estimation.estimator",
    "EstimatorConfig": "estimation.estimator",
    "Frame": "applications.bulk.stream",
    "InputError": "common.errors",
    "Known": "estimation.known",
    "Observation": "sensing.observation",
    "ShapeIndex": "applications.retrieval.index",
    "Tracker": "applications.tracking.tracker",
    "detect": "applications.detection.detector",
    "estimate_stream": "applications.bulk.stream",
    "get_category": "objects.category_file",
    "show": "output.picture",
}

if TYPE_CHECKING:
    from omad.applications.bulk.stream import Frame, estimate_stream
    from omad.applications.detection.detector import Detection, Detector, detect
    from omad.applications.retrieval.index import ShapeIndex
    from omad.applications.tracking.tracker import Tracker
    from omad.common.errors import InputError
    from omad.estimation.estimate import Estimate
    from omad.estimation.estimator import Estimator, EstimatorConfig
    from omad.estimation.known import Known
    from omad.objects.category_file import get_category
    from omad.output.picture import show
    from omad.sensing.observation import Observation


def __dir__() -> list[str]:
    """For who completes names: with those that are yet to be imported."""
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    """Import on first use, so that ``import omad`` is quick and training needs only what it uses."""
    if name not in _HOMES:
        raise AttributeError(f"module 'omad' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
