"""What networks are taught: labels of the views that are drawn, frames of second looks, and losses without error."""

import pytest
import torch

from helpers.categories import LAPTOP
from omad.data.procedural import generate
from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewSettings, draw_views
from omad.geometry.kinematics import deform
from omad.geometry.transforms import invert_transform, matrix_to_quaternion, rotation_angle
from omad.model.checkpoint import find_weights, load
from omad.model.network_input import to_input_frame
from omad.model.object_prior import object_keypoints
from omad.model.omadnet import OmadNet, Prediction
from omad.model.priornet import PriorNet
from omad.training.train_net import NetLossWeights, disturbed_frames, net_losses, view_truth


@pytest.fixture(scope="module")
def drawn():
    bank = SurfaceBank.from_models([generate(LAPTOP, index) for index in range(2)], LAPTOP, samples=4096)
    nodes = object_keypoints(load(PriorNet, find_weights("laptop") / "prior"), bank)
    settings = ViewSettings(points=64, scale=(1.3, 1.3))
    views = draw_views(bank, LAPTOP, 32, settings, torch.Generator().manual_seed(0))
    return load(OmadNet, find_weights("laptop")), nodes, views


def test_views_are_labelled_with_their_stretched_objects_where_they_are(drawn):
    net, nodes, views = drawn
    truth, wanted = view_truth(net, views, nodes), 1.3 * nodes[views.indices]
    assert (truth.canonical - wanted).norm(dim=-1).mean() < 0.05
    joints = views.axes, views.pivots, views.states
    carried = deform(net.prior.tree, net.prior.part_of, wanted, *joints, views.T_camera_base)
    assert (truth.keypoints - carried).norm(dim=-1).mean() < 0.05


def test_second_looks_are_near_the_base_and_some_are_turned(drawn):
    views, draw = drawn[2], torch.Generator().manual_seed(0)
    for turned in (0.0, 1.0):
        off = invert_transform(views.T_camera_base) @ disturbed_frames(views, 1.0, turned, draw)
        assert off[:, :3, 3].norm(dim=-1).median() < 0.2
        turn = rotation_angle(off[:, :3, :3], torch.eye(3))
        assert ((turn > 1).float().mean() > 0.6) == bool(turned)
    first = disturbed_frames(views, 0.0, 1.0, draw)
    assert torch.equal(first[:, :3, :3], torch.eye(3).expand(32, 3, 3))


class Knowing:
    """Says what is true."""

    def __init__(self, net, said):
        self.prior, self.category, self.said = net.prior, net.category, said

    def __call__(self, points):
        return self.said


def test_who_says_the_truth_in_the_frame_that_is_shown_has_no_loss(drawn):
    net, nodes, views = drawn
    truth, frames = view_truth(net, views, nodes), disturbed_frames(views, 0.5, 0.5, torch.Generator().manual_seed(0))
    base = torch.linalg.inv(frames) @ views.T_camera_base
    said = Prediction(
        truth.beta,
        matrix_to_quaternion(base[:, :3, :3]),
        base[:, :3, 3],
        views.states,
        to_input_frame(truth.keypoints, frames),
        torch.zeros(truth.keypoints.shape[:2]),
        torch.zeros(32, 0),
        100 * torch.nn.functional.one_hot(views.labels, 2).float(),
    )
    terms = net_losses(Knowing(net, said), views, truth, frames, None, NetLossWeights())
    for name in ("keypoints", "segmentation", "base", "states", "shape"):
        assert terms[name] < 1e-3, name
