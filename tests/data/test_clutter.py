"""Spoilt training views: every spoil does what it says, to no more than it says."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import ndimage

from helpers.categories import EYEGLASSES, LAPTOP
from omad.data.clutter.correlated_noise import add_correlated_noise
from omad.data.clutter.outline import ACROSS, REACH, Grid, Outline, plain_outline
from omad.data.clutter.regions import Boxes, smooth_field
from omad.data.clutter.settings import Clutter
from omad.data.clutter.spoil import SampledScene
from omad.data.clutter.spoils import Places, in_front, mask_of, of_wrong_depth, out_of_sight
from omad.data.clutter.surroundings import background_depth, plane_depth
from omad.data.point_views import CELLS
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_views
from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewSettings, draw_views
from omad.geometry.kinematics import part_transforms
from omad.geometry.transforms import invert_transform, make_transform, so3_exp, transform_points
from omad.sensing.point_choice import choose_points

SHARES = ["surrounded", "beside", "eroded", "flying", "patched", "occluded", "rim", "cut", "blobs", "correlated"]
SHARES += ["around", "resized"]
NOTHING = replace(Clutter(), clean=0.0, shift=0.0, **dict.fromkeys(SHARES, 0.0))
"""Every view goes through all spoils, and none happens."""
BATCH = 12


def random() -> torch.Generator:
    return torch.Generator().manual_seed(4)


@pytest.fixture(scope="module")
def bank() -> SurfaceBank:
    return SurfaceBank.from_models([generate(LAPTOP, i) for i in range(4)], LAPTOP)


def draw(bank: SurfaceBank, clutter: Clutter | None, batch: int = BATCH, seed: int = 0, noise: float = 0.0):
    settings = ViewSettings(points=512, noise=noise, clutter=clutter)
    return draw_views(bank, LAPTOP, batch, settings, torch.Generator().manual_seed(seed))


def shares_outside(labels: torch.Tensor) -> torch.Tensor:
    return (labels == len(LAPTOP.parts)).float().mean(1)


@pytest.fixture(scope="module")
def discs() -> tuple[Grid, torch.Tensor, torch.Tensor]:
    """Samples of discs of half the sphere's radius and 4 away, with a hole, and which are seen: one a cell."""
    batch = 3
    xy = 2 * torch.rand(batch, 20000, 2, generator=random()) - 1
    length = xy.norm(dim=-1)
    xy = torch.where(((length < 0.6) & (length > 0.2))[..., None], xy, xy.new_tensor([0.4, 0.0]))
    points = torch.cat([4 * xy * 0.25, torch.full((batch, 20000, 1), 4.0)], -1)
    grid = Grid.over(torch.tensor([[0.0, 0.0, 4.0]]).expand(batch, 3), torch.ones(batch))
    places = (grid.places(points) / 2).long()
    cell = places[..., 1] * CELLS + places[..., 0]
    seen = torch.zeros(points.shape[:2], dtype=torch.bool)
    for b in range(batch):
        seen[b, np.unique(cell[b].numpy(), return_index=True)[1]] = True
    return grid, points, seen


def places_of(grid: Grid, outline: Outline) -> Places:
    """The middles of all cells; samples of the object are those that an owner says."""
    number = torch.arange(CELLS**2)
    at = 2 * torch.stack([number % CELLS, number // CELLS], -1) + 1.0
    at = at.expand(len(grid.half), -1, 2)
    return Places.of(at, outline.owner >= 0, grid, outline, torch.ones(len(at), ACROSS**2, dtype=torch.bool))


def test_outline_is_that_of_a_distance_transform(discs):
    grid, points, seen = discs
    outline = Outline.of(points, seen, grid)
    for b in range(len(points)):
        place = grid.places(points)[b].long().numpy()
        there = np.zeros((ACROSS + 2, ACROSS + 2), bool)
        there[place[:, 1] + 1, place[:, 0] + 1] = True
        there = ndimage.binary_closing(there, np.ones((3, 3)))[1:-1, 1:-1]
        outward = ndimage.distance_transform_cdt(~there, "chessboard").clip(0, REACH + 1)
        inward = ndimage.distance_transform_cdt(there, "chessboard").clip(1, REACH + 1) - 1
        np.testing.assert_array_equal(outline.steps[b].view(ACROSS, ACROSS), np.where(there, -inward, outward))
        depth = outline.depth[b].view(ACROSS, ACROSS).numpy()
        np.testing.assert_allclose(depth[outward <= REACH], 4.0, rtol=1e-6)
        assert np.isinf(depth[outward > REACH]).all()


def test_compiled_outlines_are_the_plain_ones(discs):
    grid, points, seen = discs
    points = points * (1 + 0.1 * torch.rand(points.shape[:2], generator=random()))[..., None]  # along the rays
    ours, plain = Outline.of(points, seen, grid), plain_outline(points, seen, grid)
    # rounding may put a sample at the rim of a sub-cell into its neighbour
    for name in ("steps", "owner"):
        assert (getattr(ours, name) != getattr(plain, name)).float().mean() < 1e-3, name
    off = ~torch.isclose(ours.depth, plain.depth, rtol=1e-5)
    assert off.float().mean() < 1e-3


def test_a_mask_is_as_much_too_wide_as_it_says(discs):
    grid, points, seen = discs
    outline = Outline.of(points, seen, grid)
    three = 3.0 / grid.pixel[0].item()  # sub-cells
    wide = replace(NOTHING, surrounded=1.0, margin=(three, three))
    mask = mask_of(outline.steps, grid, wide, random())
    uneven = mask & (outline.steps > 3)
    even = ~uneven.any(1)
    assert even.any()
    assert torch.equal(mask[even], outline.steps[even] <= 3)
    # where it is not the same all around it is up to twice as wide on one side
    assert not (mask & (outline.steps > 6)).any()
    narrow = replace(NOTHING, eroded=1.0, loss=(three, three))
    mask = mask_of(outline.steps, grid, narrow, random())
    assert torch.equal(mask[even], outline.steps[even] <= -3)
    assert torch.equal(mask_of(outline.steps, grid, NOTHING, random()), outline.steps <= 0)


def test_planes_are_where_rays_meet_them():
    rays = torch.tensor([[[0.1, -0.2], [0.0, 0.5], [0.0, -0.5]]])
    normal, through = torch.tensor([[0.0, -1.0, 0.0]]), torch.tensor([[3.0, 2.0, 1.0]])
    depth = plane_depth(rays, normal, through)
    assert depth[0, 1].item() == pytest.approx(4.0)  # y / z = 0.5 is at y = 2 there
    assert torch.isinf(depth[0, [0, 2]]).all()  # these look up
    wall = plane_depth(rays, torch.tensor([[0.2, 0.1, -1.0]]), through)
    on = torch.cat([rays, torch.ones(1, 3, 1)], -1) * wall[..., None] - through
    assert torch.allclose(on @ torch.tensor([0.2, 0.1, -1.0]), torch.zeros(3), atol=1e-6)


def test_background_is_behind_the_object():
    grid = Grid.over(torch.tensor([[0.0, 0.0, 4.0]]).expand(BATCH, 3), torch.ones(BATCH))
    rays = grid.rays(ACROSS * torch.rand(BATCH, 50, 2, generator=random()))
    edge = torch.full((BATCH, 50), 4.3)
    centre, up = torch.tensor([[[0.0, 0.0, 4.0]], [[0.0, -1.0, 0.0]]]).expand(2, BATCH, 3)
    depth = background_depth(rays, edge, centre, up, centre - 0.5 * up, NOTHING, random())
    assert (depth > edge).all()
    assert depth.isfinite().all()
    # tables are just under the object: never more than a thirtieth of a unit below its lowest point
    height = rays[..., 1] * depth
    on_table = (height > 0.5 - 1e-5) & (height < 0.53 + 1e-5)
    assert 0.1 < on_table.any(1).float().mean() < 0.9


def test_turned_boxes_know_what_is_inside():
    box = Boxes(torch.tensor([[10.0, 5.0]]), torch.tensor([[4.0, 1.0]]), torch.tensor([np.pi / 2]))
    places = torch.tensor([[[10.0, 8.0], [10.5, 8.0], [13.0, 5.0], [10.0, 9.5]]])
    assert torch.allclose(box.depth_inside(places), torch.tensor([[1.0, 0.5, -2.0, -0.5]]), atol=1e-5)


def test_patches_are_of_wrong_depth_and_of_the_asked_size(discs):
    grid, points, seen = discs
    outline = Outline.of(points, seen, grid)
    places = places_of(grid, outline)
    patched = replace(NOTHING, patched=1.0, patch=(0.02, 0.02), wrong=(0.3, 0.4))
    foreign, depth = of_wrong_depth(places, torch.full(places.on_object.shape, 9.0), patched, random())
    patch = foreign & places.on_object
    off = (depth - 4.0)[patch].abs()
    assert ((off > 0.299) & (off < 0.401)).all()
    assert (depth[~places.on_object] == 9.0).all()
    share = patch.sum(1) / (outline.owner >= 0).sum(1)
    assert (share < 0.03).all()  # some of a patch may lie beside the object
    assert share.max() > 0.012


def test_what_is_in_front_hides_less_than_half_and_leaves_a_rim(discs):
    grid, points, seen = discs
    places = places_of(grid, Outline.of(points, seen, grid))
    centre = torch.tensor([[0.0, 0.0, 4.0]]).expand(len(points), 3)
    covered, rim, depth = in_front(places, centre, replace(NOTHING, occluded=1.0, rim=1.0), random())
    own = places.samples
    assert ((covered & own).sum(1) <= 0.5 * own.sum(1)).all()
    assert (covered & rim).any()
    assert (covered & ~rim).any()
    assert (depth < places.edge_depth).all()
    assert not in_front(places, centre, NOTHING, random())[0].any()
    assert not (covered & in_front(places, centre, replace(NOTHING, occluded=1.0), random())[1]).any()


def test_the_border_cuts_straight_and_less_than_half(discs):
    grid, points, seen = discs
    places = places_of(grid, Outline.of(points, seen, grid))
    gone = out_of_sight(places, replace(NOTHING, cut=1.0), random())
    assert gone.any(1).all()
    assert ((gone & places.samples).sum(1) <= 0.5 * places.samples.sum(1)).all()
    for image in gone.view(-1, CELLS, CELLS):
        assert (image == image[:1]).all() or (image == image[:, :1]).all()  # a row or a column of cells at a time
    assert not out_of_sight(places, NOTHING, random()).any()


def test_smooth_fields_are_alike_nearby_and_strangers_far_off():
    along = torch.arange(0, 40, 0.5)[None].expand(400, -1)
    places = torch.stack([along, 0.3 * along], -1)
    field = smooth_field(places, torch.full((400,), 4.0), random())
    assert field.mean().abs() < 0.05
    assert 0.9 < field.std() < 1.1

    def correlation(distance: float) -> float:
        step = round(distance / 0.5)
        return np.corrcoef(field[:, :-step].flatten(), field[:, step:].flatten())[0, 1]

    assert correlation(0.5) > 0.9
    assert correlation(3.0) > 0.2
    assert abs(correlation(10.0)) < 0.1


def test_correlated_noise_moves_points_along_their_rays():
    xy = 2 * torch.rand(400, 100, 2, generator=random()) - 1
    points = torch.cat([xy, torch.full((400, 100, 1), 4.0)], -1)
    grid = Grid.over(torch.tensor([[0.0, 0.0, 4.0]]).expand(400, 3), torch.ones(400))
    noisy = torch.arange(400) < 200
    always = replace(Clutter(), correlated=1.0, amplitude=0.1)
    moved = add_correlated_noise(points, grid, noisy, always, random())
    assert torch.equal(moved[200:], points[200:])
    assert torch.allclose(moved[..., :2] / moved[..., 2:], points[..., :2] / 4.0, atol=1e-6)
    off = (moved - points)[:200, :, 2]
    # a uniform spread between 0 and the amplitude
    assert off.square().mean().sqrt().item() == pytest.approx(0.1 / np.sqrt(3), rel=0.1)


def test_spoilt_views_of_which_nothing_is_spoilt_show_the_same_cells(bank):
    """The same cameras and states, and every visible cell still has its point of the object."""
    spared, spoilt = (draw(bank, replace(NOTHING, clean=clean)) for clean in (1.0, 0.0))
    assert torch.equal(spared.T_camera_base, spoilt.T_camera_base)
    for views in (spared, spoilt):
        assert shares_outside(views.labels).max() == 0
    distinct = [[len(points.unique(dim=0)) for points in views.points] for views in (spared, spoilt)]
    assert distinct[0] == distinct[1]


def test_the_same_seed_spoils_the_same_way(bank):
    a, b, c = draw(bank, Clutter()), draw(bank, Clutter()), draw(bank, Clutter(), seed=1)
    assert torch.equal(a.points, b.points)
    assert torch.equal(a.labels, b.labels)
    assert not torch.equal(a.points, c.points)


def test_points_on_the_object_stay_there(bank):
    """Whatever gets into the mask is labelled: without noise all other points are samples of the object's surface."""
    clutter = replace(Clutter(), clean=0.0, correlated=0.0)
    views = draw(bank, clutter, batch=32)
    G = part_transforms(LAPTOP.tree, views.axes, views.pivots, views.states, views.T_camera_base)
    assert shares_outside(views.labels).max() > 0.1
    assert views.points.isfinite().all()
    for b in range(len(views.points)):
        for part in range(2):
            seen = views.points[b][views.labels[b] == part]
            canonical = transform_points(invert_transform(G[b, part]), seen)
            own = (bank.points[views.indices[b]] * views.scale[b])[bank.labels[views.indices[b]] == part]
            if len(seen):
                assert torch.cdist(canonical, own, compute_mode="donot_use_mm_for_euclid_dist").amin(1).max() < 1e-4


def test_shares_of_views_are_those_asked_for(bank):
    views = draw(bank, replace(NOTHING, clean=0.3, surrounded=1.0), batch=300)
    spoilt = (shares_outside(views.labels) > 0).float().mean()
    assert 0.62 < spoilt < 0.78
    sizes = draw(bank, replace(NOTHING, resized=1.0, size=(3.0, 3.0)), batch=20).scale
    assert ((sizes > 2.69) & (sizes < 3.31)).all()


@pytest.mark.slow
@pytest.mark.parametrize("category", [LAPTOP, EYEGLASSES], ids=lambda category: category.name)
def test_as_much_background_as_in_rendered_views(category):
    """A mask three pixels too wide: as large a share of the chosen points as in rendered images with such masks."""
    models = [generate(category, i) for i in range(6)]
    rendered = []
    for view in standard_views(models, category, 24, seed=3):
        there = view.depth > 0
        rows, columns = np.nonzero(ndimage.distance_transform_edt(~there) <= 3)
        points = view.camera.backproject(np.stack([columns, rows], 1), np.ones(len(rows))).astype(np.float32)
        rendered.append((~there[rows, columns])[choose_points(points, 512, 1, 0)[0]].mean())
    clutter = replace(NOTHING, surrounded=1.0, margin=(3.0, 3.0))
    bank = SurfaceBank.from_models(models, category)
    views = draw_views(bank, category, 128, ViewSettings(clutter=clutter), random())
    ours = (views.labels == len(category.parts)).float().mean()
    assert 0.8 < ours / np.mean(rendered) < 1.3


def test_a_table_is_below_all_of_its_object():
    T = make_transform(so3_exp(torch.tensor([[2.0, 0.5, 1.0]])), torch.tensor([[0.1, 0.2, 4.0]]))
    points = torch.randn(1, 50, 3, generator=torch.Generator().manual_seed(0)) + T[:, None, :3, 3]
    none = torch.zeros(1)
    floor = SampledScene(points, none, none, none, none, T).floor()
    above = (points - floor[:, None]) @ T[0, :3, 1]
    assert above.min() == pytest.approx(0, abs=1e-5)
    assert torch.allclose(torch.linalg.cross(floor - T[:, :3, 3], T[:, :3, 1]), torch.zeros(1, 3), atol=1e-5)
