"""Objects of a category where they are, in compiled loops on the CPU; what ``posed_object`` gives, in metres."""

import numpy as np

from omad.common.compiled import jit

from .prior import buffers, place


@jit
def place_objects(c, rows, unit, state_units):
    """Of states in category units, rows (B, 16 + J + D) as ``State.pack`` has them, with ``unit`` metres to a category
    unit and ``state_units`` (J,): beta (B, D), joint states (B, J), axes and pivots in the camera frame (B, J, 3), part
    transforms (B, J + 1, 4, 4), canonical keypoints (B, M, 3), axes and pivots (B, J, 3), and keypoints in the camera
    frame (B, M, 3)."""
    B, J, M = len(rows), len(c.parents), c.basis.shape[2]
    beta, states = rows[:, 16 + J :].copy(), rows[:, 16 : 16 + J] * state_units
    lines, centres, T = np.empty((B, J, 3)), np.empty((B, J, 3)), np.zeros((B, J + 1, 4, 4))
    canonical, axes, pivots = np.empty((B, M, 3)), np.empty((B, J, 3)), np.empty((B, J, 3))
    points, at = np.empty((B, M, 3)), buffers(c)
    for o in range(B):
        place(c, rows[o], at)
        for i in range(3):
            for m in range(M):
                canonical[o, m, i] = unit * at.canonical[i, m]
                points[o, m, i] = unit * at.points[i, m]
            for j in range(J):
                lines[o, j, i], centres[o, j, i] = at.lines[j, i], unit * at.centres[j, i]
                axes[o, j, i], pivots[o, j, i] = at.axes[j, i], unit * at.pivots[j, i]
            for k in range(J + 1):
                T[o, k, i, 3] = unit * at.translations[k, i]
                for n in range(3):
                    T[o, k, i, n] = at.rotations[k, i, n]
        T[o, :, 3, 3] = 1.0
    return beta, states, lines, centres, T, canonical, axes, pivots, points
