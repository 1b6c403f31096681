"""OMAD: shape, pose, joint states and joint axes of unseen articulated objects from one depth view.

estimator = omad.Estimator.from_pretrained("laptop")
view = omad.Observation.from_depth(depth_m, K, mask)
estimate = estimator(view)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = [
    "Estimate",
    "Estimator",
    "EstimatorConfig",
    "InputError",
    "Known",
    "Observation",
    "ShapeIndex",
    "Tracker",
    "get_category",
    "show",
]

_HOMES = {
    "Estimate": "estimate",
    "Estimator": "estimator",
    "EstimatorConfig": "estimator",
    "InputError": "errors",
    "Known": "known",
    "Observation": "observation",
    "ShapeIndex": "retrieval.index",
    "Tracker": "tracking.tracker",
    "get_category": "spec_file",
    "show": "report",
}

if TYPE_CHECKING:
    from .errors import InputError
    from .estimate import Estimate
    from .estimator import Estimator, EstimatorConfig
    from .known import Known
    from .observation import Observation
    from .report import show
    from .retrieval.index import ShapeIndex
    from .spec_file import get_category
    from .tracking.tracker import Tracker


def __getattr__(name: str) -> Any:
    """Import on first use, so that ``import omad`` is quick and training needs only what it uses."""
    if name not in _HOMES:
        raise AttributeError(f"module 'omad' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
