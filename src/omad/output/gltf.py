"""GLB: the object as a tree of nodes, a node a joint, with an animation that opens and closes every joint. glTF's frame
is canonical space (y up, z to the front, metres), so nothing is turned, but where
the camera's place in a world is known."""

import json
import math
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omad.common.files import write_atomic
from omad.estimation.estimate import Estimate
from omad.sensing.observation import Observation

from .frame import CAMERA, Frame
from .ply import byte_colours, part_surfaces

SECONDS = 6.0
STEPS = 12
"""Of a quarter of the animation at least; a turn goes on in steps of at most a quarter round, as viewers take the short
way between two."""
FLOAT, UINT = 5126, 5125
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From a frame whose z points up."""
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def save_glb(
    estimate: Estimate, path: str | Path, observation: Observation | None = None, frame: Frame = CAMERA
) -> None:
    """Write ``path``: nodes ``<joint name>`` with the estimated state, below each a mesh node ``<part name>`` in
    canonical coordinates; the animation ``open and close`` runs all joints from the estimated state through both
    limits and back. ``extras`` of the node ``canonical`` holds ``T_camera_base`` and the joint states. Where
    ``frame`` is the world, with z up, that node hangs on another, ``world``, which puts it there, in glTF's manner y
    up."""
    file = _Glb()
    surfaces, colours = part_surfaces(estimate, observation), byte_colours(estimate)
    places = np.concatenate([np.zeros((1, 3)), estimate.canonical_pivots])
    parents = estimate.category.tree.parents
    joint_states = {joint.name: joint.state for joint in estimate.joints}
    extras = {"T_camera_base": estimate.T_camera_base.tolist(), "joint_states": joint_states}
    frames: list[dict[str, Any]] = [{"name": "canonical", "children": [], "extras": extras}]
    samplers, channels = [], []
    farthest = max(abs(joint.unit_motion.turn) * np.ptp(joint.limits) for joint in estimate.joints)
    steps = max(STEPS, math.ceil(farthest / (math.pi / 2)))
    times = np.linspace(0.0, SECONDS, 4 * steps + 1)
    clock = file.accessor(times)
    for index, (joint, parent, axis) in enumerate(zip(estimate.joints, parents, estimate.canonical_axes, strict=True)):
        low, high = joint.limits
        states = np.interp(times, SECONDS * np.array([0, 0.25, 0.75, 1]), [joint.state, high, low, joint.state])
        offset = places[index + 1] - places[parent]
        travel, moved = states[:, None] * axis, {}
        if joint.unit_motion.turn:
            moved["rotation"] = Rotation.from_rotvec(joint.unit_motion.turn * travel).as_quat()  # x, y, z, w
        if joint.unit_motion.slide:
            moved["translation"] = offset + joint.unit_motion.slide * travel
        frames[parent]["children"].append(len(frames))
        node = {"name": joint.name, "children": [], "translation": offset.tolist()}
        for kind, keys in moved.items():
            # the first key is the node's own value: a viewer that plays nothing shows the estimate
            node[kind] = keys[0].tolist()
            channels.append({"sampler": len(samplers), "target": {"node": len(frames), "path": kind}})
            samplers.append({"input": clock, "output": file.accessor(keys), "interpolation": "LINEAR"})
        frames.append(node)
    meshes, materials, nodes = [], [], list(frames)
    for part, (spec, mesh, colour) in enumerate(zip(estimate.category.parts, surfaces, colours, strict=True)):
        frames[part]["children"].append(len(nodes))
        nodes.append({"name": spec.name, "mesh": part, "translation": (-places[part]).tolist()})
        shape = {"attributes": {"POSITION": file.accessor(mesh.vertices)}, "material": part}
        shape["indices"] = file.accessor(mesh.faces.reshape(-1), UINT)
        meshes.append({"name": spec.name, "primitives": [shape]})
        # base colours are linear, ours are as a screen shows them
        linear = [*((colour / 255.0) ** 2.2).tolist(), 1.0]
        look = {"baseColorFactor": linear, "metallicFactor": 0.0, "roughnessFactor": 0.8}
        materials.append({"name": spec.name, "doubleSided": True, "pbrMetallicRoughness": look})
    animation = {"name": "open and close", "samplers": samplers, "channels": channels}
    root = 0
    if frame.upright:
        root = len(nodes)
        T = Y_UP @ frame.T_frame_camera @ estimate.T_camera_base
        nodes.append({"name": frame.name, "children": [0], "matrix": T.T.ravel().tolist()})  # column by column
    file.content |= {"scene": 0, "scenes": [{"nodes": [root]}], "nodes": nodes, "meshes": meshes}
    file.content |= {"materials": materials, "animations": [animation]}
    write_atomic(path, lambda temporary: temporary.write_bytes(file.to_bytes()))


@dataclass
class _Glb:
    """A binary glTF file in the making."""

    content: dict[str, Any] = field(
        default_factory=lambda: {"asset": {"version": "2.0", "generator": "omad"}, "accessors": [], "bufferViews": []}
    )
    data: bytes = b""

    def accessor(self, values: np.ndarray, component: int = FLOAT) -> int:
        """Append numbers (N,) or (N, C) -> the index of their accessor."""
        stored = np.ascontiguousarray(values, "<f4" if component == FLOAT else "<u4")
        rows = stored.reshape(len(stored), -1)
        views, accessors = self.content["bufferViews"], self.content["accessors"]
        limits = {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        kind = {"componentType": component, "type": TYPES[rows.shape[1]]}
        accessors.append({"bufferView": len(views), "count": len(rows), **kind, **limits})
        views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": stored.nbytes})
        self.data += stored.tobytes()
        return len(accessors) - 1

    def to_bytes(self) -> bytes:
        text = json.dumps(self.content | {"buffers": [{"byteLength": len(self.data)}]}).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(self.data), b"BIN\0")
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + len(self.data)) + chunks + self.data
