"""Figures: their measurements are right, their commands write pictures and the numbers behind them."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import omad
from helpers.categories import CATEGORIES
from helpers.command_line import answer, laptop_view, refused
from omad.cli.main import run
from omad.data.procedural import generate
from omad.evaluation.figures import surfaces
from omad.evaluation.figures.correspondence import opened
from omad.evaluation.figures.occlusion import hidden_share, occlude
from omad.evaluation.figures.scene import crop_around, shaded, studio
from omad.evaluation.figures.style import keypoint_colours
from omad.evaluation.figures.sweep import SIGMAS, shape_sweep
from omad.geometry.camera import STANDARD_CAMERA
from omad.geometry.rigid import carry
from omad.model.checkpoint import WEIGHTS as SHIPPED
from omad.model.checkpoint import load, shipped_categories
from omad.model.object_prior import object_prior, relabelled
from omad.model.omadnet import OmadNet
from omad.model.priornet import PriorNet
from omad.objects.pose import ObjectPose

LAPTOP = ["--categories", "laptop", "--output", "out"]


PAGE = Path(__file__).parents[2] / "docs" / "figures.md"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def check_pictures(found: dict, *stems: str) -> dict:
    """The named pictures are there, small and wide enough; returns the numbers behind them."""
    names = [Path(file).name for file in found["files"]]
    assert names[:-1] == [f"{stem}.png" for stem in stems]
    for file in found["files"][:-1]:
        assert Path(file).stat().st_size < 150_000
        image = np.asarray(Image.open(file).convert("RGB"))
        assert image.shape[1] >= 900
        assert (image < 128).any()
    return json.loads(Path(found["files"][-1]).read_text())


def test_qualitative(capsys):
    found = answer(capsys, "figure", "qualitative", *LAPTOP, "--objects", "1", "--views", "1")
    row = check_pictures(found, "qualitative-laptop")["categories"][0]
    initial, refined, true = (np.array(row["keypoints"][key]) for key in ("initial", "refined", "true"))
    off = [np.linalg.norm(keypoints - true, axis=1).mean() for keypoints in (initial, refined)]
    assert off[1] < off[0] < 0.1
    assert row["errors"]["refined"]["axis_deg"][0] < 5
    assert abs(row["joint_states"]["refined"][0] - row["joint_states"]["true"][0]) < 0.2


@pytest.mark.slow
def test_qualitative_of_rendered_images_and_of_many_categories(capsys):
    options = ["--category", "laptop", "--objects", "1", "--views", "2", "--output", "views"]
    answer(capsys, "render", *options)
    found = answer(capsys, "figure", "qualitative", *LAPTOP, "--source", "views", "--views", "1")
    assert check_pictures(found, "qualitative-laptop")["categories"][0]["keypoints"]["true"] is None
    two = ["--categories", "laptop", "scissors", "--output", "out", "--objects", "1", "--views", "1"]
    found = answer(capsys, "figure", "qualitative", *two)
    check_pictures(found, "qualitative-laptop", "qualitative-scissors", "qualitative")


@pytest.mark.slow
def test_keypoints(capsys):
    found = answer(capsys, "figure", "keypoints", *LAPTOP, "--objects", "3", "--columns", "2")
    row = check_pictures(found, "keypoints")["categories"][0]
    assert np.shape(row["keypoints"]) == (3, CATEGORIES["laptop"].num_keypoints, 3)
    assert np.shape(row["axes"]) == (3, 1, 3)


@pytest.mark.slow
def test_sweep(capsys):
    found = answer(capsys, "figure", "sweep", *LAPTOP, "--steps", "3", "--directions", "2")
    row = check_pictures(found, "sweep-joints", "sweep-shapes")["categories"][0]
    low, high = CATEGORIES["laptop"].joints[0].limits
    states = np.ravel(row["joints"]["joint_states"])
    assert sorted(states) == pytest.approx([low, (low + high) / 2, high], abs=1e-5)
    moved = np.array(row["joints"]["keypoints"])
    assert np.allclose(moved[0, :12], moved[2, :12])  # the base stays where it is
    assert np.linalg.norm(moved[0, 12:] - moved[2, 12:], axis=1).max() > 0.1
    assert "at least 2" in refused(capsys, "figure", "sweep", *LAPTOP, "--steps", "1")


@pytest.mark.slow
def test_occlusion(capsys):
    found = answer(capsys, "figure", "occlusion", *LAPTOP, "--objects", "2", "--views", "4")
    row = check_pictures(found, "occlusion")["categories"][0]
    assert set(row["cut"]) == set(row["hidden"]) == {"ancsh", "omad_initial", "omad_refined"}
    spread = row["cut"]["omad_refined"]["axis_deg"]
    assert spread["share"] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert (np.diff(spread["quartiles"], axis=1) >= 0).all()
    middle = np.array(spread["quartiles"])[:, 1]
    assert middle[0] < 3
    assert middle[-1] > middle[0]
    assert sum(row["hidden"]["omad_refined"]["axis_deg"]["views"]) == 4


@pytest.mark.slow
def test_tsne(capsys):
    pytest.importorskip("sklearn")
    found = answer(capsys, "figure", "tsne", *LAPTOP, "--objects", "2", "--views", "12")
    row = check_pictures(found, "tsne")["categories"][0]
    assert set(row["maps"]) == {"beta", "pooled"} | ({"siamese"} if (SHIPPED / "laptop/siamese").is_dir() else set())
    assert np.shape(row["maps"]["beta"]["points"]) == (12, 2)
    assert row["maps"]["beta"]["nearest_is_same_object"] >= 0.75
    assert "views" in refused(capsys, "figure", "tsne", *LAPTOP, "--views", "3")


def test_tsne_says_what_it_needs(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.manifold", None)
    assert "omad[figures]" in refused(capsys, "figure", "tsne", *LAPTOP)


def test_a_sweep_of_more_directions_than_there_are_is_refused(capsys):
    line = refused(capsys, "figure", "sweep", *LAPTOP, "--directions", "11", "--output", "figures")
    assert "--directions 11: beta of a laptop has 10" in line
    assert not Path("figures").exists()


@pytest.mark.parametrize("name", ["qualitative", "keypoints", "sweep", "occlusion"])
def test_bad_input(name, capsys):
    assert "spoon" in refused(capsys, "figure", name, "--categories", "spoon")
    Path("empty").mkdir()
    assert "config.json" in refused(capsys, "figure", name, "--weights", "empty")


@pytest.mark.parametrize("share", [0.0, 0.25, 0.6])
def test_occluders_take_what_they_say(share):
    depth = laptop_view().depth
    for seed in range(4):
        left = occlude(depth, depth > 0, share, np.random.default_rng(seed))
        assert np.count_nonzero(left) == pytest.approx((1 - share) * np.count_nonzero(depth), abs=1)
        assert (left[left > 0] == depth[left > 0]).all()
        again = occlude(depth, depth > 0, share, np.random.default_rng(seed))
        assert (left == again).all()
        cluttered = np.where(depth > 0, depth, 2.0)  # a wall behind, which is nothing of the object's
        assert np.array_equal(
            occlude(cluttered, depth > 0, share, np.random.default_rng(seed))[depth > 0], left[depth > 0]
        )
        assert (occlude(cluttered, depth > 0, share, np.random.default_rng(seed))[depth == 0] == 2.0).all()
    nothing = np.zeros((4, 4))
    assert not occlude(nothing, nothing > 0, 0.5, np.random.default_rng(0)).any()


def test_a_view_hides_the_far_side():
    """Of a thin board seen square on, its own back is hidden; seen with more in front of it, more."""
    view = laptop_view()
    model = generate(CATEGORIES["laptop"], 0, "test")
    hidden = hidden_share(view, model)
    assert 0.3 < hidden < 0.8
    behind = view.T_camera_base.copy()
    behind[0, 3] += 10  # out of the frame
    assert hidden_share(type(view)(**{**vars(view), "T_camera_base": behind}), model) == 1


@pytest.mark.parametrize("name", shipped_categories())
def test_prior_keypoints_lie_in_their_object(name):
    net = load(PriorNet, SHIPPED / name / "prior")
    models = [generate(net.category, index, "test") for index in range(2)]
    found = object_prior(net, models)
    for model, keypoints in zip(models, found.keypoints, strict=True):
        boxes = model.part_boxes()[list(net.category.part_of_keypoint)]
        slack = 0.15 * model.diagonal
        assert (keypoints > boxes[:, 0] - slack).all()
        assert (keypoints < boxes[:, 1] + slack).all()
    assert np.isnan(found.pivots).all(-1).any() == (not all(net.category.turning))


def test_either_labelling_is_the_same_object():
    category = CATEGORIES["scissors"]
    model = generate(category, 0, "test")
    other = relabelled(model)
    states = np.array([-0.4])
    T = model.part_transforms(states)
    pose = ObjectPose(states, model.axes, model.pivots, T).swapped()
    for k, part in enumerate(other.parts):
        assert np.allclose(carry(pose.T_camera_part[k], part.vertices), model.posed_vertices(states)[1 - k])


def test_whole_objects_are_drawn_a_column_each(tmp_path):
    view, model = laptop_view(), generate(CATEGORIES["laptop"], 0, "test")
    estimate = omad.Estimator.from_pretrained("laptop", "cpu")(view.observation())
    drawn = surfaces.draw([surfaces.Seen(view, estimate, model)] * 2)
    assert len(drawn.axes) == 2 * len(surfaces.ROWS)
    depth, mine, true, _ = (np.asarray(panel.images[0].get_array()) for panel in drawn.axes[: len(surfaces.ROWS)])
    there = [(picture < 0.99).any(2) for picture in (mine, true)]
    assert (there[0] & there[1]).sum() > 0.8 * (there[0] | there[1]).sum()
    assert np.isfinite(depth).any()


def test_shapes_spread_like_the_training_objects():
    net = load(OmadNet, SHIPPED / "laptop")
    row = shape_sweep(net.prior, net.category, 3)
    assert row.keypoints.shape == (7, net.prior.num_keypoints, 3)
    assert (np.diff(row.share) <= 0).all()
    assert row.share.sum() <= 1 + 1e-6
    assert np.allclose((row.beta[1] + row.beta[2]) / 2, row.beta[0], atol=1e-5)
    move = (row.beta[2] - row.beta[0]) / SIGMAS
    precision = np.linalg.inv(net.prior.beta_covariance.double().numpy())
    assert move @ precision @ move == pytest.approx(1, rel=1e-3)  # one standard deviation


def test_joints_open_from_the_end_nearer_to_rest():
    limits = np.array([[0.0, 2.0], [-1.0, 0.0]])
    assert opened(limits, 0.25) == pytest.approx([0.5, -0.25])


def test_a_crop_shows_what_it_is_made_for():
    points = np.random.default_rng(0).normal(size=(50, 3)) * 0.1 + [0.3, 0, 1.5]
    crop = crop_around(STANDARD_CAMERA, points, 0.8, foot=0.1)
    uv = crop.project(points)
    assert (uv > 0).all()
    assert (uv < [crop.width, 0.9 * crop.height]).all()


def test_shading_keeps_part_colours_apart():
    model = generate(CATEGORIES["laptop"], 0, "test")
    T, crop = studio(np.concatenate(model.posed_vertices(np.zeros(1))), 0.8)
    image = shaded(crop, model.posed(np.zeros(1), T), np.array([[1.0, 0, 0], [0, 0, 1.0]]))
    red, blue = ((image.argmax(-1) == channel) & (image.min(-1) < 0.1) for channel in (0, 2))
    assert red.mean() > 0.05
    assert blue.mean() > 0.05
    assert (image[0] == 1).all()  # white around


def test_keypoint_colours_differ():
    colours = keypoint_colours(36)
    apart = np.linalg.norm(colours[:, None] - colours, axis=-1) + 10 * np.eye(36)
    assert apart.min() > 0.03
    assert (colours[:24] == keypoint_colours(24)).all()


def test_the_page_names_commands_and_pictures_that_exist():
    lines = [line.split("#")[0].split() for line in PAGE.read_text().splitlines() if line.startswith("omad ")]
    assert {words[2] for words in lines} == {"keypoints", "qualitative", "sweep", "occlusion", "tsne"}
    for words in lines:
        with pytest.raises(SystemExit) as stop:
            run([*words[1:], "--help"])
        assert stop.value.code == 0
    pictures = re.findall(r"\]\((figures/[^)]+)\)", PAGE.read_text())
    assert pictures
    assert sum((PAGE.parent / picture).stat().st_size for picture in pictures) < 1_000_000
