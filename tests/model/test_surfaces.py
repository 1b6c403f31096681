"""Surfaces that follow keypoints: exact where they must be, and nearer to what was seen once they are fitted."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import omad
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.data.surface_bank import SurfaceBank
from omad.geometry.closest import Surface
from omad.geometry.mesh import merge_meshes
from omad.geometry.transforms import MIRROR_X
from omad.model.checkpoint import find_weights, load, shipped_categories
from omad.model.fitting.state import State
from omad.model.object_prior import object_keypoints
from omad.model.omadnet import OmadNet
from omad.model.priornet import PriorNet
from omad.model.surfaces import bank as banks
from omad.model.surfaces.bank import FILE, ShapeBank, train_command
from omad.model.surfaces.fitting import Cloud, FitConfig, SurfaceFit
from omad.model.surfaces.placed import Placed, VisibleSurface
from omad.model.surfaces.shares import Shares
from omad.model.surfaces.surfaces import Surfaces
from omad.model.surfaces.template import Skin
from omad.objects.category_file import get_category
from omad.training.train_surfaces import surface_bank


@pytest.fixture(scope="module")
def laptop():
    net = load(OmadNet, find_weights("laptop"))
    return net, Surfaces.beside(find_weights("laptop"), net.prior, net.category)


def test_a_skin_follows_shifts_exactly_and_stretches_nearly():
    rng = np.random.default_rng(0)
    points, keypoints = rng.normal(size=(50, 3)), rng.normal(size=(12, 3))
    skin = Skin.of(points, keypoints)
    assert np.allclose(skin.weights.sum(1), 1)
    assert np.allclose(skin.at(keypoints), points)
    assert np.allclose(skin.at(keypoints + [1.0, -2.0, 3.0]), points + [1.0, -2.0, 3.0])
    stretch = np.eye(3) + 0.1 * rng.normal(size=(3, 3))
    error = np.linalg.norm(skin.at(keypoints @ stretch.T) - points @ stretch.T, axis=1)
    assert error.max() < 0.03 * np.linalg.norm(points @ stretch.T - points, axis=1).max()  # the ridge's share


def test_a_skin_keeps_its_thickness_where_keypoints_lie_in_a_plane():
    flat = np.random.default_rng(1).normal(size=(10, 3)) * [1.0, 1.0, 0.0]
    skin = Skin.of(np.array([[0.0, 0.0, 0.1]]), flat)
    assert np.allclose(skin.at(1.2 * flat)[0, 2], 0.1)


def test_a_template_at_its_own_keypoints_is_the_object(laptop):
    net, surfaces = laptop
    unit, bank = net.category.metres_per_unit, surfaces.bank
    own = bank.template(5).at(bank.keypoints[5].astype(float))
    for mesh, part in zip(own, generate(net.category, 5).parts, strict=True):
        assert np.allclose(mesh.vertices * unit, part.vertices)
        assert np.array_equal(mesh.faces, part.faces)


@pytest.mark.parametrize("name", shipped_categories())
def test_shipped_banks_are_of_the_shipped_priors_and_generators(name):
    folder = find_weights(name)
    net, prior = load(PriorNet, folder / "prior"), load(OmadNet, folder).prior
    bank = ShapeBank.load(folder / FILE, net.category, prior)
    models = [generate(net.category, index) for index in range(3)]
    found = object_keypoints(net, SurfaceBank.from_models(models, net.category)).numpy()
    assert np.allclose(bank.keypoints[:3], found, atol=2e-3), "omad train surface was not run after a change"


def test_threads_share_a_bank(laptop, monkeypatch):
    """Of a service, say; the bank keeps few of its templates."""
    bank = replace(laptop[1].bank, _made={})
    monkeypatch.setattr(banks, "REMEMBERED", 2)
    monkeypatch.setattr(banks, "generate", lambda category, index: index)
    monkeypatch.setattr(banks, "Template", SimpleNamespace(of=lambda index, *_: index))
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            rows = [np.random.default_rng(seed).integers(0, 50, 3000).tolist() for seed in range(4)]
            found = list(pool.map(lambda row: [bank.template(index) for index in row], rows))
    finally:
        sys.setswitchinterval(before)
    assert found == rows


def test_a_bank_of_foreign_models_keeps_their_meshes(tmp_path, laptop):
    net, _ = laptop
    models = [generate(net.category, index, "test") for index in range(2)]
    priornet = load(PriorNet, find_weights("laptop") / "prior")
    path = surface_bank(priornet, models, generated=False).save(tmp_path)
    surfaces = Surfaces.beside(tmp_path, net.prior, net.category)
    assert surfaces is not None
    keypoints = surfaces.bank.keypoints[1] * net.category.metres_per_unit
    for mesh, part in zip(surfaces.of_keypoints(keypoints), models[1].parts, strict=True):
        assert np.allclose(mesh.vertices, part.vertices, atol=1e-4)
    other = load(OmadNet, find_weights("scissors"))
    with pytest.raises(InputError, match=r"another prior.*omad train surface"):
        ShapeBank.load(path, other.category, other.prior)
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"surfaces\.npz: not readable as a bank of surfaces"):
        ShapeBank.load(path, net.category, net.prior)


def test_a_bank_keeps_its_shares(tmp_path, laptop):
    net, surfaces = laptop
    shares = Shares(np.array([0.25, 1.0]), np.array([[0.2, 0.3], [0.3, 0.1], [0.15, 0.1]]), 60)
    path = replace(surfaces.bank, shares=shares).save(tmp_path)
    found = ShapeBank.load(path, net.category, net.prior).shares
    assert found is not None
    assert (found.taken.tolist(), found.errors.tolist(), found.views) == ([0.25, 1.0], shares.errors.tolist(), 60)
    assert found.of_unknowns(found.shrinkage, 9) == pytest.approx([0.75] * 6 + [1 / 3] + [0.75] * 2)
    path = replace(surfaces.bank, shares=None, follows=True).save(tmp_path)
    found = ShapeBank.load(path, net.category, net.prior)
    assert (found.shares, found.follows, surfaces.bank.follows) == (None, True, False)
    for wrong in (replace(shares, taken=np.array([2.0, 0.0])), replace(shares, errors=np.zeros((2, 2)))):
        path = replace(surfaces.bank, shares=wrong).save(tmp_path)
        with pytest.raises(InputError, match=r"surfaces\.npz: not readable as a bank of surfaces"):
            ShapeBank.load(path, net.category, net.prior)


def test_surfaces_of_betas(laptop):
    net, surfaces = laptop
    unit, betas = net.category.metres_per_unit, net.prior.beta_mean.numpy() + [np.zeros(10), np.eye(10)[1]]
    keypoints = net.prior.keypoints(torch.as_tensor(betas, dtype=torch.float32)).numpy()
    for parts, points in zip(surfaces.of_beta(betas), keypoints, strict=True):
        assert len(parts) == len(net.category.parts)
        surface = Surface.of(merge_meshes(parts).triangles / unit, 5000, np.random.default_rng(0))
        assert surface.distances(points).mean() < 0.05  # keypoints lie on surfaces, or between two sides of a thin part


def test_surfaces_of_one_beta_and_of_the_other_hand(laptop):
    net, surfaces = laptop
    betas = net.prior.beta_mean.numpy() + [np.zeros(10), np.eye(10)[1]]
    both = surfaces.of_beta(betas)
    [alone], [of_tensor] = surfaces.of_beta(betas[1]), surfaces.of_beta(torch.as_tensor(betas[1]))
    mirrored, ordinary = surfaces.of_beta(betas[::-1], np.array([True, False]))
    [image] = surfaces.of_beta(betas[1], of_other_hand=True)
    for k, part in enumerate(both[1]):
        assert np.allclose(alone[k].vertices, part.vertices)
        assert np.allclose(of_tensor[k].vertices, part.vertices)
        for other in (mirrored[k], image[k]):
            assert np.allclose(other.vertices, part.vertices * MIRROR_X)
            assert np.array_equal(other.faces, part.faces[:, ::-1])
        assert np.allclose(ordinary[k].vertices, both[0][k].vertices)


def test_the_shape_of_an_estimate_of_the_other_hand_is_its_own():
    category = get_category("cabinet_one_door")
    model = generate(category, 3, "test").mirrored()
    seen = standard_view(model, category, (7, 3)).observation()
    estimate = omad.Estimator.from_pretrained("cabinet_one_door", "cpu")(seen)
    assert estimate.of_other_hand
    [parts] = estimate.surfaces.of_beta(estimate.beta, estimate.of_other_hand)
    for part, carried in zip(parts, estimate.carried_model().parts, strict=True):
        assert np.allclose(part.vertices, carried.vertices, atol=1e-6)


@pytest.mark.parametrize(
    ("beta", "hands", "message"),
    [
        (np.zeros(9), False, r"beta: shape \(9,\).*\(10,\) or \(B, 10\)"),
        (np.zeros((2, 3, 10)), False, r"beta: shape"),
        (np.float64(0.0), False, r"beta: shape \(\)"),
        (np.array(["a"] * 10), False, r"beta: shape"),
        (np.full(10, np.nan), False, r"beta: .*finite"),
        (np.zeros((2, 10)), [True, False, True], r"of_other_hand: shape \(3,\)"),
        (np.zeros(10), 3, r"of_other_hand"),
    ],
)
def test_what_is_no_beta_is_refused(laptop, beta, hands, message):
    with pytest.raises(InputError, match=message):
        laptop[1].of_beta(beta, hands)


def test_what_makes_a_bank_names_all_that_it_needs():
    own = replace(get_category("laptop"), name="pedal_bin")
    for part in ("--category SPEC", "--weights W", "--prior P", "--source S", "--unseen U", "pedal_bin"):
        assert part in train_command(own)
    assert train_command(get_category("laptop")).startswith("omad train surface --category laptop (")


def found_again(laptop, shift: list[float], config: FitConfig) -> np.ndarray:
    """Errors of the base's rotation and of the joint state, and the distance from the cloud, before and after a fit to
    a known laptop, whose screen is shifted from where its prior has it."""
    net, surfaces = laptop
    prior, template, joints = surfaces._doubles, surfaces.bank.template(3), len(net.category.joints)
    beta = prior.encode(torch.as_tensor(surfaces.bank.keypoints[3:4], dtype=torch.float64))
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.as_tensor(Rotation.from_euler("xy", [205.0, 20.0], degrees=True).as_matrix())
    pose[2, 3] = 4.0
    truth = State(beta, torch.full((1, joints), 0.2, dtype=torch.float64), pose[None])
    own = np.zeros((prior.num_keypoints, 3))
    own[prior.keypoints_of_part[1]] = shift
    there = Placed.at(prior, truth, np.zeros(6 + joints + prior.basis_size), own)
    visible = VisibleSurface.of(there, template, there.keypoints + [0, 0, 4.0], 96, 0.01)
    step = np.concatenate([[0.03, -0.02, 0.03], [0.02, 0.03, -0.03], np.full(joints, 0.06), np.zeros(prior.basis_size)])
    start = truth.moved(torch.as_tensor(step)[None])
    covariance = np.diag(np.concatenate([np.full(6, 0.03**2), np.full(joints, 0.06**2), np.full(10, 0.05**2)]))
    limits = net.category.limits
    cloud = Cloud.of(visible.points, visible.parts, 300)
    fit = SurfaceFit.of(prior, limits, start, covariance, cloud, config)
    before, after = fit.begin(), fit(fit.begin(), template)

    def off(placed: Placed) -> np.ndarray:
        moved = placed.pose.T_camera_part[0] @ np.linalg.inv(pose.numpy())
        turn = Rotation.from_matrix(moved[:3, :3]).magnitude()
        return np.array([turn, abs(float(placed.state.joint_states[0, 0]) - 0.2), fit.apart(placed, template)])

    return np.stack([off(before), off(after)])


def test_a_fit_finds_the_pose_and_joint_state_again(laptop):
    before, after = found_again(laptop, [0.0, 0.0, 0.0], FitConfig())
    assert (after < 0.5 * before).all()


@pytest.mark.parametrize("shift", [[0.0, 0.05, 0.0], [0.0, 0.0, 0.05]])
def test_of_a_hinge_that_lies_elsewhere_the_angle_is_found(laptop, shift):
    held, free = (found_again(laptop, shift, FitConfig(shared=shared))[1] for shared in (1e-4, FitConfig.shared))
    assert (free[:2] < 0.6 * held[:2]).all()


def test_without_points_the_surface_is_that_of_the_keypoints(laptop):
    net, surfaces = laptop
    mean = net.prior.keypoints(net.prior.beta_mean[None])[0].numpy() * net.category.metres_per_unit

    class Found:
        canonical_keypoints, placed, beta = mean, None, net.prior.beta_mean.numpy()

    fitted = surfaces.fitted(Found, np.eye(17), np.zeros((0, 3)), np.zeros(0, int))
    assert fitted.step.tolist() == [0.0] * 17
    for mesh, expected in zip(fitted.parts, surfaces.of_keypoints(mean), strict=True):
        assert np.array_equal(mesh.vertices, expected.vertices)


def test_a_fit_keeps_joints_within_their_limits(laptop):
    _, surfaces = laptop
    prior, template = surfaces._doubles, surfaces.bank.template(3)
    beta = prior.encode(torch.as_tensor(surfaces.bank.keypoints[3:4], dtype=torch.float64))
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.as_tensor(Rotation.from_euler("xy", [205.0, 20.0], degrees=True).as_matrix())
    pose[2, 3] = 4.0
    start = State(beta, torch.full((1, 1), 0.2, dtype=torch.float64), pose[None])
    there = Placed.at(prior, start, np.zeros(7 + prior.basis_size), np.zeros((prior.num_keypoints, 3)))
    seen = VisibleSurface.of(there, template, there.keypoints + [0, 0, 4.0], 96, 0.01)
    covariance = np.diag([0.03**2] * 6 + [0.06**2] + [0.05**2] * prior.basis_size)

    def found(low: float, high: float) -> float:
        limits, cloud = np.array([[low, high]]), Cloud.of(seen.points, seen.parts, 300)
        fit = SurfaceFit.of(prior, limits, start, covariance, cloud, FitConfig())
        return float(fit(fit.begin(), template).state.joint_states[0, 0])

    free = found(-1.0, 1.0)
    assert free == pytest.approx(0.2, abs=0.02)
    assert found(-1.0, 0.1) < free - 0.01
    assert found(0.3, 1.0) > free + 0.01
