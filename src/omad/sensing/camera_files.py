"""Cameras as people have them: intrinsics, lens distortion and the place of one camera before another, from files."""

import re
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import yaml

from omad.common.errors import InputError, shown
from omad.common.incoming import existing, is_file, parse_json, read_text
from omad.common.limits import check_limit, limits
from omad.geometry.camera import Camera
from omad.geometry.lens import Distortion
from omad.geometry.rigid import is_rotation

from .colmap import COLMAP, camera_of_colmap, camera_of_nerf
from .depth_files import SCALES, called, read_arrays

WRONG = (TypeError, ValueError, KeyError, IndexError, OverflowError, AttributeError, RecursionError)
"""What values of the wrong kind, or none, raise."""
LARGEST = 1e7
"""Pixels of a focal length or a principal point."""
SKEWED = 1.0
"""Pixels of skew that are left out without a word: calibrations have a fraction of one, and depth errs by more."""
FARTHEST = 1e3
"""Metres between cameras."""
BOP, COARSEST = "cam_K", 0.05
"""What BOP's data sets call intrinsics, and from how many metres on no camera's integer is a step: BOP writes
millimetres."""
MATRICES = ("K", "k", "camera_matrix", BOP, "intrinsics", "intrinsic", "camera_intrinsics", "camera_intrinsic")
"""What matrices row by row are called, and Kalibr's four numbers."""
COEFFICIENTS = re.compile(r"coeffs|[Dd]|dist(o|ort|ortion)?(_?(coeff|param)\w*)?", re.IGNORECASE)
"""What lists of a lens's are called, and tables of its coefficients by name."""
OF_IMAGES = ("width", "height", "image_width", "image_height", "resolution", "distortion_model", "fisheye_model")
"""What may stand beside a table of intrinsics instead of in it, as may a lens's coefficients."""
FEW_NUMBERS = 100
"""No camera has so many in one array; one that is larger, in the same NPZ, is an image."""
LENS, FISHEYE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), ("k1", "k2", "k3", "k4")
"""Coefficients by name, in OpenCV's order."""
SCALE = "depth_scale"
YAML_CHARACTERS = 100_000
"""Which take a second to read."""
OPENCV = "%YAML:1.0"
"""How OpenCV's files begin, which is no YAML."""
REALSENSE = ("none", "modified_brown_conrady", "inverse_brown_conrady", "ftheta", "brown_conrady", "kannala_brandt4")
"""librealsense's models by number."""


@dataclass(frozen=True, eq=False)
class CameraFile:
    """What a camera's file says."""

    K: np.ndarray
    """(3, 3) pixels."""
    distortion: Distortion | None = None
    """None where there is none, or none is told."""
    size: tuple[int, int] | None = None
    """Width and height of the images that it is for, where told."""
    rectified: np.ndarray | None = None
    """(3, 3) pixels, of its images after they were rectified, where ROS's ``P`` tells it."""
    depth_scale: float | None = None
    """Metres per stored integer of its depth images, where told."""

    def without_lens(self) -> Self:
        """That of its rectified images."""
        return replace(self, K=self.K if self.rectified is None else self.rectified, distortion=None)


def read_camera(source: str | Path) -> CameraFile:
    """Intrinsics, lens and image size from ``fx,fy,cx,cy`` or a file. Files: Open3D JSON (``intrinsic_matrix``,
    column-major, alone or in PinholeCameraParameters), JSON or YAML with ``fx, fy, cx, cy`` or librealsense's ``fx, fy,
    ppx, ppy`` (with ``model`` and ``coeffs``, or ``k1`` and so on), ROS CameraInfo YAML (``K`` or ``k``, with
    ``distortion_model`` and ``D`` or ``d``), OpenCV's FileStorage YAML (``camera_matrix``,
    ``distortion_coefficients``), Kalibr's YAML of one camera, BOP's JSON (``cam_K``, of one image or the same of all),
    COLMAP's cameras.txt of one camera, instant-ngp's and Nerfstudio's transforms.json, Record3D's ``K`` (column by
    column), NPY, or text, JSON or YAML holding 3x3 or 4 numbers, maybe as ``intrinsics``; beside these names
    ``depth_scale``. Raises InputError for others."""
    text = str(source)
    if (numbers := _numbers(text)) is not None:
        return CameraFile(as_K(numbers, f"intrinsics {shown(repr(text))}"))
    if not is_file(source):
        raise InputError(f"intrinsics {shown(repr(text))}: neither fx,fy,cx,cy nor an existing file")
    path = Path(source)
    return _told(_read(path, "K"), path)


def parse_camera(text: str, name: str) -> CameraFile:
    """What ``read_camera`` reads, of a text: ``fx,fy,cx,cy``, or what a file of its would hold; never the file of that
    name. ``name``: of it in messages. Raises InputError."""
    check_limit("camera_bytes", len(text), f"{name}: the text")
    return _told(_parsed(text, name), name)


def _told(data: Any, name: str | Path) -> CameraFile:
    if isinstance(data, list):
        with suppress(*WRONG):
            data = np.asarray(data, dtype=np.float64)
    return CameraFile(as_K(data, str(name))) if isinstance(data, np.ndarray) else camera_of(data, name)


def camera_of(data: Any, name: str | Path) -> CameraFile:
    """What a table tells of a camera under any of the names that ``read_camera`` knows; ``name``: of it in messages.
    Raises InputError."""
    if _is_matrix(data):
        return CameraFile(as_K(data, str(name)))
    data = _of_all_images(data, name)
    if isinstance(data, dict) and "cam1" in data:
        raise InputError(f"{name}: holds several cameras; give the depth camera's lines, those below its name, alone")
    scale, data = scale_of(data, name), _inner(data)
    K = as_K(_find_intrinsics(data, name), str(name))
    try:
        whole = CameraFile(K, _find_distortion(data), _find_size(data), _find_rectified(data), scale)
        return _in_window(whole, data)
    except InputError as error:
        raise InputError(f"{name}: {error}; undistort the images and give fx,fy,cx,cy, or --distortion") from error
    except WRONG as error:
        cure = "give width, height, distortion_model and D, or model and coeffs"
        raise InputError(f"{name}: its lens or its image size is not readable; {cure}") from error


def tells_of_camera(data: Any) -> bool:
    """Whether a table holds intrinsics, right or wrong, or is a matrix of them."""
    data, names = _inner(data), ("intrinsic_matrix", *MATRICES, "fx")
    return _is_matrix(data) or (isinstance(data, dict) and any(name in data for name in names))


def _is_matrix(data: Any) -> bool:
    return isinstance(data, np.ndarray) and data.size == 9 and data.ravel()[6:].tolist() == [0, 0, 1]


def scale_of(data: Any, name: str | Path) -> float | None:
    """Metres per stored integer that a table tells, itself or where it keeps the camera. Open3D and TUM write how many
    integers are a metre, BOP how many millimetres an integer is. Raises InputError."""
    tables = [table for table in (data, _inner(data)) if isinstance(table, dict) and SCALE in table]
    if not tables:
        return None
    told = tables[0][SCALE]
    with suppress(ValueError):  # YAML takes 1e-4 for a word
        told = float(told) if isinstance(told, str) else told
    if isinstance(told, bool) or not isinstance(told, int | float) or not SCALES[0] <= told <= SCALES[1]:
        raise InputError(f"{name}: {SCALE} is no number of metres; correct it, or take it out")
    return 1 / told if told > 1 else told / 1000 if told >= COARSEST else float(told)


def of_image(data: Any, stem: str) -> Any:
    """What a table of cameras tells of the image called ``stem``, where it names images by their numbers as BOP's
    scene_camera.json does; any other table as it is."""
    number = str(int(stem)) if stem.isdecimal() else stem
    return data[number] if isinstance(data, dict) and isinstance(data.get(number), dict) else data


def _of_all_images(data: Any, name: str | Path) -> Any:
    """The one camera of a table of many images. Raises InputError where they have several."""
    cameras = list(data.values()) if isinstance(data, dict) else []
    if not cameras or not all(isinstance(each, dict) and BOP in each for each in cameras):
        return data
    if any((each[BOP], each.get(SCALE)) != (cameras[0][BOP], cameras[0].get(SCALE)) for each in cameras):
        cure = "leave --intrinsics out, and it is read where it lies beside the images or one folder above"
        raise InputError(f"{name}: holds a camera for each of {len(cameras)} images; {cure}")
    return cameras[0]


def _inner(data: Any) -> Any:
    """Where a table keeps them under a name of their own: ``intrinsic`` (Open3D's PinholeCameraParameters), ``camera``
    (views of ``omad render``), ``intrinsics``, ``depth`` (beside those of the colour camera), ``cam0`` (Kalibr)."""
    if not isinstance(data, dict):
        return data
    if "fl_x" in data:
        return camera_of_nerf(data)
    names = ("intrinsic", "camera", "intrinsics", "depth", "cam0")
    name = next((name for name in names if isinstance(data.get(name), dict)), None)
    if name is None or name == "depth":  # beside that stands the colour camera's
        return data if name is None else data[name]
    lens = (*OF_IMAGES, *LENS)
    return {key: told for key, told in data.items() if key in lens or _lists_lens(key, told)} | data[name]


def _lists_lens(key: Any, told: Any) -> bool:
    """Whether a table tells of a lens's coefficients under this ``key``, and not that there is none."""
    return COEFFICIENTS.fullmatch(str(key)) is not None and str(told).lower() != "none"


def read_table(path: Path) -> Any:
    """What a JSON or YAML file of a camera holds. Raises InputError."""
    return _read(path, "K")


def read_intrinsics(source: str | Path) -> np.ndarray:
    """(3, 3) pinhole K in pixels from all that ``read_camera`` reads."""
    return read_camera(source).K


def parse_distortion(text: str) -> Distortion | None:
    """``none``, or ``[model:]k1,k2,p1,p2[,k3[,k4,k5,k6]]`` as in OpenCV: ``equidistant:...``. Raises InputError."""
    if text.strip().lower() == "none":
        return None
    model, _, listed = text.rpartition(":")
    numbers = _numbers(listed)
    counts = {"": (4, 5, 8), "equidistant": (4,)}.get(_model_name(model) or "")
    if numbers is None or (counts is not None and len(numbers) not in counts):
        need = "k1,k2,p1,p2,k3 (4, 5 or 8 numbers as OpenCV orders them), equidistant:k1,k2,k3,k4, or none"
        raise InputError(f"--distortion {text}: give {need}")
    return Distortion(_model_name(model) or "plumb_bob", tuple(numbers.tolist()))


def read_transform(source: str | Path, name: str) -> np.ndarray:
    """(4, 4) rigid transform ``name`` from a file: 16 or 12 numbers row by row (text, NPY), or JSON or YAML with
    ``name``, or with librealsense's ``rotation`` (9, column by column) and ``translation`` (metres). Raises InputError
    for anything else, and where the rotation is none."""
    path = existing(source, f"a file with {name}, a 4x4 matrix")
    data = _read(path, name)
    try:
        if isinstance(data, np.ndarray):
            matrix = data
        elif "rotation" in data:
            rotation = np.asarray(data["rotation"], dtype=np.float64)
            # librealsense lists columns one after the other; a nested matrix is written row by row
            rotation = rotation if rotation.ndim == 2 else rotation.reshape(3, 3).T
            matrix = np.c_[rotation, np.asarray(data["translation"], dtype=np.float64)]
        else:
            matrix = np.asarray(data[name], dtype=np.float64)
        T = np.vstack([matrix.reshape(-1, 4), [0, 0, 0, 1]])[:4]
        if matrix.size not in (12, 16) or not np.isfinite(T).all() or not np.allclose(T[3], [0, 0, 0, 1]):
            raise ValueError("no 4x4 matrix that ends in 0 0 0 1")
    except WRONG as error:
        cure = f"give 4x4 numbers, JSON with {name}, or rotation and translation as librealsense writes them"
        raise InputError(f"{path}: holds no {name}; {cure}") from error
    if not is_rotation(T[:3, :3]):
        raise InputError(f"{path}: the 3x3 part of {name} is no rotation, but scaled, mirrored or rounded; correct it")
    if np.abs(T).max() > FARTHEST:
        raise InputError(f"{path}: {name} goes farther than {FARTHEST:g} m; give its translation in metres")
    return T


def _read(path: Path, key: str) -> Any:
    """An array of numbers, or what JSON or YAML holds."""
    if path.suffix.lower() in (".npy", ".npz"):
        found = read_arrays(path, path.suffix[1:].upper())
        if isinstance(found, np.ndarray) or len(found) == 1:
            return called(found, key, path)
        return {name: array.tolist() for name, array in found.items() if array.size < FEW_NUMBERS}
    check_limit("camera_bytes", path.stat().st_size, f"{path}: the file")
    return _parsed(read_text(path), path)


def _parsed(content: str, name: str | Path) -> Any:
    plain = "\n".join(line for line in content.splitlines() if not line.lstrip().startswith("#"))
    if (numbers := _numbers(plain)) is not None:
        return numbers
    if (camera := camera_of_colmap(content, name)) is not None:
        return camera
    if content.lstrip().startswith("{"):  # YAML reads JSON too, but not the tabs that JSON allows
        return parse_json(content, name)
    if len(content) > YAML_CHARACTERS:
        raise InputError(f"{name}: YAML of {len(content)} characters; give what tells of the camera alone, or JSON")
    try:
        # `rostopic echo` ends each message with a ---
        return next(yaml.load_all(content.removeprefix(OPENCV), _PlainYaml), None)
    except Exception as error:  # its readers of dates and numbers raise anything; what they read is not quoted
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" (line {mark.line + 1})"
        raise InputError(f"{name}: neither JSON, YAML nor numbers{where}; export it again") from error


class _PlainYaml(yaml.SafeLoader):
    """YAML without references, by which a few lines grow to gigabytes."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("references are not supported")
        return super().compose_node(parent, index)


_PlainYaml.add_constructor("tag:yaml.org,2002:opencv-matrix", _PlainYaml.construct_yaml_map)


def _find_intrinsics(data: Any, name: str | Path) -> np.ndarray:
    """Row-major K or (fx, fy, cx, cy) out of the formats that people have."""
    try:
        if "intrinsic_matrix" in data:  # Open3D writes matrices column by column, others row by row
            matrix = np.asarray(data["intrinsic_matrix"], dtype=np.float64).reshape(3, 3)
            return matrix if not matrix[2, :2].any() else matrix.T
        for key in MATRICES:
            if key in data:
                matrix = np.asarray(_listed(data[key]), dtype=np.float64)
                by_columns = matrix.shape == (9,) and matrix[6:8].any() and not matrix[[2, 5]].any()
                return matrix.reshape(3, 3).T if by_columns else matrix
        centre = ("ppx", "ppy") if "ppx" in data else ("cx", "cy")
        return np.array([data[key] for key in ("fx", "fy", *centre)], dtype=np.float64)
    except WRONG as error:
        known = "intrinsic_matrix (Open3D), fx, fy, ppx, ppy (librealsense) or K (ROS CameraInfo)"
        raise InputError(f"{name}: holds no intrinsics; expected {known}") from error


def _find_distortion(data: dict[str, Any]) -> Distortion | None:
    """The lens that a file tells of; None for none, or for coefficients that are all zero."""
    model = _model_name(next((data[key] for key in ("model", "distortion_model") if data.get(key) is not None), ""))
    if data.get("fisheye_model") or data.get("is_fisheye"):  # OpenCV's and instant-ngp's
        model = "equidistant"
    listed = next((told for key, told in data.items() if _lists_lens(key, told)), None)
    if isinstance(listed, dict) and "data" not in listed:  # by their names
        return _find_distortion({"model": model, **listed})
    if listed is None and "k1" in data:
        if model is None and "k4" in data and "p1" not in data:
            raise ValueError("it may be a fisheye lens or none")
        names = FISHEYE if model in ("equidistant", "kannala_brandt4") else LENS
        listed = [data.get(name, 0.0) for name in names]
    coefficients = np.asarray([] if listed is None else _listed(listed), dtype=np.float64).ravel()
    # a fisheye lens without coefficients still is one
    if model == "none" or (not coefficients.any() and model != "equidistant"):
        return None
    return Distortion(model or "plumb_bob", tuple(coefficients.tolist()))


def _model_name(told: Any) -> str | None:
    """As in ``lens.MODELS``; drivers write 'Inverse Brown Conrady', 'distortion.brown_conrady', or a number."""
    if isinstance(told, int):
        return dict(enumerate(REALSENSE))[told]  # a tuple has something at -1, too
    name = str(told).strip().lower().removeprefix("rs2_").removeprefix("distortion").lstrip("._")
    if name.upper() in COLMAP:
        return "equidistant" if "fisheye" in name else "plumb_bob"
    names = {"fisheye": "equidistant", "equi": "equidistant", "radtan": "plumb_bob"}
    return names.get(name, name.replace(" ", "_").replace("-", "_")) or None


def _find_rectified(data: dict[str, Any]) -> np.ndarray | None:
    listed = next((data[key] for key in ("P", "p", "projection_matrix") if key in data), None)
    with suppress(*WRONG, InputError):  # drivers leave zeros
        return as_K(np.asarray(_listed(listed), dtype=np.float64).reshape(3, 4)[:, :3], "P")
    return None


def _find_size(data: dict[str, Any]) -> tuple[int, int] | None:
    pairs = [[data.get(name) for name in names] for names in (("width", "height"), ("image_width", "image_height"))]
    for width, height in [*pairs, data.get("resolution") or (0, 0)]:
        if width and height:  # a simulator may leave zeros
            sides = int(width), int(height)
            if not all(1 <= side <= limits().image_side for side in sides):
                raise ValueError("no size of an image")
            return sides
    return None


def _in_window(camera: CameraFile, data: dict[str, Any]) -> CameraFile:
    """The camera of the images, where ROS tells that of the whole sensor, which window of it they show (``roi``), and
    how many of its pixels are one of theirs (``binning_x``): as image_geometry takes them."""
    roi, window = data.get("roi"), ("x_offset", "y_offset", "width", "height")
    told = roi if isinstance(roi, dict) else {name: getattr(roi, name, 0) for name in window}
    left, top, *sides = (int(told.get(name) or 0) for name in window)
    across, down = binning = [int(data.get(name) or 1) for name in ("binning_x", "binning_y")]
    if camera.size is not None:
        seen = (side or whole for side, whole in zip(sides, camera.size, strict=True))
        width, height = (side // many for side, many in zip(seen, binning, strict=True))
        camera = replace(camera, size=(width, height))
    shown = np.array([[1 / across, 0, -left / across], [0, 1 / down, -top / down], [0, 0, 1]])
    return replace(camera, K=shown @ camera.K, rectified=None if camera.rectified is None else shown @ camera.rectified)


def _listed(value: Any) -> Any:
    """ROS calibration files keep a matrix as rows, cols and data."""
    return value["data"] if isinstance(value, dict) else value


def as_K(numbers: np.ndarray, name: str) -> np.ndarray:
    """(3, 3) from 4 numbers (fx, fy, cx, cy) or 9 row by row, or the 12 or 16 of a projection (3, 4) or (4, 4) from the
    camera's own frame; ``name``: of them in messages. Raises InputError."""
    if numbers.size in (12, 16) and not (rows := numbers.reshape(-1, 4))[:3, 3].any():
        numbers = rows[:3, :3]
    if numbers.size not in (4, 9) or numbers.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected fx,fy,cx,cy or a 3x3 matrix, got {numbers.size} numbers")
    numbers = numbers.astype(np.float64).ravel()
    K = numbers.reshape(3, 3) if numbers.size == 9 else Camera(0, 0, *numbers).K
    if not (np.abs(K) <= LARGEST).all() or K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], [0, 0, 1]):
        raise InputError(f"{name}: no pinhole matrix; expected [fx 0 cx; 0 fy cy; 0 0 1], positive pixels, row by row")
    if (askew := max(abs(K[0, 1]), abs(K[1, 0]))) > SKEWED:
        raise InputError(f"{name}: skewed by {askew:.3g} pixels; rectify the image, and give the matrix of that")
    return K


def is_numbers(text: str) -> bool:
    """Whether ``text`` gives intrinsics itself, and does not name a file."""
    return _numbers(text) is not None


def _numbers(text: str) -> np.ndarray | None:
    """Numbers separated by commas, semicolons or space; None if there is anything else."""
    words = text.translate(str.maketrans(",;[]", "    ")).split()
    with suppress(ValueError):
        return np.array([float(word) for word in words]) if words else None
