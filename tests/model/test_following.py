"""Surfaces that follow what is seen beyond what their template can be."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from omad.geometry.closest import Surface
from omad.geometry.rigid import carry
from omad.model.checkpoint import find_weights, load
from omad.model.fitting.state import State
from omad.model.omadnet import OmadNet
from omad.model.surfaces.fitting import Cloud, FitConfig, SurfaceFit
from omad.model.surfaces.following import LENGTH, SIZE, Displacement, followed
from omad.model.surfaces.placed import Placed, VisibleSurface
from omad.model.surfaces.surfaces import Surfaces


def test_a_displacement_is_the_mean_of_a_gaussian_process():
    rng = np.random.default_rng(0)
    at, off, variances = rng.uniform(-0.2, 0.2, (12, 3)), rng.normal(0, 0.05, (12, 3)), rng.uniform(1e-4, 1e-2, 12)
    move = Displacement.of(at, off, variances)
    alone = Displacement.of(at[:1], off[:1], variances[:1])
    share = SIZE**2 / (SIZE**2 + variances[0])
    assert alone(at[:1]) - at[:1] == pytest.approx(share * off[:1])
    assert alone(at[:1] + 1.0) == pytest.approx(at[:1] + 1.0)  # many lengths away
    # by sequential conditioning: mean and covariance of all points, one measurement after the other
    points = np.concatenate([at, rng.uniform(-0.2, 0.2, (5, 3))])
    apart = np.square(points[:, None] - points).sum(2)
    covariance, mean = SIZE**2 * np.exp(-apart / (2 * LENGTH**2)), np.zeros((len(points), 3))
    for k, variance in enumerate(variances):
        gain = covariance[:, k] / (covariance[k, k] + variance)
        mean = mean + gain[:, None] * (off[k] - mean[k])
        covariance = covariance - np.outer(gain, covariance[k])
    assert move(points) - points == pytest.approx(mean, abs=1e-9)


@pytest.fixture(scope="module")
def scissors():
    """A known pair, where it is placed, and the samples of it that are seen."""
    net = load(OmadNet, find_weights("scissors"))
    surfaces = Surfaces.beside(find_weights("scissors"), net.prior, net.category)
    assert surfaces is not None
    prior, template = surfaces._doubles, surfaces.bank.template(3)
    known = surfaces.bank.keypoints[3].astype(np.float64)
    beta = prior.encode(torch.as_tensor(known)[None])
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3] = torch.as_tensor(Rotation.from_euler("x", 90, degrees=True).as_matrix())  # its flat side
    T[2, 3] = 4.0
    state = State(beta, torch.full((1, 1), -0.5, dtype=torch.float64), T[None])
    own = known - prior.keypoints(beta)[0].numpy()
    placed = Placed.at(prior, state, np.zeros(7 + prior.basis_size), own)
    seen = VisibleSurface.of(placed, template, placed.keypoints + [0, 0, 4.0], 96, 0.01)
    limits = net.category.limits
    return prior, limits, placed, template, seen


def fit_to(prior, limits, placed: Placed, points: np.ndarray, parts: np.ndarray) -> SurfaceFit:
    cloud = Cloud.of(points, parts, 400)
    assert cloud is not None
    return SurfaceFit.of(prior, limits, placed.state, np.eye(len(placed.moved)), cloud, FitConfig())


def bent(points: np.ndarray) -> np.ndarray:
    """Wider by up to 0.06 units the farther down the handles."""
    return points + 0.06 * np.sin(2 * points[:, 1:2]) * [1.0, 0.0, 0.0]


def test_a_surface_follows_what_is_bent(scissors):
    prior, limits, placed, template, seen = scissors
    fit = fit_to(prior, limits, placed, bent(seen.points), seen.parts)
    meshes = followed(fit, placed, template)
    before, after = [], []
    for still, moved, T in zip(template.at(placed.keypoints), meshes, placed.pose.T_camera_part, strict=True):
        assert np.array_equal(still.faces, moved.faces)
        truth = Surface.of(still.carried(T).warped(bent).triangles, 5000, np.random.default_rng(0))
        before.append(truth.distances(carry(T, still.vertices)))
        after.append(truth.distances(carry(T, moved.vertices)))
    assert np.concatenate(after).mean() < 0.5 * np.concatenate(before).mean()


def test_what_is_where_it_was_seen_keeps_still(scissors):
    prior, limits, placed, template, seen = scissors
    first = seen.parts == 0
    fit = fit_to(prior, limits, placed, seen.points[first], seen.parts[first])
    for still, moved in zip(template.at(placed.keypoints), followed(fit, placed, template), strict=True):
        assert np.linalg.norm(moved.vertices - still.vertices, axis=1).mean() < 0.01
