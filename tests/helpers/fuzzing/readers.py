"""Every reader, with good files of each kind that it takes."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from omad.applications.retrieval.index import Entry, ShapeIndex
from omad.applications.retrieval.signature import Space
from omad.applications.tracking.frames import read_times, read_truth
from omad.common.errors import InputError
from omad.common.incoming import read_json
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

from .trial import Target


def encoded(write: Callable[[io.BytesIO], Any]) -> bytes:
    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()


def below(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _observed(path: Path) -> np.ndarray:
    depth = read_depth(path)
    return Observation.from_depth(depth, Camera(depth.shape[1], depth.shape[0], 60, 60, 30, 20)).points


def readers(folder: Path) -> list[Target]:
    """All readers; good files are made in ``folder``."""
    rng = np.random.default_rng(0)
    depth = rng.uniform(900, 1100, (40, 60)).astype(np.uint16)
    cloud = rng.normal((0, 0, 1), 0.1, (200, 3))
    text = "\n".join(" ".join(f"{x:.4f}" for x in row) for row in cloud).encode()
    made = [
        Target(f"depth {kind}", {f"d.{kind}": encoded(write)}, lambda at, kind=kind: _observed(at / f"d.{kind}"))
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
        "c.npz": encoded(lambda file: np.savez(file, points=cloud)),
    }
    for name, content in clouds.items():
        read = lambda at, name=name: Observation.from_points(read_cloud(at / name)).points  # noqa: E731
        made.append(Target(f"cloud {name}", {name: content}, read))
    coco = json.dumps({"size": [4, 6], "counts": [3, 4, 17]}).encode()
    grey = encoded(lambda file: Image.fromarray(np.eye(8, dtype=np.uint8) * 255).save(file, "PNG"))
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
    urdf, prior = below(folder / "urdf"), below(folder / "prior")
    return [
        Target("spec toml", {"s.toml": toml}, lambda at: get_category(at / "s.toml")),
        Target("category", {"c.json": json.dumps(config["category"]).encode()}, _category),
        Target("urdf", urdf, lambda at: read_articulation(at / "model.urdf").links[0].mesh.vertices),
        Target("import", urdf, lambda at: import_model(at / "model.urdf", laptop).parts[0].vertices),
        Target("imported", below(folder / "ours"), lambda at: import_folder(source, laptop, at), ("import.json",)),
        Target("views", below(folder / "views"), views),
        Target("index", {"index.npz": (folder / "index.npz").read_bytes()}, searched),
        Target("checkpoint", prior, lambda at: load(PriorNet, at)),
    ]


def _category(at: Path) -> Any:
    """As a checkpoint's is read, whose reader says which file it is."""
    try:
        return category_from_dict(read_json(at / "c.json", "export it again"))
    except (ValueError, RecursionError) as error:
        raise InputError("c.json: " + str(error).replace("\n", " ")) from error
