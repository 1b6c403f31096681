"""Which cells of a grid lie inside a solid."""

import numpy as np

from omad.common.compiled import jit


def occupancy(triangles: np.ndarray, low: np.ndarray, cell: float, shape: tuple[int, int, int]) -> np.ndarray:
    """(X, Y, Z) bool: whether the middle of each cell is inside closed, outward-oriented triangles (F, 3, 3). Solids
    may overlap. The grid's low corner is ``low`` (3,), its cubes have sides of ``cell``."""
    crossings = np.zeros((shape[0], shape[1], shape[2] + 1), np.int16)
    _cross((triangles - low) / cell - 0.5, crossings)
    return crossings[..., :-1].cumsum(2, dtype=np.int16) > 0


@jit
def _cross(triangles, crossings):
    """Add to every column's cells how often the ray from below enters (1) or leaves (-1) there. Triangles in cells,
    whose middles are at integers. A column on an edge counts for one of its two triangles."""
    columns, rows, levels = crossings.shape
    for f in range(len(triangles)):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        enters = -1 if area > 0 else 1
        if area < 0:
            bx, by, bz, cx, cy, cz = cx, cy, cz, bx, by, bz
        left, right = max(0, int(np.ceil(min(ax, bx, cx)))), min(columns - 1, int(np.floor(max(ax, bx, cx))))
        low, high = max(0, int(np.ceil(min(ay, by, cy)))), min(rows - 1, int(np.floor(max(ay, by, cy))))
        for x in range(left, right + 1):
            for y in range(low, high + 1):
                of_a, of_b, of_c = _side(bx, by, cx, cy, x, y), _side(cx, cy, ax, ay, x, y), _side(ax, ay, bx, by, x, y)
                if of_a < 0 or of_b < 0 or of_c < 0:
                    continue
                on_edge = (of_a == 0 and not _owns(cx - bx, cy - by)) or (of_b == 0 and not _owns(ax - cx, ay - cy))
                if on_edge or (of_c == 0 and not _owns(bx - ax, by - ay)):
                    continue
                z = (of_a * az + of_b * bz + of_c * cz) / (of_a + of_b + of_c)
                crossings[x, y, min(max(int(np.ceil(z)), 0), levels - 1)] += enters


@jit
def _side(ax, ay, bx, by, x, y):
    """Above zero where (x, y) is to the left of the line from a to b. The same number, but for its sign, both ways."""
    if (ax, ay) < (bx, by):
        return (bx - ax) * (y - ay) - (by - ay) * (x - ax)
    return (ax - bx) * (by - y) - (ay - by) * (bx - x)


@jit
def _owns(dx, dy):
    """Whether a triangle on the left of an edge in this direction has the edge's own points: one of two neighbours."""
    return dy > 0 or (dy == 0 and dx < 0)
