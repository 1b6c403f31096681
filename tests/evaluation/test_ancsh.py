"""A-NCSH: exact on truth, sturdy against outliers, honest about missing parts; it trains, saves and loads."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.categories import CATEGORIES, DRAWER, EYEGLASSES, LAPTOP
from helpers.command_line import answer, refused
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view, true_pose
from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewBatch, ViewSettings, draw_views
from omad.evaluation.baselines.ancsh.alignment import AlignmentConfig, Poses, align
from omad.evaluation.baselines.ancsh.chain import (
    ChainConfig,
    PartPoses,
    of_joint,
    of_points,
    part_moments,
)
from omad.evaluation.baselines.ancsh.coordinates import HEAT_RADIUS, Coordinates, part_boxes, true_coordinates
from omad.evaluation.baselines.ancsh.estimator import AncshConfig, AncshEstimator
from omad.evaluation.baselines.ancsh.net import AncshNet, AncshPrediction
from omad.evaluation.baselines.ancsh.similarity import RansacConfig, fit_similarity, ransac
from omad.evaluation.baselines.ancsh.training import AncshTraining, train_ancsh
from omad.evaluation.metrics import pose_errors
from omad.geometry.kinematics import joint_lines, part_transforms
from omad.geometry.transforms import (
    axis_angle_to_matrix,
    point_to_line,
    rotation_angle,
    so3_exp,
    transform_points,
    vector_angle,
)
from omad.model.backbones.pointnet2 import PointNet2Config
from omad.model.checkpoint import load, save
from omad.model.omadnet import OmadNet
from omad.objects.category import Category
from omad.sensing.observation import Observation
from omad.training.loop import Schedule

TINY = PointNet2Config(points=128, centres=(32, 16), neighbours=(8, 8), widths=(24, 32, 48), dense=32)
VIEWS = 6


@pytest.fixture(scope="module")
def scenes():
    """Per category, clean views of a few objects and their true coordinates."""
    made = {}
    for category in CATEGORIES.values():
        bank = SurfaceBank.from_models([generate(category, i) for i in range(3)], category, samples=4096)
        settings = ViewSettings(points=512, noise=0.0)
        views = draw_views(bank, category, VIEWS, settings, torch.Generator().manual_seed(3))
        made[category.name] = views, true_coordinates(views, part_boxes(bank, len(category.parts)), category)
    return made


def said(truth: Coordinates, category: Category) -> AncshPrediction:
    """The answer of a network that knows."""
    B, N = truth.labels.shape
    K = len(category.parts)
    return AncshPrediction(
        part_logits=torch.nn.functional.one_hot(truth.labels, K).float(),
        npcs=truth.npcs[:, :, None].expand(B, N, K, 3),
        sizes=truth.sizes[:, None].expand(B, N, K),
        centres=truth.centres[:, None].expand(B, N, K, 3),
        heat=truth.heat,
        towards=truth.towards,
        axes=truth.axes[:, None].expand(B, N, -1, 3),
    )


def errors(poses: Poses, views: ViewBatch, found: torch.Tensor, category: Category):
    """Largest errors of what was found: rotation, translation, state, axis, and pivot's distance from the axis."""
    G = part_transforms(category.tree, views.axes, views.pivots, views.states, views.T_camera_base)
    lines = joint_lines(category.tree, views.axes, views.pivots, G)
    both = found[:, 1:] & found[:, list(category.tree.parents)]
    turns = both & torch.tensor(category.turning)
    T = poses.T_camera_part.float()
    pivot = point_to_line(poses.pivots.float(), lines.axes, lines.pivots)
    return [
        rotation_angle(T[..., :3, :3], G[..., :3, :3])[found].max().item(),
        (T[..., :3, 3] - G[..., :3, 3]).norm(dim=-1)[found].max().item(),
        (poses.states - views.states)[both].abs().max().item(),
        vector_angle(poses.axes.float(), lines.axes)[both].max().item(),
        pivot[turns].max().item() if turns.any() else 0.0,
    ]


def near_joints(truth: Coordinates, category: Category) -> torch.Tensor:
    """(B,) whether every revolute joint has points beside it: others are not told where they are."""
    return ((truth.heat > 0).sum(1) >= 5).logical_or(~torch.tensor(category.turning)).all(1)


def only(views: ViewBatch, truth: Coordinates, rows: torch.Tensor) -> tuple[ViewBatch, Coordinates]:
    return (
        type(views)(**{k: v[rows] for k, v in vars(views).items()}),
        type(truth)(**{k: v[rows] for k, v in vars(truth).items()}),
    )


@pytest.mark.parametrize("name", sorted(CATEGORIES))
def test_true_coordinates_give_exact_poses(scenes, name):
    category = CATEGORIES[name]
    views, truth = only(*scenes[name], near_joints(scenes[name][1], category))
    assert len(views.points) >= 3
    result = align(views.points, said(truth, category), category, AlignmentConfig())
    assert result.found.any(0).all()
    assert result.found[:, 0].all()
    for poses in (result.separate, result.joined):
        assert max(errors(poses, views, result.found, category)) < 2e-3


@pytest.mark.parametrize("name", sorted(CATEGORIES))
def test_noise_and_outliers_are_borne(scenes, name):
    category = CATEGORIES[name]
    views, truth = only(*scenes[name], near_joints(scenes[name][1], category))
    draw = torch.Generator().manual_seed(0)
    known = said(truth, category)

    def normal(like: torch.Tensor) -> torch.Tensor:
        return torch.randn(like.shape, generator=draw)

    wrong = torch.rand(truth.labels.shape, generator=draw) < 0.3
    npcs = known.npcs + 0.01 * normal(known.npcs)
    npcs = torch.where(wrong[..., None, None], 0.3 * normal(npcs), npcs)
    axes = torch.nn.functional.normalize(known.axes + 0.05 * normal(known.axes), dim=-1)
    noisy = replace(known, npcs=npcs, axes=axes, sizes=known.sizes * (1 + 0.02 * normal(known.sizes)))
    result = align(views.points, noisy, category, AlignmentConfig(fewest_points=40))
    rotation, translation, state, axis, pivot = errors(result.joined, views, result.found, category)
    assert max(rotation, axis) < 0.1
    assert max(translation, state, pivot) < 0.12
    alone = errors(result.separate, views, result.found, category)
    assert axis <= alone[3] + 0.01


def test_coordinates_are_of_the_stretched_object_at_rest(scenes):
    views, truth = scenes["eyeglasses"]
    G = part_transforms(EYEGLASSES.tree, views.axes, views.pivots, views.states, views.T_camera_base)
    diagonal = views.pivots.norm(dim=-1) / truth.pivots.norm(dim=-1)
    for b in range(VIEWS):
        placed = truth.naocs[b] * diagonal[b, 0]
        for part in range(3):
            own = truth.labels[b] == part
            assert torch.allclose(transform_points(G[b, part], placed[own]), views.points[b][own], atol=1e-4)
    assert truth.npcs.norm(dim=-1).max() < 0.5 + 1e-4  # the box's corners are half a diagonal from its centre
    place = truth.naocs[:, :, None] + truth.towards * ((1 - truth.heat) * HEAT_RADIUS)[..., None]
    missed = point_to_line(place, truth.axes[:, None].expand_as(place), truth.pivots[:, None].expand_as(place))
    assert missed[truth.heat > 0].max() < 1e-4


def test_similarity_is_found_among_outliers():
    draw = torch.Generator().manual_seed(1)
    a = torch.rand(2, 3, 200, 3, generator=draw) - 0.5
    R = axis_angle_to_matrix(torch.tensor([0.6, 0.0, 0.8]), torch.tensor(2.0))
    b = 1.7 * a @ R.mT + torch.tensor([0.1, -0.2, 3.0])
    exact = fit_similarity(a, b, torch.ones(2, 3, 200))
    assert exact.scale == pytest.approx(1.7, abs=1e-5)
    b[:, :, ::2] += torch.randn(2, 3, 100, 3, generator=draw)
    count = torch.full((2, 3), 200)
    similarity, inliers = ransac(a, b, count, RansacConfig(), torch.Generator().manual_seed(0))
    assert similarity.scale == pytest.approx(1.7, abs=1e-2)
    assert rotation_angle(similarity.rotation, R).max() < 0.01
    assert inliers[:, :, 1::2].all()


def test_a_part_without_points_is_missing_and_its_joint_with_it(scenes):
    views, truth = scenes["eyeglasses"]
    known = said(truth, EYEGLASSES)
    known.part_logits[0, :, 1] = -10.0  # the first view has no right temple, ...
    known.part_logits[1, :, 0] = -10.0  # the second one no frame
    whole = align(views.points, said(truth, EYEGLASSES), EYEGLASSES, AlignmentConfig())
    result = align(views.points, known, EYEGLASSES, AlignmentConfig())
    assert not result.found[0, 1]
    assert result.joined.states[0].isnan().tolist() == [True, not whole.found[0, 2]]
    assert result.joined.T_camera_part[0, 1].isnan().all()
    assert result.joined.axes[0].isfinite().all()  # the frame tells them
    assert result.joined.states[1].isnan().all()
    assert result.joined.T_camera_part[1, 0].isnan().all()
    assert torch.equal(result.joined.states[2:].nan_to_num(), whole.joined.states[2:].nan_to_num())


def test_no_points_at_all_are_all_missing(scenes):
    views, truth = scenes["drawer"]
    result = align(views.points, said(truth, DRAWER), DRAWER, AlignmentConfig(fewest_points=10_000))
    assert not result.found.any()
    for values in (result.joined.states, result.joined.axes, result.joined.T_camera_part):
        assert values.isnan().all()


@pytest.mark.parametrize("kind", ["points", "revolute", "prismatic"])
def test_jacobians_of_the_chain(kind):
    draw = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    B, K = 2, 3
    poses = PartPoses(1 + normal(B).square(), so3_exp(normal(B, K, 3)), normal(B, K, 3))
    moments = part_moments(normal(B, K, 20, 3), normal(B, K, 20, 3), torch.ones(B, K, 20))
    axis, pivot = torch.nn.functional.normalize(normal(B, 3), dim=-1), normal(B, 3)

    def block(step: torch.Tensor):
        moves = step[:, 1:].unflatten(1, (K, 6))
        moved = PartPoses(
            poses.scale * step[:, 0].exp(),
            so3_exp(moves[..., :3]) @ poses.rotations,
            poses.translations + moves[..., 3:],
        )
        if kind == "points":
            return of_points(moved, *moments)
        return of_joint(moved, 0, 2, axis, pivot, kind == "revolute", ChainConfig())

    zero = torch.zeros(B, 1 + 6 * K, dtype=torch.float64)
    jacobian = block(zero).jacobian
    for column in range(zero.shape[1]):
        step = zero.clone()
        step[:, column] = 1e-6
        numeric = (block(step).residuals - block(-step).residuals) / 2e-6
        assert torch.allclose(numeric, jacobian[..., column], atol=1e-6)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A net that has hardly seen anything, with the folder of its training."""
    folder = tmp_path_factory.mktemp("ancsh")
    models = [generate(LAPTOP, i) for i in range(3)]
    schedule = Schedule(steps=60, batch=8, learning_rate=5e-3, log_steps=5, average=0.9)
    settings = AncshTraining(schedule=schedule, backbone=TINY, views=ViewSettings(points=TINY.points))
    net = train_ancsh(models, LAPTOP, folder, settings)
    save(net, folder, {})
    return net, folder


@pytest.mark.slow
def test_training_reduces_every_loss(trained):
    rows = [json.loads(line) for line in (trained[1] / "metrics.jsonl").read_text().splitlines()]
    first, last = rows[0], rows[-1]
    assert last["loss"] < 0.75 * first["loss"]
    for term in ("segmentation", "npcs", "naocs", "axes"):
        assert last[term] < first[term]


@pytest.mark.slow
def test_a_checkpoint_gives_the_same_answers(trained):
    net, folder = trained
    again = load(AncshNet, folder)
    assert again.category == LAPTOP
    points = torch.randn(2, TINY.points, 3)
    with torch.no_grad():
        first, second = net(points), again(points)
    assert all(torch.equal(vars(first)[name], vars(second)[name]) for name in vars(first))
    with pytest.raises(InputError, match=r"config\.json: .*'ancsh'"):
        load(OmadNet, folder)


@pytest.mark.slow
def test_estimates_are_measured_like_omads_and_repeat(trained):
    views = [standard_view(generate(LAPTOP, 0, "test"), LAPTOP, (0, i)) for i in range(3)]
    observations = [Observation.from_depth(view.depth, view.camera) for view in views]
    estimator = AncshEstimator.from_folder(trained[1], "cpu", AncshConfig(samples=(1, 2)))
    batch = estimator(observations)
    singles = [estimator([observation])[0] for observation in observations]
    for view, together, alone in zip(views, batch, singles, strict=True):
        for pose in (together.initial_pose(), together.pose()):
            found = pose_errors(pose, true_pose(view, LAPTOP), view.truth.part_boxes, LAPTOP)
            assert np.isfinite(found.joint_state).all()
            assert found.missing == bool(together.missing_parts)
        assert alone.missing_parts == together.missing_parts
        assert alone.pose().T_camera_part == pytest.approx(together.pose().T_camera_part, abs=1e-3, nan_ok=True)
        assert set(alone.seconds) == {"network", "refinement"}


@pytest.mark.slow
def test_what_is_missing_is_counted(trained):
    view = standard_view(generate(LAPTOP, 0, "test"), LAPTOP, (0, 5))
    few = AncshConfig(alignment=AlignmentConfig(fewest_points=10_000))
    lost = AncshEstimator(trained[0], few)([Observation.from_depth(view.depth, view.camera)])[0]
    assert lost.missing_parts == ("base", "screen")
    found = pose_errors(lost.pose(), true_pose(view, LAPTOP), view.truth.part_boxes, LAPTOP)
    assert found.missing
    assert np.degrees(found.joint_state) == pytest.approx([90])
    assert found.axis_distance == pytest.approx([LAPTOP.metres_per_unit])
    assert np.degrees(found.rotation) == pytest.approx([90, 90])


@pytest.mark.slow
def test_the_command_trains_resumes_and_refuses(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["train", "ancsh", "--category", "drawer", "--output", "out", "--objects", "2", "--batch", "2"]
    found = answer(capsys, *command, "--steps", "3")
    assert found == {"checkpoint": "out"}
    assert load(AncshNet, tmp_path / "out").category == DRAWER
    config = json.loads((tmp_path / "out" / "config.json").read_text())
    assert (config["kind"], config["training"]["objects"]) == ("ancsh", 2)
    assert "out" in refused(capsys, *command, "--steps", "4")
    assert "--batch" in refused(capsys, *command[:-1], "0")
