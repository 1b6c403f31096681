"""Files as no friend would write them, for every reader: good ones, of which one is spoilt at random."""

import io
import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from omad.applications.retrieval.index import Entry, ShapeIndex
from omad.applications.retrieval.signature import Space
from omad.applications.tracking.frames import read_times, read_truth
from omad.common.errors import InputError, WorkError
from omad.data.procedural import generate
from omad.data.rendering.view_folder import open_views, render_to_folder
from omad.data.urdf_import.articulation import read_articulation
from omad.data.urdf_import.folder import import_model
from omad.data.urdf_import.importing import import_folder
from omad.geometry.camera import Camera
from omad.model.checkpoint import category_from_dict, load, save
from omad.model.priornet import PriorNet
from omad.objects.category_file import get_category
from omad.objects.urdf import write_urdf
from omad.sensing.camera_files import read_camera, read_transform
from omad.sensing.depth_files import read_cloud, read_depth, read_mask
from omad.sensing.observation import Observation

ODD: list[Any] = [
    None, True, 0, -1, 1, 7, 2**31, 10**30, 10**400, -0.0, 0.5, 1e-300, 1e30, 1e300, float("nan"), float("inf"), "",
    "x", "a\0b", "../../../etc/passwd", "/etc/passwd", "$x$", "\\frac{1", "\ud800", "x" * 5000, [], [[]], [1, 2],
    [[1, 2], [3]], {}, {"a": 1}, [None], ["x"], [1e300] * 3,
]  # fmt: skip
"""In place of a value."""
WORDS = [
    b"\0",
    b"nan",
    b"inf",
    b"1e999",
    b"-1",
    b"99999999999999999999",
    b"\xff\xfe",
    b"[" * 2000,
    b"<a>" * 300,
    b"&a;",
    b"$",
]
"""Into a file of any kind."""


@dataclass(frozen=True)
class Target:
    """A reader."""

    name: str
    files: dict[str, bytes]
    """By path, what is good; all are there, and one is spoilt."""
    use: Callable[[Path], Any]
    """Reads them from a folder; gives numbers, or anything."""
    spoilt: tuple[str, ...] = ()
    """Of the files; empty: any."""


def attempt(target: Target, rng: np.random.Generator, folder: Path) -> str | None:
    """Read a spoilt copy in an empty ``folder``: None where it is refused in one line or gives numbers that are finite;
    else what went wrong."""
    place = str(rng.choice(sorted(target.spoilt or target.files)))
    for name, content in target.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(spoil(content, name, rng) if name == place else content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = target.use(folder)
    except (InputError, WorkError) as error:
        text = str(error)
        return (
            None if "\n" not in text and 0 < len(text) < 20_000 else f"{target.name}/{place}: no line: {text[:200]!r}"
        )
    except Exception as error:
        return f"{target.name}/{place}: {type(error).__name__}: {error}"
    return None if _finite(found) else f"{target.name}/{place}: an answer that is not a number"


def spoil(content: bytes, name: str, rng: np.random.Generator) -> bytes:
    """The same but for something."""
    if name.endswith(".json") and rng.random() < 0.8:
        return json.dumps(_odd_value(json.loads(content), rng)).encode()
    data, kind = bytearray(content), rng.integers(6)
    start, end = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    if kind == 0:
        return bytes(data[:start])
    if kind == 1:
        return bytes(data[:start] + data[end:])
    if kind == 2:
        return bytes(data[:start] + WORDS[rng.integers(len(WORDS))] + data[start:])
    if kind == 3:
        return bytes(data[:end] + data[start:end] + data[end:])
    for place in rng.integers(0, max(len(data), 1), rng.integers(1, 8)):
        if len(data):
            data[place] ^= 1 << int(rng.integers(8))
    return bytes(data)


def _odd_value(value: Any, rng: np.random.Generator) -> Any:
    """JSON with one value at any depth replaced, or gone."""
    inner = list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    if not inner or rng.random() < 0.1:
        return ODD[rng.integers(len(ODD))]
    key = inner[rng.integers(len(inner))]
    if rng.random() < 0.1:
        return (
            {k: v for k, v in value.items() if k != key} if isinstance(value, dict) else value[:key] + value[key + 1 :]
        )
    changed = value.copy()
    changed[key] = _odd_value(value[key], rng)
    return changed


def _finite(found: Any) -> bool:
    if isinstance(found, np.ndarray) and found.dtype.kind == "f":
        return bool(np.isfinite(found).all())
    return True


def _encoded(write: Callable[[io.BytesIO], Any]) -> bytes:
    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()


def _below(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _observed(path: Path) -> np.ndarray:
    depth = read_depth(path)
    return Observation.from_depth(depth, Camera(depth.shape[1], depth.shape[0], 60, 60, 30, 20)).points


def targets(folder: Path) -> list[Target]:
    """All readers; good files are made in ``folder``."""
    rng = np.random.default_rng(0)
    depth = rng.uniform(900, 1100, (40, 60)).astype(np.uint16)
    cloud = rng.normal((0, 0, 1), 0.1, (200, 3))
    text = "\n".join(" ".join(f"{x:.4f}" for x in row) for row in cloud).encode()
    made = [
        Target(f"depth {kind}", {f"d.{kind}": _encoded(write)}, lambda at, kind=kind: _observed(at / f"d.{kind}"))
        for kind, write in {
            "png": lambda file: Image.fromarray(depth).save(file, "PNG"),
            "tif": lambda file: Image.fromarray(depth).save(file, "TIFF"),
            "npy": lambda file: np.save(file, depth),
            "npz": lambda file: np.savez_compressed(file, depth=depth),
        }.items()
    ]
    pcd = b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 200\nHEIGHT 1\nPOINTS 200\nDATA "
    ply = b"ply\nformat ascii 1.0\nelement vertex 200\n" + b"".join(b"property float %c\n" % c for c in b"xyz")
    clouds = {
        "c.xyz": text,
        "c.ply": ply + b"end_header\n" + text + b"\n",
        "a.pcd": pcd + b"ascii\n" + text + b"\n",
        "b.pcd": pcd + b"binary\n" + cloud.astype("<f4").tobytes(),
        "c.npz": _encoded(lambda file: np.savez(file, points=cloud)),
    }
    for name, content in clouds.items():
        read = lambda at, name=name: Observation.from_points(read_cloud(at / name)).points  # noqa: E731
        made.append(Target(f"cloud {name}", {name: content}, read))
    coco = json.dumps({"size": [4, 6], "counts": [3, 4, 17]}).encode()
    grey = _encoded(lambda file: Image.fromarray(np.eye(8, dtype=np.uint8) * 255).save(file, "PNG"))
    camera = {
        "fx": 600.0,
        "fy": 600.0,
        "ppx": 320,
        "ppy": 240,
        "width": 640,
        "height": 480,
        "model": 4,
        "coeffs": [0.1] * 5,
    }
    yaml = b"image_width: 640\nimage_height: 480\ncamera_matrix: {data: [6e2, 0, 320, 0, 6e2, 240, 0, 0, 1]}\n"
    place = {"rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "translation": [0.1, 0, 0]}
    made += [
        Target("mask json", {"m.json": coco}, lambda at: read_mask(at / "m.json")),
        Target("mask png", {"m.png": grey}, lambda at: read_mask(at / "m.png")),
        Target("camera json", {"k.json": json.dumps(camera).encode()}, lambda at: read_camera(at / "k.json").K),
        Target("camera yaml", {"k.yaml": yaml}, lambda at: read_camera(at / "k.yaml").K),
        Target("camera text", {"k.txt": b"600 0 320\n0 600 240\n0 0 1\n"}, lambda at: read_camera(at / "k.txt").K),
        Target("transform", {"t.json": json.dumps(place).encode()}, lambda at: read_transform(at / "t.json", "T_a_b")),
        Target("times", {"t.csv": b"name,seconds\na.png,0.5\nb.png,1.5\n"}, lambda at: read_times(at / "t.csv")),
        Target("truth", {"t.csv": b"frame,lid\na.png,0.5\n"}, lambda at: read_truth(at / "t.csv", ("lid",))),
    ]
    return made + _object_targets(folder)


def _object_targets(folder: Path) -> list[Target]:
    """Specs, URDFs, imports, rendered views, indexes and checkpoints."""
    laptop, models = get_category("laptop"), [generate(get_category("laptop"), index) for index in range(2)]
    spec = Path(get_category.__code__.co_filename).parent / "builtin" / "laptop.toml"
    toml = spec.read_bytes().replace(b'"laptop"', b'"mine"', 1)
    write_urdf(models[0], folder / "urdf/model.urdf")
    for model in models:
        write_urdf(model, folder / f"models/{model.name}/{model.name}.urdf")
    import_folder(folder / "models", laptop, folder / "ours")
    source = (folder / "models").resolve()
    render_to_folder(models, laptop, folder / "views", 2)
    net = PriorNet(laptop)
    save(net, folder / "prior", {})
    index = ShapeIndex(Space.of(net.prior, laptop, "beta"))
    index.add_betas(np.eye(laptop.basis_size)[:3], [Entry(name, "source", b"png") for name in "abc"])
    index.save(folder / "index.npz")

    def views(at: Path) -> np.ndarray:
        return np.concatenate([view.observation().points.ravel() for view in open_views(at)])

    def searched(at: Path) -> np.ndarray:
        return ShapeIndex.load(at / "index.npz").nearest(np.zeros((1, laptop.basis_size)), 2).distances

    config = json.loads((folder / "prior/config.json").read_text())
    urdf, prior = _below(folder / "urdf"), _below(folder / "prior")
    return [
        Target("spec toml", {"s.toml": toml}, lambda at: get_category(at / "s.toml")),
        Target("category", {"c.json": json.dumps(config["category"]).encode()}, _category),
        Target("urdf", urdf, lambda at: read_articulation(at / "model.urdf").links[0].mesh.vertices),
        Target("import", urdf, lambda at: import_model(at / "model.urdf", laptop).parts[0].vertices),
        Target("imported", _below(folder / "ours"), lambda at: import_folder(source, laptop, at), ("import.json",)),
        Target("views", _below(folder / "views"), views),
        Target("index", {"index.npz": (folder / "index.npz").read_bytes()}, searched),
        Target("checkpoint", prior, lambda at: load(PriorNet, at)),
    ]


def _category(at: Path) -> Any:
    """As a checkpoint's is read, whose reader says which file it is."""
    try:
        return category_from_dict(json.loads((at / "c.json").read_bytes()))
    except (ValueError, RecursionError) as error:
        raise InputError("c.json: " + str(error).replace("\n", " ")) from error
