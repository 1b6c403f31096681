"""ArtImage: the original's numbers, a writer that the reader undoes, proof of the geometry."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.artimage_disguise import disguise
from helpers.artimage_roots import edit, objects
from helpers.categories import CATEGORIES, LAPTOP
from helpers.command_line import answer, refused
from helpers.misfit import FITS, misfit
from omad.common.errors import InputError
from omad.data.artimage import ArtImage, open_artimage, write_artimage
from omad.data.artimage.layout import Layout, Split
from omad.data.rendering import view_folder
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.rasteriser import NOTHING
from omad.data.rendering.standard_views import View, standard_views
from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewSettings, draw_views
from omad.geometry.kinematics import part_transforms
from omad.objects.category import Category, PartSpec
from omad.objects.model import ObjectModel

ORIGINAL = os.environ.get("OMAD_ARTIMAGE")
needs_original = pytest.mark.skipif(ORIGINAL is None, reason="OMAD_ARTIMAGE names no folder in ArtImage's layout")
every_category = pytest.mark.parametrize("category", CATEGORIES.values(), ids=CATEGORIES)
BOTH: tuple[Split, ...] = ("train", "test")


def poses(view: View, category: Category) -> np.ndarray:
    """(K, 4, 4) canonical -> camera."""
    arrays = (view.truth.axes, view.truth.pivots, view.states, view.T_camera_base)
    return part_transforms(category.tree, *(torch.as_tensor(a)[None] for a in arrays))[0].numpy()


def check_same_views(found: ArtImage, models: list[ObjectModel], category: Category) -> None:
    """``found`` holds the standard views of the models: poses and joints exactly, depth to the stored step."""
    step = 1e-3 * category.metres_per_unit
    for read, drawn in zip(found, standard_views(models, category, len(found)), strict=True):
        assert read.camera == drawn.camera
        assert np.array_equal(read.labels, drawn.labels)
        assert np.abs(read.depth - drawn.depth).max() <= 0.51 * step
        np.testing.assert_allclose(read.states, drawn.states, atol=1e-9)
        np.testing.assert_allclose(read.T_camera_base, drawn.T_camera_base, atol=1e-8)
        np.testing.assert_allclose(poses(read, category), poses(drawn, category), atol=1e-8)
        np.testing.assert_allclose(read.truth.axes, drawn.truth.axes, atol=1e-8)
        np.testing.assert_allclose(read.truth.part_boxes, drawn.truth.part_boxes, atol=1e-8)
        for joint, spec in enumerate(category.joints):
            if spec.type == "revolute":
                np.testing.assert_allclose(read.truth.pivots[joint], drawn.truth.pivots[joint], atol=1e-8)


# the original


@needs_original
@every_category
def test_the_authors_numbers_are_reproduced(category: Category) -> None:
    root = Path(ORIGINAL or "")
    expected = [r for r in json.loads((root / "expected.json").read_text()) if r["category"] == category.name]
    assert expected
    found = 0
    unit = category.metres_per_unit
    prismatic = np.array([joint.type == "prismatic" for joint in category.joints])
    for split in BOTH:
        images = open_artimage(root, category, split)
        for annotation, view in zip(images.annotations, images, strict=True):
            (row,) = [r for r in expected if r["annotation"] == annotation.path.name]
            assert (row["split"], str(row["object"])) == (split, view.object)
            T = poses(view, category)
            T[:, :3, 3] /= unit
            np.testing.assert_allclose(T, row["T_camera_canonical"], atol=1e-6)
            states = np.where(prismatic, view.states / unit, view.states)
            np.testing.assert_allclose(states, row["joint_states"], atol=1e-6)
            np.testing.assert_allclose(view.truth.axes, row["joint_axes"], atol=1e-6)
            np.testing.assert_allclose(view.truth.pivots / unit, row["joint_pivots"], atol=1e-6)
            assert np.count_nonzero(view.depth) == row["points_in_bbox"]
            assert np.array_equal(view.labels != NOTHING, view.depth > 0)
            low, high = view.truth.limits.T
            assert ((low - 1e-9 <= view.states) & (view.states <= high + 1e-9)).all()
            found += 1
    assert found == len(expected)


@pytest.mark.slow
@needs_original
@every_category
def test_points_of_the_original_land_on_its_depth(category: Category) -> None:
    for split in BOTH:
        check_geometry(open_artimage(ORIGINAL or "", category, split), category)


@pytest.mark.slow
@every_category
def test_points_that_we_write_land_on_the_depth(category: Category, written: Callable[[Category], Path]) -> None:
    check_geometry(open_artimage(written(category), category, "test"), category)


def check_geometry(images: ArtImage, category: Category) -> None:
    """Every part lies where the image shows it, and with negated states it would not."""
    moved = 0
    for view in images:
        surface = images.objects[view.object].surface
        assert np.nanmax(misfit(view, surface, category)) < FITS
        far = [
            abs(state) > (0.05 * view.truth.diagonal if joint.type == "prismatic" else 0.15)
            for state, joint in zip(view.states, category.joints, strict=True)
        ]
        if any(far):  # a joint near its rest state looks the same the other way
            assert np.nanmax(misfit(replace(view, states=-view.states), surface, category)) > FITS
            moved += 1
    assert moved


# the writer


@pytest.mark.slow
@every_category
def test_reading_undoes_writing(category: Category, written: Callable[[Category], Path]) -> None:
    images = open_artimage(written(category), category, "test")
    models = objects(category)
    assert list(images.objects) == ["2000000", "2000001"]
    check_same_views(images, models, category)
    for model, thing in zip(models, images.objects.values(), strict=True):
        np.testing.assert_allclose(thing.truth.limits, model.limits, atol=1e-9)


@pytest.mark.slow
@every_category
def test_any_model_frame_rest_state_and_order_of_parts_is_read(
    category: Category, written: Callable[[Category], Path], tmp_path: Path
) -> None:
    shutil.copytree(written(category), tmp_path / "root")
    layout = Layout(tmp_path / "root", category.name)
    for index, name in enumerate(["2000000", "2000001"]):
        disguise(layout, name, category, np.random.default_rng(index))
    check_same_views(open_artimage(layout.root, category, "test"), objects(category), category)


def contents(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.mark.slow
@pytest.mark.usefixtures("begun_quickly")
def test_the_bytes_do_not_depend_on_processes_or_interruptions(
    written: Callable[[Category], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models = objects(LAPTOP)
    write_artimage(models, LAPTOP, tmp_path / "two", 4, "test", processes=2)

    class Killed(BaseException):
        pass

    write_png, drawn = view_folder.write_png, []

    def killed_at_the_third(path: Path, image: np.ndarray) -> None:
        drawn.append(path)
        if len(drawn) == 3:
            raise Killed
        write_png(path, image)

    with monkeypatch.context() as patch:
        patch.setattr("omad.data.artimage.writer.write_png", killed_at_the_third)
        with pytest.raises(Killed):
            write_artimage(models, LAPTOP, tmp_path / "twice", 4, "test")
    write_artimage(models, LAPTOP, tmp_path / "twice", 4, "test")
    expected = {name: digest for name, digest in contents(written(LAPTOP)).items() if "/" not in name}
    expected |= {f"laptop/{name}": digest for name, digest in contents(written(LAPTOP) / "laptop").items()}
    assert contents(tmp_path / "two") == contents(tmp_path / "twice") == expected


@pytest.mark.slow
def test_splits_and_categories_share_a_root_and_objects_with_ids_keep_them(tmp_path: Path) -> None:
    write_artimage(objects(LAPTOP, 2, "train"), LAPTOP, tmp_path, 3, "train")
    write_artimage(objects(LAPTOP, 1), LAPTOP, tmp_path, 1, "test", seed=5)
    scissors = CATEGORIES["scissors"]
    named = [replace(m, name=name) for m, name in zip(objects(scissors), ("10495", "10449"), strict=True)]
    write_artimage(named, scissors, tmp_path, 4, "test")
    found = {(c.name, s): open_artimage(tmp_path, c, s) for c in (LAPTOP, scissors) for s in BOTH}
    counts = {key: (list(images.objects), len(images)) for key, images in found.items()}
    assert counts == {
        ("laptop", "train"): (["1000000", "1000001"], 3),
        ("laptop", "test"): (["2000000"], 1),
        ("scissors", "train"): (["10495"], 2),
        ("scissors", "test"): (["10449"], 2),
    }
    write_artimage(objects(LAPTOP, 2, "train"), LAPTOP, tmp_path, 5, "train")
    assert len(open_artimage(tmp_path, LAPTOP, "train")) == 5


def test_an_object_tests_by_its_id_whatever_the_lists_say(laptops: Layout) -> None:
    files = laptops.valid("test").read_text()
    laptops.valid("train").write_text(files)
    assert list(open_artimage(laptops.root, LAPTOP, "train").objects) == ["2000000", "2000001"]
    with pytest.raises(InputError, match="test"):
        open_artimage(laptops.root, LAPTOP, "test")
    laptops.object("2000001").rename(laptops.object("10885"))
    for file in laptops.annotation("").glob("2000001*"):
        file.write_text(file.read_text().replace('"urdf_id": 2000001', '"urdf_id": 10885'))
    assert list(open_artimage(laptops.root, LAPTOP, "test").objects) == ["10885"]
    assert list(open_artimage(laptops.root, LAPTOP, "train").objects) == ["2000000"]


def test_other_arguments_are_refused(laptops: Layout) -> None:
    models, before = objects(LAPTOP), contents(laptops.root)
    for word, call in (
        ("seed", lambda: write_artimage(models, LAPTOP, laptops.root, 4, "test", seed=1)),
        ("noise", lambda: write_artimage(models, LAPTOP, laptops.root, 4, "test", noise=ON)),
        ("objects", lambda: write_artimage(models[:1], LAPTOP, laptops.root, 4, "test")),
        ("2000000", lambda: write_artimage(swapped(models), LAPTOP, laptops.root, 4, "test")),
        (str(laptops.root), lambda: write_artimage([], LAPTOP, laptops.root, 4, "test")),
    ):
        with pytest.raises(InputError, match=word):
            call()
    assert contents(laptops.root) == before
    joints = (LAPTOP.joints[0], replace(LAPTOP.joints[0], name="latch", parent=1))
    hanging = replace(LAPTOP, parts=(*LAPTOP.parts, PartSpec("latch", 2)), joints=joints)
    with pytest.raises(InputError, match=LAPTOP.name):
        write_artimage(models, hanging, laptops.root, 4, "test")


def swapped(models: list[ObjectModel]) -> list[ObjectModel]:
    """Each under the other's name."""
    a, b = models
    return [replace(b, name=a.name), replace(a, name=b.name)]


def test_rest_states_that_are_not_listed(laptops: Layout, written: Callable[[Category], Path], tmp_path: Path) -> None:
    laptops.rest_states.write_text("{}")
    check_same_views(open_artimage(laptops.root, LAPTOP, "test"), objects(LAPTOP), LAPTOP)
    drawer = CATEGORIES["drawer"]
    shutil.copytree(written(drawer), tmp_path / "drawers")
    layout = Layout(tmp_path / "drawers", "drawer")
    edit(layout.rest_states, lambda record: record["2000001"].pop("2"))
    with pytest.raises(InputError, match=r"rest_state\.json: .*part 2 .*2000001"):
        open_artimage(layout.root, drawer, "test")


def test_limits_that_cannot_be_degrees_give_way_to_the_category(laptops: Layout) -> None:
    urdf = laptops.aligned_urdf("2000000")
    text = urdf.read_text()
    for limit, expected in (
        (' lower="-1.5" upper="1.5"', (-80, 85)),
        (' lower="-20" upper="200"', (-20, 85)),
        ("", (-80, 85)),
    ):
        urdf.write_text(
            text.replace(text[text.index("<limit") : text.index("/>", text.index("<limit"))], f"<limit{limit}")
        )
        truth = open_artimage(laptops.root, LAPTOP, "test").objects["2000000"].truth
        np.testing.assert_allclose(np.degrees(truth.limits), [expected])


# surfaces to train on


@every_category
def test_training_views_of_points_are_like_those_of_meshes(
    category: Category, written: Callable[[Category], Path]
) -> None:
    images, models = open_artimage(written(category), category, "test"), objects(category)
    banks = [
        SurfaceBank.from_models(things, category)
        for things in ([thing.surface for thing in images.objects.values()], models)
    ]
    assert not banks[0].closed.any()
    for key in ("axes", "limits"):
        torch.testing.assert_close(getattr(banks[0], key), getattr(banks[1], key), atol=1e-5, rtol=0)
    shares = [
        torch.stack([(bank.labels == part).float().mean() for part in range(len(category.parts))]) for bank in banks
    ]
    torch.testing.assert_close(shares[0], shares[1], atol=0.1, rtol=0)
    assert len(np.unique(banks[0].points[0], axis=0)) > 0.5 * min(8192, 4000 * len(category.parts))
    spans = [torch.stack([bank.points.amin(1), bank.points.amax(1)]) for bank in banks]
    torch.testing.assert_close(spans[0], spans[1], atol=0.03, rtol=0)
    views = draw_views(banks[0], category, 4, ViewSettings(points=256), torch.Generator().manual_seed(0))
    assert torch.isfinite(views.points).all()
    assert (views.points[..., 2] > 0).all()


# the commands


@pytest.mark.slow
def test_render_eval_and_train_take_the_layout(
    capsys: pytest.CaptureFixture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    laptop = ("--category", "laptop")
    for split in BOTH:
        render = ("render", *laptop, "--layout", "artimage", "--output", "root", "--objects", "2", "--split", split)
        assert answer(capsys, *render, "--views", "4") == {"folder": "root", "views": 4, "refused": []}
    result = answer(capsys, "eval", "pose", *laptop, "--source", "root")
    assert (result["objects"], result["views"], result["refused"], result["depth_noise"]) == (2, 4, [], False)
    assert result["refined"]["axis_error_deg"][0]["median"] < 5
    short = ("--steps", "2", "--batch", "2", "--threads", "1", "--device", "cpu")
    answer(capsys, "train", "prior", *laptop, "--source", "root", "--output", "prior", *short)
    answer(capsys, "train", "net", *laptop, "--source", "root", "--prior", "prior", "--output", "net", *short)
    config = json.loads((tmp_path / "net" / "config.json").read_text())
    assert config["training"]["source"] == "root"

    (tmp_path / "root/laptop/train/depth/2000000_0001.png").unlink()
    assert "2000000_0001.png: " in refused(capsys, "eval", "pose", *laptop, "--source", "root")
    result = answer(capsys, "eval", "pose", *laptop, "--source", "root", "--broken", "skip")
    assert result["views"] == 3
    assert [row["name"] for row in result["refused"]] == ["2000000_0001.json"]
    assert "--depth-noise" in refused(capsys, "eval", "pose", *laptop, "--source", "root", "--depth-noise", "on")
    assert "root/laptop: " in refused(capsys, "eval", "pose", *laptop, "--source", "root/laptop")
    assert "drawer" in refused(capsys, "eval", "pose", "--category", "drawer", "--source", "root")
    assert "root: " in refused(capsys, "render", *laptop, "--source", "root", "--output", "other")
