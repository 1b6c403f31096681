"""Standard views: what they show, that they repeat, and that a folder of them holds the same."""

from __future__ import annotations

import hashlib
import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.categories import CATEGORIES
from omad.common.errors import InputError
from omad.data.clutter.settings import Clutter
from omad.data.procedural import generate
from omad.data.rendering import view_folder
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.rasteriser import NOTHING
from omad.data.rendering.standard_views import MIN_PIXELS, standard_view, standard_views
from omad.data.rendering.tabletop import draw_tabletop
from omad.data.rendering.view_folder import open_views, render_to_folder
from omad.data.rendering.viewpoints import SPAN, keep_possible, sample_poses
from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewSettings, draw_views
from omad.geometry.camera import STANDARD_CAMERA as CAMERA
from omad.geometry.mesh import Mesh
from omad.objects.category import ViewRange
from omad.objects.category_file import get_category
from omad.objects.model import ObjectModel

CATEGORY = CATEGORIES["dishwasher"]


@pytest.fixture(scope="module")
def models() -> list[ObjectModel]:
    return [generate(CATEGORY, index, "test") for index in range(3)]


def contents(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_views_lie_on_the_object_within_its_limits(models: list[ObjectModel]) -> None:
    states = []
    for view in standard_views(models, CATEGORY, 12, seed=1):
        model = next(m for m in models if m.name == view.object)
        assert (view.depth > 0).sum() >= MIN_PIXELS
        assert np.array_equal(view.labels != NOTHING, view.depth > 0)
        assert ((view.states >= model.limits[:, 0]) & (view.states <= model.limits[:, 1])).all()
        assert np.array_equal(view.truth.pivots, model.pivots)
        assert view.truth.diagonal == pytest.approx(model.diagonal)
        states.append(view.states[0])
        for part, vertices in enumerate(model.posed_vertices(view.states, view.T_camera_base)):
            rows, columns = np.nonzero(view.labels == part)
            z = view.depth[rows, columns]
            camera = view.camera
            points = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], 1)
            assert (points > vertices.min(0) - 1e-5).all()
            assert (points < vertices.max(0) + 1e-5).all()
    assert np.ptp(states) > 0.5


def test_no_part_is_drawn_where_it_would_go_through_another() -> None:
    category = get_category("stapler")
    models = [generate(category, index, "test") for index in range(2)]
    rendered = np.array([view.states for view in standard_views(models, category, 20)])
    bank = SurfaceBank.from_models(models, category, samples=2048)
    settings = ViewSettings(points=64, clutter=Clutter())
    trained = draw_views(bank, category, 200, settings, torch.Generator().manual_seed(0)).states.double().numpy()
    for states in rendered, trained:
        lid, magazine = states.T
        assert (magazine <= lid + 1e-6).all()
        assert np.ptp(magazine) > 1.0
        assert (magazine > 0.9 * lid).any()


def test_a_joint_that_cannot_move_stays_where_it_is() -> None:
    states, limits = np.array([1.0, 0.5]), np.array([[0.0, 1.7], [0.5, 0.5]])
    keep_possible(states, limits, get_category("stapler").joints)
    np.testing.assert_array_equal(states, [1.0, 0.5])


def test_views_repeat_and_do_not_depend_on_how_many_are_drawn(models: list[ObjectModel]) -> None:
    few = list(standard_views(models, CATEGORY, 4, seed=3, noise=ON))
    many = list(standard_views(models, CATEGORY, 7, seed=3, noise=ON))
    for a, b in zip(few, many, strict=False):
        assert np.array_equal(a.depth, b.depth)
        assert np.array_equal(a.T_camera_base, b.T_camera_base)
    assert [v.object for v in many] == [models[i % 3].name for i in range(7)]
    assert many[3].seed == (3, 0, 1)
    other = next(standard_views(models, CATEGORY, 1, seed=4))
    assert not np.array_equal(other.T_camera_base, few[0].T_camera_base)


def test_noise_leaves_the_truth_alone(models: list[ObjectModel]) -> None:
    clean, noisy = (standard_view(models[0], CATEGORY, (0, 0, 0), noise) for noise in (None, ON))
    assert np.array_equal(clean.states, noisy.states)
    assert np.array_equal(clean.T_camera_base, noisy.T_camera_base)
    assert not np.array_equal(clean.depth, noisy.depth)
    assert np.array_equal(noisy.labels != NOTHING, noisy.depth > 0)


@pytest.mark.parametrize("elevation", [-math.pi / 2, math.pi / 2])
def test_poses_are_rotations_from_straight_above_and_below(elevation: float) -> None:
    views, ball = ViewRange(math.pi, (elevation, elevation), 0.1), (torch.zeros(4, 3), torch.ones(4))
    R = sample_poses(views, *(one.double() for one in ball))[:, :3, :3]
    np.testing.assert_allclose(R @ R.mT, np.eye(3)[None].repeat(4, 0), atol=1e-9)


def test_an_object_that_cannot_be_seen_is_refused(models: list[ObjectModel], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("omad.data.rendering.standard_views.ATTEMPTS", 3)
    thread = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1e-9, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match=models[0].name):
        standard_view(replace(models[0], parts=(thread, thread)), CATEGORY, (0,))


def test_a_folder_holds_the_same_views(models: list[ObjectModel], tmp_path: Path) -> None:
    folder = render_to_folder(models, CATEGORY, tmp_path, 5, seed=2, noise=ON)
    assert (folder.category, folder.noise, len(folder)) == ("dishwasher", ON, 5)
    for read, drawn in zip(open_views(tmp_path), standard_views(models, CATEGORY, 5, 2, ON), strict=True):
        assert read.object == drawn.object
        assert read.seed == drawn.seed
        assert read.camera == drawn.camera
        assert np.array_equal(read.labels, drawn.labels)
        assert np.abs(read.depth - drawn.depth).max() <= folder.depth_scale * 0.51
        assert np.array_equal(read.states, drawn.states)
        assert np.array_equal(read.T_camera_base, drawn.T_camera_base)
        for key in ("axes", "pivots", "limits", "part_boxes"):
            assert np.array_equal(getattr(read.truth, key), getattr(drawn.truth, key))


@pytest.mark.slow
@pytest.mark.usefixtures("begun_quickly")
def test_the_bytes_do_not_depend_on_processes_or_interruptions(
    models: list[ObjectModel], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    render_to_folder(models, CATEGORY, tmp_path / "once", 8)
    render_to_folder(models, CATEGORY, tmp_path / "two", 8, processes=2)

    class Killed(BaseException):
        pass

    def killed_at_the_fifth(*arguments: object, **named: object) -> object:
        drawn.append(1)
        if len(drawn) == 5:
            raise Killed
        return standard_view(*arguments, **named)  # type: ignore[arg-type]

    drawn: list[int] = []
    with monkeypatch.context() as patch:
        patch.setattr(view_folder, "standard_view", killed_at_the_fifth)
        with pytest.raises(Killed):
            render_to_folder(models, CATEGORY, tmp_path / "twice", 8)
        with pytest.raises(InputError, match="twice"):
            open_views(tmp_path / "twice")
        render_to_folder(models, CATEGORY, tmp_path / "twice", 8)
    assert len(drawn) == 5 + 4
    assert contents(tmp_path / "once") == contents(tmp_path / "two") == contents(tmp_path / "twice")


@pytest.mark.parametrize(("views", "processes", "begun", "each"), [(10, 4, 4, 3), (3, 8, 3, 1), (100, 2, 2, 8)])
def test_few_views_are_dealt_out_to_all_processes(views, processes, begun, each, tmp_path, monkeypatch):
    class Pool(ThreadPoolExecutor):
        def map(self, work, seeds, chunksize):  # pyright: ignore
            asked.append(chunksize)
            return super().map(work, seeds)

    def helpers(count, begin, draw):
        asked.append(count)
        monkeypatch.setattr(view_folder, "_drawing", draw, raising=False)
        return Pool(count)

    asked, drawn = [], []
    monkeypatch.setattr(view_folder, "helpers", helpers)
    view_folder.draw_missing(drawn.append, lambda seed: tmp_path / "none", 2, views, 0, processes)
    assert asked == [begun, each]
    assert len(drawn) == views


def test_more_views_can_be_added_but_other_settings_are_refused(models: list[ObjectModel], tmp_path: Path) -> None:
    render_to_folder(models[:1], CATEGORY, tmp_path / "grown", 1)
    render_to_folder(models[:1], CATEGORY, tmp_path / "grown", 3)
    render_to_folder(models[:1], CATEGORY, tmp_path / "straight", 3)
    assert contents(tmp_path / "grown") == contents(tmp_path / "straight")
    for word, changed in (
        ("seed", lambda: render_to_folder(models[:1], CATEGORY, tmp_path / "grown", 3, seed=1)),
        ("noise", lambda: render_to_folder(models[:1], CATEGORY, tmp_path / "grown", 3, noise=ON)),
        ("objects", lambda: render_to_folder(models, CATEGORY, tmp_path / "grown", 3)),
        ("3 views", lambda: render_to_folder(models[:1], CATEGORY, tmp_path / "grown", 2)),
        (
            models[0].name,
            lambda: render_to_folder([replace(models[1], name=models[0].name)], CATEGORY, tmp_path / "grown", 3),
        ),
    ):
        with pytest.raises(InputError, match=word):
            changed()
    assert contents(tmp_path / "grown") == contents(tmp_path / "straight")


def test_broken_folders_are_named(models: list[ObjectModel], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"dataset\.json"):
        open_views(tmp_path)
    with pytest.raises(InputError, match=models[0].name):
        render_to_folder([models[0], models[0]], CATEGORY, tmp_path, 2)
    with pytest.raises(InputError, match=r"\.\./out"):
        render_to_folder([replace(models[0], name="../out")], CATEGORY, tmp_path, 2)
    render_to_folder(models, CATEGORY, tmp_path, 3)
    depth = tmp_path / models[0].name / "00000.depth.png"
    whole = depth.read_bytes()
    depth.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"00000\.depth\.png"):
        list(open_views(tmp_path))
    (tmp_path / models[1].name / "object.json").write_text("{")
    rest = open_views(tmp_path, broken="skip")
    assert [view.object for view in rest] == [models[2].name]
    assert [left["name"] for left in rest.left_out] == [models[1].name, f"{models[0].name}/00000"]
    assert "00000.depth.png: not readable" in rest.left_out[1]["reason"]
    assert not [*rest.after(1)]
    record = json.loads((tmp_path / "dataset.json").read_text())
    (tmp_path / "dataset.json").write_text(json.dumps({**record, "format": "else"}))
    with pytest.raises(InputError, match="format"):
        open_views(tmp_path)


def test_a_lid_of_a_jar_that_is_made_smaller_is_as_far_open():
    own, small = (draw_tabletop(["jar"], (0, 1), largest=largest) for largest in (np.inf, 0.05))
    for one, other in zip(own.objects, small.objects, strict=True):
        assert np.array_equal(one.states, other.states)


def test_drawers_of_a_chest_that_is_made_smaller_are_open_by_less():
    own, small = (draw_tabletop(["drawer"], (0, 1), largest=largest) for largest in (np.inf, 0.2))
    for one, other in zip(own.objects, small.objects, strict=True):
        if one.category:
            factor = other.states / one.states
            assert factor.max() < 0.9
            np.testing.assert_allclose(factor, factor[0])


def test_objects_fill_as_much_of_the_height_as_stated_and_cameras_roll():
    balls = torch.zeros(2000, 3).double(), torch.ones(2000).double()
    poses = sample_poses(ViewRange(1e-6, (0.0, 0.0), 0.3), *balls, torch.Generator().manual_seed(0))
    share = 2 * CAMERA.fy / CAMERA.height / (poses[:, 2, 3] ** 2 - 1).sqrt()
    np.testing.assert_allclose([share.min(), share.max()], SPAN, atol=0.01)
    roll = torch.atan2(poses[:, 0, 1], -poses[:, 1, 1])
    np.testing.assert_allclose([roll.min(), roll.max()], [-0.3, 0.3], atol=0.01)
