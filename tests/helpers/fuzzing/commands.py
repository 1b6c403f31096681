"""Every command that reads files, with good files for it."""

import contextlib
import io
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh
from PIL import Image

from omad.applications.bulk.sources import open_sources
from omad.cli.main import parse, run
from omad.data.procedural import generate
from omad.model.checkpoint import WEIGHTS
from omad.objects.category_file import get_category
from omad.objects.urdf import write_urdf

from ..command_line import cloud, laptop_view
from ..own_models import write_microwaves
from .readers import below, encoded
from .trial import HERE, Command

LAPTOP = ("--category", "laptop")
CHECKPOINT = ("config.json", "model.safetensors", "confidence.json", "surfaces.npz")
SPEC = Path(__file__).parents[3] / "docs" / "categories" / "microwave.toml"
ROBOT = """<robot name="r">
<link name="a"><visual><geometry><mesh filename="m.KIND" scale="1 1 1"/></geometry></visual></link>
<link name="b"><visual>
<origin xyz="0 0.1 -0.1" rpy="1.5 0 0"/><geometry><box size="0.3 0.01 0.2"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0.01 -0.1"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1"/><mimic joint="j" multiplier="1"/></joint></robot>"""
SMALL = ("--steps", "2", "--batch", "2", "--seed", "1", "--threads", "1", "--device", "cpu", "--output", "out")


def commands(folder: Path) -> list[Command]:
    """All of them; good files are made in ``folder``."""
    return [*_of_frames(), *_of_checkpoints(), *_of_models(folder), *_of_made(folder)]


def _frame() -> dict[str, bytes]:
    """A depth image of a laptop, small enough to be quick, and all that may be told of it."""
    view = laptop_view()
    depth, K = view.depth[::2, ::2], [300.0, 300.0, 159.75, 119.75]
    stored = np.rint(1000 * depth).astype(np.uint16)
    camera = {
        "width": 320,
        "height": 240,
        "fx": K[0],
        "fy": K[1],
        "ppx": K[2],
        "ppy": K[3],
        "model": 4,
        "coeffs": [0.01] * 5,
    }
    place = {"T_world_camera": [[1, 0, 0, 0.1], [0, 0, 1, 0.2], [0, -1, 0, 0.3], [0, 0, 0, 1]]}
    colour = {"rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "translation": [0.02, 0, 0]}
    return {
        "d.png": encoded(lambda file: Image.fromarray(stored).save(file, "PNG")),
        "d.npy": encoded(lambda file: np.save(file, depth.astype(np.float32))),
        "m.png": encoded(lambda file: Image.fromarray(np.uint8(255 * (stored > 0))).save(file, "PNG")),
        "m.npy": encoded(lambda file: np.save(file, stored > 0)),
        "k.json": json.dumps(camera).encode(),
        "w.json": json.dumps(place).encode(),
        "c.json": json.dumps(colour).encode(),
        "c.ply": trimesh.PointCloud(cloud()[::20]).export(file_type="ply"),
        "s.npz": encoded(lambda file: np.savez(file, depth=np.stack([stored] * 2), mask=np.stack([stored > 0] * 2))),
    }


def _of_frames() -> list[Command]:
    good = _frame()
    k, inline = ("--intrinsics", "k.json"), ("--intrinsics", "300,300,159.75,119.75")
    told = ("--world", "w.json", "--gravity", "world", "--output", "out", "--json")

    def some(*names: str) -> dict[str, bytes]:
        return {name: good[name] for name in names}

    two = {"v/a.png": good["d.png"], "v/b.png": good["d.png"], "k.json": good["k.json"]}
    film = {"f/frame_01.png": good["d.png"], "f/frame_02.png": good["d.png"], "k.json": good["k.json"]}
    film |= {"t.csv": b"frame_01.png,0.5\nframe_02.png,0.6\n"}
    film |= {"f/truth.csv": b"frame,screen_joint\nframe_01.png,0.1\nframe_02.png,0.2\n"}
    joint = get_category("laptop").joints[0].name
    film["f/truth.csv"] = film["f/truth.csv"].replace(b"screen_joint", joint.encode())
    resumed = ("bulk", "s.npz", *LAPTOP, *inline, "--output", "r.jsonl", "--json")
    rest = (
        "--box",
        "10,10,300,230",
        "--depth-scale",
        "0.001",
        "--distortion",
        "0.1,0,0,0,0",
        "--output",
        "out",
        "--json",
    )
    colour = ("--color-intrinsics", "k.json", "--color-extrinsics", "c.json")
    return [
        Command(
            "estimate",
            ("estimate", "d.png", *LAPTOP, *k, "--mask", "m.png", *told),
            some("d.png", "m.png", "k.json", "w.json"),
        ),
        Command(
            "estimate array",
            ("estimate", "d.npy", *LAPTOP, *inline, "--mask", "m.npy", *told),
            some("d.npy", "m.npy", "w.json"),
        ),
        Command("estimate options", ("estimate", "d.png", *LAPTOP, *inline, *rest), some("d.png")),
        Command(
            "estimate colour",
            ("estimate", "d.png", *LAPTOP, *k, "--mask", "m.png", *colour, "--output", "out", "--json"),
            some("d.png", "m.png", "k.json", "c.json"),
        ),
        Command(
            "estimate cloud",
            ("estimate", "c.ply", *LAPTOP, "--formats", "ply", "--gravity", "0,1,0", "--output", "out", "--json"),
            some("c.ply"),
        ),
        Command(
            "estimate together",
            ("estimate", "v", *LAPTOP, *k, "--together", "w.json", "w2.json", "--output", "out", "--json"),
            two | some("w.json") | {"w2.json": good["w.json"]},
        ),
        Command(
            "detect",
            ("detect", "d.png", "--categories", "laptop", *k, "--box", "10,10,300,230", "--output", "out", "--json"),
            some("d.png", "k.json"),
        ),
        Command(
            "bulk",
            ("bulk", "v", *LAPTOP, *k, "--batch", "2", "--workers", "1", "--output", "out/r.jsonl", "--json"),
            two,
        ),
        Command("bulk stack", ("bulk", "s.npz", *LAPTOP, *inline, "--output", "out/r.jsonl", "--json"), some("s.npz")),
        Command(
            "bulk array",
            ("bulk", "d.npy", *LAPTOP, *inline, "--mask", "m.npy", "--output", "r.parquet", "--json"),
            some("d.npy", "m.npy"),
        ),
        Command(
            "bulk table",
            ("bulk", "t.parquet", *LAPTOP, "--output", "out/r.jsonl", "--json"),
            {"t.parquet": _table(good)},
        ),
        Command("bulk resumed", resumed, some("s.npz") | _begun(resumed, good["s.npz"])),
        Command(
            "track", ("track", "f", *LAPTOP, *k, "--times", "t.csv", "--fps", "30", "--output", "out", "--json"), film
        ),
        Command(
            "track stream",
            ("track", "-", *LAPTOP, *k, "--fps", "10", "--output", "out", "--json"),
            two,
            stdin="v/a.png\nv/b.png\n",
        ),
        Command(
            "index from clouds",
            ("index", "build", *LAPTOP, "--source", "v", *k, "--output", "out/i.npz", "--json"),
            two,
        ),
    ]


def _begun(arguments: tuple[str, ...], stack: bytes) -> dict[str, bytes]:
    """What a run leaves that was killed after its first image."""
    with TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("s.npz").write_bytes(stack)
        command = parse([*arguments])
        record = command._made_of(open_sources(command.inputs, command.reading, command.frame))
    return {"r.jsonl.run": json.dumps(record).encode(), "r.jsonl.part": b'{"name": "s.npz[0]", "refused": null}\n' * 2}


def _table(good: dict[str, bytes]) -> bytes:
    import pyarrow
    import pyarrow.parquet

    rows = {"id": ["a", "b"], "depth": [good["d.png"]] * 2, "mask": [good["m.png"]] * 2}
    table, file = pyarrow.table(rows | {"intrinsics": [[300.0, 300.0, 159.75, 119.75]] * 2}), io.BytesIO()
    pyarrow.parquet.write_table(table, file)
    return file.getvalue()


def _of_checkpoints() -> list[Command]:
    """Commands that are given weights of one's own."""
    good, own = _frame(), {f"w/{name}": (WEIGHTS / "laptop" / name).read_bytes() for name in CHECKPOINT}
    prior = {f"p/{path.name}": path.read_bytes() for path in (WEIGHTS / "laptop" / "prior").iterdir()}
    frame = {name: good[name] for name in ("d.png", "m.png", "k.json")}
    asked = ("estimate", "d.png", *LAPTOP, "--intrinsics", "k.json", "--mask", "m.png", "--output", "out", "--json")
    views = ("--objects", "1", "--views", "1", "--seed", "0", "--json")
    few = ("--objects", "2", *SMALL, "--json")
    return [
        Command("estimate weights", (*asked, "--weights", "w", "--formats", "glb"), frame | own, tuple(own)),
        Command("eval pose weights", ("eval", "pose", *LAPTOP, "--weights", "w", *views), own),
        Command(
            "eval keypoints weights",
            ("eval", "keypoints", *LAPTOP, "--weights", "p", "--objects", "2", "--seed", "0", "--json"),
            prior,
        ),
        Command(
            "export",
            ("export", *LAPTOP, "--weights", "w", "--output", "out", "--json"),
            own | {f"w/prior/{name[2:]}": content for name, content in prior.items()},
        ),
        Command("train net from", ("train", "net", *LAPTOP, "--prior", "p", "--learning-rate", "0.001", *few), prior),
        Command(
            "train net initial",
            ("train", "net", *LAPTOP, "--initial", "w", *few),
            own,
            ("w/config.json", "w/model.safetensors"),
        ),
        Command(
            "train prior initial", ("train", "prior", *LAPTOP, "--initial", "p", "--save-seconds", "9", *few), prior
        ),
        Command(
            "train surface",
            (
                "train",
                "surface",
                *LAPTOP,
                "--views",
                "4",
                "--weights",
                "w",
                "--prior",
                "p",
                "--objects",
                "2",
                "--threads",
                "1",
                "--device",
                "cpu",
            ),
            own | prior,
        ),
    ]


def _of_models(folder: Path) -> list[Command]:
    """Commands that are given URDFs, specs and rendered views."""
    write_microwaves(folder / "boxes", 2)
    boxes = {f"models/{name}": content for name, content in below(folder / "boxes").items()} | {
        "s.toml": SPEC.read_bytes()
    }
    write_urdf(generate(get_category("laptop"), 0), folder / "laptops/one/one.urdf")
    laptops = {f"models/{name}": content for name, content in below(folder / "laptops").items()}
    box = trimesh.creation.box((0.3, 0.02, 0.2))
    meshes = {kind: box.export(file_type=kind) for kind in ("stl", "glb", "ply", "obj", "off")}
    render = ("--objects", "1", "--views", "2", "--seed", "1", "--output", "out", "--json")
    own = ("--category", "s.toml")
    made = [
        Command("import", ("import", "models", *own, "--scale", "1", "--output", "out", "--json"), boxes),
        Command("render models", ("render", *LAPTOP, "--source", "models", *render), laptops),
        Command(
            "train prior on",
            ("train", "prior", *LAPTOP, "--source", "models", "--variants", "4", *SMALL, "--json"),
            laptops,
        ),
        Command(
            "eval keypoints on",
            ("eval", "keypoints", *LAPTOP, "--source", "models", "--objects", "1", "--json"),
            laptops,
        ),
        Command(
            "index from models",
            ("index", "build", *LAPTOP, "--source", "models", "--output", "i.npz", "--json"),
            laptops,
        ),
        Command("generate", ("generate", *LAPTOP, "--objects", "1", "--seed", "3", "--output", "out", "--json"), {}),
        Command("info", ("info", "--json"), {}),
    ]
    for kind, content in meshes.items():
        content = content.encode() if isinstance(content, str) else content
        files = {"models/r/r.urdf": ROBOT.replace("KIND", kind).encode(), f"models/r/m.{kind}": content}
        made.append(Command(f"import {kind}", ("import", "models", *LAPTOP, "--output", "out", "--json"), files))
    return made


def _of_made(folder: Path) -> list[Command]:
    """Commands that go on with what others wrote."""
    few = ("--objects", "2", *SMALL, "--json")
    train = ("train", "prior", *LAPTOP, *few)
    render = ("render", *LAPTOP, "--objects", "1", "--views", "2", "--seed", "1", "--depth-noise", "on", "--json")
    build = ("index", "build", *LAPTOP, "--source", "procedural", "--objects", "2")
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        write_microwaves(Path("models"), 2)
        assert run([*train[:-3], "--output", "trained"]) == 0
        assert run([*render, "--output", "views"]) == 0
        assert run([*build, "--output", "i.npz"]) == 0
        assert run(["import", "models", "--category", str(SPEC), "--output", "imported"]) == 0
    state = {f"out/{name}": content for name, content in below(folder / "trained").items() if "tfevents" not in name}
    views = {f"views/{name}": content for name, content in below(folder / "views").items()}
    again = {f"out/{name}": content for name, content in below(folder / "views").items()}
    models = {f"models/{name}": content for name, content in below(folder / "models").items()} | {
        "s.toml": SPEC.read_bytes()
    }
    here = str(folder.resolve()).encode()
    imported = {f"out/{name}": content.replace(here, HERE) for name, content in below(folder / "imported").items()}
    good = _frame()
    catalogue = {"i.npz": (folder / "i.npz").read_bytes(), "d.png": good["d.png"], "k.json": good["k.json"]}
    query = (
        "index",
        "query",
        "d.png",
        "--index",
        "i.npz",
        "--intrinsics",
        "k.json",
        "--count",
        "2",
        "--output",
        "out",
        "--json",
    )
    return [
        Command("train resumed", train, state, ("out/state.pt", "out/metrics.jsonl")),
        Command("render resumed", (*render, "--output", "out"), again),
        Command(
            "import resumed",
            ("import", "models", "--category", "s.toml", "--output", "out", "--json"),
            models | imported,
            tuple(imported),
        ),
        Command("index query", query, catalogue),
        Command("index query by information", (*query, "--by-information"), catalogue, ("i.npz",)),
        Command("eval pose views", ("eval", "pose", *LAPTOP, "--source", "views", "--json"), views),
        Command(
            "eval robustness views",
            ("eval", "robustness", *LAPTOP, "--source", "views", "--rows", "clean", "--views", "2", "--json"),
            views,
        ),
        Command(
            "index from views", ("index", "build", *LAPTOP, "--source", "views", "--output", "j.npz", "--json"), views
        ),
        *_of_artimage(folder),
    ]


def _of_artimage(folder: Path) -> list[Command]:
    write = ("render", *LAPTOP, "--objects", "1", "--views", "2", "--layout", "artimage", "--seed", "1")
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        assert run([*write, "--split", "test", "--output", "art"]) == 0
    root = {f"art/{name}": content for name, content in below(folder / "art").items()}
    asked = ("eval", "pose", *LAPTOP, "--source", "art", "--views", "2", "--json")
    return [
        Command("eval pose artimage", asked, root),
        Command("eval pose artimage skip", (*asked, "--broken", "skip"), root),
    ]
