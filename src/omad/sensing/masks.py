"""Masks as people have them: booleans, label images, probabilities, cut-out pictures, COCO's run lengths and polygons,
LabelMe's polygons.

COCO's run lengths are those of pycocotools (Lin et al., "Microsoft COCO", 2014).
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from numbers import Integral
from os import PathLike
from typing import Any

import numpy as np

from omad.common.arrays import as_numpy, number
from omad.common.errors import InputError, shown
from omad.common.limits import check_limit

INSIDE = 0.5
"""A pixel with at least this probability is the object's."""
OPAQUE = 128
"""A pixel with at least this alpha, of 255, is the object's."""
LISTED = 12
"""Ids that an error lists at most."""
SHADE = 16
"""Of 255: the edge of a smooth mask has greys from here on, while labels are small numbers."""
FEW = 64
"""Of fewer numbers an image is one of labels; of more, a picture cut out of its background, say."""
GREY, SAME_HUE = 0.15, 0.25
"""Of a colour, by what share of its brightest channel the others are below it where it is grey, and by how much these
shares differ between shades of one colour."""
DARK = 0.25
"""What is not so bright, of the brightest colour, has hardly any hue."""
HUE_BINS, OTHER_HUE, MANY = 36, np.pi / 6, 0.02
"""Of a circle of hues, and how far from the commonest a hue is another one; which share of the pixels are many."""
LONGEST = 35
"""Bits of a run length in COCO's strings; no image has so many pixels."""
EDGE, MOST_WORK = 1000, 300_000_000
"""What an edge of a polygon costs beside a pixel of its box, and pixels at most: some seconds."""
WHOLE, SPECK = 0.95, 0.0005
"""Shares of the image above and below which a mask is doubtful."""
BEYOND, SOME, FEW_ENOUGH = 4.0, 0.01, 2000
"""What is so many times as far as most of a mask is no object's; the share of it from which on that is told; and pixels
that tell how far most are."""
PROPORTIONS = 0.02
"""By what share proportions differ at most of images that are one, resized."""
MUCH = 0.25
"""Of a mask, what is much to add to it. Exact masks gain a tenth at most, before noise with holes, too."""


def as_mask(values: Any, mask_id: int | None = None) -> np.ndarray:
    """(H, W) bool of what stands for a mask:

    - numbers (H, W), (1, H, W), (1, 1, H, W) or (H, W, 1), NumPy or torch: what is not zero, or with ``mask_id`` what
      has that number, which label images need. Floats between 0 and 1 are probabilities, and one half is enough;
    - colours (H, W, 3): what is not black, of one colour or a picture; grey ones are numbers. (H, W, 4): where the
      alpha channel tells pixels apart it is the mask, else the colours;
    - a COCO segmentation, a mapping with ``size`` (H, W) and ``counts``, compressed or not, or ``polygons``, rows of
      x, y, x, y ... in pixels; or an annotation that has it, or an array as above, under ``segmentation``; or a file
      of ``annotations``, or a list of them, of which ``mask_id`` is one's id, where there are several, or its place
      from 0 on where they have none;
    - a file of LabelMe's, whose ``shapes`` are such annotations without ids, those of one ``group_id`` together.

    ``mask_id`` is any kind of whole number. Raises InputError for logits, for several masks or labels in one, and for
    what is none of these."""
    mask_id = None if mask_id is None else _whole(mask_id)
    if are_annotations(values):
        values = {"annotations": values}
    if isinstance(values, Mapping):
        values = _of_labelme(values) if "shapes" in values else values
        if mask_id is not None and "annotations" not in values and values.get("id", mask_id) != mask_id:
            raise InputError(f"mask: the annotation has the id {values['id']}, not {mask_id}")
        return _decoded(_annotation(values, mask_id), None if {"annotations", "id"} & values.keys() else mask_id)
    try:
        stored = as_numpy(values)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged lists
        raise InputError("mask: cannot be read as an array; pass (H, W) of booleans or numbers") from error
    if stored.dtype.kind not in "biuf":
        is_path = isinstance(values, str | PathLike)
        path, array = "read the file first: omad.sensing.depth_files.read_mask", "pass (H, W) of booleans or numbers"
        raise InputError(f"mask: dtype {stored.dtype} is no mask; {path if is_path else array}")
    while stored.ndim > 3 and stored.shape[0] == 1:
        stored = stored[0]
    if stored.ndim == 3 and stored.shape[-1] in (3, 4) and stored.shape[0] > 1:
        stored = _of_colours(stored) if mask_id is None else _one_channel(stored)
    stored = stored[0] if stored.ndim == 3 and stored.shape[0] == 1 else stored
    stored = stored[..., 0] if stored.ndim == 3 and stored.shape[-1] == 1 else stored
    if stored.ndim > 2:
        cure = "pass one of them, mask[0] say, or a file of it alone"
        raise InputError(f"mask: shape {stored.shape} holds {stored.shape[0]} masks; {cure}")
    if stored.ndim != 2:
        raise InputError(f"mask: a mask needs shape (H, W), got {stored.shape}")
    if mask_id is not None:
        return _labelled(stored, mask_id)
    if stored.dtype.kind == "f":
        return _likely(stored)
    return stored if stored.dtype == bool else _of_one_thing(stored)


def _whole(mask_id: Any) -> int:
    if not (told := number(mask_id)).is_integer():
        raise InputError(f"mask_id: is {shown(repr(mask_id))}; give a whole number")
    return int(mask_id if isinstance(mask_id, Integral) else told)  # a float holds no id beyond 2^53


def are_annotations(values: Any) -> bool:
    """Whether that is a list of COCO annotations or segmentations, as networks that find objects give it."""
    each = values if isinstance(values, list | tuple) and values else [None]
    return all(isinstance(one, Mapping) and {"segmentation", "counts"} & one.keys() for one in each)


def of_palette(numbers: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """What ``as_mask`` is to take for an image with a palette, whose ``numbers`` (H, W) stand for ``colours``
    (H, W, 4): mostly the numbers, which are labels. They may be any in a picture with transparency, in a grey one and
    where there are but two, of which black is the background."""
    shades, alpha = colours[..., :3], colours[..., 3]
    if alpha.min() < alpha.max():
        return colours
    if (shades == shades[0, 0]).all() and numbers.min() < numbers.max():  # a palette that nobody filled
        return numbers
    if (shades == shades[..., :1]).all():
        return shades[..., 0]
    black = ~shades.any(-1)
    return colours if len(np.unique(numbers)) <= 2 and black.any() else numbers


def _of_colours(image: np.ndarray) -> np.ndarray:
    """Alpha where it tells pixels apart, else what is not black; numbers of a grey image. NaN is nothing."""
    image = np.nan_to_num(image)
    colours, alpha = image[..., :3], image[..., 3:]
    opaque = OPAQUE if image.dtype.kind in "iu" and alpha.max(initial=0) > 1 else INSIDE
    inside = np.any(alpha >= opaque, axis=-1)
    if not (inside.any() and not inside.all()):
        if (colours == colours[..., :1]).all():
            return colours[..., 0]
        inside = np.asarray(colours.any(-1))
    _check_one_thing(colours[inside])
    return inside


def _check_one_thing(colours: np.ndarray) -> None:
    """Raises InputError where few (N, 3) ``colours``, as a picture does not have, are of several hues: then each is an
    object's. Shades of one are its smooth edge, and greys are lines between objects."""
    levels = np.rint(255.0 / (colours.max(initial=0) or 1) * colours).astype(int)
    codes, counts = np.unique(levels[~_is_grey(levels)] @ (1 << 16, 1 << 8, 1), return_counts=True)
    if not 1 < len(codes) < FEW:
        return
    shades = np.bitwise_and(np.right_shift(codes[:, None].astype(int), (16, 8, 0)), 255)
    bright = shades.max(1) >= DARK * shades.max()
    hues = shades / shades.max(1, keepdims=True)
    if (np.abs(hues - hues[counts.argmax()]).max(1) > SAME_HUE)[bright].any():
        cure = "give a label image of one channel with mask_id (--mask-id), or a mask of one colour"
        raise InputError(f"mask: shows several objects, in {len(codes)} colours; {cure}")


def check_one_blurred_thing(image: np.ndarray) -> None:
    """Raises InputError where (H, W, 3) uint8 colours, which a JPEG has changed a little, are mostly a few of several
    hues. Compression makes the edges of a colour paler, but hardly of another hue."""
    brightest = image.max(-1)
    inside = image[brightest >= max(DARK * brightest.max(initial=0), 1)]
    colours = inside[~_is_grey(inside.astype(int))]
    counts = np.sort(np.unique(colours // 8 @ (1 << 10, 1 << 5, 1), return_counts=True)[1])[::-1]
    if np.count_nonzero(np.cumsum(counts) < len(colours) / 2) >= FEW:  # a picture
        return
    hues = np.angle(colours @ np.exp(2j * np.pi / 3 * np.arange(3)))
    found, edges = np.histogram(hues, HUE_BINS, (-np.pi, np.pi))
    common = edges[found.argmax()] + np.pi / HUE_BINS
    others = np.abs(np.angle(np.exp(1j * (hues - common)))) > OTHER_HUE
    if np.count_nonzero(others) > MANY * len(inside):
        cure = "store it as PNG: a label image with mask_id (--mask-id), or a mask of one colour"
        raise InputError(f"mask: shows several objects, whose colours a JPEG or WebP has blurred; {cure}")


def _is_grey(colours: np.ndarray) -> np.ndarray:
    """Which of (..., 3)."""
    high = colours.max(-1)
    return high - colours.min(-1) <= GREY * high


def _one_channel(image: np.ndarray) -> np.ndarray:
    """Of a grey image that is stored as colours."""
    if (image[..., :3] != image[..., :1]).any():
        raise InputError("mask: a coloured image holds no ids; give a label image of one channel, or a palette's")
    return image[..., 0]


def _labelled(labels: np.ndarray, mask_id: int) -> np.ndarray:
    found = labels == mask_id
    if not found.any():
        raise InputError(f"mask: no pixel has the id {mask_id}; there are {_listed(np.unique(labels))}")
    return found


def _of_one_thing(numbers: np.ndarray) -> np.ndarray:
    """What is not zero. Edges may be grey, but of an image with several labels it is not known which is meant."""
    high, there = numbers.max(initial=0), numbers != 0
    others = numbers[there & (numbers != high)]
    grey = 255 * int(others.max(initial=0)) >= SHADE * int(high)
    smoothed = grey and high == np.iinfo(numbers.dtype).max and 2 * len(others) < np.count_nonzero(there)
    if len(others) and not smoothed and len(ids := np.unique(others)) < FEW - 1:
        border, counts = np.unique(np.concatenate([*numbers[[0, -1]], *numbers.T[[0, -1]]]), return_counts=True)
        cure = f"give mask_id (--mask-id), or mask != {border[counts.argmax()]} for all of them"
        raise InputError(f"mask: is a label image of {_listed(np.append(ids, high))}; {cure}")
    return there


def _listed(ids: np.ndarray) -> str:
    return ", ".join(f"{number:g}" for number in ids[:LISTED]) + (", ..." if len(ids) > LISTED else "")


def _likely(values: np.ndarray) -> np.ndarray:
    """Of floats: probabilities, zero and one other number, or what integers may be. NaN is nothing."""
    values = np.where(np.isnan(values), 0, values)
    low, high = values.min(initial=0), values.max(initial=0)
    if low >= 0 and high <= 1:
        return values >= INSIDE
    if low >= 0 and high < np.iinfo(np.int64).max and (values == np.rint(values)).all():
        return _of_one_thing(values.astype(np.uint8 if high <= 255 else np.int64))
    if low == 0 and ((values == 0) | (values == high)).all():
        return values != 0
    what, cure = "look like logits", "pass mask > 0 of logits"
    if low >= 0:
        what, cure = "are no probabilities", "divide them by the largest that there may be, or pass mask >= a threshold"
    raise InputError(f"mask: floats from {low:.3g} to {high:.3g} {what}; {cure}")


def _annotation(coco: Mapping[str, Any], mask_id: int | None) -> Mapping[str, Any]:
    """One annotation of a COCO file, the only one or that with the id ``mask_id``, with its image's size; what is no
    file as it is."""
    if "annotations" not in coco:
        return coco
    found = coco["annotations"]
    if not isinstance(found, Sequence) or not found or not all(isinstance(one, Mapping) for one in found):
        raise InputError('mask: "annotations" holds none; give one with its "segmentation", or "size" and "counts"')
    numbered = [one.get("id", place) for place, one in enumerate(found)]
    chosen = [one for one, its in zip(found, numbered, strict=True) if mask_id in (None, its)]
    if len(chosen) != 1:
        ids = ", ".join(map(str, numbered[:LISTED])) + (", ..." if len(found) > LISTED else "")
        many = "several of them are" if chosen else "none of them is"
        cure = "give mask_id (--mask-id), or one of them" if mask_id is None else f"{many} {mask_id}; give one"
        raise InputError(f"mask: holds {len(found)} annotations with the ids {ids}; {cure}")
    images = coco.get("images", coco.get("image", ()))
    listed = images if isinstance(images, list) else [images]
    its = [one for one in listed if isinstance(one, Mapping) and one.get("id") == chosen[0].get("image_id")]
    sizes = [(one.get("height"), one.get("width")) for one in its]
    return {"size": sizes[0] if sizes else (), **chosen[0]}


def _of_labelme(file: Mapping[str, Any]) -> Mapping[str, Any]:
    """A file of LabelMe's as one of COCO's."""
    things: dict[int | str, list[Any]] = {}
    shapes = file["shapes"]
    if not isinstance(shapes, Sequence) or not all(isinstance(shape, Mapping) for shape in shapes):
        raise InputError('mask: "shapes" are no list of outlines as LabelMe writes them; export it again')
    for place, shape in enumerate(shapes):
        if shape.get("shape_type", "polygon") != "polygon":
            kind = shown(repr(shape["shape_type"]))
            raise InputError(f"mask: a shape of the kind {kind}; draw polygons, or give a --box, or an image")
        group = shape.get("group_id")
        things.setdefault(place if group is None else repr(group), []).append(shape.get("points"))
    size = {"height": file.get("imageHeight"), "width": file.get("imageWidth")}
    return {"image": size, "annotations": [{"segmentation": polygons} for polygons in things.values()]}


def _decoded(coco: Mapping[str, Any], mask_id: int | None) -> np.ndarray:
    """(H, W) bool of a COCO segmentation or annotation; ``mask_id``: of an array of labels in one."""
    found, size = coco.get("segmentation", coco), _sides(coco.get("size"))
    if hasattr(found, "shape") and size in ([], [*found.shape[-2:]]):  # an array under COCO's key, as networks have it
        return as_mask(found, mask_id)
    if not isinstance(found, Mapping):
        found = {"polygons": found, "size": size}
    size = _sides(found.get("size"))
    if len(size) != 2 or not all(isinstance(side, int | np.integer) and side > 0 for side in size):
        raise InputError('mask: a COCO segmentation needs "size": [height, width], beside "counts" or "polygons"')
    height, width = map(int, size)
    check_limit("image_pixels", height * width, "the mask")
    if "polygons" in found:
        return _filled(found["polygons"], height, width)
    if "counts" not in found:
        raise InputError('mask: a COCO segmentation needs "counts" or "polygons"; give one annotation of a file')
    return decode_runs(found["counts"], height, width)


def _sides(size: Any) -> list[Any]:
    """Height and width; empty where they are not told."""
    return [] if size is None else np.asarray(size, dtype=object).ravel().tolist()


def decode_runs(counts: str | bytes | Sequence[int], height: int, width: int) -> np.ndarray:
    """(H, W) bool of COCO run lengths, column by column, the first of what is not the object; as a list of numbers, or
    as the string that they are compressed to. Raises InputError where they do not fill the image."""
    listed, runs = _decompressed(counts) if isinstance(counts, str | bytes) else counts, np.zeros(0)
    with suppress(ValueError):  # of ragged lists
        runs = np.asarray(listed)
    pixels = height * width  # of longer runs the sum may wrap round to it, and NumPy then writes out of bounds
    possible = runs.dtype.kind in "iu" and runs.ndim == 1 and 0 <= runs.min(initial=0) <= runs.max(initial=0) <= pixels
    if not possible or runs.sum() != pixels:
        raise InputError(f'mask: "counts" are no run lengths of {width}x{height} pixels; is "size" [height, width]?')
    return np.repeat(np.arange(len(runs)) % 2 == 1, runs.astype(np.int64)).reshape(width, height).T


def _decompressed(text: str | bytes) -> list[int]:
    """Run lengths of a string: characters from "0" on hold five bits each, the least significant first, and a sixth
    that says that more follow. From the fourth run on it is the difference to the run two before that is written."""
    codes = text.encode("latin-1", "replace") if isinstance(text, str) else text
    runs: list[int] = []
    value = shift = 0
    for code in codes:
        bits = code - 48
        value |= (bits & 31) << shift
        shift += 5
        if shift > LONGEST:
            raise InputError('mask: "counts" is no string of COCO run lengths; export it again')
        if bits & 32:
            continue
        if bits & 16:
            value -= 1 << shift
        runs.append(value + runs[-2] if len(runs) > 2 else value)
        value = shift = 0
    return runs


def _filled(polygons: Any, height: int, width: int) -> np.ndarray:
    """(H, W) bool, pixels whose centres are inside any of the polygons; pixel (0, 0) reaches from 0 to 1."""
    filled, work = np.zeros((height, width), dtype=bool), 0
    for polygon in polygons if isinstance(polygons, Sequence | np.ndarray) else [polygons]:
        try:
            corners = np.asarray(polygon, dtype=float).ravel()
        except (TypeError, ValueError) as error:
            raise InputError("mask: a polygon is no list of numbers; give x, y, x, y ... in pixels") from error
        if not np.isfinite(corners).all():
            raise InputError("mask: a polygon holds NaN or infinity; give x, y, x, y ... in pixels")
        if len(corners) < 6 or len(corners) % 2:
            raise InputError(f"mask: a polygon of {len(corners)} numbers; give x, y, x, y ... of three corners or more")
        corners = corners.reshape(-1, 2)
        low, high = (np.clip(ends, 0, (width, height)).astype(int) for ends in (corners.min(0), corners.max(0) + 1))
        across, down = high - low
        work += int(across * down + len(corners) * (EDGE + down))
        if work > MOST_WORK:
            raise InputError("mask: polygons with too many corners; give run lengths, or an image")
        filled[low[1] : high[1], low[0] : high[0]] |= _inside(corners - low, across, down)
    return filled


def _inside(corners: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) bool, pixels whose centres are inside one polygon (n, 2): an odd number of its edges lies beyond them."""
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    edges = np.zeros((height, width + 1), dtype=bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        rows = np.arange(*np.sort(np.searchsorted(y, (y0, y1))))
        edges[rows, np.searchsorted(x, x0 + (y[rows] - y0) * (x1 - x0) / (y1 - y0 or 1.0))] ^= True
    return np.logical_xor.accumulate(edges[:, ::-1], axis=1)[:, ::-1][:, 1:]


def without_beyond(mask: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """A mask (H, W) bool without what is far beyond the object in a ``depth`` image, as the numbers are that some write
    where nothing was measured; and what to know of that."""
    inside = depth[mask]
    measured = inside[inside > 0]
    if not len(measured) or measured.max() <= (far := BEYOND * np.median(measured[:: 1 + len(measured) // FEW_ENOUGH])):
        return mask, ()
    beyond = mask & (depth > far)
    if (share := np.count_nonzero(beyond) / len(measured)) < SOME:
        return mask & ~beyond, ()
    what = f"{share:.0%} of the mask's pixels are {np.median(depth[beyond]):.3g} m away, far behind the rest"
    return mask & ~beyond, (f"{what}, and were left out; store 0 where nothing was measured, or check the mask",)


def check_size(mask: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raises InputError where a mask (H, W) is not of the depth image's ``shape``. Resized to other proportions it
    would lie beside the object."""
    if mask.shape == shape:
        return
    (height, width), (down, across) = mask.shape, shape
    cure = "resize it to that"
    if mask.shape == shape[::-1]:
        cure = "turn it by 90 degrees, as the depth image is"
    elif abs(width * down / (height * across) - 1) > PROPORTIONS:
        both = "give --color-intrinsics and --color-extrinsics"
        cure = f"it is of another image: draw it in the depth image, or where it is of the colour image {both}"
    raise InputError(f"mask: shape {mask.shape} differs from the depth image's {shape}; {cure}")


def odd_mask(mask: np.ndarray | None, given: np.ndarray | None) -> tuple[str, ...]:
    """What is odd of a ``mask`` (H, W) bool: it is of the background, or of a speck, or much had to be added to the one
    that was ``given``."""
    if mask is None or given is None:
        return ()
    share, added = float(mask.mean()), np.count_nonzero(mask) / max(np.count_nonzero(given), 1) - 1
    if share > WHOLE:
        return (f"the mask covers {share:.0%} of the image: does it show the object, and not all or the background?",)
    if share < SPECK:
        return (f"the mask covers {share:.2%} of the image, hardly anything: does it show the object?",)
    if added > MUCH:
        what = f"the mask seems too narrow: thin parts that go on from it were added, {added:.0%} of it"
        return (f"{what}; see in estimate.png that they are the object's, or give a wider mask",)
    return ()
