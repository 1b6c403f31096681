"""Every spoil does what it says, as far as it says, and leaves the truth alone."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from helpers.categories import CATEGORIES
from omad.applications.cluster import render as cluster_render
from omad.applications.cluster.render import RenderWork
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering import view_folder
from omad.data.rendering.rasteriser import NOTHING, render
from omad.data.rendering.spoils.depths import blotted, patched, wavy
from omad.data.rendering.spoils.masks import grown, shifted, with_rim, without_part
from omad.data.rendering.spoils.occluders import occluder
from omad.data.rendering.spoils.scenes import (
    BACKGROUND,
    DISTANCES,
    FOCAL_LIMITS,
    OBJECT,
    SpoilScene,
    draw_scene,
    random_camera,
    scene_of,
)
from omad.data.rendering.spoils.spoil import Spoil, Staging, random_spoil
from omad.data.rendering.spoils.spoiling import cluttered, spoilt
from omad.data.rendering.spoils.thinned import FEWEST, some_points
from omad.data.rendering.standard_views import MIN_PIXELS, standard_view
from omad.data.rendering.view_folder import open_views, render_to_folder
from omad.geometry.camera import STANDARD_CAMERA
from omad.objects.model import ObjectModel

NAMES = ("laptop", "eyeglasses", "dishwasher")
AS_IT_IS = Staging()


def model(name: str = "laptop", index: int = 0) -> ObjectModel:
    return generate(CATEGORIES[name], index, "test")


def scene(staging: Staging = AS_IT_IS, name: str = "laptop", index: int = 0) -> SpoilScene:
    return draw_scene(model(name, index), CATEGORIES[name], (0, index, 0), staging)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def disc(radius: float = 60) -> np.ndarray:
    v, u = np.indices((240, 320))
    return (u - 150) ** 2 + (v - 120) ** 2 < radius**2


@pytest.mark.parametrize("pixels", [1, 3, 6])
def test_masks_grow_and_shrink_by_exactly_so_many_pixels(pixels: int) -> None:
    mask = disc()
    mask[:, 300:] = True  # at the image's border
    v, u = np.indices((2 * pixels + 1, 2 * pixels + 1)) - pixels
    ball = u**2 + v**2 <= pixels**2
    assert np.array_equal(grown(mask, pixels), ndimage.binary_dilation(mask, ball))
    assert np.array_equal(grown(mask, -pixels), ndimage.binary_erosion(mask, ball, border_value=1))
    assert np.array_equal(grown(mask, 0), mask)
    assert not grown(np.zeros_like(mask), pixels).any()
    assert grown(np.ones_like(mask), -pixels).all()


def test_a_shifted_mask_is_the_same_elsewhere() -> None:
    moved = shifted(disc(), 4, rng())
    assert moved.sum() == disc().sum()
    by = np.array(ndimage.center_of_mass(moved)) - ndimage.center_of_mass(disc())
    assert np.linalg.norm(by) == pytest.approx(4, abs=0.75)  # whole pixels


def test_a_rim_is_of_the_occluder_and_so_wide() -> None:
    mask, other = disc() & (np.arange(320) < 150), np.broadcast_to(np.arange(320) >= 152, (240, 320))
    rim = with_rim(mask, other, 4) & ~mask
    assert not (rim & ~other).any()
    assert np.array_equal(np.unique(np.nonzero(rim)[1]), [152, 153])


def test_a_mask_misses_one_whole_part_that_shows_and_nothing_else() -> None:
    labels = np.full((240, 320), NOTHING, dtype=np.uint8)
    labels[:, :150], labels[:100, 150:] = 0, 2
    left_out = set()
    for seed in range(8):
        lost = disc() & ~without_part(disc(), labels, rng(seed))
        [part] = np.unique(labels[lost])
        assert np.array_equal(lost, disc() & (labels == part))
        left_out.add(int(part))
    assert left_out == {0, 2}
    assert np.array_equal(without_part(labels == 2, labels, rng()), labels == 2)  # else nothing would be left


def test_a_patch_is_one_has_its_share_and_is_3_to_20_cm_off() -> None:
    depth = np.where(disc(), 1.0, 2.0).astype(np.float32)
    signs = set()
    for seed in range(8):
        error = patched(depth, disc(), 0.03, rng(seed)) - depth
        wrong = error != 0
        assert wrong.sum() == round(0.03 * disc().sum())
        assert not wrong[~disc()].any()
        assert ndimage.label(wrong, np.ones((3, 3)))[1] == 1
        assert 0.03 <= np.abs(error[wrong]).min() == np.abs(error[wrong]).max() <= 0.2
        signs.add(np.sign(error[wrong][0]))
    assert signs == {-1, 1}


def test_lost_pixels_have_their_share_of_the_object() -> None:
    depth = np.ones((240, 320), dtype=np.float32)
    lost = blotted(depth, disc(), 0.3, rng()) == 0
    assert lost[disc()].mean() == pytest.approx(0.3, abs=0.005)


def test_waves_have_their_size_and_are_smooth() -> None:
    depth = np.ones((240, 320), dtype=np.float32)
    error = np.stack([wavy(depth, 0.01, rng(seed)) for seed in range(30)]) - 1.0
    assert error.std() == pytest.approx(0.01, rel=0.05)
    assert (error[..., 8:] * error[..., :-8]).mean() / error.var() == pytest.approx(0.93, abs=0.03)
    assert not wavy(np.zeros_like(depth), 0.01, rng()).any()


@pytest.mark.parametrize("share", [0.1, 0.25])
@pytest.mark.parametrize("name", NAMES)
def test_an_occluder_hides_what_is_asked_from_in_front(name: str, share: float) -> None:
    for index in range(4):
        thing = scene(name=name, index=index).thing
        front = occluder(thing.depth > 0, thing.depth, STANDARD_CAMERA, share, rng(index))
        covers = front.depth > 0
        assert covers[thing.depth > 0].mean() == pytest.approx(share, abs=0.03)
        assert front.depth[covers].max() < thing.depth[thing.depth > 0].min() * 1.05


def test_with_nothing_wrong_it_is_the_standard_view() -> None:
    for name in NAMES:
        plain = spoilt(scene(name=name), Spoil())
        standard = standard_view(model(name), CATEGORIES[name], (0, 0, 0))
        assert np.array_equal(plain.view.depth, standard.depth)
        assert np.array_equal(plain.view.labels, standard.labels)
        assert np.array_equal(plain.view.observation().points, standard.observation().points)
        assert np.array_equal(plain.view.T_camera_base, standard.T_camera_base)
        assert set(np.unique(plain.instances)) == {OBJECT, NOTHING}


@pytest.mark.parametrize("place", ["wall", "table", "shelf", "clutter"])
def test_surroundings_do_not_hide_the_object_and_are_no_part_of_it(place) -> None:
    for index in range(3):
        alone, staged = scene(index=index), scene(Staging(place), index=index)
        assert np.array_equal(alone.T_camera_base, staged.T_camera_base)
        assert np.array_equal(alone.states, staged.states)
        made, seen = spoilt(staged, Spoil()), alone.thing.depth > 0
        assert (made.instances[seen] == OBJECT).mean() > 0.98
        assert (made.instances[~seen] != OBJECT).all()
        on = made.view.labels != NOTHING
        assert np.array_equal(on, made.instances == OBJECT)
        assert np.array_equal(made.view.mask, on)
        assert np.array_equal(made.view.depth[on], alone.thing.depth[on])


def test_there_is_a_wall_behind_and_a_table_below() -> None:
    for index in range(3):
        wall, table = (spoilt(scene(Staging(place), index=index), Spoil()) for place in ("wall", "table"))
        beside = grown(wall.view.mask, 3) & ~wall.view.mask
        assert (wall.instances[beside] == BACKGROUND).mean() > 0.95
        assert wall.view.depth[beside].min() > wall.view.depth[wall.view.mask].min()
        rows, columns = np.nonzero(table.instances == BACKGROUND)
        view = table.view
        points = view.camera.backproject(np.stack([columns, rows], 1), view.depth[rows, columns])
        base = np.linalg.inv(view.T_camera_base)
        heights = points @ base[1, :3] + base[1, 3]
        lowest = np.concatenate(model(index=index).posed_vertices(view.states))[:, 1].min()
        assert heights.max() <= lowest + 1e-4


@pytest.mark.parametrize("share", [0.1, 0.25])
@pytest.mark.parametrize("name", NAMES)
def test_the_border_cuts_off_what_is_asked_and_the_truth_moves_along(name: str, share: float) -> None:
    for index in range(4):
        cut = scene(Staging(cut_off=share), name, index)
        wider = replace(STANDARD_CAMERA, width=2560, height=1920, cx=1279.5, cy=959.5)
        whole = render(model(name, index), cut.states, cut.T_camera_base, wider).depth > 0
        assert 1 - np.count_nonzero(cut.thing.depth) / whole.sum() == pytest.approx(share, abs=0.02)
        exact = render(model(name, index), cut.states, cut.T_camera_base, STANDARD_CAMERA)
        assert np.array_equal(exact.depth, cut.thing.depth)


def test_cameras_are_such_as_there_are() -> None:
    for seed in range(20):
        camera = random_camera(rng(seed))
        assert FOCAL_LIMITS[0] <= camera.fx <= FOCAL_LIMITS[1]
        assert 320 <= camera.width <= 1280
    for index in range(4):
        seen = scene(Staging(any_camera=True), "eyeglasses", index)
        assert DISTANCES[0] * 0.7 < seen.distance < DISTANCES[1]
        assert seen.thing.depth.shape == (seen.camera.height, seen.camera.width)


def test_spoils_leave_pose_and_states_alone_and_do_not_disturb_each_other() -> None:
    staged = scene(Staging("clutter"))
    alone = spoilt(staged, Spoil(hidden=0.2)).view
    both = spoilt(staged, Spoil(hidden=0.2, patch=0.03, lost=0.05, rim=2, grown=3, noise="active_stereo")).view
    for view in (alone, both):
        assert np.array_equal(view.states, staged.states)
        assert np.array_equal(view.T_camera_base, staged.T_camera_base)
    again = spoilt(staged, Spoil(hidden=0.2)).view
    assert np.array_equal(alone.depth, again.depth)
    assert np.array_equal(alone.mask, again.mask)
    assert both.mask is not None
    assert not (alone.mask & ~both.mask).any()  # the same occluder
    assert np.array_equal(both.labels != NOTHING, (both.labels != NOTHING) & (both.depth > 0))


def test_hidden_pixels_are_no_part_and_not_in_the_mask_but_for_the_rim() -> None:
    staged = scene()
    plain, rim = (spoilt(staged, Spoil(hidden=0.25, rim=pixels)) for pixels in (0, 2))
    seen = staged.thing.depth > 0
    assert (plain.instances[seen] == OBJECT).mean() == pytest.approx(0.75, abs=0.03)
    assert np.array_equal(plain.view.mask, plain.instances == OBJECT)
    extra = rim.view.mask & ~plain.view.mask
    assert extra.any()
    assert (rim.instances[extra] > OBJECT).all()
    assert not (extra & ~grown(plain.view.mask, 2)).any()


def test_a_view_that_is_there_can_be_spoilt_but_not_seen_from_elsewhere() -> None:
    view, category = standard_view(model(), CATEGORIES["laptop"], (0, 0, 0)), CATEGORIES["laptop"]
    assert scene_of(view, category, Staging(all_around=True)) is None
    assert scene_of(view, category, Staging(cut_off=0.2)) is None
    same = scene_of(view, category, Staging())
    assert same is not None
    assert np.array_equal(spoilt(same, Spoil()).view.depth, view.depth)
    before_wall = scene_of(view, category, Staging("wall"))
    assert before_wall is not None
    framed = spoilt(before_wall, Spoil()).view
    assert (framed.depth > 0).mean() > 0.9
    kept = scene_of(framed, category, Staging("table"))  # it has surroundings of its own
    assert kept is not None
    assert np.array_equal(spoilt(kept, Spoil()).view.depth, framed.depth)
    narrow = framed.mask & (np.arange(framed.mask.shape[1]) < 320)  # not all that is labelled, and beside it a wall
    narrow[:9] = True
    masked = scene_of(replace(framed, mask=narrow), category, Staging())
    assert np.array_equal(spoilt(masked, Spoil()).view.mask, narrow)
    hidden = spoilt(masked, Spoil(hidden=0.25))
    assert np.array_equal(hidden.view.mask, narrow & (hidden.instances <= OBJECT))


def test_random_spoils_show_the_object_and_repeat() -> None:
    category = CATEGORIES["laptop"]
    (spoil, made), (same, again) = (cluttered(model(), category, (3, 0, 1)) for _ in range(2))
    assert spoil == same
    assert np.array_equal(made.view.depth, again.view.depth)
    assert ((made.view.labels != NOTHING) & made.view.mask).sum() >= MIN_PIXELS
    assert len({random_spoil(rng(seed)) for seed in range(30)}) == 30


def test_labels_and_instances_are_nothing_where_it_is_too_far_for_the_file(tmp_path: Path, monkeypatch) -> None:
    for writer in (view_folder, cluster_render):
        monkeypatch.setattr(writer, "depth_scale_of", lambda category: 1.5e-5)  # a metre
    render_to_folder([model()], CATEGORIES["laptop"], tmp_path, 3, clutter=True)
    rows = RenderWork("laptop", "procedural", 1, "test", 0, "off", clutter=True)(0, 3)
    for number, (view, row) in enumerate(zip(open_views(tmp_path), rows, strict=True)):
        instances = np.asarray(Image.open(tmp_path / view.object / f"{number:05d}.instances.png"))
        assert np.array_equal(instances == NOTHING, view.depth == 0)
        assert np.array_equal(view.labels == NOTHING, instances != OBJECT)
        for name, image in (("labels", view.labels), ("instances", instances)):
            assert np.array_equal(np.asarray(Image.open(io.BytesIO(row[name]))), image)


def test_a_cluttered_folder_holds_the_same_views(tmp_path: Path) -> None:
    category, models = CATEGORIES["dishwasher"], [model("dishwasher", index) for index in range(2)]
    folder = render_to_folder(models, category, tmp_path, 4, seed=1, clutter=True)
    assert folder.clutter
    for index, read in enumerate(open_views(tmp_path)):
        _, drawn = cluttered(models[index % 2], category, (1, index % 2, index // 2))
        assert read.camera == drawn.view.camera
        assert np.array_equal(read.mask, drawn.view.mask)
        assert np.array_equal(read.labels, drawn.view.labels)
        stored = drawn.view.depth < folder.depth_scale * (2**16 - 1)
        assert np.abs(read.depth - drawn.view.depth)[stored].max() <= folder.depth_scale * 0.51
        assert np.array_equal(read.T_camera_base, drawn.view.T_camera_base)
    with pytest.raises(InputError, match="clutter"):
        render_to_folder(models, category, tmp_path, 4, seed=1)


@pytest.mark.parametrize("count", [1, FEWEST, 20_000])
def test_some_points_are_left_of_a_cloud(count):
    left = [some_points(count, np.random.default_rng(seed)) for seed in range(300)]
    counts = np.array([len(np.unique(some)) for some in left])
    assert all(len(some) == few and some.max() < count for some, few in zip(left, counts, strict=True))
    assert min(FEWEST, count) <= counts.min() + 1
    assert counts.max() <= count
    if count > FEWEST:
        assert np.log(counts).mean() == pytest.approx(np.log(FEWEST * count) / 2, abs=0.2)


def test_labels_go_with_the_outlines_that_wander():
    for index in range(2):
        view = spoilt(scene(index=index), Spoil(noise="active_stereo")).view
        assert np.array_equal(view.labels != NOTHING, view.depth > 0)


def test_waves_are_shares_of_the_object():
    errors = []
    for index in range(4):
        staged = scene(name="eyeglasses", index=index)
        plain, waved = (spoilt(staged, Spoil(waves=waves)).view for waves in (0.0, 0.02))
        errors.append((waved.depth - plain.depth)[plain.mask].std() / staged.truth.diagonal)
    assert np.mean(errors) == pytest.approx(0.02, rel=0.3)
