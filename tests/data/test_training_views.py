"""Training views: seeded, right in geometry, and alike to rendered views."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.categories import CATEGORIES, DISHWASHER, LAPTOP
from omad.data.clutter.settings import Clutter
from omad.data.point_views import look, plain_look, plain_pose, plain_visible, pose, visible
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import ON, add_noise
from omad.data.surface_bank import PartSamples, SurfaceBank
from omad.data.training_views import ViewSettings, _add_noise, _at_limits, draw_views
from omad.geometry.camera import STANDARD_CAMERA as CAMERA
from omad.geometry.kinematics import part_transforms
from omad.geometry.transforms import invert_transform, make_transform, transform_points
from omad.objects.model import PointObject

CLEAN = ViewSettings(points=256, noise=0.0)


@pytest.fixture(scope="module")
def bank() -> SurfaceBank:
    return SurfaceBank.from_models([generate(LAPTOP, i) for i in range(4)], LAPTOP, samples=4096)


def draw(bank: SurfaceBank, settings: ViewSettings = CLEAN, batch: int = 6, seed: int = 0):
    return draw_views(bank, LAPTOP, batch, settings, torch.Generator().manual_seed(seed))


def test_same_seed_same_views(bank):
    a, b, c = draw(bank), draw(bank), draw(bank, seed=1)
    assert torch.equal(a.points, b.points)
    assert torch.equal(a.states, b.states)
    assert not torch.equal(a.points, c.points)


def test_points_lie_on_the_stretched_posed_object(bank):
    views = draw(bank)
    G = part_transforms(LAPTOP.tree, views.axes, views.pivots, views.states, views.T_camera_base)
    for b in range(len(views.points)):
        surface = bank.points[views.indices[b]] * views.scale[b]
        for part in range(2):
            seen = views.points[b][views.labels[b] == part]
            if len(seen) == 0:
                continue
            canonical = transform_points(invert_transform(G[b, part]), seen)
            own = surface[bank.labels[views.indices[b]] == part]
            distance = torch.cdist(canonical, own, compute_mode="donot_use_mm_for_euclid_dist")
            assert distance.amin(1).max() < 1e-4


def test_states_stay_within_limits_and_the_object_in_front_of_the_camera(bank):
    views = draw(bank, batch=64)
    limits = bank.limits[views.indices]
    assert (views.states >= limits[..., 0]).all()
    assert (views.states <= limits[..., 1]).all()
    assert (views.points[..., 2] > 0.5).all()
    u = 600 * views.points[..., 0] / views.points[..., 2] + 319.5
    assert (u >= -0.5).all()
    assert (u <= 639.5).all()


def test_some_spoilt_views_are_of_shut_objects(bank):
    settings = ViewSettings(points=256, clutter=Clutter(shut=0.5))
    views = draw(bank, settings, batch=256)
    low, high = bank.limits[views.indices].unbind(-1)
    at_low, at_high = ((views.states == limit).all(1).float().mean() for limit in (low, high))
    assert 0.4 < at_low + at_high < 0.6
    assert 0.1 < min(at_low, at_high) < max(at_low, at_high) < 0.45


def test_a_sheet_hides_what_is_behind_it():
    grid = torch.stack(torch.meshgrid(torch.linspace(-1, 1, 80), torch.linspace(-1, 1, 80), indexing="ij"), -1)
    near = torch.cat([grid.reshape(-1, 2), torch.full((6400, 1), 4.0)], 1)
    far = near * 1.5
    points = torch.cat([near, far])[None]
    seen = visible(points, torch.tensor([[0.0, 0.0, 4.0]]), torch.tensor([1.5]))[0]
    assert seen[:6400].sum() > 500
    assert seen[6400:].sum() == 0


def test_noise_moves_points_as_a_stereo_camera_does(bank):
    settings = ViewSettings(points=256, noise=1e-9), ViewSettings(points=256, noise=2.0)
    clean, noisy = (draw(bank, s, batch=64) for s in settings)
    # the views are the same, and in about half of them points are displaced
    assert torch.equal(clean.T_camera_base, noisy.T_camera_base)
    moved = (clean.points.mean(1) - noisy.points.mean(1)).norm(dim=-1) > 1e-4
    assert 0.25 < moved.float().mean() < 0.75


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CATEGORIES))
def test_generated_objects_are_closed(name):
    assert all(generate(CATEGORIES[name], i).closed for i in range(30))


def test_stretching_carries_joints_along():
    bank = SurfaceBank.from_models([generate(DISHWASHER, 0)], DISHWASHER, samples=64)
    scale = torch.tensor([[1.0, 2.0, 0.5]])
    stretched = bank.scaled(torch.tensor([0]), scale)
    assert torch.allclose(stretched.pivots[0, 0], bank.pivots[0, 0] * scale[0])
    assert torch.allclose(stretched.axes[0, 0], torch.tensor([1.0, 0.0, 0.0]))
    assert np.isclose(stretched.normals.norm(dim=-1).numpy(), 1, atol=1e-5).all()


def test_compiled_views_are_the_plain_ones(bank):
    generator = torch.Generator().manual_seed(5)
    indices, scale = torch.tensor([2, 0, 3]), torch.rand(3, 3, generator=generator) + 0.5
    poses = torch.linalg.qr(torch.randn(9, 3, 3, generator=generator)).Q
    T = make_transform(poses, torch.randn(9, 3, generator=generator))
    T_base_part, T_camera_base = T[:6].unflatten(0, (3, 2)), T[6:].clone()
    T_camera_base[:, 2, 3] += 6.0
    closed, steepest = torch.tensor([True, False, True]), torch.tensor([-1.0, 0.2, 0.3])
    ours, plain = pose(bank, indices, scale, T_base_part), plain_pose(bank, indices, scale, T_base_part)
    for name, expected in vars(plain).items():
        assert torch.allclose(getattr(ours, name), expected, atol=2e-6), name
    points, facing = look(ours, closed, T_camera_base, steepest)
    expected, facing_too = plain_look(plain, closed, T_camera_base, steepest)
    assert torch.allclose(points, expected, atol=1e-5)
    centre = transform_points(T_camera_base, plain.centre[:, None]).squeeze(1)
    seen, seen_too = visible(points, centre, ours.radius), plain_visible(points, centre, ours.radius)
    assert 0.02 < seen.float().mean() < 0.98
    # rounding may put a sample at the rim of a cell, or of what is seen, on its other side
    assert (facing != facing_too).float().mean() < 1e-3
    assert (seen != seen_too).float().mean() < 1e-3


def test_as_many_samples_of_every_part_are_drawn(bank):
    """Of the object asked for, at its stretch, and of small parts no fewer than of large ones."""
    indices, scale = torch.tensor([1, 3]), torch.tensor([[1.0, 2.0, 0.5], [1.2, 1.0, 1.0]])
    samples = PartSamples.of(bank, 2)
    clouds = samples.draw(indices, scale, 50, torch.Generator().manual_seed(0))
    again = samples.draw(indices, scale, 50, torch.Generator().manual_seed(0))
    for part, cloud in enumerate(clouds):
        assert cloud.shape == (2, 50, 3)
        assert torch.equal(cloud, again[part])
        for b, index in enumerate(indices):
            own = bank.points[index][bank.labels[index] == part] * scale[b]
            assert (cloud[b][:, None] - own).abs().amax(-1).amin(1).max() < 1e-6
            assert len(cloud[b].unique(dim=0)) > 40


def test_the_smallest_part_has_samples():
    """As a button has beside a whole cabinet."""
    model = generate(DISHWASHER, 0)
    small = replace(model, parts=(model.parts[0], model.parts[1].warped(lambda v: 0.01 * v)))
    samples = small.surface_samples(8192, np.random.default_rng(0))
    assert np.bincount(samples.labels).min() >= 32
    low, high = small.part_boxes()[1]
    button = samples.points[samples.labels == 1]
    assert (button > low - 1e-6).all()
    assert (button < high + 1e-6).all()
    clouds = [part.vertices for part in small.parts]
    known = PointObject.from_clouds("cloud", clouds, small.axes, small.pivots, small.limits)
    assert np.bincount(known.surface_samples(8192, np.random.default_rng(0)).labels).min() >= 31


def test_noise_is_that_of_rendered_views():
    wall, unit = np.ones((CAMERA.height, CAMERA.width), np.float32), 0.3
    level, random = replace(ON, edge_drop=0, holes=0), np.random.default_rng(0)
    rendered = add_noise(wall, level, CAMERA, random, wall)
    points = torch.tensor([0.0, 0.0, 1 / unit]).expand(1, 20000, 3)
    made = unit * _add_noise(points, torch.ones(1), unit, torch.Generator().manual_seed(0))
    assert float(made[..., 2].std()) == pytest.approx(rendered.std(), rel=0.1)
    assert float(made[..., 0].std()) == pytest.approx(ON.shift / CAMERA.fx, rel=0.1)


def test_shut_objects_are_at_rest_twice_as_often_as_wide_open():
    limits = torch.tensor([[[0.0, 2.0], [-2.0, 0.0]]]).expand(3000, 2, 2)
    states = _at_limits(torch.ones(3000, 2), limits, 1.0, torch.Generator().manual_seed(0))
    np.testing.assert_allclose((states == 0).float().mean(0), 2 / 3, atol=0.04)


def test_points_are_within_the_image(bank):
    points = draw(bank, batch=256).points
    for axis, (focal, centre, size) in enumerate(((600, 319.5, 640), (600, 239.5, 480))):
        place = focal * points[..., axis] / points[..., 2] + centre
        assert (place >= -0.5).all()
        assert (place <= size - 0.5).all()
