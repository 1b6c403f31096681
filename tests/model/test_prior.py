from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from helpers.categories import CATEGORIES, LAPTOP
from helpers.scenes import random_prior, scene
from omad.data.surface_bank import Joints
from omad.geometry.transforms import make_transform, so3_exp
from omad.model.checkpoint import find_weights, load
from omad.model.fitting.energy import RefinementConfig
from omad.model.fitting.refinement import DEFAULT_CONFIG, Refiner
from omad.model.fitting.state import State, Targets
from omad.model.omadnet import OmadNet
from omad.model.prior import OmadPrior, mirror_map
from omad.objects.category import Category, JointSpec, PartSpec
from omad.training.train_prior import loosen_pivots

MIRROR = torch.tensor([-1.0, 1.0, 1.0])

SWAPPING = Category(
    name="swapping",
    metres_per_unit=1.0,
    parts=(PartSpec("frame", 4, mirror=0), PartSpec("left", 3, mirror=2), PartSpec("right", 3, mirror=1)),
    joints=(
        JointSpec("left", "revolute", 0, (0.0, 1.0, 0.0), (0.0, 1.0)),
        JointSpec("right", "prismatic", 0, (0.0, 0.0, 1.0), (-1.0, 0.0)),
    ),
    basis_size=5,
)
PLAIN = Category(
    name="plain",
    metres_per_unit=1.0,
    parts=(PartSpec("one", 3), PartSpec("two", 5)),
    joints=(JointSpec("pin", "revolute", 0, (0.0, 1.0, 0.0), (0.0, 1.0)),),
)

ALL = (*CATEGORIES.values(), SWAPPING, PLAIN)


def prior_of(category: Category, **options) -> OmadPrior:
    return OmadPrior(category, generator=torch.Generator().manual_seed(0), **options)


@pytest.mark.parametrize("category", ALL, ids=lambda c: c.name)
def test_mirrored_keypoints_are_images_for_every_beta(category: Category) -> None:
    prior = prior_of(category)
    points = prior.keypoints(torch.randn(4, prior.basis_size))
    start = [0]
    for part in category.parts:
        start.append(start[-1] + part.keypoints)
    for index, part in enumerate(category.parts):
        mine = points[:, start[index] : start[index + 1]]
        if part.mirror == index:
            half = part.keypoints // 2
            torch.testing.assert_close(mine[:, half:], mine[:, :half] * MIRROR)
        elif part.mirror is not None:
            other = points[:, start[part.mirror] : start[part.mirror + 1]]
            torch.testing.assert_close(mine, other * MIRROR)


@pytest.mark.parametrize("category", ALL, ids=lambda c: c.name)
def test_only_what_no_mirror_gives_is_learned_and_all_of_it_gets_a_gradient(category: Category) -> None:
    prior = prior_of(category)
    images = sum(mirror_map(category).is_image)
    assert prior.learned_basis.shape == (category.num_keypoints - images, 3, prior.basis_size)
    prior.basis.square().sum().backward()
    assert prior.learned_basis.grad is not None
    assert (prior.learned_basis.grad != 0).all()


def test_mirror_map_of_two_parts_that_swap() -> None:
    mirror = mirror_map(SWAPPING)
    assert mirror.source == (0, 1, 0, 1, 4, 5, 6, 4, 5, 6)
    assert mirror.is_image == (False, False, True, True, False, False, False, True, True, True)


def test_shape_is_linear() -> None:
    prior = prior_of(PLAIN)
    beta = torch.randn(3, prior.basis_size)
    flat = prior.basis.reshape(-1, prior.basis_size)
    torch.testing.assert_close(prior.keypoints(beta).flatten(1), beta @ flat.T)
    torch.testing.assert_close(prior.keypoints(2 * beta), 2 * prior.keypoints(beta))


@pytest.mark.parametrize("category", ALL, ids=lambda c: c.name)
def test_joints_are_unit_axes_that_start_near_the_spec_and_pivots_only_where_they_mean_something(
    category: Category,
) -> None:
    prior = prior_of(category)
    joints = prior.joints(0.1 * torch.randn(6, prior.basis_size))
    torch.testing.assert_close(joints.axes.norm(dim=-1), torch.ones(6, len(category.joints)))
    nominal = torch.tensor([joint.axis for joint in category.joints])
    assert ((joints.axes * nominal).sum(-1) > math.cos(math.radians(15))).all()
    for index, joint in enumerate(category.joints):
        assert (joints.pivots[:, index] == 0).all() == (joint.type == "prismatic")


def test_deform_moves_base_and_child_as_the_tree_says() -> None:
    prior = prior_of(SWAPPING).double()
    draw = torch.Generator().manual_seed(1)
    beta = torch.randn(2, 5, generator=draw, dtype=torch.float64)
    T = make_transform(so3_exp(torch.randn(2, 3, generator=draw, dtype=torch.float64)), torch.ones(2, 3).double())
    states = torch.tensor([[0.3, -0.2], [0.0, 0.0]], dtype=torch.float64)
    points = prior.deform(beta, states, T)
    rest = prior.keypoints(beta)
    placed = rest @ T[:, :3, :3].mT + T[:, None, :3, 3]
    torch.testing.assert_close(points[:, :4], placed[:, :4])
    torch.testing.assert_close(points[1], placed[1])
    shift = -0.2 * (T[0, :3, :3] @ prior.joints(beta).axes[0, 1])
    torch.testing.assert_close(points[0, 7:], placed[0, 7:] + shift)
    pivot = T[0, :3, :3] @ prior.joints(beta).pivots[0, 0] + T[0, :3, 3]
    torch.testing.assert_close((points[0, 4:7] - pivot).norm(dim=-1), (placed[0, 4:7] - pivot).norm(dim=-1))
    assert (points[0, 4:7] - placed[0, 4:7]).norm(dim=-1).min() > 1e-3


def test_encode_inverts_shape() -> None:
    prior = prior_of(PLAIN).double()
    beta = torch.randn(4, prior.basis_size, dtype=torch.float64)
    torch.testing.assert_close(prior.encode(prior.keypoints(beta)), beta)


def test_same_generator_same_prior_and_sizes_can_be_chosen() -> None:
    one, two = prior_of(PLAIN, basis_size=4, hidden=80), prior_of(PLAIN, basis_size=4, hidden=80)
    assert one.basis_size == 4
    assert one.joint_hidden.out_features == 80
    for a, b in zip(one.parameters(), two.parameters(), strict=True):
        assert torch.equal(a, b)
    assert "beta_mean" in one.state_dict()
    assert "beta_covariance" in one.state_dict()


def test_loose_numbers_move_pivots_where_joints_turn_and_nothing_else() -> None:
    prior, moves = prior_of(SWAPPING), torch.randn(2, 3, 2, generator=torch.Generator().manual_seed(1))
    plain, beta = prior_of(SWAPPING), torch.randn(4, 7, generator=torch.Generator().manual_seed(2))
    prior.loosen(moves)
    assert (prior.basis_size, prior.shape_size, plain.basis_size) == (7, 5, 5)
    assert torch.equal(prior.keypoints(beta), plain.keypoints(beta[:, :5]))
    loose, tight = prior.joints(beta), plain.joints(beta[:, :5])
    assert torch.equal(loose.axes, tight.axes)
    torch.testing.assert_close(loose.pivots[:, 0] - tight.pivots[:, 0], beta[:, 5:] @ moves[0].T)
    assert (loose.pivots[:, 1] == 0).all()  # of one that slides
    assert (prior.encode(prior.keypoints(beta))[:, 5:] == 0).all()
    torch.testing.assert_close(prior.beta_covariance[5:, 5:], torch.eye(2))


def test_loose_numbers_come_and_go_with_the_weights() -> None:
    loose, plain, other = prior_of(PLAIN), prior_of(PLAIN), prior_of(PLAIN, basis_size=10)
    loose.loosen(torch.ones(1, 3, 2))
    assert "pivot_basis" not in plain.state_dict()
    other.load_state_dict(loose.state_dict())
    assert other.basis_size == 12
    assert torch.equal(other.pivot_basis, loose.pivot_basis)
    other.load_state_dict(plain.state_dict())
    assert other.basis_size == 10
    broken = loose.state_dict() | {"pivot_basis": torch.ones(3, 2)}
    with pytest.raises(RuntimeError, match="pivot_basis"):
        other.load_state_dict(broken)


@pytest.mark.parametrize("backend", ["torch", "kernel"])
def test_a_hinge_off_the_joint_function_leaves_states_alone_where_pivots_are_loose(backend) -> None:
    """As where doors hang from the sides of an unusual body: keypoints turn about another place than beta says."""
    s = scene(LAPTOP, loose=2)
    tight = random_prior(LAPTOP, torch.Generator().manual_seed(0))
    shapes = replace(s.start, beta=s.start.beta[:, : tight.basis_size])
    config = RefinementConfig(prior_weight=0.01, huber=None, max_iterations=200, backend=backend)
    errors = [
        (Refiner(prior, s.limits, config)(s.targets, start).state.joint_states - s.truth.joint_states).abs().mean()
        for prior, start in ((tight, shapes), (s.prior, s.start))
    ]
    assert errors[1] < 0.2 * errors[0]


def test_where_along_its_axis_a_pivot_lies_is_no_number_of_beta():
    prior, draw = OmadPrior(LAPTOP), torch.Generator().manual_seed(0)
    beta, along = torch.randn(40, prior.shape_size, generator=draw), torch.randn(40, 1, 1, generator=draw)
    found = prior.joints(beta)
    loosen_pivots(prior, beta, Joints(found.axes, found.pivots + along * found.axes, torch.zeros(40, 1, 2)))
    assert prior.pivot_basis.shape[-1] > 0
    assert prior.pivot_basis.abs().max() < 1e-4


@pytest.mark.parametrize("backend", ["torch", "kernel"])
def test_another_shape_prior_counts_as_much_as_the_categorys(backend):
    prior = load(OmadNet, find_weights("laptop")).prior.double()
    config = replace(DEFAULT_CONFIG, prior_weight=30.0, backend=backend)
    limits = torch.tensor([[-1.4, 1.4]], dtype=torch.float64)
    refiner = Refiner(prior, limits, config)
    beta = prior.beta_mean[None].double() + 0.5
    pose, theta = torch.eye(4, dtype=torch.float64)[None], torch.full((1, 1), 0.3, dtype=torch.float64)
    points = prior.deform(beta, theta, pose)
    targets, start = Targets(points, torch.full(points.shape[:2], 100.0, dtype=torch.float64)), State(beta, theta, pose)
    same = refiner.with_shape_prior(prior.beta_mean, prior.beta_covariance)
    assert torch.allclose(same(targets, start).state.beta, refiner(targets, start).state.beta)
