"""The command line: promised JSON, exit codes, and one clear line for every kind of bad input."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from omad.categories import get_category
from omad.checkpoint import find_weights
from omad.cli import run
from omad.sources.procedural import generate
from omad.standard_views import View, standard_view
from omad.urdf import write_urdf

K = "600,600,319.5,239.5"


@pytest.fixture(scope="module")
def view() -> View:
    category = get_category("laptop")
    return standard_view(generate(category, 0, "test"), category, (0, 1000))


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def answer(capsys, *arguments: str, code: int = 0) -> dict:
    """Run with --json and return the one object on stdout."""
    assert run([*arguments, "--json"]) == code
    return json.loads(capsys.readouterr().out)


def save_png(path: str, depth: np.ndarray) -> str:
    Image.fromarray(np.rint(depth * 1000).astype(np.uint16)).save(path)
    return path


def points_of(view: View) -> np.ndarray:
    rows, columns = np.nonzero(view.depth)
    z = view.depth[rows, columns]
    return np.stack([(columns - 319.5) / 600 * z, (rows - 239.5) / 600 * z, z], 1)


def test_info(capsys):
    found = answer(capsys, "info")
    assert {"version", "categories", "weights", "device", "torch", "numpy"} <= set(found)
    assert Path(found["weights"]["laptop"]).is_dir()


def test_demo(capsys):
    found = answer(capsys, "demo", "--category", "laptop", "--objects", "1", "--output", "out")
    assert set(found) == {"results", "files"}
    assert {"category", "object", "estimate", "truth", "errors"} <= set(found["results"][0])
    assert all(Path(file).is_file() for file in found["files"])
    assert run(["demo", "--category", "laptop", "--objects", "1", "--output", "out"]) == 0
    assert "hinge" in capsys.readouterr().out


def test_every_format_of_the_same_view_gives_the_same_answer(view, capsys):
    import trimesh

    cloud = points_of(view)
    save_png("a.png", view.depth)
    np.save("b.npy", view.depth)
    trimesh.PointCloud(cloud).export("c.ply")
    np.savetxt("d.xyz", cloud)
    np.savez("e.npz", points=cloud)
    header = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    header += f"WIDTH {len(cloud)}\nHEIGHT 1\nPOINTS {len(cloud)}\nDATA ascii"
    np.savetxt("f.pcd", cloud, header=header, comments="")
    inputs = ["a.png", "b.npy", "c.ply", "d.xyz", "e.npz", "f.pcd"]
    found = answer(capsys, "estimate", *inputs, "--category", "laptop", "--intrinsics", K)["results"]
    states = np.degrees([result["joints"][0]["state"] for result in found])
    assert len(states) == 6
    assert np.ptp(states) < 2.0
    assert abs(states.mean() - np.degrees(view.states[0])) < 6
    for name in "abcdef":
        folder = Path("omad-estimate") / name
        assert {"estimate.json", "object.urdf", "state.json", "estimate.png"} <= {p.name for p in folder.iterdir()}


def test_a_folder_is_many_inputs_and_a_mask_cuts_the_object_out(view, capsys):
    Path("frames").mkdir()
    cluttered = np.where(view.depth > 0, view.depth, 3.0)
    for name in "ab":
        save_png(f"frames/{name}.png", cluttered)
    Image.fromarray(((view.depth > 0) * 255).astype(np.uint8)).save("mask.png")
    arguments = ["estimate", "frames", "--category", "laptop", "--intrinsics", K, "--mask", "mask.png"]
    found = answer(capsys, *arguments)["results"]
    assert len(found) == 2
    assert abs(np.degrees(found[0]["joints"][0]["state"] - view.states[0])) < 6
    rows, columns = np.nonzero(view.depth)
    box = f"{columns.min()},{rows.min()},{columns.max() + 1},{rows.max() + 1}"
    save_png("alone.png", view.depth)
    boxed = answer(capsys, "estimate", "alone.png", "--category", "laptop", "--intrinsics", K, "--box", box)
    assert abs(np.degrees(boxed["joints"][0]["state"] - view.states[0])) < 6


def test_pose_evaluation_has_the_promised_keys(capsys):
    found = answer(capsys, "eval", "pose", "--category", "laptop", "--objects", "2", "--views", "4", "--depth-noise")
    assert {"category", "source", "objects", "views", "failures", "metres_per_unit", "seconds"} <= set(found)
    keys = "joint_state_error_deg joint_state_error axis_error_deg axis_distance pivot_distance rotation_error_deg"
    assert set(keys.split()) | {"translation_error", "within_5deg_5percent"} == set(found["refined"])
    assert set(found["refined"]["joint_state_error_deg"][0]) == {"mean", "median", "p90"}
    assert found["refined"]["joint_state_error"] == [None]
    assert len(found["by_object"]) == 2
    assert set(found["seconds"]) == {"network", "refinement"}


def test_render_then_evaluate_and_models_from_a_folder(capsys):
    answer(capsys, "render", "--category", "laptop", "--output", "views", "--objects", "2", "--views", "4")
    found = answer(capsys, "eval", "pose", "--category", "laptop", "--source", "views")
    assert found["views"] == 4
    answer(capsys, "generate", "--category", "laptop", "--output", "models", "--objects", "2")
    found = answer(capsys, "eval", "pose", "--category", "laptop", "--source", "models", "--views", "2")
    assert found["objects"] == 2
    assert found["refused"] == []


def test_training_export_and_use_of_the_result(capsys):
    small = ["--objects", "3", "--batch", "4", "--threads", "1"]
    answer(capsys, "train", "prior", "--category", "laptop", "--output", "prior", "--steps", "3", *small)
    train = ["train", "net", "--category", "laptop", "--prior", "prior", "--output", "net", "--steps", "2", *small]
    answer(capsys, *train)
    answer(capsys, *train)  # finished already: goes on where it stopped, which is the end
    answer(capsys, "export", "--category", "laptop", "--weights", "net", "--output", "exported")
    assert np.load("exported/prior.npz")["basis"].shape[1] == 3
    found = answer(
        capsys, "eval", "pose", "--category", "laptop", "--weights", "exported", "--objects", "1", "--views", "1"
    )
    assert found["views"] == 1
    assert run([*train[:-1], "9", "--threads", "1", "--seed", "3"]) == 2
    assert "other settings" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    ["demo", "estimate", "generate", "render", "train prior", "train net", "eval pose", "export", "info"],
)
def test_help_explains(command, capsys):
    with pytest.raises(SystemExit) as stop:
        run([*command.split(), "--help"])
    assert stop.value.code == 0
    assert len(capsys.readouterr().out) > 150


@pytest.mark.parametrize("arguments", [[], ["nonsense"], ["estimate"], ["demo", "--objects", "many"]])
def test_wrong_usage_exits_with_two(arguments):
    with pytest.raises(SystemExit) as stop:
        run(arguments)
    assert stop.value.code == 2


def refused(capsys, *arguments: str) -> str:
    """The one line that a bad input gives."""
    assert run(list(arguments)) == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert captured.out == ""
    assert not any(path.is_file() for path in Path("omad-estimate").rglob("*"))
    return lines[0]


def bad_depth(view: View, kind: str) -> tuple[str, list[str]]:
    """A file that cannot be right, and further options."""
    extra = ["--intrinsics", K]
    if kind == "missing":
        return "nowhere.png", extra
    if kind == "no intrinsics":
        return save_png("d.png", view.depth), []
    if kind == "bad intrinsics":
        return save_png("d.png", view.depth), ["--intrinsics", "600,600"]
    if kind == "mask size":
        Image.fromarray(np.full((10, 10), 255, dtype=np.uint8)).save("mask.png")
        return save_png("d.png", view.depth), [*extra, "--mask", "mask.png"]
    if kind == "box":
        return save_png("d.png", view.depth), [*extra, "--box", "1,2,3"]
    if kind == "box outside":
        return save_png("d.png", view.depth), [*extra, "--box", "900,900,950,950"]
    if kind == "all zero":
        return save_png("d.png", 0 * view.depth), extra
    if kind == "eight bit":
        Image.fromarray((view.depth > 0).astype(np.uint8)).save("d.png")
        return "d.png", extra
    if kind == "truncated":
        save_png("d.png", view.depth)
        Path("d.png").write_bytes(Path("d.png").read_bytes()[:200])
        return "d.png", extra
    if kind == "unknown extension":
        Path("d.bmp").write_bytes(b"BM")
        return "d.bmp", extra
    few = np.zeros_like(view.depth)
    few[200, 300:340] = 1.0
    arrays = {
        "all nan": np.full_like(view.depth, np.nan),
        "wrong shape": np.ones((4, 5, 6)),
        "few points": few,
        "millimetres": view.depth * 1000,
    }
    np.save("d.npy", arrays[kind])
    return "d.npy", extra


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("missing", "nowhere.png"),
        ("no intrinsics", "--intrinsics"),
        ("bad intrinsics", "fx,fy,cx,cy"),
        ("mask size", "mask"),
        ("box", "--box"),
        ("box outside", "box"),
        ("all zero", "d.png"),
        ("eight bit", "bit"),
        ("truncated", "d.png"),
        ("unknown extension", ".png"),
        ("all nan", "d.npy"),
        ("wrong shape", "shape"),
        ("few points", "50"),
        ("millimetres", "millimet"),
    ],
)
def test_bad_depth_is_refused_in_one_line(kind, words, view, capsys):
    file, extra = bad_depth(view, kind)
    line = refused(capsys, "estimate", file, "--category", "laptop", *extra)
    assert words in line


def test_unknown_category_and_device(view, capsys):
    file = save_png("d.png", view.depth)
    assert "laptop" in refused(capsys, "estimate", file, "--category", "submarine", "--intrinsics", K)
    line = refused(capsys, "estimate", file, "--category", "laptop", "--intrinsics", K, "--device", "abacus")
    assert "abacus" in line
    assert "submarine" in refused(capsys, "generate", "--category", "submarine", "--output", "x")


@pytest.mark.parametrize("kind", ["none", "foreign", "cut", "other net", "prior", "other category"])
def test_bad_checkpoints_are_refused_in_one_line(kind, view, capsys):
    shutil.copytree(find_weights("laptop"), "w")
    category = "laptop"
    if kind == "none":
        shutil.rmtree("w")
    elif kind == "foreign":
        Path("w/config.json").write_text('{"model_type": "bert"}')
    elif kind == "cut":
        Path("w/model.safetensors").write_bytes(Path("w/model.safetensors").read_bytes()[:1000])
    elif kind == "other net":
        shutil.copy("w/prior/model.safetensors", "w/model.safetensors")
    elif kind == "prior":
        shutil.copytree("w/prior", "p")
        shutil.rmtree("w")
        Path("p").rename("w")
    else:
        category = "dishwasher"
    file = save_png("d.png", view.depth)
    refused(capsys, "estimate", file, "--category", category, "--intrinsics", K, "--weights", "w")


@pytest.mark.parametrize("kind", ["missing mesh", "cycle", "nothing"])
def test_bad_models_are_refused(kind, capsys):
    path = Path("models/one/one.urdf")
    write_urdf(generate(get_category("laptop"), 1, "test"), path)
    if kind == "missing mesh":
        next(Path("models/one/meshes").iterdir()).unlink()
    elif kind == "cycle":
        text = path.read_text()
        start, end = text.index("<joint"), text.index("</joint>") + len("</joint>")
        joint = text[start:end]
        parent, child = (joint.split(f'<{w} link="')[1].split('"')[0] for w in ("parent", "child"))
        back = joint.replace(f'<parent link="{parent}"', '<parent link="?"').replace(
            f'<child link="{child}"', f'<child link="{parent}"'
        )
        back = back.replace('link="?"', f'link="{child}"').replace('name="', 'name="back_', 1)
        path.write_text(text.replace("</robot>", back + "</robot>"))
    else:
        shutil.rmtree("models/one")
    assert run(["eval", "pose", "--category", "laptop", "--source", "models", "--views", "2"]) == 2
    error = capsys.readouterr().err
    assert "Traceback" not in error
    assert "models" in error or "one" in error


@pytest.mark.parametrize("option", ["--views", "--objects"])
def test_nothing_to_do_is_refused(option, capsys):
    assert option[2:] in refused(capsys, "eval", "pose", "--category", "laptop", option, "0")


def test_output_that_is_a_file(view, capsys):
    Path("out").write_text("mine")
    file = save_png("d.png", view.depth)
    line = refused(capsys, "estimate", file, "--category", "laptop", "--intrinsics", K, "--output", "out")
    assert "out" in line
    assert Path("out").read_text() == "mine"


def test_as_a_program(view):
    file = save_png("d.png", view.depth)
    command = [sys.executable, "-m", "omad", "estimate", file, "--category", "laptop", "--json"]
    good = subprocess.run([*command, "--intrinsics", K], capture_output=True, text=True, check=False)
    assert good.returncode == 0, good.stderr
    assert json.loads(good.stdout)["converged"]
    bad = subprocess.run(command, capture_output=True, text=True, check=False)
    assert bad.returncode == 2
    assert bad.stdout == ""
    assert "Traceback" not in bad.stderr
