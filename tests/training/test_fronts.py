"""Training the network that tells categories by their fronts: its images, and that it learns from them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from omad.data.procedural import generate
from omad.model.fronts.image import CHANNELS, COLUMNS, ROWS
from omad.model.fronts.network import FrontNet
from omad.objects.category_file import get_category
from omad.training.train_fronts import (
    PLACED,
    STEPS,
    FrontTraining,
    HandTraining,
    _misplaced,
    front_images,
    train_fronts,
    train_hands,
)

NAMES = "drawer_1", "drawer_5"


def images(name: str, views: int, seed: int = 0) -> np.ndarray:
    category = get_category(name)
    return front_images([generate(category, index) for index in range(4)], category, views, seed)


@pytest.fixture(scope="module")
def fronts() -> dict[str, np.ndarray]:
    return {name: images(name, 24) for name in NAMES}


def test_images_are_of_clean_and_of_spoilt_views_and_the_same_by_seed(fronts):
    found = fronts["drawer_1"]
    assert found.dtype == np.int8
    assert found.shape[1:] == (CHANNELS, ROWS, COLUMNS)
    assert 12 * PLACED < len(found) <= 24 * PLACED
    few = images("drawer_1", 6)
    assert len(few) > 3 * PLACED
    assert np.array_equal(found[: len(few)], few)
    assert not np.array_equal(found[0], images("drawer_1", 6, seed=1)[0])
    assert not np.array_equal(found[0], found[1])  # one view, placed twice
    assert set(np.unique(found[:, 0])) == {0, round(STEPS)}


def trained(fronts, folder, **schedule) -> FrontNet:
    settings = FrontTraining(replace(FrontTraining().schedule, log_steps=1, **schedule))
    return train_fronts(fronts, folder, settings)


def test_the_same_seed_gives_the_same_network(fronts, tmp_path):
    one, other, another = (
        trained(fronts, tmp_path / name, steps=2, batch=8, seed=seed) for name, seed in (("a", 0), ("b", 0), ("c", 1))
    )
    assert one.names == NAMES
    weights = [torch.cat([p.flatten() for p in net.parameters()]) for net in (one, other, another)]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_it_learns_what_it_is_shown(fronts, tmp_path):
    net = trained(fronts, tmp_path, steps=60, batch=32, average=0.9).eval()
    with torch.no_grad():
        right = [net(torch.from_numpy(fronts[name] / np.float32(STEPS))).argmax(1) == i for i, name in enumerate(NAMES)]
    assert torch.cat(right).double().mean() > 0.9


def test_it_learns_which_hand_a_door_is_of(tmp_path):
    category = get_category("microwave")
    seen = {"microwave": front_images([generate(category, index) for index in range(4)], category, 24, 0)}
    schedule = replace(HandTraining().schedule, steps=60, batch=32, average=0.9, log_steps=1)
    net = train_hands(seen, tmp_path, HandTraining(schedule)).eval()
    with torch.no_grad():
        own = net(torch.from_numpy(seen["microwave"] / np.float32(STEPS)))[:, 0] > 0
    assert own.double().mean() > 0.9


def test_places_are_off_along_the_sides_of_the_body():
    T = np.eye(4)
    T[:2, :2] = [[0, -1], [1, 0]]
    place, _ = _misplaced(T, np.array([[0.0, 0, 0], [1, 0, 0]]), np.random.default_rng(0))
    assert place[0, 3] == place[2, 3] == 0 != place[1, 3]
