"""The compiled steps of PointNet++ against plain PyTorch and SciPy, forward and backward."""

import threading
from copy import deepcopy

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from helpers.categories import LAPTOP
from omad.model.backbones import BACKBONES, BackboneConfig
from omad.model.backbones.point_ops import (
    gather,
    interpolate,
    nearest,
    plain_nearest,
    plain_pooled_groups,
    pooled_groups,
)
from omad.model.backbones.pointnet2 import PointNet2Config
from omad.model.inference.network import TOGETHER, InferenceNet, inference_net
from omad.model.omadnet import OmadNet
from omad.model.prior import OmadPrior

ODD = PointNet2Config(
    points=200, centres=(70, 19), neighbours=(7, 5), widths=(24, 40, 56), dense=48, radii=(0.3, None)
)  # fmt: skip


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(("queries", "points", "k"), [(128, 512, 16), (33, 100, 3), (5, 9, 9), (20, 70, 7), (1, 3, 3)])
def test_neighbours_are_those_of_a_tree(queries, points, k):
    cloud = normal(2, points, 3)
    squared, index = nearest(cloud[:, :queries], cloud, k)
    for b in range(2):
        distance, expected = KDTree(cloud[b]).query(cloud[b, :queries], k)
        assert np.array_equal(index[b].numpy(), expected.reshape(-1, k))
        assert np.allclose(squared[b].numpy(), distance.reshape(-1, k) ** 2, atol=1e-6)


@pytest.mark.parametrize("k", [3, 4])
def test_of_equally_near_points_the_earlier_ones_are_taken(k):
    cloud = normal(1, 6, 3).repeat(1, 5, 1)  # every point five times
    _, index = nearest(cloud[:, :6], cloud, k)
    assert torch.equal(index[0], (torch.arange(6)[:, None] + 6 * torch.arange(k)).int())


def gradients(function, *inputs: torch.Tensor) -> list[torch.Tensor]:
    own = [tensor.clone().requires_grad_() for tensor in inputs]
    out = function(*own)
    (out * normal(*out.shape, seed=9)).sum().backward()
    return [out.detach(), *(tensor.grad for tensor in own)]


@pytest.mark.parametrize(("n", "k", "C", "D"), [(128, 16, 96, 96), (10, 3, 7, 5), (4, 1, 3, 33)])
def test_pooled_groups_and_their_gradients(n, k, C, D):
    values, centres, weight, bias = normal(3, 200, C), normal(3, n, C, seed=1), normal(D, C, seed=2), normal(D, seed=3)
    index = torch.randint(200, (3, n, k), generator=torch.Generator().manual_seed(4))
    inputs = values, centres, weight / C**0.5, bias
    ours = gradients(lambda v, c, w, b: pooled_groups(v, c, index, w, b), *inputs)
    plain = gradients(lambda v, c, w, b: plain_pooled_groups(v, c, index, w, b), *(x.double() for x in inputs))
    for one, other in zip(ours, plain, strict=True):
        assert torch.allclose(one.double(), other, rtol=1e-5, atol=1e-5 * float(other.abs().max()))


def test_interpolation_and_its_gradient():
    queries, points, values = normal(2, 90, 3), normal(2, 31, 3, seed=1), normal(2, 31, 11, seed=2)

    def plain(values: torch.Tensor) -> torch.Tensor:
        squared, index = plain_nearest(queries.double(), points.double(), 3)
        shares = 1 / (squared + 1e-6)
        return (gather(values, index) * (shares / shares.sum(-1, keepdim=True))[..., None]).sum(2)

    ours = gradients(lambda v: interpolate(queries, points, v), values)
    for one, other in zip(ours, gradients(plain, values.double()), strict=True):
        assert torch.allclose(one.double(), other, rtol=1e-5, atol=1e-5)


def network(config: BackboneConfig, attention: bool = True) -> OmadNet:
    torch.manual_seed(0)
    net = OmadNet(LAPTOP, OmadPrior(LAPTOP), config, attention)
    for parameter in net.parameters():  # a fresh network's normalisation has no scale or shift to forget
        torch.nn.init.normal_(parameter, std=0.2 if parameter.dim() == 1 else parameter.shape[-1] ** -0.5)
    return net.eval().requires_grad_(False)


def plainly(net: OmadNet, points: torch.Tensor):
    """Through PyTorch alone, in doubles."""
    return deepcopy(net).double()(points.double())


@pytest.mark.parametrize("config", [*BACKBONES.values(), ODD])
@pytest.mark.parametrize("attention", [True, False])
def test_inference_says_what_the_network_says(config, attention):
    net, points = network(config, attention), normal(TOGETHER + 1, config.points, 3) * 0.4
    fast = inference_net(net)
    assert isinstance(fast, InferenceNet)
    ours, expected = fast(points), plainly(net, points)
    for name, value in vars(expected).items():
        assert torch.allclose(getattr(ours, name).double(), value, rtol=1e-4, atol=1e-5 * float(value.abs().max())), (
            name
        )
    assert fast(points, labels=False).part_logits.shape == (len(points), 0, 2)


def test_inference_of_a_cloud_does_not_depend_on_the_batch():
    fast, points = inference_net(network(BACKBONES["slim"])), normal(7, 512, 3) * 0.4
    together = fast(points)
    for i in range(7):
        alone = fast(points[i : i + 1])
        assert torch.allclose(together.keypoints[i : i + 1], alone.keypoints, atol=1e-6)


def test_threads_do_not_disturb_each_other():
    fast, clouds = inference_net(network(BACKBONES["slim"])), normal(2, 40, 512, 3) * 0.4
    alone = [[fast(one[None]).keypoints for one in some] for some in clouds]
    found: list[list[torch.Tensor]] = [[], []]
    shared_by = torch.get_num_threads()  # a matrix product's rounding depends on it, and each thread has its own

    def work(number: int) -> None:
        torch.set_num_threads(shared_by)
        found[number] += [fast(one[None]).keypoints for one in clouds[number]]

    threads = [threading.Thread(target=work, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for some, expected in zip(found, alone, strict=True):
        assert all(torch.equal(one, other) for one, other in zip(some, expected, strict=True))
