"""GLB: the object as a tree of nodes, a node a joint, with an animation that opens and closes every joint.

glTF's frame is canonical space (y up, z to the front, metres), so nothing is turned.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..estimate import Estimate
from ..files import write_atomic
from ..observation import Observation
from .surfaces import part_colours, part_surfaces

SECONDS = 6.0
KEYS = 49
FLOAT, UINT = 5126, 5125
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def save_glb(estimate: Estimate, path: str | Path, observation: Observation | None = None) -> None:
    """Write ``path``: nodes ``<joint name>`` with the estimated state, below each a mesh node ``<part name>`` in
    canonical coordinates; the animation ``open and close`` runs all joints from the estimated state through both
    limits and back. ``extras`` of the root node ``canonical`` holds ``T_camera_base`` and the joint states."""
    file = _Glb()
    surfaces, colours = part_surfaces(estimate, observation), part_colours(estimate)
    places = np.concatenate([np.zeros((1, 3)), estimate.canonical_pivots])
    parents = estimate.category.tree.parents
    frames: list[dict[str, Any]] = [{"name": "canonical", "children": [], "extras": _extras(estimate)}]
    samplers, channels = [], []
    times = np.linspace(0.0, SECONDS, KEYS)
    clock = file.accessor(times)
    for index, (joint, parent, axis) in enumerate(zip(estimate.joints, parents, estimate.canonical_axes, strict=True)):
        low, high = joint.limits
        states = np.interp(times, SECONDS * np.array([0, 0.25, 0.75, 1]), [joint.state, high, low, joint.state])
        offset = places[index + 1] - places[parent]
        # the first key is the node's own value: a viewer that plays nothing shows the estimate
        kind, keys = _moved(joint.type, axis, offset, states)
        frame = {"name": joint.name, "children": [], "translation": offset.tolist()} | {kind: keys[0].tolist()}
        frames[parent]["children"].append(len(frames))
        frames.append(frame)
        channels.append({"sampler": len(samplers), "target": {"node": len(frames) - 1, "path": kind}})
        samplers.append({"input": clock, "output": file.accessor(keys), "interpolation": "LINEAR"})
    meshes, materials, nodes = [], [], list(frames)
    for part, (spec, mesh, colour) in enumerate(zip(estimate.category.parts, surfaces, colours, strict=True)):
        frames[part]["children"].append(len(nodes))
        nodes.append({"name": spec.name, "mesh": part, "translation": (-places[part]).tolist()})
        attributes = {"POSITION": file.accessor(mesh.vertices)}
        indices = file.accessor(mesh.faces.reshape(-1), UINT)
        meshes.append(
            {"name": spec.name, "primitives": [{"attributes": attributes, "indices": indices, "material": part}]}
        )
        # base colours are linear, ours are as a screen shows them
        linear = [*((colour / 255.0) ** 2.2).tolist(), 1.0]
        look = {"baseColorFactor": linear, "metallicFactor": 0.0, "roughnessFactor": 0.8}
        materials.append({"name": spec.name, "doubleSided": True, "pbrMetallicRoughness": look})
    file.content |= {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        "animations": [{"name": "open and close", "samplers": samplers, "channels": channels}],
    }
    write_atomic(path, lambda temporary: temporary.write_bytes(file.to_bytes()))


def _moved(kind: str, axis: np.ndarray, offset: np.ndarray, states: np.ndarray) -> tuple[str, np.ndarray]:
    """Which property of the joint's node moves, and its values (T, 4) x, y, z, w or (T, 3) metres."""
    if kind == "prismatic":
        return "translation", offset + states[:, None] * axis
    return "rotation", Rotation.from_rotvec(states[:, None] * axis).as_quat()


def _extras(estimate: Estimate) -> dict[str, Any]:
    return {
        "T_camera_base": estimate.T_camera_base.tolist(),
        "joint_states": {joint.name: joint.state for joint in estimate.joints},
    }


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
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": stored.nbytes}
        self.content["bufferViews"].append(view)
        self.data += stored.tobytes()
        self.content["accessors"].append(
            {
                "bufferView": len(self.content["bufferViews"]) - 1,
                "componentType": component,
                "count": len(rows),
                "type": TYPES[rows.shape[1]],
                "min": rows.min(0).tolist(),
                "max": rows.max(0).tolist(),
            }
        )
        return len(self.content["accessors"]) - 1

    def to_bytes(self) -> bytes:
        text = json.dumps(self.content | {"buffers": [{"byteLength": len(self.data)}]}).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(self.data), b"BIN\0")
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + len(self.data)) + chunks + self.data
