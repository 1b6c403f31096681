"""Independent forward kinematics of a URDF, for tests."""

import numpy as np
import yourdfpy
from scipy.spatial import cKDTree


def vertices_of(robot: yourdfpy.URDF, link: str) -> np.ndarray:
    """(V, 3) vertices of a link's own meshes in the root frame, at the robot's present configuration."""
    graph, found = robot.scene.graph, []
    for node in graph.nodes_geometry:
        if graph.transforms.parents[node] == link:
            T, geometry = graph[node]
            found.append(robot.scene.geometry[geometry].vertices @ T[:3, :3].T + T[:3, 3])
    return np.concatenate(found)


def largest_gap(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of a point of either set from the other set (vertices may be merged or in another order)."""
    return max(cKDTree(a).query(b)[0].max(), cKDTree(b).query(a)[0].max())
