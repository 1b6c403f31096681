"""How depth images and clouds are to be read, as it is written on a command line. Imports nothing that takes long."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class InputOptions:
    """How depth images and clouds are read."""

    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file (Open3D or RealSense JSON, ROS or Kalibr YAML, 3x3 text). A lens that
    the file tells of is undone."""
    mask: Path | None = None
    """Image or array, non-zero where the object is (of probabilities one half), or a COCO segmentation (JSON); or a
    folder with a mask for each input, of the same name: where inputs lie in several folders, in sub-folders called as
    these."""
    mask_id: int | None = None
    """The object's number in a --mask that is a label image."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels around the object, half-open; in every image. omad estimate and omad track find in it what
    the object is: table, floor and walls are taken away, and of the things left the one most like the category is
    taken. To all others all that lies in it is the object, but for what --segment takes away."""
    segment: Literal["plane"] | None = None
    """plane: take away the dominant plane and keep the largest thing on it (tens of milliseconds an image)."""
    depth_scale: float | None = None
    """Metres per stored number; default: what the file of --intrinsics or one beside the image tells, else 0.001 for
    integers, and 1 for floats and clouds."""


@dataclass(frozen=True)
class CameraOptions:
    """A camera of one's own as it is: with a lens, and a colour camera beside it."""

    distortion: str | None = None
    """The depth camera's lens in place of what the file of --intrinsics tells: k1,k2,p1,p2,k3 as OpenCV orders them,
    equidistant:k1,k2,k3,k4, or none for images that are undistorted already."""
    color: Path | None = None
    """Colour image, or a folder with one for each input, of the same name: shown under what is drawn. It lies on the
    depth image, or is that of --color-intrinsics. x.color.png beside x.png is found without."""
    color_intrinsics: str | None = None
    """As --intrinsics, of the colour camera: --color, a mask and --box then belong to its image, and depth stays
    unaligned."""
    color_extrinsics: Path | None = None
    """T_color_depth, depth camera to colour camera in metres: 4x4 text or NPY, or JSON with rotation and translation
    as librealsense writes them."""


@dataclass(frozen=True)
class FrameOptions(CameraOptions):
    """Frames of such a camera as they come: with stray points."""

    drop_flying: bool = False
    """Leave out stray points that fly between fore- and background, and small patches that hang apart from the
    object. Thin parts that are seen in pieces may go with them."""
