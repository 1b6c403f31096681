"""Backbone and networks against brute force, and the properties that users rely on."""

import copy
import json

import pytest
import torch

from helpers.categories import CATEGORIES, LAPTOP
from omad.common.incoming import CHECKSUM
from omad.model.backbones import BACKBONES
from omad.model.backbones.point_ops import gather, interpolate, nearest
from omad.model.checkpoint import load, save
from omad.model.network_input import first_frame, to_input_frame
from omad.model.omadnet import OmadNet
from omad.model.prior import OmadPrior
from omad.model.priornet import PriorNet
from omad.training.train_prior import PriorLossWeights, prior_losses


def cloud(batch: int = 2, points: int = 512, seed: int = 0) -> torch.Tensor:
    return torch.randn(batch, points, 3, generator=torch.Generator().manual_seed(seed)) * 0.4


def test_nearest_matches_brute_force():
    points = cloud(2, 200)
    squared, index = nearest(points[:, :20], points, 5)
    brute = torch.cdist(points[:, :20].double(), points.double()).square()
    expected = brute.topk(5, largest=False).values
    assert torch.allclose(squared.sort().values.double(), expected, atol=1e-5)
    assert torch.allclose(brute.gather(2, index).sort().values, expected, atol=1e-5)


def test_gather_takes_rows():
    values = torch.arange(24.0).reshape(2, 4, 3)
    index = torch.tensor([[[0, 3], [1, 1]], [[2, 0], [3, 3]]])
    taken = gather(values, index)
    assert torch.equal(taken[1, 0, 0], values[1, 2])
    assert torch.equal(taken[0, 0, 1], values[0, 3])


def test_interpolation_reproduces_values_at_the_points_themselves():
    points = cloud(2, 50)
    values = torch.randn(2, 50, 7, generator=torch.Generator().manual_seed(1))
    assert torch.allclose(interpolate(points, points, values), values, atol=0.02)


@pytest.fixture(scope="module")
def net() -> OmadNet:
    torch.manual_seed(0)
    return OmadNet(LAPTOP, OmadPrior(LAPTOP, generator=torch.Generator().manual_seed(0))).eval()


@torch.no_grad()
def test_shapes_and_ranges(net):
    out = net(cloud())
    assert out.keypoints.shape == (2, LAPTOP.num_keypoints, 3)
    assert out.states.shape == (2, 1)
    assert out.part_logits.shape == (2, 512, 2)
    assert torch.allclose(out.quaternion.norm(dim=-1), torch.ones(2))


@torch.no_grad()
def test_one_cloud_of_a_batch_does_not_see_the_others(net):
    a, b = cloud(seed=1), cloud(seed=2)
    together = net(torch.cat([a, b]))
    assert torch.allclose(together.keypoints[:2], net(a).keypoints, atol=1e-5)


@torch.no_grad()
def test_paper_size_runs():
    net = OmadNet(LAPTOP, OmadPrior(LAPTOP), BACKBONES["paper"]).eval()
    assert net(cloud(1, 1024)).keypoints.isfinite().all()


def test_every_weight_of_the_network_learns(net):
    out = net(cloud())
    total = sum(x.square().sum() for x in (out.beta, out.quaternion @ torch.randn(4, 1), out.translation, out.states))
    (total + out.keypoints.square().sum() + out.log_sigma.sum() + out.part_logits.square().sum()).backward()
    missing = [n for n, p in net.named_parameters() if p.requires_grad and (p.grad is None or not p.grad.any())]
    assert missing == []


@torch.no_grad()
def test_input_frame_round_trip():
    points = cloud() + 3
    frame = first_frame(points)
    local = to_input_frame(points, frame)
    assert torch.allclose(local.mean(1), torch.zeros(2, 3), atol=1e-5)
    assert torch.allclose(local @ frame[:, :3, :3].mT + frame[:, None, :3, 3], points, atol=1e-5)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
@torch.no_grad()
def test_cpu_and_cuda_agree(net):
    here = net(cloud())
    there = net.to("cuda")(cloud().to("cuda"))
    net.to("cpu")
    assert torch.allclose(here.keypoints, there.keypoints.cpu(), atol=1e-3)


@pytest.mark.parametrize("name", sorted(CATEGORIES))
def test_nodes_lie_within_their_part_and_mirror(name):
    category = CATEGORIES[name]
    net = PriorNet(category, generator=torch.Generator().manual_seed(0))
    clouds = [cloud(2, 60 + 20 * part, seed=part) for part in range(len(category.parts))]
    with torch.no_grad():
        nodes = net(clouds).nodes
    on_part = nodes[:, net.part_of == 1]
    assert (on_part[..., 1:] >= clouds[1].amin(1)[:, None, 1:] - 1e-5).all()
    image = net.prior.is_image
    assert torch.allclose(nodes[:, image], nodes[:, net.prior.source[image]] * torch.tensor([-1.0, 1, 1]))


def test_prior_losses_have_every_term_of_the_paper():
    net = PriorNet(LAPTOP)
    clouds = [cloud(3, 150), cloud(3, 200, seed=1)]
    axes, pivots = torch.tensor([[[1.0, 0, 0]]]).expand(3, 1, 3), torch.zeros(3, 1, 3)
    terms = prior_losses(net, clouds, axes, pivots, PriorLossWeights())
    assert {"chamfer", "coverage", "surface", "separation", "joint", "beta"} <= set(terms)
    sum(terms.values()).backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())


@torch.no_grad()
def test_a_network_learns_to_tell_outside_from_one_that_did_not(net, tmp_path):
    told = OmadNet(net.category, net.prior, net.backbone.config, tells_outside=True)
    told.start_from(net)
    points = torch.randn(2, net.backbone.config.points, 3, generator=torch.Generator().manual_seed(0))
    before, after = net(points), told(points)
    assert torch.equal(after.part_logits[..., :-1], before.part_logits)
    assert torch.equal(after.keypoints, before.keypoints)
    save(told, tmp_path, {})
    again = load(OmadNet, tmp_path)
    assert again.tells_outside
    assert torch.equal(again(points).part_logits, after.part_logits)
    again_from_it = OmadNet(net.category, net.prior, net.backbone.config, tells_outside=True)
    again_from_it.start_from(again)
    assert torch.equal(again_from_it(points).part_logits, after.part_logits)


@torch.no_grad()
@pytest.mark.parametrize("loose", [(0, 0), (2, 0), (0, 2), (2, 1)], ids=str)
def test_a_network_starts_with_a_prior_that_speaks_of_the_same_keypoints_otherwise(net, loose):
    turned, net = PriorNet(net.category).prior, copy.deepcopy(net)
    turned.load_state_dict(net.prior.state_dict())
    turn = torch.linalg.qr(torch.randn(2 * (turned.basis_size,), generator=torch.Generator().manual_seed(0))).Q
    turned.learned_basis.copy_(turned.learned_basis @ turn)
    turned.beta_mean.copy_(turn.mT @ turned.beta_mean + 0.1)
    for prior, count in zip((turned, net.prior), loose, strict=True):
        prior.loosen(torch.ones(1, 3, count))
    own = OmadNet(net.category, turned, net.backbone.config)
    own.start_from(net)
    assert torch.equal(own.prior.basis, turned.basis)
    assert own.prior.pivot_basis.shape == (1, 3, loose[0])
    points = torch.randn(2, net.backbone.config.points, 3, generator=torch.Generator().manual_seed(0))
    before, after = net(points), own(points)
    torch.testing.assert_close(turned.keypoints(after.beta), net.prior.keypoints(before.beta), atol=1e-4, rtol=0)
    assert torch.equal(after.keypoints, before.keypoints)


def test_checkpoints_from_before_tell_no_outside(net, tmp_path):
    save(net, tmp_path, {})
    config = json.loads((tmp_path / "config.json").read_text())
    del config["tells_outside"], config[CHECKSUM]
    (tmp_path / "config.json").write_text(json.dumps(config))
    assert not load(OmadNet, tmp_path).tells_outside


def test_a_far_wall_does_not_move_the_first_frame():
    cloud = torch.rand(1, 400, 3, generator=torch.Generator().manual_seed(0))
    wall = torch.cat([4 * torch.rand(1, 100, 2), torch.full((1, 100, 1), 6.0)], -1)
    assert torch.allclose(first_frame(cloud)[0, :3, 3], cloud.mean(1)[0])
    assert torch.allclose(first_frame(torch.cat([cloud, wall], 1))[0, :3, 3], cloud.mean(1)[0], atol=1e-6)


def test_a_cloud_in_pieces_far_from_its_median_has_a_first_frame():
    corners = 9 * torch.eye(3).repeat(1, 50, 1)
    both = torch.cat([corners, torch.rand(1, 150, 3)])
    assert torch.allclose(first_frame(both)[:, :3, 3], both.mean(1))
