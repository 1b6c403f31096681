"""What the estimator sees: the points of one object in the camera frame, from a depth image or a cloud."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, Literal, Self

import numpy as np

from omad.common.arrays import as_numpy, numbers
from omad.common.errors import InputError, NothingSeen, shown
from omad.geometry.camera import Camera, intrinsics_doubts
from omad.geometry.lens import Distortion
from omad.geometry.transforms import MIRROR_X

from .camera_files import as_K
from .depth_files import FAR, NEAR, check_metres, one_channel
from .foreign.cameras import camera_from
from .foreign.images import depth_from, eight_bits, image_from, points_from
from .masks import as_mask, check_size, odd_mask, without_beyond

MIN_POINTS = 50
FARTHEST = 1e4
"""Metres. Nothing is measured farther away: such numbers mean no measurement."""
MOST_POINTS = 1_500_000
"""Of an observation: a network looks at hundreds, and what many millions of pixels say of an object, these do."""
NEAREST, FEW = 0.05, 0.01
"""Of a cloud: points nearer than this share of its distance along z are wrong, where they are not more than this."""
LOST = 0.1
"""Of the points, how many may lie beyond an image whose lens is undone."""

Segmentation = Literal["plane"]


@dataclass(frozen=True, eq=False)
class Observation:
    """One object as seen by one camera."""

    points: np.ndarray
    """(N, 3) float32 metres, camera frame (x right, y down, z forward)."""
    depth: np.ndarray | None = None
    """(H, W) float32 metres of the whole frame, 0 = no measurement; None for a bare cloud."""
    camera: Camera | None = None
    """Of ``depth``, without a lens; None for a bare cloud."""
    pixels: np.ndarray | None = None
    """(N, 2) int column and row of each point."""
    mask: np.ndarray | None = None
    """(H, W) bool, of pixels that are the object; very many are thinned out before they become points."""
    warnings: tuple[str, ...] = ()
    """What a person should know before trusting the result."""
    color: np.ndarray | None = None
    """(H, W, 3) uint8, what a colour camera saw at the pixels of ``depth``: for pictures."""
    likelihood: float = 1.0
    """That it is of the object that was looked for, where one had to be found in a whole frame."""
    every: int = 1
    """Rows and columns of ``depth`` for one of points."""
    seen_at: np.ndarray | None = None
    """(N, 2) as ``pixels``, in the image that was given, where that had a lens."""

    def __repr__(self) -> str:
        image = "" if self.camera is None else f" of a {self.camera.width}x{self.camera.height} image"
        near, far = self.depth_range
        return f"<Observation: {len(self.points)} points{image}, {near:.2f} to {far:.2f} m away>"

    @classmethod
    def from_depth(
        cls,
        depth_m: Any,
        K: Any = None,
        mask: Any = None,
        box: Sequence[float] | None = None,
        segment: Segmentation | None = None,
        drop_flying: bool = False,
        distortion: Distortion | None = None,
        mask_id: int | None = None,
        color: Any = None,
    ) -> Self:
        """Back-project a depth image (H, W), (H, W, 1) or (1, H, W) of floats in metres; 0, negative, NaN and infinite
        mean no measurement. NumPy arrays and torch tensors of any device are taken alike, so are ROS's Image and
        CompressedImage, Open3D's Image and RGBDImage, librealsense's depth_frame, which brings its intrinsics along.

        Which pixels are the object's: ``mask``, whatever ``as_mask`` takes, of a label image those with ``mask_id``;
        thin parts that a mask lost, as it is too narrow, are given back to it (``thin_parts``);
        ``box`` (x1, y1, x2, y2) pixels, half-open;
        ``segment="plane"`` takes away table, floor and walls and keeps the largest thing left. They combine; with none
        of them every measured pixel counts. ``drop_flying`` removes stray points between fore- and background, and
        small patches that hang apart from the object.

        Where more than ``MOST_POINTS`` pixels count, points are made of every second row and column, or third ...
        ``K``: (3, 3) matrix, or its 9 numbers row by row, (fx, fy, cx, cy) in pixels, a ``Camera``, the file of one, or
        a camera of another package: librealsense's intrinsics, Open3D's PinholeCameraIntrinsic, ROS's CameraInfo, with
        their lenses; ``distortion``: the lens, where the image was not undistorted and ``K`` does not tell. ``color``
        (H, W, 3): what a colour camera saw at the depth image's pixels; it serves pictures alone. Points then lie on
        the pixels' true rays, and ``depth``, ``mask`` and ``pixels`` are those of the undistorted image, into which
        points project with K alone.
        Raises InputError for input that cannot be right, and for fewer than 50 points."""
        from omad.geometry.back_projection import back_projected, pixels_at  # imports Numba, which takes long

        brought = depth_from(depth_m)
        depth = _check_depth(brought.depth)
        camera = _check_camera(brought.camera if K is None else K, depth.shape)
        color = _check_color(brought.color if color is None else color, depth.shape)
        if not isinstance(distortion, Distortion | None):
            raise InputError(f"distortion: is {type(distortion).__name__}; give an omad.geometry.lens.Distortion")
        camera = camera if distortion is None else replace(camera, distortion=distortion)
        measured = depth > 0
        if mask is None and mask_id is not None:
            raise InputError("mask_id: tells one of a mask's objects; give the mask, or leave it out")
        given = mask = None if mask is None else as_mask(image_from(mask), mask_id)
        if mask is not None and not mask.any():
            raise NothingSeen("mask: is empty, no pixel of it is the object's; check it")
        far = ()
        if mask is not None and mask.shape == depth.shape and not mask.all():
            from .thin_parts import with_thin_parts  # imports Numba, which takes long

            given, far = without_beyond(mask, depth)
            mask = with_thin_parts(given, depth)
        chosen = region_of(depth.shape, mask, box) & measured
        if (count := np.count_nonzero(chosen)) < MIN_POINTS:
            lie = f"depth: {count} of {np.count_nonzero(depth)} measured pixels lie inside mask and box"
            raise NothingSeen(f"{lie}, at least {MIN_POINTS} are needed; check mask, box and the camera's range")
        # a table is found in the whole frame even where the box leaves little of it
        used = chosen if segment is None or given is box is None else measured
        every = _every(used)
        if every > 1:
            thinned = np.zeros_like(used)
            thinned[::every, ::every] = used[::every, ::every]
            used, count = thinned, np.count_nonzero(chosen & thinned)
        place, points = back_projected(camera, depth, used)
        kept, warnings = _select(points, segment, None if used is chosen else chosen.ravel()[place], measured)
        if segment is not None:
            place, points = place[kept], points[kept]
        pixels = pixels_at(place, camera.width)
        if len(pixels) < count or segment is not None:
            chosen = _mask_of(pixels, depth, every)
        points = np.ascontiguousarray(points, dtype=np.float32)
        seen = cls(points, depth, camera, pixels, chosen, warnings, color, every=every)
        if camera.distortion is not None:
            seen = seen._without_lens()
        told = (*intrinsics_doubts(camera.pinhole), *odd_mask(mask, given), *far)
        seen = replace(seen, warnings=told + seen.warnings)
        return seen.without_strays() if drop_flying else seen

    def _without_lens(self) -> Self:
        """As the image is undistorted, with ``seen_at`` where its points were; those that are not in it are left out.
        Raises NothingSeen for fewer than 50."""
        assert self.camera is not None
        assert self.depth is not None
        assert self.mask is not None
        assert self.pixels is not None
        camera, straight, color, warnings = self.camera.pinhole, self.camera.rectified, self.color, self.warnings
        color = None if color is None else np.stack([straight(color[..., i]) for i in range(3)], -1)
        pixels = np.rint(camera.project(self.points))
        kept = np.all((pixels >= 0) & (pixels < (camera.width, camera.height)), axis=1)  # the corners may be lost
        if (count := np.count_nonzero(kept)) < MIN_POINTS:
            lie = f"distortion: without it {count} of {len(kept)} points lie within the image"
            raise NothingSeen(f"{lie}, at least {MIN_POINTS} are needed; check its coefficients")
        if (lost := 1 - count / len(kept)) > LOST:
            where = "outside of the image as it is without its lens, and were left out"
            warnings += (f"{lost:.0%} of the points lie {where}; turn the camera towards the object",)
        seen = replace(self, points=self.points[kept], pixels=pixels[kept].astype(int), seen_at=self.pixels[kept])
        depth, mask = straight(self.depth), straight(self.mask)
        return replace(seen, depth=depth, camera=camera, mask=mask, warnings=warnings, color=color)

    def part(self, index: np.ndarray) -> Self:
        """Some of its points, by their indices or (N,) bool. Raises NothingSeen for fewer than 50."""
        points = self.points[index]
        if len(points) < MIN_POINTS:
            need = f"{MIN_POINTS} are needed; give another mask or box"
            raise NothingSeen(f"points: only {len(points)} of {len(self.points)} are left, {need}")
        if self.depth is None or self.pixels is None:
            return replace(self, points=points)
        pixels, seen_at = self.pixels[index], None if self.seen_at is None else self.seen_at[index]
        mask = _mask_of(pixels, self.depth, self.every)
        return replace(self, points=points, pixels=pixels, mask=mask, seen_at=seen_at)

    @property
    def given_pixels(self) -> np.ndarray | None:
        """(N, 2) int column and row of each point in the image that was given; None for a bare cloud."""
        return self.pixels if self.seen_at is None else self.seen_at

    def inside(self, box: Sequence[float]) -> np.ndarray:
        """(N,) bool: which points are within a ``box`` (x1, y1, x2, y2) in pixels of the image that was given,
        half-open. Raises InputError for one that is wrong, and for one of a bare cloud."""
        if self.depth is None or self.given_pixels is None:
            raise InputError("box: needs a depth image; a bare cloud has no pixels")
        return region_of(self.depth.shape, None, box)[tuple(self.given_pixels.T[::-1])]

    def mirrored(self) -> Self:
        """What the camera would see in a mirror in its plane x = 0."""
        points = self.points * np.array(MIRROR_X, dtype=self.points.dtype)
        if self.depth is None or self.camera is None or self.pixels is None:
            return replace(self, points=points)
        width = self.camera.width
        return replace(
            self,
            points=points,
            depth=np.ascontiguousarray(self.depth[:, ::-1]),
            camera=replace(self.camera, cx=width - 1 - self.camera.cx),
            pixels=np.array([width - 1, 0]) + self.pixels * [-1, 1],
            seen_at=None if self.seen_at is None else np.array([width - 1, 0]) + self.seen_at * [-1, 1],
            mask=None if self.mask is None else np.ascontiguousarray(self.mask[:, ::-1]),
            color=None if self.color is None else np.ascontiguousarray(self.color[:, ::-1]),
        )

    def warned(self, *warnings: str) -> Self:
        """The same with more to know before trusting the result."""
        return replace(self, warnings=(*self.warnings, *warnings))

    def without_strays(self) -> Self:
        """Without points that fly alone, and in an image without small patches that hang apart from the object. Raises
        NothingSeen where too few are left."""
        from .cutting.patches import flying, hanging  # imports SciPy, which takes long

        steady = self.part(~flying(self.points))
        if steady.depth is None or steady.pixels is None:
            return steady
        return steady.part(~hanging(steady.points, steady.pixels // self.every, steady.depth.shape))

    @property
    def depth_range(self) -> tuple[float, float]:
        """Metres along z between which nearly all points lie, for pictures."""
        near, far = np.percentile(self.points[:, 2], [1, 99]) if len(self.points) else (np.nan, np.nan)
        return float(near), float(far)

    @classmethod
    def from_points(cls, points: Any, segment: Segmentation | None = None, drop_flying: bool = False) -> Self:
        """A cloud (N, 3) or (H, W, 3) in metres, camera frame, or one of another package: ROS's PointCloud2, Open3D's
        PointCloud, librealsense's points. Rows that are not finite or all zero mean no measurement. Of more than
        ``MOST_POINTS`` rows every second counts, or third ... Raises InputError for a wrong shape, millimetres, and for
        fewer than 50 points."""
        cloud = _numbers(points_from(points), "points").astype(np.float64)
        if cloud.ndim not in (2, 3) or cloud.shape[-1] != 3:
            cure = "; leave out what is no x, y, z: points[:, :3]" if cloud.ndim == 2 and cloud.shape[1] > 3 else ""
            cure = "; give its columns as rows: points.T" if cloud.ndim == 2 and len(cloud) == 3 else cure
            raise InputError(f"points: expected shape (N, 3) or (H, W, 3), got {cloud.shape}{cure}")
        cloud = cloud.reshape(-1, 3)
        cloud = cloud[np.isfinite(cloud).all(1) & cloud.any(1)]
        if len(cloud) < MIN_POINTS:
            raise NothingSeen(f"points: {len(cloud)} valid points, at least {MIN_POINTS} are needed")
        check_metres(np.abs(cloud).max(1), "points")
        cloud = cloud[np.abs(cloud).max(1) < FARTHEST]
        cloud = cloud[:: -(-len(cloud) // MOST_POINTS) or 1]
        if len(cloud) < MIN_POINTS:
            raise NothingSeen(f"points: {len(cloud)} within {FARTHEST:g} m, at least {MIN_POINTS} are needed")
        kept, warnings = _select(cloud, segment)
        depth = cloud[kept, 2]
        if (behind := float((depth <= 0).mean())) > 0.5:
            cure = "turn z forward (of OpenGL's axes, y and z times -1; of those with x forward, -y, -z, x)"
            raise InputError(f"points: {behind:.0%} of them lie behind the camera; {cure}")
        beside = depth < NEAREST * np.median(depth)
        if 0 < (count := np.count_nonzero(beside)) <= FEW * len(kept):  # their rays are far from all others
            kept = kept[~beside]
            warnings += (f"{count} point(s) beside or behind the camera were left out",)
        elif behind > 0:
            cure = "the cloud should be in the camera frame, z forward"
            warnings += (f"{behind:.0%} of the points lie behind the camera: {cure}",)
        seen = cls(cloud[kept].astype(np.float32), warnings=warnings)
        return seen.without_strays() if drop_flying else seen


def _every(used: np.ndarray) -> int:
    """So that of every so many rows and columns of the image ``used`` (H, W) not too many pixels are left."""
    return max(1, math.ceil(math.sqrt(np.count_nonzero(used) / MOST_POINTS)))


def _mask_of(pixels: np.ndarray, depth: np.ndarray, every: int) -> np.ndarray:
    """(H, W) bool of points at ``pixels`` (N, 2), for each of which there are so many rows and columns."""
    height, width = depth.shape
    mask = np.zeros((-(-height // every), -(-width // every)), dtype=bool)
    mask[tuple(pixels.T[::-1] // every)] = True
    return mask if every == 1 else mask.repeat(every, 0).repeat(every, 1)[:height, :width] & (depth > 0)


def _numbers(values: Any, name: str, cure: str = "pass floats in metres") -> np.ndarray:
    """Integers or floats as they are."""
    try:
        array = as_numpy(values)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged lists
        raise InputError(f"{name}: cannot be read as an array; pass NumPy numbers") from error
    if array.dtype.kind not in "iuf":
        cure = "read the file first: omad.sensing.depth_files" if isinstance(values, str | PathLike) else cure
        raise InputError(f"{name}: dtype {array.dtype} is not numeric; {cure}")
    return array


def _check_depth(depth_m: Any) -> np.ndarray:
    """(H, W) float32, the caller's no longer, with every kind of missing measurement turned into 0."""
    stored = one_channel(_numbers(depth_m, "depth"))
    if stored.ndim != 2:
        raise InputError(f"depth: expected one channel of shape (H, W), got shape {stored.shape}")
    if stored.dtype.itemsize == 1:
        raise InputError(f"depth: {stored.dtype} holds too few depth steps; take the camera's own depth, in metres")
    with np.errstate(over="ignore"):  # of doubles beyond singles: no measurements, as infinite ones are none
        depth = np.fmax(stored.astype(np.float32, copy=False), 0)  # of NaN and 0, fmax takes 0
    if (farthest := depth.max(initial=0)) == np.inf:
        depth[depth == np.inf] = 0
        farthest = depth.max()
    if farthest == 0:
        why = "some are negative, and z points forward" if (stored < 0).any() else "all are zero or NaN"
        raise NothingSeen(f"depth: no pixel holds a measurement ({why}); check the camera and the file")
    if farthest > FAR or farthest < NEAR:
        check_metres(stored[depth > 0], "depth")
        depth[depth > FARTHEST] = 0
    if stored.dtype.kind in "iu":
        raise InputError("depth: integers cannot be metres; multiply by the depth scale first (0.001 for millimetres)")
    return depth


def _check_camera(K: Any, shape: tuple[int, ...]) -> Camera:
    height, width = shape
    if isinstance(K, Camera):
        if (K.height, K.width) != (height, width):
            raise InputError(f"depth: is {width}x{height} but its camera {K.width}x{K.height}; use the image's own")
        as_K(numbers([K.fx, K.fy, K.cx, K.cy], 4, what="intrinsics"), "intrinsics")
        return replace(K, width=width, height=height)  # whole numbers
    if K is None:
        raise InputError("intrinsics: none given; pass K as a 3x3 matrix or (fx, fy, cx, cy) in pixels")
    if (told := camera_from(K)) is not None:
        if told.size not in (None, (width, height)):
            size = "x".join(map(str, told.size))
            raise InputError(f"depth: is {width}x{height} but its camera {size}; use the image's own")
        return Camera.from_K(told.K, width, height, told.distortion)
    values = _numbers(K, "intrinsics", "pass a 3x3 matrix or (fx, fy, cx, cy)")
    if values.shape not in ((4,), (9,), (3, 3), (3, 4), (4, 4)):
        raise InputError(f"intrinsics: expected a 3x3 matrix or (fx, fy, cx, cy), got shape {values.shape}")
    return Camera.from_K(as_K(values, "intrinsics"), width, height)


def _check_color(color: Any, shape: tuple[int, ...]) -> np.ndarray | None:
    """(H, W, 3) uint8."""
    if color is None:
        return None
    image = _numbers(image_from(color), "color", "pass integers up to 255, or floats")
    if image.shape[:2] != shape:
        cure = "give one that is aligned to depth, or on the command line --color-intrinsics and --color-extrinsics"
        sizes = ["x".join(map(str, size[1::-1])) for size in (image.shape, shape)]
        raise InputError(f"color: is {sizes[0]} where the depth image is {sizes[1]}; {cure}")
    if image.shape in (shape, (*shape, 1)):
        image = np.repeat(image.reshape(*shape, 1), 3, 2)
    if image.ndim != 3 or image.shape[2] not in (3, 4):
        raise InputError(f"color: expected shape (H, W, 3), got {image.shape}")
    return eight_bits(image[..., :3])


def region_of(shape: tuple[int, ...], mask: np.ndarray | None, box: Sequence[float] | None) -> np.ndarray:
    """(H, W) bool of a mask (H, W) bool and box together."""
    height, width = shape
    region = np.ones(shape, dtype=bool)
    if mask is not None:
        check_size(mask, shape)
        region &= mask
    if box is not None:
        corners = numbers(box, 4, what="box: x1, y1, x2, y2 in pixels")
        x1, y1, x2, y2 = np.rint(corners).astype(int)
        if x1 >= x2 or y1 >= y2 or corners.max() <= 1:  # shares of the image
            got = ",".join(f"{corner:g}" for corner in corners)
            raise InputError(f"box: x1 < x2 and y1 < y2 are needed, in whole pixels, got {got}")
        if x1 >= width or y1 >= height or x2 <= 0 or y2 <= 0:
            raise InputError(f"box: {x1},{y1},{x2},{y2} lies outside the {width}x{height} image")
        within = np.zeros(shape, dtype=bool)
        within[max(y1, 0) : y2, max(x1, 0) : x2] = True
        region &= within
    return region


def _select(
    points: np.ndarray, segment: str | None, inside: np.ndarray | None = None, measured: np.ndarray | None = None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Indices of the object's points, and warnings; ``inside`` (N,) bool is where a segment may lie, ``measured``
    (H, W) bool what the image shows."""
    warnings: tuple[str, ...] = ()
    if segment is None:
        kept = np.arange(len(points))
    else:
        from .cutting.angles import angle_doubts
        from .cutting.segmentation import RIVAL, TOUCHED, segment_on_plane, share_of_margin  # imports SciPy

        if not isinstance(segment, str) or segment != "plane":
            raise InputError(f"segment: unknown way {shown(repr(segment))}; use 'plane', or give a mask or a box")
        found = segment_on_plane(points, inside)
        kept = np.nonzero(found.selected)[0]
        if not len(found.planes):
            warnings += ("no table, floor or wall was found; the largest connected thing was taken",)
        elif measured is not None and share_of_margin(measured) < TOUCHED:
            why = "the frame shows hardly anything at its margin, as what was cut out already does"
            warnings += (f"{why}: the plane taken away may be the object's own; then leave out segment (--segment)",)
        warnings += angle_doubts(found.planes)
        if found.rival > RIVAL:
            warnings += ("another thing of similar size stands beside the one chosen; give a box or a mask",)
    if len(kept) < MIN_POINTS:
        need = f"{MIN_POINTS} are needed; {'check K' if segment is None else 'give a mask or a box'}"
        raise NothingSeen(f"{segment or 'points'}: only {len(kept)} of {len(points)} points are left, {need}")
    return kept, warnings
