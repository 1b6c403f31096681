"""Building, asking and measuring catalogues on the command line; the Siamese baseline learns and is kept."""

import importlib.util
import io
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from helpers.categories import LAPTOP
from helpers.command_line import LAPTOP as OF_LAPTOP
from helpers.command_line import K, answer, cloud, laptop_view, refused, save_png
from omad.applications.retrieval.index import Entry, ShapeIndex
from omad.applications.retrieval.signature import Space
from omad.cli.main import run
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.evaluation.baselines.siamese import SiameseNet, SiameseTraining, contrastive_losses, train_siamese
from omad.model.backbones.pointnet2 import PointNet2Config
from omad.model.checkpoint import WEIGHTS, load, save
from omad.model.omadnet import OmadNet
from omad.objects.category_file import get_category
from omad.objects.urdf import write_urdf
from omad.sensing.reader import files_in
from omad.training.loop import Schedule

FAISS = importlib.util.find_spec("faiss") is not None
TINY = PointNet2Config(points=128, centres=(32, 16), neighbours=(8, 8), widths=(24, 32, 48), dense=32)


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def build(capsys, *options: str) -> dict:
    return answer(capsys, "index", "build", *OF_LAPTOP, "--output", "index.npz", *options)


@pytest.mark.slow
def test_a_view_finds_its_object_among_models(capsys):
    made = build(capsys, "--objects", "3")
    assert (made["entries"], made["objects"], made["metric"]) == (3, 3, "keypoints")
    found = answer(capsys, "index", "query", save_png("q.png"), *K, "--index", "index.npz", "--count", "2")
    names = [hit["object"] for hit in found["ranking"]]
    assert names[0] == generate(LAPTOP, 0, "test").name  # what the view shows
    assert len(names) == 2
    assert found["ranking"][0]["distance"] < found["ranking"][1]["distance"] < 0.1
    assert found["unit"] == "m"
    with Image.open(found["ranking"][0]["thumbnail"]) as thumbnail:
        assert thumbnail.size == (224, 224)
        seen = np.asarray(thumbnail.convert("L")) < 250
        assert max(seen.any(0).mean(), seen.any(1).mean()) > 0.7  # the object fills it
    with Image.open(found["picture"]) as picture:
        assert (np.asarray(picture.convert("L")) < 40).mean() < 0.1  # colours are those of the thumbnails, on white

    np.save("cloud.npy", cloud())
    again = answer(
        capsys, "index", "query", "cloud.npy", "q.png", *K, "--index", "index.npz", "--by-information"
    )  # two views of it
    assert again["ranking"][0]["object"] == names[0]
    assert again["unit"] == "std"
    assert run(["index", "query", "cloud.npy", "--index", "index.npz"]) == 0
    assert names[0] in capsys.readouterr().out

    line = refused(capsys, "index", "query", "q.png", *K, "--index", "index.npz", "--weights", str(other_prior()))
    assert "--weights" in line


def other_prior() -> Path:
    """The shipped laptop, speaking another language."""
    net = load(OmadNet, WEIGHTS / "laptop")
    with torch.no_grad():
        net.prior.learned_basis.mul_(1.5)
    save(net, Path("other"), {})
    return Path("other")


@pytest.mark.slow
def test_a_catalogue_of_views_has_an_entry_an_object_or_a_view(capsys):
    views = ["render", *OF_LAPTOP, "--output", "views", "--objects", "2", "--views", "4"]
    answer(capsys, *views)
    made = build(capsys, "--source", "views")
    assert (made["entries"], made["objects"]) == (2, 2)
    made = build(capsys, "--source", "views", "--no-fuse", "--metric", "beta")
    assert (made["entries"], made["objects"]) == (4, 2)
    index = ShapeIndex.load("index.npz")
    assert all(entry.thumbnail.startswith(b"\x89PNG") for entry in index.entries)
    assert "views: " in refused(
        capsys, "index", "build", "--category", "drawer", "--output", "x.npz", "--source", "views"
    )


@pytest.mark.slow
def test_mirror_images_are_told_apart(capsys):
    """A fridge and its image in a mirror are not two views of one object, nor is the one named as the other."""
    of = ["--category", "refrigerator", "--objects", "2"]
    answer(capsys, "render", *of, "--output", "views", "--views", "6")
    answer(capsys, "index", "build", *of, "--output", "index.npz")
    states = {file: json.loads(file.read_text())["states"][0] for file in Path("views").rglob("0*.json")}
    file = max(states, key=states.__getitem__).with_suffix(".depth.png")  # wide open, which shows its hinge
    with Image.open(file) as depth:
        Image.fromarray(np.asarray(depth)[:, ::-1].copy()).save("image.png")
    query = ["--intrinsics", "600,600,319.5,239.5", "--depth-scale", "0.001", "--index", "index.npz"]
    for shown, mirrored in ((str(file), False), ("image.png", True)):
        found = answer(capsys, "index", "query", shown, *query)
        assert [hit["mirrored"] for hit in found["ranking"]] == [mirrored] * 2
        assert found["ranking"][0]["object"] == file.parent.name
        assert run(["index", "query", shown, *query]) == 0
        assert ("in the mirror" in capsys.readouterr().out) == mirrored
    assert "other hand" in refused(capsys, "index", "query", str(file), "image.png", *query)
    made = answer(capsys, "index", "build", "--category", "refrigerator", "--source", "views", "--output", "seen.npz")
    assert made["entries"] == 2
    index = ShapeIndex.load("index.npz")
    index.entries = [replace(entry, of_other_hand=None) for entry in index.entries]  # as of before there were hands
    index.save("old.npz")
    found = answer(capsys, "index", "query", "image.png", *query[:-1], "old.npz")
    assert {hit["mirrored"] for hit in found["ranking"]} == {None}
    assert "build it anew" in found["warnings"][0]


@pytest.mark.slow
def test_a_catalogue_of_ones_own_images(capsys):
    save_png("images/mine/a.png")
    save_png("images/mine/b.png")
    np.save("images/lone.npy", cloud())
    Path("images/broken.png").write_text("")
    command = ["index", "build", *OF_LAPTOP, "--output", "index.npz", "--source", "images", *K]
    assert run(command) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("omad: images/broken.png: ")
    made = answer(capsys, *command, code=2)
    assert (made["entries"], made["objects"]) == (2, 2)
    assert [Path(refusal["name"]).name for refusal in made["refused"]] == ["broken.png"]
    assert sorted(entry.name for entry in ShapeIndex.load("index.npz").entries) == ["lone", "mine"]
    found = answer(capsys, "index", "query", "images/lone.npy", "--index", "index.npz")
    assert found["ranking"][0]["object"] == "lone"
    shutil.rmtree("images/mine")
    Path("images/lone.npy").unlink()
    line = refused(capsys, "index", "build", *OF_LAPTOP, "--output", "new.npz", "--source", "images", *K)
    assert "images: none of its 1 inputs" in line
    assert "broken.png: " in line


@pytest.mark.slow
def test_a_query_leaves_no_thumbnails_of_an_earlier_one_and_takes_no_file_of_others(capsys):
    few_entries("index.npz", ["one", "new\nline", "three"])
    query = ["index", "query", save_png("01.png"), *K, "--index", "index.npz", "--output", "."]
    depth = Path("01.png").read_bytes()
    for mine in ("ranking-07.png", "ranking-2024.png"):
        Path(mine).write_bytes(b"mine")
    found = answer(capsys, *query, "--count", "3")
    assert Path("ranking-07.png").read_bytes() == b"mine"  # no earlier query was here
    Path("ranking-07.png").unlink()
    assert all(Path(hit["thumbnail"]).is_file() for hit in found["ranking"])
    found = answer(capsys, *query, "--count", "1")
    assert {path.name for path in Path().glob("*.png")} == {
        "01.png",
        "ranking.png",
        "ranking-01.png",
        "ranking-2024.png",
    }
    assert found["ranking"][0]["thumbnail"] == "ranking-01.png"
    assert Path("01.png").read_bytes() == depth
    assert run([*query, "--count", "3"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 6  # head, line, three objects and the picture
    assert any("new line" in row for row in rows)


def few_entries(path: str, names: list[str]) -> None:
    """A catalogue of laptops around the mean one, with thumbnails."""
    net = load(OmadNet, WEIGHTS / "laptop")
    index, thumbnail = ShapeIndex(Space.of(net.prior, LAPTOP)), io.BytesIO()
    Image.new("RGB", (8, 8)).save(thumbnail, "PNG")
    betas = net.prior.beta_mean.numpy() + 0.1 * np.arange(len(names))[:, None]
    index.add_betas(betas, [Entry(name, "", thumbnail.getvalue()) for name in names])
    index.save(path)


@pytest.mark.slow
def test_what_is_unlike_the_category_is_told_of(capsys):
    """A cabinet among laptops, and one that is asked for among them."""
    category = get_category("drawer")
    view = standard_view(generate(category, 0, "test"), category, (0, 1000))
    few_entries("index.npz", ["one"])
    save_png("images/a.png")
    cabinet = save_png("images/cabinet.png", view.depth)
    for place, more in (("new.npz", []), *([("disk", ["--backend", "disk"])] if FAISS else [])):
        made = answer(capsys, "index", "build", *OF_LAPTOP, *K, "--source", "images", "--output", place, *more)
        assert made["entries"] == 2
        assert [(doubt["name"], doubt["source"]) for doubt in made["doubtful"]] == [("cabinet", cabinet)]
        assert made["doubtful"][0]["probability"] < 0.5
    found = answer(capsys, "index", "query", cabinet, *K, "--index", "index.npz")
    assert any(warning.startswith(f"{cabinet}: right with probability") for warning in found["warnings"])
    found = answer(capsys, "index", "query", "images/a.png", *K, "--index", "index.npz")
    assert not any("doubtful" in warning for warning in found["warnings"])


def test_hidden_folders_are_no_objects(capsys):
    save_png("images/.ipynb_checkpoints/a-checkpoint.png")
    save_png("images/a.png")
    assert files_in(Path("images"), "**/[!.]*") == [Path("images/a.png")]
    save_png(".hidden/b.png")
    assert files_in(Path(".hidden"), "**/[!.]*") == [Path(".hidden/b.png")]  # which was asked for


def test_a_picture_beside_a_cloud_is_no_input(capsys):
    save_png("images/a.png")
    np.savetxt("images/b.xyz", np.eye(3))
    for name in ("a.tif", "b.png"):
        Image.new("RGB", (4, 3)).save(f"images/{name}")
    assert files_in(Path("images")) == [Path("images/a.png"), Path("images/b.xyz")]
    Image.new("L", (4, 3)).save("images/c.png")  # alone, it is refused when it is read
    assert files_in(Path("images"))[2:] == [Path("images/c.png")]


def test_bad_input_is_one_line(capsys):
    query = ["index", "query", save_png("q.png")]
    assert "nowhere.npz: " in refused(capsys, *query, *K, "--index", "nowhere.npz")
    Path("bad.npz").write_bytes(b"nonsense")
    assert "bad.npz: " in refused(capsys, *query, *K, "--index", "bad.npz")
    assert "--objects 0" in refused(capsys, "index", "build", *OF_LAPTOP, "--output", "x.npz", "--objects", "0")
    assert "nowhere" in refused(capsys, "index", "build", *OF_LAPTOP, "--output", "x.npz", "--source", "nowhere")
    before = Path("q.png").read_bytes()
    assert "q.png: " in refused(capsys, "index", "build", *OF_LAPTOP, "--output", "q.png", "--objects", "1")
    assert Path("q.png").read_bytes() == before
    build_of = ["index", "build", *OF_LAPTOP, *K, "--output", "x.npz", "--source"]
    assert "q.png: is no URDF, nor a folder" in refused(capsys, *build_of, "q.png")
    lone = save_png("images/lone.png")
    Path("images/lone").mkdir()
    for alike in (Path("images/lone.npy"), Path("images/lone/view.png")):
        alike.touch()
        line = refused(capsys, *build_of, "images")
        assert all(told in line for told in [lone, str(alike), "is object lone", "sub-folder"]), line
        alike.unlink()


@pytest.mark.slow
def test_table3_of_all_methods_and_again_from_the_cache(capsys, monkeypatch):
    shutil.copytree(WEIGHTS / "laptop", "weights/laptop", ignore=shutil.ignore_patterns("prior", "ancsh", "siamese"))
    torch.manual_seed(0)
    save(SiameseNet(LAPTOP, TINY), Path("weights/laptop/siamese"), {})
    command = ["eval", "retrieval", "--objects", "3", "--views", "4", "--gallery", "2", "--draws", "3"]
    command += ["--queries", "5", "--weights", "weights", "--cache", "kept"]
    found = answer(capsys, *command)
    methods = found["laptop"]
    assert {
        "omad",
        "omad_initial",
        "siamese",
        "omad_keypoints",
        "omad_information",
        "omad_three_views",
    } <= methods.keys()
    for part in methods.values():
        for scores in (part, part["large"], part["across_states"]):
            assert {"map_at_10", "nearest_neighbour", "first_tier", "second_tier"} == scores["chance"].keys()
            assert all(0 <= scores[key] <= 1 for key in scores["chance"])
        assert (part["objects"], part["gallery"], part["draws"]) == (2, 8, 3)
        assert (part["large"]["objects"], part["large"]["gallery"]) == (3, 12)
    assert methods["omad"]["paper"] == 0.452
    assert methods["omad"]["map_at_10"] > methods["omad"]["chance"]["map_at_10"]

    def again(*_):
        raise AssertionError("what is kept is not made again")

    monkeypatch.setattr("omad.evaluation.retrieval.pool.describe_with_omad", again)
    monkeypatch.setattr("omad.evaluation.retrieval.pool.describe_with_siamese", again)
    assert answer(capsys, *command) == found
    assert run(command) == 0
    assert "across states" in capsys.readouterr().out
    command[command.index("--gallery") + 1] = "4"
    assert "has 3 objects" in refused(capsys, *command)
    command[command.index("--gallery") + 1] = "2"
    assert "cache" in refused(capsys, *command, "--seed", "1")
    save(SiameseNet(LAPTOP, TINY), Path("weights/laptop/siamese"), {})
    assert "cache" in refused(capsys, *command)
    shutil.rmtree("weights/laptop/siamese")
    assert run([*command, "--json"]) == 0
    captured = capsys.readouterr()
    assert "siamese" not in json.loads(captured.out)["laptop"]
    assert "siamese" in captured.err
    assert "cache" in refused(capsys, "eval", "retrieval", "--weights", "cache")


def test_contrastive_loss_by_hand():
    embeddings = torch.tensor([[0.0, 0.0], [0.3, 0.4], [0.6, 0.8], [9.0, 0.0]])
    found = contrastive_losses(embeddings, torch.tensor([0, 0, 1, 1]), margin=1.0)
    apart = (8.4**2 + 0.8**2) ** 0.5
    assert found["same"].item() == pytest.approx((0.5**2 + apart**2) / 2)
    assert found["other"].item() == pytest.approx((0.0 + 0.0 + 0.5**2 + 0.0) / 4, abs=1e-6)


@pytest.mark.slow
def test_the_siamese_network_learns_and_is_kept(tmp_path):
    models = [generate(LAPTOP, index) for index in range(3)]
    settings = SiameseTraining(schedule=Schedule(steps=12, batch=9, log_steps=1), backbone=TINY)
    net = train_siamese(models, LAPTOP, tmp_path, settings)
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert rows[-1]["step"] == 12
    assert set(rows[0]) >= {"same", "other", "loss"}
    assert np.mean([row["loss"] for row in rows[-3:]]) < rows[0]["loss"]
    save(net, tmp_path / "kept", {})
    again = load(SiameseNet, tmp_path / "kept")
    points = torch.randn(2, 128, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(again(points), net.eval()(points))


def test_the_view_is_of_the_object_that_the_tests_take_it_for():
    assert laptop_view().object == generate(LAPTOP, 0, "test").name


@pytest.mark.slow
@pytest.mark.skipif(not FAISS, reason="FAISS is not installed (extra omad[faiss])")
def test_a_catalogue_on_disk_is_built_added_to_merged_and_asked(capsys):
    on_disk = ["index", "build", *OF_LAPTOP, "--output", "large", "--backend", "disk"]
    assert answer(capsys, *on_disk, "--objects", "2")["entries"] == 2
    assert answer(capsys, *on_disk, "--objects", "3")["entries"] == 3  # goes on with the third
    for number in range(2):
        save_png(f"frames/mine/{number}.png")
    save_png("frames/other.png")
    made = answer(capsys, *on_disk, "--source", "frames", *K)
    assert (made["entries"], made["refused"]) == (5, [])  # two files show one object
    Path("link").symlink_to(".")
    assert answer(capsys, *on_disk, "--source", "link/frames", *K)["entries"] == 5  # the same folder
    build(capsys, "--objects", "4")
    merged = answer(capsys, "index", "merge", "large", "index.npz", "--output", "all")
    assert merged["entries"] == 9
    assert answer(capsys, "index", "merge", "link/large", "link/index.npz", "--output", "all")["entries"] == 9
    assert "leave it out" in refused(capsys, "index", "merge", "large", "all", "--output", "./all")
    assert answer(capsys, *on_disk, "--source", "unusual", "--objects", "2")["entries"] == 7
    assert answer(capsys, *on_disk, "--source", "unusual", "--objects", "2", "--seed", "7")["entries"] == 9
    found = answer(capsys, "index", "query", save_png("q.png"), *K, "--index", "all", "--count", "3")
    names = [hit["object"] for hit in found["ranking"]]
    assert set(names) == {"mine", "other", generate(LAPTOP, 0, "test").name}  # three of what the view shows
    assert Path(found["ranking"][0]["thumbnail"]).is_file()
    assert "large" in refused(capsys, *on_disk, "--metric", "beta")


@pytest.mark.slow
@pytest.mark.skipif(not FAISS, reason="FAISS is not installed (extra omad[faiss])")
def test_a_catalogue_on_disk_knows_what_it_was_made_of(capsys):
    on_disk = ["index", "build", *OF_LAPTOP, "--output", "large", "--backend", "disk"]
    for number in range(2):
        save_png(f"frames/{number}.png")
    frames = [*on_disk, "--source", "frames", *K]
    assert run([*frames, "--depth-scale", "0.9"]) == 2
    assert "none of its 2 inputs" in capsys.readouterr().err
    assert answer(capsys, *frames)["entries"] == 2  # the mistake is not remembered
    assert "options" in refused(capsys, *frames, "--depth-scale", "0.0005")
    assert "options" in refused(capsys, *frames, "--no-fuse")
    assert answer(capsys, *frames)["entries"] == 2
    for index, name in enumerate("bd"):
        write_urdf(replace(generate(LAPTOP, index, "test"), name=name), f"models/{name}/{name}.urdf")
    assert answer(capsys, *on_disk, "--source", "models")["entries"] == 4
    write_urdf(replace(generate(LAPTOP, 9, "test"), name="d"), "models/d/d.urdf")
    assert "are not those" in refused(capsys, *on_disk, "--source", "models")
    write_urdf(replace(generate(LAPTOP, 1, "test"), name="d"), "models/d/d.urdf")
    write_urdf(replace(generate(LAPTOP, 2, "test"), name="c"), "models/c/c.urdf")
    assert "are not those" in refused(capsys, *on_disk, "--source", "models")
    shutil.move("models/c", "models/e")
    Path("models/e/c.urdf").rename("models/e/e.urdf")
    assert answer(capsys, *on_disk, "--source", "models")["entries"] == 5
    save_png("frames/1.png", laptop_view().depth[:, ::-1])
    assert "are not those" in refused(capsys, *frames)


@pytest.mark.slow
@pytest.mark.skipif(not FAISS, reason="FAISS is not installed (extra omad[faiss])")
def test_views_that_were_rendered_anew_are_not_taken_for_those_that_are_in(capsys):
    on_disk = ["index", "build", *OF_LAPTOP, "--output", "large", "--backend", "disk", "--source", "views"]
    for options in (("--views", "4"), ("--views", "4", "--seed", "9"), ("--views", "10")):
        shutil.rmtree("views", ignore_errors=True)
        assert run(["render", *OF_LAPTOP, "--objects", "2", "--output", "views", *options]) == 0
        capsys.readouterr()
        if options == ("--views", "4"):
            assert answer(capsys, *on_disk)["entries"] == answer(capsys, *on_disk)["entries"] == 2
            assert "read with other options" in refused(capsys, *on_disk, "--no-fuse")
        else:
            assert "its first 4 inputs are not those that are in" in refused(capsys, *on_disk)


@pytest.mark.slow
@pytest.mark.skipif(not FAISS, reason="FAISS is not installed (extra omad[faiss])")
def test_a_catalogue_on_disk_lists_what_it_skipped(capsys):
    assert run(["render", *OF_LAPTOP, "--objects", "2", "--views", "4", "--output", "views"]) == 0
    capsys.readouterr()
    next(Path("views").glob("*/*.json")).write_text("{")
    on_disk = ["index", "build", *OF_LAPTOP, "--output", "large", "--backend", "disk", "--source", "views"]
    [skipped] = answer(capsys, *on_disk, "--broken", "skip")["refused"]
    assert "JSON" in skipped["reason"]
