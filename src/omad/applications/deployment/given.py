"""What a deployed program is given on its command line: .npy files of points, or of a depth image and a mask."""

from contextlib import suppress

import numpy as np

INSIDE, FEW = 0.5, 64
"""A pixel with at least this probability is the object's; of fewer numbers an image is one of labels."""
HOW = "numpy.save writes one: points (N, 3) or a depth image (H, W) in metres, a mask (H, W)"


def read_points(file: str, intrinsics: str | None = None, mask: str | None = None) -> np.ndarray:
    """(N, 3) metres, camera frame: those in the file, or of the depth image (H, W) there with its ``intrinsics``
    fx,fy,cx,cy, of which ``mask`` is another file. Points need no intrinsics. Raises ValueError that names the option
    which is wrong."""
    stored = read_array(file)
    if stored.shape[1:] == (3,):  # no image is so narrow
        if mask is not None:
            raise ValueError("--mask: is of a depth image (H, W), and these are points (N, 3); leave it out")
        return stored
    seen = None if mask is None else read_array(mask, f"--mask {mask}: ")
    numbers: list[float] = []
    with suppress(ValueError):
        numbers = [float(number) for number in (intrinsics or "").split(",")]
    return back_projected(stored, numbers, seen)


def read_array(path: str, name: str = "") -> np.ndarray:
    """Of an .npy file; ``name``: with which messages begin. Raises ValueError for what is none, as an .npz."""
    try:
        with open(path, "rb") as file:
            stored = np.lib.format.read_array(file, allow_pickle=False)
        if stored.dtype.kind not in "biuf":
            raise ValueError(f"dtype {stored.dtype} is not of numbers")
        return stored
    except OSError as error:
        raise ValueError(f"{name}cannot be read ({error.strerror}); give an .npy file") from error
    except ValueError as error:
        raise ValueError(f"{name}is no .npy file of numbers; {HOW}") from error


def back_projected(depth: np.ndarray, intrinsics: list[float], mask: np.ndarray | None) -> np.ndarray:
    """(N, 3) of a depth image (H, W) in metres; 0 and what is not finite is no measurement. Raises ValueError."""
    if depth.ndim != 2 or depth.dtype.kind == "b":
        raise ValueError(f"depth: shape {depth.shape} of {depth.dtype} is no depth image's; give numbers (H, W)")
    if len(intrinsics) != 4 or not np.isfinite(intrinsics).all() or min(intrinsics[:2]) <= 0:
        raise ValueError("--intrinsics: give four numbers fx,fy,cx,cy of the image in pixels, the first two positive")
    if mask is not None and mask.shape != depth.shape:
        raise ValueError(f"mask: shape {mask.shape} differs from the depth image's {depth.shape}")
    fx, fy, cx, cy = intrinsics
    seen = np.isfinite(depth) & (depth > 0)
    v, u = np.nonzero(seen if mask is None else seen & of_object(mask))
    z = depth[v, u]
    return np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], 1)


def of_object(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: not zero, and of probabilities from one half on, as OMAD itself takes them. Raises ValueError for
    logits, and for a label image."""
    if mask.dtype.kind != "f":
        if 1 < len(labels := np.unique(mask[mask != 0])) < FEW:
            raise ValueError(f"mask: holds {len(labels)} labels; give mask == n of the object's")
        return mask != 0
    mask = np.nan_to_num(mask)
    if mask.min(initial=0) < 0:
        raise ValueError(f"mask: floats down to {mask.min():.3g} look like logits; give mask > 0 of logits")
    return mask >= INSIDE if mask.max(initial=0) <= 1 else mask > 0
