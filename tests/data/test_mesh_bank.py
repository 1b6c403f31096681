"""Training views of meshes: what they show is what rays meet first, on the part that they meet."""

import numpy as np
import pytest
import torch

from omad.data.mesh_bank import MeshBank
from omad.data.point_views import CELLS
from omad.data.procedural import generate
from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewSettings, draw_views
from omad.geometry.kinematics import part_transforms
from omad.geometry.transforms import transform_points
from omad.objects.category_file import get_category

CHEST = get_category("drawer")
CLEAN = ViewSettings(points=256, noise=0.0)


@pytest.fixture(scope="module")
def bank() -> MeshBank:
    return MeshBank.of([generate(CHEST, index) for index in range(3)], CHEST)


def first_hits(triangles: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far along the rays to points (N, 3) triangles (F, 3, 3) are met first, 1 at the points, and which triangles
    (Moeller and Trumbore 1997)."""
    a, e, g = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        h = np.cross(points[:, None], g)
        scale = 1 / (h * e).sum(-1)
        u, q = -(h * a).sum(-1) * scale, np.cross(-a, e)
        v, far = (points @ q.T) * scale, (q * g).sum(-1) * scale
    met = np.where((u > -1e-6) & (v > -1e-6) & (u + v < 1 + 1e-6) & (far > 0), far, np.inf)
    return met.min(1), met.argmin(1)


def test_places_are_where_rays_meet_the_object_first(bank):
    views = draw_views(bank, CHEST, 6, CLEAN, torch.Generator().manual_seed(1))
    T = part_transforms(CHEST.tree, views.axes, views.pivots, views.states, views.T_camera_base)
    for b, index in enumerate(views.indices.tolist()):
        labels, faces = bank.labels[index], bank.faces[index]
        corners = transform_points(T[b][labels], (bank.points[index] * views.scale[b])[:, None]).squeeze(1)
        met, face = first_hits(corners.double().numpy()[faces], views.points[b].double().numpy())
        assert met == pytest.approx(1, abs=1e-4)
        assert (labels.numpy()[faces[face, 0]] == views.labels[b].numpy()).mean() > 0.98  # else where parts touch


def test_each_cell_shows_one_place_within_it(bank):
    indices, T = torch.tensor([0, 2]), torch.eye(4)
    T[:3, :3], T[2, 3] = torch.diag(torch.tensor([1.0, -1.0, -1.0])), 6.0
    corners = transform_points(T, bank.points[indices])
    centre, radius = torch.tensor([[0.0, 0.0, 6.0]] * 2), torch.tensor([1.5, 1.5])
    places, there, _ = bank.seen(indices, corners, centre, radius, torch.full((2,), -1.0), torch.Generator())
    assert places.shape == (2, CELLS**2, 3)
    assert there.sum(1).min() > 300
    half = 1.3 * 1.5 / 6
    cell = ((places[..., :2] / places[..., 2:] / half + 1) * CELLS / 2).numpy()
    own = np.arange(CELLS**2)
    assert np.abs(cell[..., 0] - own % CELLS - 0.5)[there].max() < 0.51
    assert np.abs(cell[..., 1] - own // CELLS - 0.5)[there].max() < 0.51


def test_what_is_drawn_is_drawn_where_the_generator_is(bank):
    """An accelerator's generator draws nothing on the CPU: no draw may be left to the default device."""
    given = bank.points[:1], torch.tensor([[0.0, 0.0, 6.0]]), torch.ones(1), torch.full((1,), -1.0)
    indices, corners = torch.tensor([0]), given[0] + given[1]
    with torch.device("meta"):
        places, _, _ = bank.seen(indices, corners, *given[1:], torch.Generator("cpu"))
    assert places.device.type == "cpu"


def test_views_are_those_of_samples_but_for_what_shines_through_these(bank):
    """The same seed gives the same objects in the same poses, and clouds of the same size."""
    models = [generate(CHEST, index) for index in range(3)]
    samples = SurfaceBank.from_models(models, CHEST)
    one, other = (draw_views(each, CHEST, 64, CLEAN, torch.Generator().manual_seed(2)) for each in (bank, samples))
    assert torch.equal(one.states, other.states)
    assert torch.allclose(one.T_camera_base[:, :3, :3], other.T_camera_base[:, :3, :3], atol=1e-5)
    spread = [
        (views.points - views.points.median(1, keepdim=True).values).norm(dim=-1).median(1).values
        for views in (one, other)
    ]
    assert (spread[0] / spread[1]).median() == pytest.approx(1, abs=0.1)


def test_the_same_seed_gives_the_same_views(bank):
    seen = [draw_views(bank, CHEST, 4, CLEAN, torch.Generator().manual_seed(seed)).points for seed in (0, 0, 1)]
    assert torch.equal(seen[0], seen[1])
    assert not torch.equal(seen[0], seen[2])
