"""An ArtImage data set said in other words: what a reader must see through."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from omad.data.artimage.layout import Layout, peculiarities
from omad.objects.category import Category


def disguise(layout: Layout, name: str, category: Category, rng: np.random.Generator) -> None:
    """Say the same of an object from another model frame: shifted, and turned where the category has a base offset;
    its children off their rest states, their axes reversed, numbered the other way round; depth in three channels."""
    parts, shift = len(category.parts), rng.uniform(-0.5, 0.5, 3)
    number = [0, *range(parts - 1, 0, -1)]
    D = np.eye(4)
    if peculiarities(category).base_offset:
        angles, move = rng.uniform(-0.4, 0.4, 3), rng.uniform(-0.2, 0.2, 3)
        D[:3, :3], D[:3, 3] = Rotation.from_euler("ZXY", angles).as_matrix(), move
        tree = ElementTree.parse(layout.aligned_urdf(name))
        origin = tree.find("joint[@name='joint_0']/origin")
        assert origin is not None
        origin.set("xyz", words(-move[0], -move[2], move[1]))
        origin.set("rpy", words(-angles[0], -angles[2], angles[1]))
        tree.write(layout.aligned_urdf(name))
    inverse = np.linalg.inv(D)
    rest_states, T_rest = {}, [np.eye(4) for _ in range(parts)]
    tree = ElementTree.parse(layout.aligned_urdf(name))
    joints = [joint for joint in tree.iter("joint") if joint.get("type") != "fixed"]
    for part, (joint, spec) in enumerate(zip(joints, category.joints, strict=True), start=1):
        axis, origin, limit = joint.find("axis"), joint.find("origin"), joint.find("limit")
        assert axis is not None
        assert origin is not None
        assert limit is not None
        z, x, y = (float(word) for word in axis.attrib["xyz"].split())
        u = -inverse[:3, :3] @ (x, y, z)
        z, x, y = (float(word) for word in origin.attrib["xyz"].split())
        q = inverse[:3, :3] @ (shift + (x, y, z)) + inverse[:3, 3]
        state = float(rng.uniform(-0.3, 0.3))
        if spec.type == "revolute":
            T_rest[part][:3, :3] = Rotation.from_rotvec(-state * u).as_matrix()
            T_rest[part][:3, 3] = q - T_rest[part][:3, :3] @ q
            state = math.degrees(state)
        else:
            T_rest[part][:3, 3] = state * u
        rest_states[str(number[part])] = {"state": state}
        axis.set("xyz", words(u[2], u[0], u[1]))
        origin.set("xyz", words(q[2], q[0], q[1]))
        low, high = float(limit.attrib["lower"]), float(limit.attrib["upper"])
        limit.attrib.update(lower=repr(-high), upper=repr(-low))
        joint.set("name", f"joint_{number[part]}")
    tree.write(layout.aligned_urdf(name))
    record = json.loads(layout.rest_states.read_text())
    layout.rest_states.write_text(json.dumps(record | {name: rest_states}))

    T_canonical_model = [D @ T for T in T_rest]
    for T in T_canonical_model:
        T[:3, 3] -= shift
    clouds = [np.loadtxt(layout.points(name, part)) for part in range(parts)]
    for part, (cloud, T) in enumerate(zip(clouds, T_canonical_model, strict=True)):
        back = np.linalg.inv(T)
        np.savetxt(layout.points(name, number[part]), cloud @ back[:3, :3].T + back[:3, 3], "%.12f")
    for file in layout.annotation("").glob(f"{name}_*.json"):
        record = json.loads(file.read_text())
        for link in record["instances"][0]["links"]:
            part = link["link_category_id"]
            link["transformation"] = (np.array(link["transformation"]) @ T_canonical_model[part]).tolist()
            link["link_category_id"] = number[part]
            if part:
                link["state"] *= -1
        record["instances"][0]["links"].reverse()
        file.write_text(json.dumps(record))
        depth = layout.images / record["depth_path"]
        stored = np.asarray(Image.open(depth))
        Image.fromarray(np.stack([stored % 256, stored // 256, 0 * stored], 2).astype(np.uint8)).save(depth)
        mask = Path(str(depth).replace("depth", "category_mask"))
        Image.fromarray(np.array(number, np.uint8)[np.asarray(Image.open(mask))]).save(mask)


def words(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
