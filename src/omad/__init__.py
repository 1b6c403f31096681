"""OMAD: shape, pose, joint states and joint axes of unseen articulated objects from one depth view."""

__version__ = "0.1.0"
