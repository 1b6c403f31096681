"""The deformation function against plain 4x4 products, finite differences and its own joint lines."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from omad.geometry.joint_kinds import PRISMATIC, REVOLUTE, motion_of, type_of
from omad.geometry.kinematics import KinematicTree, deform, joint_lines, joint_transforms, part_transforms
from omad.geometry.transforms import axis_angle_to_matrix, so3_exp

PITCH = -0.7
SCREW = motion_of("screw", PITCH)
TREES = [
    KinematicTree((0,), (REVOLUTE,)),
    KinematicTree((0,), (PRISMATIC,)),
    KinematicTree((0, 0, 0), (PRISMATIC, PRISMATIC, PRISMATIC)),
    KinematicTree((0, 1, 2, 3), (REVOLUTE, PRISMATIC, REVOLUTE, REVOLUTE)),
    KinematicTree((0, 0, 1, 1, 3, 2), (REVOLUTE, PRISMATIC, PRISMATIC, REVOLUTE, REVOLUTE, REVOLUTE)),
    KinematicTree((0, 1, 1), (SCREW, REVOLUTE, SCREW)),
]


class Problem:
    """Random axes, pivots, states, poses and keypoints for a tree."""

    def __init__(self, tree: KinematicTree, batch: int = 3, dtype=torch.float64, seed: int = 0):
        rng = np.random.default_rng(seed)
        joints, parts = tree.num_joints, tree.num_parts
        axes = rng.normal(size=(batch, joints, 3))
        pose = np.tile(np.eye(4), (batch, 1, 1))
        pose[:, :3, :3] = Rotation.random(batch, rng=rng).as_matrix()
        pose[:, :3, 3] = rng.normal(size=(batch, 3))
        self.tree = tree
        self.part_of = torch.as_tensor(np.sort(np.concatenate([np.arange(parts), rng.integers(0, parts, 8)])))
        self.keypoints = torch.as_tensor(rng.normal(size=(batch, len(self.part_of), 3)), dtype=dtype)
        self.axes = torch.as_tensor(axes / np.linalg.norm(axes, axis=-1, keepdims=True), dtype=dtype)
        self.pivots = torch.as_tensor(rng.normal(size=(batch, joints, 3)), dtype=dtype)
        self.states = torch.as_tensor(rng.uniform(-3, 3, (batch, joints)), dtype=dtype)
        self.pose = torch.as_tensor(pose, dtype=dtype)

    def deformed(self) -> torch.Tensor:
        return deform(self.tree, self.part_of, self.keypoints, self.axes, self.pivots, self.states, self.pose)


def by_matrix_products(problem: Problem) -> np.ndarray:
    """W written out with homogeneous matrices: to the pivot, turn, and back, from the root to the part."""
    tree, result = problem.tree, np.zeros(problem.keypoints.shape)
    for b in range(len(problem.keypoints)):
        for m, part in enumerate(problem.part_of.tolist()):
            G = problem.pose[b].double().numpy()
            chain = []
            while part:
                chain.insert(0, part - 1)
                part = tree.parents[part - 1]
            for joint in chain:
                u = problem.axes[b, joint].double().numpy()
                q = problem.pivots[b, joint].double().numpy()
                theta = float(problem.states[b, joint])
                there, turn, back = np.eye(4), np.eye(4), np.eye(4)
                if tree.motions[joint] == PRISMATIC:
                    there[:3, 3] = theta * u
                else:
                    there[:3, 3], back[:3, 3] = q, -q
                    turn[:3, :3] = Rotation.from_rotvec(theta * u).as_matrix()
                    if tree.motions[joint] == SCREW:
                        there[:3, 3] += theta / (2 * np.pi) * PITCH * u
                G = G @ there @ turn @ back
            point = np.append(problem.keypoints[b, m].double().numpy(), 1.0)
            result[b, m] = (G @ point)[:3]
    return result


@pytest.mark.parametrize("tree", TREES, ids=lambda tree: f"{tree.parents}")
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-4)])
def test_deform_is_the_product_of_joint_matrices(tree, dtype, tolerance):
    for seed in range(3):
        problem = Problem(tree, dtype=dtype, seed=seed)
        result = problem.deformed()
        assert result.dtype == dtype
        np.testing.assert_allclose(result.double().numpy(), by_matrix_products(problem), atol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("tree", TREES, ids=lambda tree: f"{tree.parents}")
def test_deform_is_differentiable_in_everything(tree):
    problem = Problem(tree, batch=2)
    inputs = (problem.keypoints, problem.axes, problem.pivots, problem.states, problem.pose)
    leaves = tuple(value.clone().requires_grad_() for value in inputs)
    assert torch.autograd.gradcheck(lambda *values: deform(tree, problem.part_of, *values), leaves)


def test_gradients_are_finite_at_the_rest_state():
    problem = Problem(TREES[4])
    states = torch.zeros_like(problem.states).requires_grad_()
    points = deform(
        problem.tree, problem.part_of, problem.keypoints, problem.axes, problem.pivots, states, problem.pose
    )
    points.square().sum().backward()
    assert states.grad is not None
    assert states.grad.isfinite().all()


def test_rest_state_leaves_only_the_pose():
    problem = Problem(TREES[4])
    problem.states.zero_()
    expected = problem.keypoints @ problem.pose[:, :3, :3].mT + problem.pose[:, None, :3, 3]
    torch.testing.assert_close(problem.deformed(), expected)


@pytest.mark.parametrize("tree", TREES, ids=lambda tree: f"{tree.parents}")
def test_turning_about_the_camera_space_line_is_moving_the_joint(tree):
    problem = Problem(tree)
    G = part_transforms(tree, problem.axes, problem.pivots, problem.states, problem.pose)
    lines = joint_lines(tree, problem.axes, problem.pivots, G)
    before = problem.deformed()
    torch.testing.assert_close(lines.axes.norm(dim=-1), torch.ones_like(problem.states))
    for joint in range(tree.num_joints):
        step = 0.7
        problem.states[:, joint] += step
        after = problem.deformed()
        problem.states[:, joint] -= step
        u, q = lines.axes[:, joint], lines.pivots[:, joint]
        moved = before
        if tree.motions[joint] != PRISMATIC:
            R = axis_angle_to_matrix(u, torch.full((len(u),), step, dtype=u.dtype))
            moved = (before - q[:, None]) @ R.mT + q[:, None]
        advance = {PRISMATIC: step, REVOLUTE: 0.0, SCREW: step / (2 * np.pi) * PITCH}[tree.motions[joint]]
        moved = moved + advance * u[:, None]
        carried = torch.tensor([joint in tree.path(part) for part in problem.part_of.tolist()])
        torch.testing.assert_close(after[:, carried], moved[:, carried])
        torch.testing.assert_close(after[:, ~carried], before[:, ~carried])


def test_states_of_a_batch_do_not_touch_each_other():
    problem = Problem(TREES[3], batch=4)
    together = problem.deformed()
    problem.states[2] = torch.nan
    alone = problem.deformed()
    torch.testing.assert_close(alone[[0, 1, 3]], together[[0, 1, 3]])


def test_prismatic_joints_ignore_their_pivot():
    problem = Problem(TREES[2])
    before = problem.deformed()
    problem.pivots += 10
    torch.testing.assert_close(problem.deformed(), before)
    F = joint_transforms(problem.tree, problem.axes, problem.pivots, problem.states)
    torch.testing.assert_close(F[..., :3, :3], torch.eye(3, dtype=F.dtype).expand(3, 3, 3, 3))


def test_a_pose_moves_everything_alike():
    problem = Problem(TREES[4])
    before = problem.deformed()
    R = so3_exp(torch.tensor([0.3, -1.2, 0.5], dtype=torch.float64))
    turn = torch.eye(4, dtype=torch.float64)
    turn[:3, :3] = R
    problem.pose = turn @ problem.pose
    torch.testing.assert_close(problem.deformed(), before @ R.mT)


def test_paths_lead_from_the_root():
    tree = TREES[4]
    assert tree.num_parts == 7
    assert [tree.path(part) for part in range(7)] == [(), (0,), (1,), (0, 2), (0, 3), (0, 2, 4), (1, 5)]


@pytest.mark.parametrize(
    ("parents", "message"),
    [
        ((1, 0), "parent part"),
        ((0, -1), "parent part"),
        ((0,), "parents"),
    ],
)
def test_impossible_trees_are_refused(parents, message):
    with pytest.raises(ValueError, match=message):
        KinematicTree(parents, (REVOLUTE, REVOLUTE))


def test_motions_have_names_and_scale_with_lengths():
    for motion in (REVOLUTE, PRISMATIC):
        assert motion_of(type_of(motion)) == motion == motion.scaled(3.0)
    assert type_of(SCREW) == "screw"
    assert SCREW.scaled(2.0) == motion_of("screw", 2 * PITCH)
    assert [motion.state_unit(0.3) for motion in (REVOLUTE, PRISMATIC, SCREW)] == [1.0, 0.3, 1.0]


@pytest.mark.parametrize(("type", "pitch"), [("helical", None), ("screw", None), ("screw", 0.0), ("revolute", 0.1)])
def test_impossible_motions_are_refused(type, pitch):
    with pytest.raises(ValueError, match=f"{type}|pitch"):
        motion_of(type, pitch)
