"""What lies where in an ArtImage download, and what is particular to it about a category.

    <root>/camera_intrinsic.json                                  Open3D pinhole
    <root>/<category>/{train,test}.txt                            valid annotation file names, one a line
    <root>/<category>/train/annotations/*.json                    of both splits: they are by object
    <root>/<category>/train/{depth,category_mask}/*.png
    <root>/<category>/urdf/rest_state.json
    <root>/<category>/urdf/<id>/mobility_for_unity_align.urdf
    <root>/<category>/urdf/<id>/mobility_for_unity.urdf           where the category has a base offset
    <root>/<category>/urdf/<id>/part_point_sample/<part>.xyz

One unit of length is a category unit; images count thousandths of it.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from omad.common.errors import InputError
from omad.objects.category import Category

Split = Literal["train", "test"]
SPLITS: tuple[Split, ...] = ("train", "test")
AGAIN = "download it again"
"""What cures a file of a download that is missing or broken."""


@dataclass(frozen=True)
class Peculiarities:
    """What ArtImage knows of a category beside its spec."""

    test_objects: frozenset[str] = frozenset()
    """Ids of the objects that its authors test on; all others of theirs train."""
    base_offset: bool = False
    """The difference between two URDFs of an object moves its model frame."""


_PECULIARITIES = {
    "laptop": Peculiarities(frozenset({"10040", "10885", "11242", "11030", "11156"})),
    "eyeglasses": Peculiarities(frozenset({"101300", "101859", "102586", "102590", "102596", "102612"})),
    "dishwasher": Peculiarities(frozenset({"11700", "12530", "12559", "12580"})),
    "drawer": Peculiarities(frozenset({"46123", "45841", "46440"})),
    "scissors": Peculiarities(frozenset({"10449", "10502", "10569", "10907"}), base_offset=True),
}


def peculiarities(category: Category) -> Peculiarities:
    """Those of a category; none for one that the original does not have."""
    return _PECULIARITIES.get(category.name, Peculiarities())


@dataclass(frozen=True)
class Layout:
    """Where the files of one category lie."""

    root: Path
    category: str

    @property
    def folder(self) -> Path:
        """All of the category."""
        return self.root / self.category

    @property
    def camera(self) -> Path:
        """Intrinsics of all images."""
        return self.root / "camera_intrinsic.json"

    @property
    def images(self) -> Path:
        """Paths in annotations are relative to it."""
        return self.folder / "train"

    @property
    def rest_states(self) -> Path:
        """Joint states of the models' files, object by object."""
        return self.folder / "urdf" / "rest_state.json"

    def valid(self, split: Split) -> Path:
        """Names of a split's annotations, one a line."""
        return self.folder / f"{split}.txt"

    def annotation(self, name: str) -> Path:
        """One image's truth."""
        return self.images / "annotations" / name

    def object(self, name: str) -> Path:
        """One object's model and clouds."""
        return self.folder / "urdf" / name

    def aligned_urdf(self, name: str) -> Path:
        """Its model in the category's canonical axes ..."""
        return self.object(name) / "mobility_for_unity_align.urdf"

    def plain_urdf(self, name: str) -> Path:
        """... and in its own."""
        return self.object(name) / "mobility_for_unity.urdf"

    def points(self, name: str, part: int) -> Path:
        """A cloud of one of its parts."""
        return self.object(name) / "part_point_sample" / f"{part}.xyz"


def is_artimage(root: Path | str) -> bool:
    """Whether a folder looks like an ArtImage root, whole or not, or like one category of it."""
    if not os.path.isdir(root):  # nor where its name is too long for there to be one
        return False
    root = Path(root)
    one = Layout(root.parent, root.name)
    signs = [Layout(root, "").camera, one.annotation(""), *root.glob("*/train/annotations")]
    return any(path.exists() for path in signs)


def depth_step(category: Category) -> float:
    """Metres per stored depth integer."""
    return 1e-3 * category.metres_per_unit


def require_flat_tree(category: Category) -> None:
    """Raises InputError for a category whose parts do not all hang on the base."""
    if any(joint.parent for joint in category.joints):
        raise InputError(f"ArtImage's layout hangs every part on the base; those of a {category.name} do not")
