"""Every bad input gives one line that says what is wrong and what to do, exit code 2, and no file."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.command_line import LAPTOP, K, cloud, laptop_view, refused, save_png
from omad.cli.main import run
from omad.common.incoming import CHECKSUM
from omad.data.procedural import generate
from omad.model.checkpoint import find_weights
from omad.objects.category_file import get_category
from omad.objects.urdf import write_urdf

SHIPPED = str(find_weights("laptop"))


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def saved(array: np.ndarray, name: str = "d.npy") -> str:
    np.save(name, array)
    return name


def truncated() -> str:
    save_png("d.png")
    Path("d.png").write_bytes(Path("d.png").read_bytes()[:200])
    return "d.png"


def eight_bit() -> str:
    Image.fromarray((laptop_view().depth > 0).astype(np.uint8)).save("d.png")
    return "d.png"


def few_pixels() -> np.ndarray:
    few = np.zeros_like(laptop_view().depth)
    few[200, 300:340] = 1.0
    return few


def text(name: str, content: str) -> str:
    Path(name).write_text(content)
    return name


def points(name: str, values: np.ndarray) -> str:
    np.savetxt(name, values)
    return name


BAD_FILES: dict[str, tuple[Callable[[], str], tuple[str, ...]]] = {
    "missing": (lambda: "nowhere.png", ("nowhere.png",)),
    "missing folder": (lambda: "nowhere", ("nowhere",)),
    "empty folder": (lambda: Path("empty").mkdir() or "empty", ("empty", ".png")),
    "truncated": (truncated, ("d.png",)),
    "eight bit": (eight_bit, ("d.png", "16-bit")),
    "empty file": (lambda: text("d.png", ""), ("d.png",)),
    "unknown extension": (lambda: text("d.bmp", "BM"), ("d.bmp", ".png")),
    "all zero": (lambda: save_png("d.png", 0 * laptop_view().depth), ("d.png",)),
    "all nan": (lambda: saved(np.full((480, 640), np.nan)), ("d.npy", "NaN")),
    "wrong shape": (lambda: saved(np.ones((4, 5, 6))), ("d.npy", "shape")),
    "no numbers": (lambda: saved(np.full((480, 640), "x")), ("d.npy", "dtype")),
    "few points": (lambda: saved(few_pixels()), ("d.npy", "40", "50")),
    "millimetres": (lambda: saved(laptop_view().depth * 1000), ("d.npy", "millimetres", "--depth-scale 0.001")),
    "cloud in millimetres": (lambda: points("c.xyz", 1000 * cloud()), ("c.xyz", "millimetres", "--depth-scale")),
    "cloud of few points": (lambda: points("c.xyz", cloud()[:30]), ("c.xyz", "30", "50")),
    "cloud of nothing": (lambda: points("c.xyz", np.nan * cloud()), ("c.xyz",)),
    "empty cloud": (lambda: text("c.xyz", ""), ("c.xyz",)),
    "no cloud": (lambda: text("c.ply", "hello"), ("c.ply", "PLY")),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", BAD_FILES)
def test_bad_files(kind, capsys):
    make, words = BAD_FILES[kind]
    line = refused(capsys, "estimate", make(), *LAPTOP, *K)
    assert all(word in line for word in words), line


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], ("d.png", "--intrinsics fx,fy,cx,cy")),
        (["--intrinsics", "600,600"], ("600,600", "fx,fy,cx,cy")),
        (["--intrinsics", "0,600,320,240"], ("pinhole",)),
        (["--intrinsics", "camera.json"], ("camera.json", "fx,fy,cx,cy")),
        ([*K, "--box", "1,2,3"], ("--box", "4 numbers")),
        ([*K, "--box", "a,b,c,d"], ("--box", "4 numbers")),
        ([*K, "--box", "10,10,5,5"], ("box", "x1 < x2")),
        ([*K, "--box", "900,900,950,950"], ("box", "outside", "640x480")),
        ([*K, "--box", "0,0,4,4"], ("d.png", "box", "50")),
        ([*K, "--mask", "small.png"], ("mask", "(10, 10)", "(480, 640)")),
        ([*K, "--mask", "nowhere.png"], ("nowhere.png", "mask")),
        ([*K, "--mask", "masks"], ("masks", "d.png")),
        ([*K, "--depth-scale", "0"], ("--depth-scale",)),
        ([*K, "--depth-scale", "nan"], ("--depth-scale",)),
        ([*K, "--depth-scale", "1"], ("d.png", "millimetres")),
        ([*K, "--device", "abacus"], ("abacus", "cpu")),
        ([*K, "--device", "meta"], ("meta", "cpu")),
        ([*K, "--weights", "nowhere"], ("nowhere",)),
        ([*K, "--output", "small.png"], ("small.png",)),
        ([*K, "--output", "/proc/nowhere"], ("/proc/nowhere",)),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_options(options, words, capsys):
    file = save_png("d.png")
    Image.fromarray(np.full((10, 10), 255, dtype=np.uint8)).save("small.png")
    Path("masks").mkdir()
    line = refused(capsys, "estimate", file, *LAPTOP, *options)
    assert all(word in line for word in words), line


def test_a_mask_is_not_silently_ignored_for_a_cloud(capsys):
    mask = ["--mask", save_png("mask.png")]
    line = refused(capsys, "estimate", points("c.xyz", cloud()), *LAPTOP, *mask)
    assert "c.xyz" in line
    assert "--segment plane" in line


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("detect frames", ("frames", "is a folder")),
        ("track d.png --category laptop", ("d.png", "no recording", "give a folder")),
        ("estimate d.png --category laptop --weights ./runs/lost", ("runs/lost", "no such folder")),
    ],
)
def test_a_file_for_a_folder_and_a_folder_for_a_file(command, words, capsys):
    save_png("d.png")
    Path("frames").mkdir()
    line = refused(capsys, *command.split(), *K)
    assert all(word in line for word in words), line


def test_no_input_at_all(capsys):
    assert "depth" in refused(capsys, "estimate", *LAPTOP, *K)


@pytest.mark.slow
def test_images_in_sub_folders_are_told_of(capsys, tmp_path):
    (tmp_path / "views/one").mkdir(parents=True)
    save_png(tmp_path / "views/one/0.depth.png")
    line = refused(capsys, "estimate", str(tmp_path / "views"), *LAPTOP)
    assert f"lie in its sub-folders; give {tmp_path / 'views'}/*" in line


def test_a_bad_one_among_many_is_named_and_the_others_are_done(capsys):
    save_png("frames/a.png")
    save_png("frames/b.png", 0 * laptop_view().depth)
    save_png("frames/c.png")
    assert run(["estimate", "frames", "nowhere.png", *LAPTOP, *K, "--json"]) == 2
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert [result["input"] for result in found["results"]] == ["frames/a.png", "frames/c.png"]
    assert [refusal["input"] for refusal in found["refused"]] == ["frames/b.png", "nowhere.png"]
    assert {path.name for path in Path("omad-estimate").iterdir()} == {"a", "c"}
    errors = [line for line in said.err.splitlines() if line.startswith("omad: ")]
    assert [("b.png" in error, "nowhere.png" in error) for error in errors] == [(True, False), (False, True)]


def test_what_is_wrong_for_all_inputs_is_said_once(capsys):
    for name in "abc":
        save_png(f"frames/{name}.png")
    for wrong in (["--intrinsics", "600"], [], [*K, "--box", "1"], [*K, "--mask", "nowhere.png"]):
        refused(capsys, "estimate", "frames", *LAPTOP, *wrong)


@pytest.mark.parametrize(
    "command",
    [
        *["demo", "generate --output x", "render --output x", "train prior --output x", "train net --output x"],
        *["eval pose", "eval keypoints", "eval views", "export --output x", f"estimate d.png {' '.join(K)}"],
        "eval robustness",
    ],
)
def test_unknown_categories(command, capsys):
    save_png("d.png")
    line = refused(capsys, *command.split(), "--category", "submarine")
    assert "submarine" in line
    assert "laptop" in line


@pytest.mark.parametrize(
    "command",
    [
        *["demo", "eval pose", "eval views", "export --output x", f"estimate d.png {' '.join(K)}"],
        *["eval keypoints --weights {0}/prior", "train net --output x --prior {0}/prior"],
        "eval robustness",
    ],
)
def test_weights_of_another_category(command, capsys):
    save_png("d.png")
    arguments = command.format(SHIPPED).split()
    own = [] if "{0}" in command else ["--weights", SHIPPED]
    line = refused(capsys, *arguments, "--category", "dishwasher", *own)
    assert "laptop" in line
    assert "dishwasher" in line


def change_config(change: Callable[[dict], None]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        config = json.loads((folder / "config.json").read_text())
        del config[CHECKSUM]
        change(config)
        (folder / "config.json").write_text(json.dumps(config))

    return apply


def change_bytes(first: int, last: int | None, value: int) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        data = bytearray((folder / "model.safetensors").read_bytes())
        data[first:last] = bytes([value]) * len(data[first:last])
        (folder / "model.safetensors").write_bytes(data)

    return apply


def keep_bytes(count: int) -> Callable[[Path], None]:
    file = "model.safetensors"
    return lambda folder: (folder / file).write_bytes((folder / file).read_bytes()[:count]) and None


DAMAGES: dict[str, Callable[[Path], object]] = {
    "gone": shutil.rmtree,
    "config gone": lambda folder: (folder / "config.json").unlink(),
    "tensors gone": lambda folder: (folder / "model.safetensors").unlink(),
    "of another program": lambda folder: (folder / "config.json").write_text('{"model_type": "bert"}'),
    "no json": lambda folder: (folder / "config.json").write_bytes(b"\xff\xfe\x00"),
    "a list": lambda folder: (folder / "config.json").write_text("[1, 2]"),
    "of a later version": change_config(lambda config: config.update(format=2)),
    "without category": change_config(lambda config: config.update(category={})),
    "senseless sizes": change_config(lambda config: config["category"].update(basis_size=-1)),
    "senseless unit": change_config(lambda config: config["category"].update(metres_per_unit=0)),
    "unknown fields": change_config(lambda config: config["backbone"].update(nonsense=1)),
    "one more number": lambda folder: (folder / "config.json").write_text(
        (folder / "config.json").read_text().replace('"points": 512', '"points": 513')
    ),
    "another backbone": change_config(lambda config: config["backbone"].update(global_channels=[8, 8])),
    "cut": keep_bytes(100_000),
    "empty": keep_bytes(0),
    "header damaged": change_bytes(3, 4, 255),
    "numbers damaged": change_bytes(-400, None, 255),
    "prior's tensors": lambda folder: shutil.copy(folder / "prior/model.safetensors", folder),
    "a prior": lambda folder: [
        shutil.copy(folder / f"prior/{n}", folder) for n in ("config.json", "model.safetensors")
    ],
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_damaged_and_foreign_checkpoints(kind, capsys):
    save_png("d.png")
    shutil.copytree(SHIPPED, "w")
    DAMAGES[kind](Path("w"))
    line = refused(capsys, "estimate", "d.png", *LAPTOP, *K, "--weights", "w")
    assert line.startswith("omad: w")


def test_a_net_is_no_prior(capsys):
    assert "config.json: " in refused(capsys, "train", "net", *LAPTOP, "--prior", SHIPPED, "--output", "x")
    assert "config.json: " in refused(capsys, "train", "prior", *LAPTOP, "--initial", SHIPPED, "--output", "x")
    line = refused(capsys, "train", "net", *LAPTOP, "--initial", SHIPPED, "--size", "paper", "--output", "x")
    assert "--size" in line


def missing_mesh(urdf: Path) -> None:
    next((urdf.parent / "meshes").iterdir()).unlink()


def cycle(urdf: Path) -> None:
    joint = '<joint name="back" type="fixed"><parent link="screen"/><child link="base"/></joint>'
    urdf.write_text(urdf.read_text().replace("</robot>", joint + "</robot>"))


def no_model(urdf: Path) -> None:
    shutil.rmtree(urdf.parent)


def other_category(urdf: Path) -> None:
    shutil.rmtree(urdf.parent)
    write_urdf(generate(get_category("drawer"), 0, "test"), urdf)


SOURCES = {
    "missing mesh": (missing_mesh, ("one.urdf", "mesh")),
    "cycle": (cycle, ("one.urdf", "cycle")),
    "nothing": (no_model, ("models", ".urdf")),
    "broken": (lambda urdf: urdf.write_text("<robot"), ("one.urdf",)),
    "other": (other_category, ("one.urdf", "laptop")),
}


@pytest.mark.parametrize("command", ["eval pose", "render --output x", "train prior --output x"])
@pytest.mark.parametrize("kind", SOURCES)
def test_bad_models(kind, command, capsys):
    spoil, words = SOURCES[kind]
    write_urdf(generate(get_category("laptop"), 1, "test"), "models/one/one.urdf")
    spoil(Path("models/one/one.urdf"))
    line = refused(capsys, *command.split(), *LAPTOP, "--source", "models")
    assert all(word in line for word in words), line


def test_bad_sources(capsys):
    assert "nowhere" in refused(capsys, "eval", "pose", *LAPTOP, "--source", "nowhere")
    Path("views").mkdir()
    Path("views/dataset.json").write_text('{"format": "coco"}')
    line = refused(capsys, "eval", "pose", *LAPTOP, "--source", "views")
    assert "dataset.json" in line


@pytest.mark.parametrize(
    "command",
    [
        *["eval pose --views {0}", "eval pose --objects {0}", "eval keypoints --objects {0}", "eval views --views {0}"],
        *["render --output x --views {0}", "render --output x --objects {0}"],
        *["generate --output x --objects {0}", "demo --objects {0}", "train prior --output x --steps {0}"],
        *["train net --output x --batch {0}", "train prior --output x --learning-rate {0}"],
        *["train net --output x --max-minutes {0}", "eval robustness --views {0}", "eval robustness --objects {0}"],
    ],
)
@pytest.mark.parametrize("value", ["0", "-3"])
def test_counts_must_be_above_zero(command, value, capsys):
    arguments = command.format(value).split()
    assert arguments[-2] in refused(capsys, *arguments, *LAPTOP)


def test_more_objects_than_a_machine_can_bear_are_refused_at_once(capsys):
    asked = {name: "--objects" for name in ("generate", "render", "train prior")} | {"train net": "--variants"}
    for command, option in asked.items():
        line = refused(capsys, *command.split(), "--output", "x", *LAPTOP, option, "200000")
        assert option in line
        assert "OMAD_LIMITS" in line
    assert not Path("x").exists()


@pytest.mark.parametrize(
    "command",
    [
        *["demo --objects 1", "generate --objects 1", "render --objects 1 --views 1", "export"],
        "train prior --objects 2 --batch 2 --steps 1 --device cpu",
    ],
)
@pytest.mark.parametrize("output", ["mine", "mine/inside", "/proc/nowhere"])
def test_outputs_that_cannot_be_written(command, output, capsys):
    Path("mine").write_text("keep me")
    assert output.split("/")[0] in refused(capsys, *command.split(), *LAPTOP, "--output", output)
    assert Path("mine").read_text() == "keep me"


def test_a_source_whose_name_no_file_can_have_is_refused(capsys):
    name = 300 * "x"
    assert name[:20] in refused(capsys, "index", "build", *LAPTOP, "--source", name, "--output", "i.npz")


def test_pictures_that_cannot_be_written_are_refused_before_the_work(capsys):
    Path("mine").write_text("keep me")
    for command in ("pose", "robustness"):
        assert "mine" in refused(capsys, "eval", command, *LAPTOP, "--pictures", "mine")
    assert "x.png" in refused(capsys, "train", "prior", *LAPTOP, "--output", "x.png")


def test_rows_that_there_are_not_and_options_that_exclude_each_other(capsys):
    line = refused(capsys, "eval", "robustness", *LAPTOP, "--rows", "clean", "hail")
    assert "hail" in line
    assert "hidden-25" in line
    for other in (["--depth-noise", "on"], ["--layout", "artimage"]):
        assert "--clutter" in refused(capsys, "render", *LAPTOP, "--output", "x", "--clutter", *other)


def test_weights_of_one_category_are_not_taken_for_others(capsys):
    np.save("d.npy", np.ones((480, 640)))
    for command in (["figure", "sweep", "--output", "x"], ["detect", "d.npy", *K]):
        line = refused(capsys, *command, "--weights", SHIPPED, "--categories", "drawer")
        assert "is for laptop, not for drawer" in line


def test_an_option_that_names_nothing_is_refused(capsys):
    """As a variable that is not set does."""
    assert "--formats: names nothing" in refused(capsys, "estimate", "a.png", *LAPTOP, "--formats")
    assert "--rows: names nothing" in refused(capsys, "eval", "robustness", *LAPTOP, "--rows")


def test_seeds_and_threads(capsys):
    assert "--threads" in refused(capsys, "train", "prior", *LAPTOP, "--output", "x", "--threads", "-1")
    for command in (["generate", "--output", "x"], ["render", "--output", "x"], ["eval", "pose"], ["demo"],
                    ["eval", "pose", "--source", "."]):  # fmt: skip
        assert "seed" in refused(capsys, *command, *LAPTOP, "--seed", "-1")
