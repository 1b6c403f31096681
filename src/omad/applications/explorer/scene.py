"""The explorer's view in space: draws objects and clouds with viser, in the canonical base frame (y up)."""

from typing import Any

import matplotlib
import numpy as np
import trimesh
import viser
from scipy.spatial.transform import Rotation

from omad.output.picture import part_colours

from .drawing import Drawing
from .fitting import Fit

AXIS_COLOUR = (170, 0, 30)
SOLID: Any = {"opacity": 0.8, "flat_shading": True, "side": "double", "cast_shadow": False}
"""How parts look: cloud and keypoints inside shine through."""
LAYERS = ("parts", "keypoints", "axes", "cloud", "seen keypoints")
"""What can be shown and hidden; the last two are there after a fit."""


class Scene:
    """Shows one object and at most one fit."""

    def __init__(self, server: viser.ViserServer, unit: float, part_of_keypoint: tuple[int, ...]) -> None:
        """``unit``: metres that an object's radius is about, so that spheres and arrows fit any category."""
        self._server, self._scene, self._unit = server, server.scene, unit
        self._part_of = np.array(part_of_keypoint)
        self._frames = {layer: self._scene.add_frame(f"/{layer}", show_axes=False) for layer in LAYERS}
        self._index_colours = False
        self._drawing: Drawing | None = None
        self._floor = np.inf
        self._scene.set_up_direction("+y")
        self._scene.configure_default_lights(False)  # they wash the parts' colours out
        self._scene.add_light_ambient("/light/all", intensity=0.7)
        self._scene.add_light_directional("/light/above", intensity=1.0, position=(1.0, 3.0, 2.0))
        camera = server.initial_camera
        camera.position, camera.look_at, camera.up = (1.6 * unit, 1.8 * unit, 3.7 * unit), (0, 0, 0), (0, 1, 0)
        camera.fov, camera.near = 0.7, 0.01 * unit

    def show(self, layer: str, visible: bool) -> None:
        """Show or hide one of ``LAYERS``."""
        self._frames[layer].visible = visible

    def colour_by_index(self, by_index: bool) -> None:
        """Keypoints in a colour each (the same place has the same colour on every object), or in their part's."""
        self._index_colours = by_index
        if self._drawing:
            self._add_keypoints(self._drawing)

    def draw(self, drawing: Drawing) -> None:
        """Replace the object."""
        self._drawing, unit = drawing, self._unit
        with self._server.atomic():
            self._add_keypoints(drawing)
            sizes: Any = {"shaft_radius": 0.012 * unit, "head_radius": 0.035 * unit, "head_length": 0.1 * unit}
            self._scene.add_arrows("/axes/arrows", drawing.arrows, AXIS_COLOUR, **sizes)
            for part, (mesh, T) in enumerate(zip(drawing.parts, drawing.T_base_part, strict=True)):
                pose: Any = {"wxyz": Rotation.from_matrix(T[:3, :3]).as_quat()[[3, 0, 1, 2]], "position": T[:3, 3]}
                look = pose | {"color": _bytes(part_colours(part)), **SOLID}
                self._scene.add_mesh_simple(f"/parts/{part}", mesh.vertices.astype(np.float32), mesh.faces, **look)
            self._lay_floor(drawing)

    def show_fit(self, fit: Fit) -> None:
        """Replace the cloud and the keypoints that the network saw."""
        with self._server.atomic():
            points, colours = fit.cloud.astype(np.float32), _bytes(0.75 * part_colours(fit.labels))
            look: Any = {"point_size": 0.006 * self._unit, "point_shape": "circle", "precision": "float32"}
            self._scene.add_point_cloud("/cloud/points", points, colours, **look)
            self._spheres("/seen keypoints/spheres", fit.seen_keypoints, np.full((len(self._part_of), 3), 0.1), 0.015)

    def clear_fit(self) -> None:
        """Take cloud and seen keypoints away."""
        for name in ("/cloud/points", "/seen keypoints/spheres"):
            self._scene.remove_by_name(name)

    def _add_keypoints(self, drawing: Drawing) -> None:
        if self._index_colours:
            colours = matplotlib.colormaps["hsv"](np.linspace(0, 1, len(self._part_of), endpoint=False))[:, :3]
        else:
            colours = part_colours(self._part_of)
        self._spheres("/keypoints/spheres", drawing.keypoints, 0.8 * colours**1.5, 0.03)

    def _spheres(self, name: str, centres: np.ndarray, colours: np.ndarray, radius: float) -> None:
        """``radius`` in category units."""
        ball = trimesh.creation.icosphere(subdivisions=2, radius=radius * self._unit)
        vertices, faces = np.asarray(ball.vertices, dtype=np.float32), np.asarray(ball.faces)
        turns, look = np.tile([1.0, 0.0, 0.0, 0.0], (len(centres), 1)), _bytes(colours)
        self._scene.add_batched_meshes_simple(
            name, vertices, faces, turns, centres, batched_colors=look, lod="off", cast_shadow=False
        )

    def _lay_floor(self, drawing: Drawing) -> None:
        """A grid under the base, which stays where it is while other parts move: 10 cm a square, or 1 cm."""
        low = float(drawing.parts[0].vertices[:, 1].min()) - 0.02 * self._unit
        if abs(low - self._floor) < 1e-4:
            return
        self._floor = low
        cell = 0.1 if self._unit > 0.2 else 0.01
        look: Any = {"cell_size": cell, "cell_color": (222, 222, 222)}
        look |= {"section_size": 5 * cell, "section_color": (190, 190, 190), "position": (0.0, low, 0.0)}
        self._scene.add_grid("/floor", 40 * cell, 40 * cell, plane="xz", **look)


def _bytes(colours: np.ndarray) -> Any:
    return np.rint(255 * np.clip(colours, 0, 1)).astype(np.uint8)
