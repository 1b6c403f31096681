"""The optimisation-based estimator: shape, joint states and pose that explain keypoints (paper, Eq. 9)."""
