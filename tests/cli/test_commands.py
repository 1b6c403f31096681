"""The command line keeps its promises: JSON, exit codes, every format, resumption, its own outputs as inputs."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from safetensors.numpy import load_file

from helpers.command_line import LAPTOP, K, answer, cloud, laptop_view, save_png
from omad.cli.main import run
from omad.data.rendering import view_folder
from omad.data.rendering.tabletop import draw_tabletop
from omad.training import loop as training

SMALL = ["--objects", "4", "--batch", "4", "--threads", "1", "--device", "cpu"]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def truth_deg() -> float:
    return np.degrees(laptop_view().states[0])


def state_deg(estimate: dict) -> float:
    return np.degrees(estimate["joints"][0]["state"])


@pytest.mark.slow
def test_estimate_keeps_its_promise(capsys):
    found = answer(capsys, "estimate", save_png("a.png"), *LAPTOP, *K)
    promised = "category converged residual beta T_camera_base joints parts keypoints initial seconds warnings checks"
    promised += " input output probability doubtful mirrored hand_probability base_std"
    assert set(promised.split()) == set(found)
    joint = found["joints"][0]
    promised = "name type state state_std interval_50 interval_90 limits fraction axis pivot"
    assert set(joint) == set(promised.split())
    low, high = joint["limits"]
    assert (low, high) == pytest.approx((np.radians(-80), np.radians(85)))
    assert joint["fraction"] == pytest.approx((joint["state"] - low) / (high - low))
    assert np.linalg.norm(joint["axis"]) == pytest.approx(1)
    assert abs(state_deg(found) - truth_deg()) < 6
    assert found["converged"] is True
    assert 0 < found["residual"] < 0.05
    pose = np.array(found["T_camera_base"])
    assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-6)
    assert np.linalg.norm(pose[:3, 3] - laptop_view().T_camera_base[:3, 3]) < 0.05  # metres
    assert [set(part) for part in found["parts"]] == [{"name", "T_camera_part", "points"}] * 2
    assert found["parts"][0]["T_camera_part"] == found["T_camera_base"]
    assert sum(part["points"] for part in found["parts"]) == np.count_nonzero(laptop_view().depth)
    assert np.shape(found["keypoints"])[1] == 3
    assert {"joints", "T_camera_base"} <= set(found["initial"])
    assert set(found["initial"]["joints"][0]) == set(joint)
    assert found["initial"]["joints"][0]["state_std"] is None  # absent values are null
    assert set(found["seconds"]) == {"read", "network", "refinement"}
    assert found["warnings"] == []
    written = json.loads((Path(found["output"]) / "estimate.json").read_text())
    assert written == {key: value for key, value in found.items() if key not in ("input", "output")}
    state = json.loads((Path(found["output"]) / "state.json").read_text())
    assert state["joint_states"] == {"hinge": joint["state"]}


@pytest.mark.slow
def test_every_format_of_the_same_view_gives_the_same_answer(capsys):
    depth, points = laptop_view().depth, cloud()
    save_png("png16.png")
    Image.fromarray(np.rint(depth * 1e4).astype(np.uint16)).save("tenths.png")
    Image.fromarray(np.rint(depth * 1000).astype(np.uint16)).save("tiff.tiff")
    np.save("metres.npy", depth)
    np.save("integers.npy", np.rint(depth * 1000).astype(np.int32))
    np.savez("depth.npz", depth=depth)
    np.savez("points.npz", points=points)
    np.save("cloud.npy", points)
    trimesh.PointCloud(points).export("ply.ply")
    np.savetxt("text.xyz", points)
    np.savetxt("millimetres.xyz", 1000 * points)
    header = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    header += f"WIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA ascii"
    np.savetxt("pcd.pcd", points, header=header, comments="")
    scales = {"tenths.png": "1e-4", "millimetres.xyz": "1e-3"}
    plain = [path.name for path in Path().iterdir() if path.name not in scales]
    assert len(plain) == 10
    found = answer(capsys, "estimate", *plain, *LAPTOP, *K)["results"]
    found += [answer(capsys, "estimate", file, *LAPTOP, *K, "--depth-scale", s) for file, s in scales.items()]
    states = np.array([state_deg(result) for result in found])
    assert np.ptp(states) < 0.5
    assert abs(states.mean() - truth_deg()) < 6
    places = np.array([result["joints"][0]["pivot"] for result in found])
    assert np.ptp(places, axis=0).max() < 0.002
    for result in found:
        kept = {path.name for path in Path(result["output"]).iterdir()}
        assert {"estimate.json", "object.urdf", "state.json", "estimate.png"} <= kept


@pytest.mark.slow
def test_a_folder_is_many_inputs(capsys):
    save_png("frames/a.png")
    one = answer(capsys, "estimate", "frames", *LAPTOP, *K)
    assert [result["input"] for result in one["results"]] == ["frames/a.png"]
    np.savetxt("frames/b.xyz", cloud())
    Path("frames/notes.txt").write_text("not an input")
    Path("frames/.hidden.png").write_text("not an input")
    found = answer(capsys, "estimate", "frames", *LAPTOP, *K)
    assert [result["input"] for result in found["results"]] == ["frames/a.png", "frames/b.xyz"]
    assert found["refused"] == []
    assert run(["estimate", "frames", *LAPTOP, *K]) == 0
    table = capsys.readouterr().out
    assert "frames/a.png" in table
    assert f"{state_deg(found['results'][0]):.1f}°" in table


@pytest.mark.slow
def test_inputs_of_the_same_name_do_not_overwrite_each_other(capsys):
    for file in ("one/d.png", "two/d.png"):
        save_png(file)
    for inputs in (["one/d.png", "two/d.png"], ["one", "two"]):
        found = answer(capsys, "estimate", *inputs, *LAPTOP, *K)["results"]
        assert len({result["output"] for result in found}) == 2
    assert len(answer(capsys, "estimate", "one/d.png", "./one/d.png", *LAPTOP, *K)["results"]) == 1  # the same file


@pytest.mark.slow
def test_mask_and_box_cut_the_object_out(capsys):
    depth = laptop_view().depth
    for name in ("a", "b"):
        save_png(f"frames/{name}.png", np.where(depth > 0, depth, 3.0))
        Path("masks").mkdir(exist_ok=True)
        Image.fromarray(((depth > 0) * 255).astype(np.uint8)).save(f"masks/{name}.png")
    for mask in ("masks", "masks/a.png"):
        found = answer(capsys, "estimate", "frames", *LAPTOP, *K, "--mask", mask)["results"]
        assert [abs(state_deg(result) - truth_deg()) < 6 for result in found] == [True, True]
    rows, columns = np.nonzero(depth)
    clutter = depth.copy()
    clutter[: rows.min() - 5, : columns.min() - 5] = 1.0
    box = f"{columns.min()},{rows.min()},{columns.max() + 1},{rows.max() + 1}"
    found = answer(capsys, "estimate", save_png("c.png", clutter), *LAPTOP, *K, "--box", box)
    assert abs(state_deg(found) - truth_deg()) < 6


@pytest.mark.slow
def test_plane_segmentation_finds_the_object_on_its_table(capsys):
    depth, pose = laptop_view().depth, laptop_view().T_camera_base
    rows, columns = np.mgrid[:480, :640]
    rays = np.stack([(columns - 319.5) / 600, (rows - 239.5) / 600, np.ones_like(rows)], -1)
    up, below = pose[:3, 1], cloud()[np.argmin(cloud() @ pose[:3, 1])]
    with np.errstate(divide="ignore"):
        table = (below @ up) / (rays @ up)
    scene = np.where(depth > 0, depth, np.where((table > 0) & (table < 3), table, 0))
    found = answer(capsys, "estimate", save_png("d.png", scene), *LAPTOP, *K, "--segment", "plane")
    assert abs(state_deg(found) - truth_deg()) < 8


@pytest.mark.slow
def test_demo(capsys):
    found = answer(capsys, "demo", *LAPTOP, "--objects", "1", "--output", "out")
    assert set(found) == {"results", "files"}
    assert {"category", "object", "estimate", "truth", "errors"} == set(found["results"][0])
    assert {"joints", "T_camera_base", "keypoints"} <= set(found["results"][0]["estimate"])
    assert [Path(file).is_file() for file in found["files"]] == [True] * 4
    assert run(["demo", *LAPTOP, "--objects", "1", "--output", "out"]) == 0
    assert "hinge" in capsys.readouterr().out


def test_info(capsys):
    found = answer(capsys, "info")
    assert {"version", "categories", "weights", "device", "torch", "numpy"} <= set(found)
    assert all(Path(folder).is_dir() for folder in found["weights"].values())
    assert set(found["weights"]) <= set(found["categories"])


SHARES = ("within_5deg_5percent", "flipped", "swapped")


def errors_have_the_promised_keys(errors: dict, revolute: list[bool], parts: int) -> None:
    spread = {"mean", "median", "p90"}
    always = ("joint_state_error_deg", "joint_state_error", "axis_error_deg", "axis_distance", "pivot_distance")
    assert set(errors) == {*always, "rotation_error_deg", "translation_error", *SHARES}
    assert all(0 <= errors[share] <= 1 for share in SHARES)
    for name in always:
        assert len(errors[name]) == len(revolute)
        for turns, error in zip(revolute, errors[name], strict=True):
            absent = name == "joint_state_error" if turns else name not in ("joint_state_error", "axis_error_deg")
            assert error is None if absent else set(error) == spread, name
    for name in ("rotation_error_deg", "translation_error"):
        assert [set(error) for error in errors[name]] == [spread] * parts


@pytest.mark.slow
@pytest.mark.parametrize(("category", "revolute"), [("laptop", [True]), ("drawer", [False] * 3)])
def test_pose_evaluation_keeps_its_promise(category, revolute, capsys):
    arguments = ["eval", "pose", "--category", category, "--objects", "2", "--views", "4"]
    found = answer(capsys, *arguments, "--depth-noise", "on", "--seed", "3", "--pictures", "worst")
    promised = "category source objects views failures metres_per_unit initial refined by_object seconds"
    assert set(promised.split()) <= set(found)
    assert (found["category"], found["source"], found["objects"], found["views"]) == (category, "procedural", 2, 4)
    assert found["depth_noise"] is True
    for errors in (found["initial"], found["refined"], *(entry["refined"] for entry in found["by_object"])):
        errors_have_the_promised_keys(errors, revolute, len(revolute) + 1)
    assert [set(entry) for entry in found["by_object"]] == [{"object", "refined"}] * 2
    for name in ("joint_state_error_deg", "joint_state_error", "axis_error_deg"):
        for error, interval in zip(found["refined"][name], found["interval"][name], strict=True):
            assert interval is None if error is None else interval[0] <= error["mean"] <= interval[1], name
    assert set(found["seconds"]) == {"network", "refinement"}
    assert [Path(file).is_file() for file in found["pictures"]] == [True] * 4
    assert run(arguments) == 0
    printed = capsys.readouterr().out
    assert "refined" in printed
    assert "95 % interval of means, over objects: joint state" in printed


@pytest.mark.slow
def test_robustness_keeps_its_promise_on_models_and_on_rendered_scenes(capsys):
    few = ["eval", "robustness", *LAPTOP, "--views", "2", "--rows", "hidden-25", "around"]
    found = answer(capsys, *few, "--objects", "2", "--pictures", "worst")
    assert [row["row"] for row in found["rows"]] == ["clean", "hidden-25", "around"]
    assert (found["category"], found["source"], found["views"], found["left_out"]) == ("laptop", "procedural", 2, [])
    promised = {"row", "what", "views", "missing", "joint_state_error_deg", "joint_state_error", "ratio"}
    promised |= {"trusted", "seen"}
    assert set(found["rows"][1]) == promised | {"covered_50", "covered_90", "flagged", "wrong", "silently_wrong"}
    assert found["others"]["views"] == 2
    assert set(found["probability"] or {}) <= {"answers", "right", "calibration_error", "area_under_roc"}
    assert found["rows"][0]["ratio"] == 1.0
    assert {Path(path).name for path in found["pictures"]} == {"clean.png", "hidden-25.png", "around.png"}
    assert found["rows"] == answer(capsys, *few, "--objects", "2")["rows"]
    answer(capsys, "render", *LAPTOP, "--objects", "1", "--views", "3", "--output", "scenes", "--clutter")
    assert answer(capsys, "eval", "pose", *LAPTOP, "--source", "scenes")["views"] == 3
    scenes = answer(capsys, *few, "--source", "scenes")
    assert [row["row"] for row in scenes["rows"]] == ["clean", "hidden-25"]
    assert scenes["left_out"] == ["around"]
    assert scenes["rows"][0]["what"] == "the frames as they are"
    assert run([*few, "--source", "scenes"]) == 0
    assert "a quarter hidden" in capsys.readouterr().out


def test_frames_of_ones_own_need_no_more_than_the_page_on_robustness_says(capsys):
    answer(capsys, "render", *LAPTOP, "--objects", "1", "--views", "2", "--output", "views")
    evaluate = ["eval", "pose", *LAPTOP, "--source", "views"]
    before = answer(capsys, *evaluate)["refined"]
    said = {"dataset.json": ("format", "category", "camera", "depth_scale", "objects", "views")}
    said |= {"object.json": ("axes", "pivots", "limits", "part_boxes")}
    for file in Path("views").rglob("*.json"):
        record = json.loads(file.read_text())
        file.write_text(json.dumps({key: record[key] for key in said.get(file.name, ("states", "T_camera_base"))}))
    assert answer(capsys, *evaluate)["refined"] == before


def test_models_of_a_folder_are_evaluated_and_unfit_ones_named(capsys):
    answer(capsys, "generate", *LAPTOP, "--output", "models", "--objects", "2")
    Path("models/broken").mkdir()
    Path("models/broken/model.urdf").write_text("<robot")
    found = answer(capsys, "eval", "pose", *LAPTOP, "--source", "models", "--views", "2")
    assert found["objects"] == 2
    assert [refusal["name"] for refusal in found["refused"]] == ["broken"]
    assert "model.urdf" in found["refused"][0]["reason"]


def files_in(folder: str) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in Path(folder).rglob("*") if p.is_file()}


def interrupt_after(monkeypatch, module, name: str, calls: int) -> None:
    """The next ``calls`` calls of a function work, the one after them is interrupted from the keyboard."""
    original, done = getattr(module, name), []

    def interrupted(*arguments, **options):
        done.append(1)
        if len(done) > calls:
            raise KeyboardInterrupt
        return original(*arguments, **options)

    monkeypatch.setattr(module, name, interrupted)


@pytest.mark.slow
def test_an_interrupted_rendering_goes_on_and_can_be_evaluated(capsys, monkeypatch):
    render = ["render", *LAPTOP, "--objects", "2", "--views", "5", "--depth-noise", "on", "--output"]
    with monkeypatch.context() as patch:
        interrupt_after(patch, view_folder, "standard_view", 3)
        assert run([*render, "views"]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert run(["eval", "pose", *LAPTOP, "--source", "views"]) == 2
    assert "same render command" in capsys.readouterr().err
    old = {path: path.stat().st_mtime_ns for path in Path("views").rglob("*.png")}
    found = answer(capsys, *render, "views")
    assert (found["views"], len(old)) == (5, 6)
    assert all(path.stat().st_mtime_ns == time for path, time in old.items())  # kept, not drawn again
    answer(capsys, *render, "at-once")
    assert files_in("views") == files_in("at-once")

    evaluated = answer(capsys, "eval", "pose", *LAPTOP, "--source", "views")
    assert (evaluated["views"], evaluated["objects"], evaluated["depth_noise"]) == (5, 2, True)
    assert run([*render, "views", "--seed", "1"]) == 2
    assert "other seed" in capsys.readouterr().err
    answer(capsys, *render, "views", "--views", "6")  # more of the same is no other setting


@pytest.mark.slow
def test_an_interrupted_training_goes_on_where_it_was(capsys, monkeypatch):
    clock = iter(range(0, 10**6, 100))
    monkeypatch.setattr(training.time, "monotonic", lambda: float(next(clock)))  # the state is saved at every step
    train = ["train", "prior", *LAPTOP, "--steps", "3", *SMALL, "--output"]
    with monkeypatch.context() as patch:
        interrupt_after(patch, training, "_average", 2)
        assert run([*train, "prior"]) == 130
    assert not Path("prior/config.json").exists()
    assert answer(capsys, *train, "prior") == {"checkpoint": "prior"}
    answer(capsys, *train, "at-once")
    assert Path("prior/config.json").read_bytes() == Path("at-once/config.json").read_bytes()
    resumed, whole = (load_file(f"{folder}/model.safetensors") for folder in ("prior", "at-once"))
    for name in resumed:  # so few objects leave beta ill-determined, and what follows from it
        if not name.startswith("prior."):
            assert resumed[name] == pytest.approx(whole[name], abs=1e-6), name
    assert run([*train, "prior", "--seed", "1"]) == 2
    told = capsys.readouterr().err
    assert "other seed (0, here 1)" in told
    assert "same options" in told

    net = ["train", "net", *LAPTOP, "--prior", "prior", "--steps", "3", *SMALL, "--output", "net"]
    answer(capsys, *net)
    before = Path("net/model.safetensors").read_bytes()
    answer(capsys, *net)  # finished already
    assert Path("net/model.safetensors").read_bytes() == before
    use_weights(capsys, "net")
    assert answer(capsys, "eval", "keypoints", *LAPTOP, "--weights", "prior", "--objects", "2")["objects"] == 2

    # fine-tuned on spoilt views, it tells points outside the object, and answers wherever it did
    answer(capsys, *net[:-1], "robust", "--initial", "net", "--clutter")
    config = json.loads(Path("robust/config.json").read_text())
    assert config["tells_outside"]
    assert (config["training"]["clutter"], config["training"]["device"]) == (True, "CPU")
    few = ["--objects", "1", "--views", "1", "--device", "cpu"]
    assert answer(capsys, "eval", "pose", *LAPTOP, "--weights", "robust", *few)["views"] == 1

    # begun from what is known of another category
    answer(capsys, *net[:-1], "begun", "--initial", "dishwasher")
    assert json.loads(Path("begun/config.json").read_text())["training"]["initial"]["category"] == "dishwasher"

    # a prior remembers the one that it was fine-tuned from
    answer(capsys, *train, "finer", "--initial", "prior")
    first, finer = (json.loads(Path(f"{name}/config.json").read_text())["training"] for name in ("prior", "finer"))
    assert finer["initial"] == {"category": "laptop", **first}


def use_weights(capsys, folder: str) -> None:
    """``omad export`` takes a training's folder, and every command takes what it writes."""
    found = answer(capsys, "export", *LAPTOP, "--weights", folder, "--output", "laptop")
    assert {path.relative_to("laptop").as_posix() for path in Path("laptop").rglob("*.*")} == set(found["files"])
    assert np.load("laptop/prior.npz")["basis"].shape[1] == 3
    few = ["--objects", "1", "--views", "1", "--device", "cpu"]
    own, exported = (
        answer(capsys, "eval", "pose", *LAPTOP, "--weights", weights, *few) for weights in (folder, "laptop")
    )
    assert own["refined"] == exported["refined"]
    assert own["refined"] != answer(capsys, "eval", "pose", *LAPTOP, *few)["refined"]  # a folder of that name is used


@pytest.mark.slow
def test_as_a_program():
    command = [sys.executable, "-m", "omad", "estimate", save_png("d.png"), *LAPTOP, *K, "--json"]
    good = subprocess.run(command, capture_output=True, text=True, check=False)
    assert good.returncode == 0, good.stderr
    assert json.loads(good.stdout)["converged"]
    bad = subprocess.run([*command, "--output", "d.png"], capture_output=True, text=True, check=False)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert len(bad.stderr.strip().splitlines()) == 1


@pytest.mark.slow
def test_detect_finds_every_object_of_a_frame(capsys):
    scene = draw_tabletop(("laptop",), (2, 5))
    found = answer(capsys, "detect", save_png("table.png", scene.depth), *K, "--categories", "laptop")
    laptops = [placed for placed in scene.objects if placed.category and placed.to_be_found]
    named = [one for one in found["objects"] if one["category"] == "laptop"]
    assert len(named) >= len(laptops) - 1
    for one in found["objects"]:
        assert set(one["probabilities"]) == {"laptop", "none"}
        assert (one["estimate"] is None) == (one["category"] is None)
    kept = json.loads(Path("omad-detect/detect.json").read_text())
    assert kept["objects"] == found["objects"]
    *normal, offset = found["support_plane"]
    rows, columns = np.nonzero((scene.depth > 0) & ~np.any([placed.mask for placed in scene.objects], axis=0))
    points = scene.camera.backproject(np.stack([columns, rows], 1), scene.depth[rows, columns].astype(float))
    assert np.median(np.abs(points @ normal - offset)) < 0.005
    assert normal @ points.mean(0) < 0  # towards the camera
    assert Path("omad-detect/detect.png").stat().st_size > 0
    Image.fromarray(np.zeros(scene.depth.shape, np.uint8)).save("table.mask.png")  # as others may lie beside it
    again = answer(capsys, "detect", "table.png", *K, "--categories", "laptop")
    assert [one["box"] for one in again["objects"]] == [one["box"] for one in found["objects"]]
    assert run(["detect", "table.png", *K, "--categories", "laptop", "--box", "0,0,640,480"]) == 0
    assert "laptop" in capsys.readouterr().out
