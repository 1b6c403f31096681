"""An object's front as an image, and the network that tells categories by it."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from omad.data.procedural import generate
from omad.data.rendering.standard_views import View, standard_view
from omad.model.checkpoint import load, save, shipped_categories
from omad.model.fronts.hands import WEIGHTS as HAND_WEIGHTS
from omad.model.fronts.hands import HandNet, shipped_hand_net
from omad.model.fronts.image import ABOVE, BESIDE, CHANNELS, COLUMNS, MOST, OUT, RELIEF, ROWS, front_image
from omad.model.fronts.network import WEIGHTS, FrontNet, shipped_front_net
from omad.objects.category_file import get_category

BODY = np.array([[-0.2, -0.5, -0.3], [0.2, 0.5, 0.3]])
"""A metre high, so that heights of it are metres."""


def sheet(out: float, across: tuple[float, float] = (-0.2, 0.2), up: tuple[float, float] = (-0.5, 0.5)) -> np.ndarray:
    """Points side by side, so far in front of the body's front."""
    x, y = np.meshgrid(np.linspace(*across, 200), np.linspace(*up, 400))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.3 + out)])


def test_a_place_of_the_front_is_where_it_is_in_the_image():
    image = front_image(np.array([[0.14, -0.495, 0.3]]), np.eye(4), BODY)
    assert image.shape == (CHANNELS, ROWS, COLUMNS)
    [[row, column]] = np.argwhere(image[0])
    assert row == int((0.005 + ABOVE) / (1 + 2 * ABOVE) * ROWS)
    assert column == int((0.85 + BESIDE) / (1 + 2 * BESIDE) * COLUMNS)
    assert not front_image(np.array([[0.3, 0.0, 0.3], [0.0, 0.0, 0.0]]), np.eye(4), BODY).any()  # beside it, behind it


def test_an_open_drawer_is_in_front_and_a_handle_in_relief():
    drawer, handle = sheet(0.15, up=(0.0, 0.5)), sheet(0.03, (-0.05, 0.05), (-0.26, -0.24))
    image = front_image(np.concatenate([sheet(0.0, up=(-0.5, 0.0)), drawer, handle]), np.eye(4), BODY)
    middle = COLUMNS // 2
    row = [int((y + 0.5 + ABOVE) / (1 + 2 * ABOVE) * ROWS) for y in (0.25, -0.35, -0.25)]
    assert image[1, row[0], middle] == pytest.approx(0.15 / OUT, abs=0.01)
    assert image[1, row[1], middle] == pytest.approx(0.0, abs=0.01)
    assert image[3, row[2], middle] > 0.5 * 0.03 / RELIEF  # the handle stands out of what is around it
    assert abs(image[3, row[0], middle]) < 0.01
    assert np.abs(image).max() <= MOST


def seen(name: str, index: int) -> View:
    category = get_category(name)
    return standard_view(generate(category, index, "test"), category, (3, index))


def test_the_front_is_the_same_from_wherever_it_is_seen():
    view = seen("drawer", 0)
    points, body = view.observation().points.astype(np.float64), view.truth.part_boxes[0]
    turned = np.eye(4)
    turned[:3, :3] = Rotation.random(rng=0).as_matrix()
    turned[:3, 3] = 0.3, -0.2, 1.0
    one = front_image(points, view.T_camera_base, body)
    other = front_image(points @ turned[:3, :3].T + turned[:3, 3], turned @ view.T_camera_base, body)
    assert np.allclose(one, other, atol=1e-5)


@pytest.mark.parametrize("kind", [FrontNet, HandNet])
def test_a_checkpoint_gives_the_same_network(kind, tmp_path):
    net = kind(("a", "b")).eval()
    save(net, tmp_path, {"why": "test"})
    again = load(kind, tmp_path)
    assert again.names == ("a", "b")
    images = torch.randn(2, CHANNELS, ROWS, COLUMNS)
    assert torch.equal(again(images), net(images))


def test_it_says_how_likely_each_category_is():
    said = FrontNet(("a", "b")).eval().says(np.zeros((3, CHANNELS, ROWS, COLUMNS), np.float32))
    assert said.shape == (3, 2)
    assert np.exp(said).sum(1) == pytest.approx(np.ones(3), abs=1e-5)


def test_the_shipped_one_is_small_and_counts_drawers():
    net = shipped_front_net()
    assert set(net.names) == set(shipped_categories())
    assert (WEIGHTS / "model.safetensors").stat().st_size < 2e5
    chests = ("drawer_2", "drawer", "drawer_4", "drawer_5")
    right = []
    for name in chests:
        for index in range(10):
            view = seen(name, index)
            image = front_image(view.observation().points, view.T_camera_base, view.truth.part_boxes[0])
            said = dict(zip(net.names, net.says(image[None])[0], strict=True))
            right.append(max(chests, key=said.__getitem__) == name)
    assert np.mean(right) >= 0.85


def test_an_image_and_its_mirror_image_are_of_opposite_hands():
    net = HandNet(("a", "b")).eval()
    images = torch.randn(3, CHANNELS, ROWS, COLUMNS)
    assert torch.allclose(net(images), -net(images.flip(3)), atol=1e-6)
    assert not torch.allclose(net(images), torch.zeros(3, 2), atol=1e-6)
    assert net.says(images[0].numpy(), "b") == pytest.approx(net(images)[0, 1].item(), abs=1e-6)
    assert net.says(images[0].numpy(), "c") == 0.0


def test_the_shipped_one_tells_which_hand_an_object_is_of():
    net = shipped_hand_net()
    assert set(net.names) == {name for name in shipped_categories() if get_category(name).either_hand}
    assert (HAND_WEIGHTS / "model.safetensors").stat().st_size < 2e5
    right = []
    for name in net.names:
        for index in range(10):
            view = seen(name, index)
            image = front_image(view.observation().points, view.T_camera_base, view.truth.part_boxes[0])
            right.append(net.says(image, name) > 0)
    assert np.mean(right) >= 0.85
