"""Models of one joint, and what is changed in their files."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from omad.geometry.mesh import Mesh
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .categories import DISHWASHER, LAPTOP
from .own_models import box


def as_object(category: Category, parts: list[Mesh], pivot, limits=None) -> ObjectModel:
    spec = category.joints[0]
    return ObjectModel(
        name="made",
        category=category.name,
        part_names=tuple(part.name for part in category.parts),
        parts=tuple(parts),
        joint_names=(spec.name,),
        tree=category.tree,
        axes=np.array([spec.axis]),
        pivots=np.array([pivot], dtype=float),
        limits=np.array([limits or spec.limits]),
    ).centred()


def plain_laptop() -> ObjectModel:
    base, screen = box((-0.17, 0, 0), (0.17, 0.02, 0.24)), box((-0.165, 0.025, -0.01), (0.165, 0.24, 0.0))
    return as_object(LAPTOP, [base, screen], (0, 0.022, 0.005))


def plain_dishwasher() -> ObjectModel:
    body, door = box((-0.3, 0, -0.55), (0.3, 0.82, 0)), box((-0.29, 0.1, 0), (0.29, 0.8, 0.03))
    return as_object(DISHWASHER, [body, door], (0, 0.1, 0.01))


def edited(file: Path, change) -> Path:
    """Rewrite a URDF through ``change(root element)``."""
    tree = ElementTree.parse(file)
    change(tree.getroot())
    tree.write(file)
    return file


def box_link(root, name: str, low, high) -> None:
    low, high = np.array(low), np.array(high)
    link = ElementTree.SubElement(root, "link", name=name)
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=" ".join(map(str, (low + high) / 2)))
    geometry = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(geometry, "box", size=" ".join(map(str, high - low)))


def extra_joint(root, name: str, parent: str, child: str, kind: str, **limits: str) -> None:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "axis", xyz="0 0 1")
    if limits:
        ElementTree.SubElement(joint, "limit", limits)
