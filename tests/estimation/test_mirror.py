"""What is said of a mirror image is said of the object: as the model itself has it, and as networks say it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import omad
from helpers.categories import CATEGORIES
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.estimation.looks.mirror import Mirror
from omad.geometry.transforms import invert_transform, make_transform, matrix_to_quaternion, so3_exp
from omad.model.omadnet import Prediction
from omad.model.prior import OmadPrior
from omad.objects.category import Category

FLIP = torch.tensor([-1.0, 1.0, 1.0])
ALIKE = {"laptop", "eyeglasses", "dishwasher", "drawer"}


def prior_of(category: Category) -> OmadPrior:
    """Random shapes whose joints are where the spec has them, in the plane of the mirror."""
    prior = OmadPrior(category, generator=torch.Generator().manual_seed(0))
    torch.nn.init.zeros_(prior.joint_out.weight)
    return prior


def said_of(prior: OmadPrior, beta: torch.Tensor, states: torch.Tensor, T: torch.Tensor) -> Prediction:
    """The truth, of labels as many as there are parts, and outside."""
    keypoints = prior.deform(beta, states, T)
    logits = torch.eye(int(prior.part_of.max()) + 2).expand(len(beta), -1, -1)
    sigma = keypoints.square().sum(-1)
    return Prediction(beta, matrix_to_quaternion(T[:, :3, :3]), T[:, :3, 3], states, keypoints, sigma, beta, logits)


@pytest.mark.parametrize("name", sorted(ALIKE))
def test_the_truth_of_an_image_is_the_truth_of_the_object(name: str) -> None:
    """Joint states of the image are found by the model alone: those that put its keypoints where the image has them."""
    category = CATEGORIES[name]
    prior, mirror = prior_of(category), Mirror.of(category, tells_outside=True)
    assert mirror is not None
    generator = torch.Generator().manual_seed(1)
    beta = torch.randn(6, prior.basis_size, generator=generator)
    low, high = torch.as_tensor(category.limits).float().T
    states = low + (high - low) * torch.rand(6, len(low), generator=generator)
    T = make_transform(so3_exp(torch.randn(6, 3, generator=generator)), torch.randn(6, 3, generator=generator))
    flip = torch.diag(torch.tensor([-1.0, 1, 1, 1]))
    truth = said_of(prior, beta, states, T)
    image = said_of(prior, beta, (mirror.signs * states[:, mirror.joints]), flip @ T @ flip)
    # keypoints of the image are images of keypoints
    torch.testing.assert_close(image.keypoints, truth.keypoints[:, mirror.keypoints] * FLIP, atol=1e-5, rtol=1e-5)
    assert ((image.states >= low - 1e-6) & (image.states <= high + 1e-6)).all()
    labels = [part.mirror for part in category.parts]
    shown = image.part_logits[:, [*labels, len(labels)]]  # the same points, of which the image shows the other part
    every = torch.ones(6, dtype=torch.bool)
    found = mirror.back(replace(image, part_logits=shown), every)
    turned = torch.sign((found.quaternion * truth.quaternion).sum(1, keepdim=True))
    torch.testing.assert_close(found.quaternion * turned, truth.quaternion, atol=1e-5, rtol=1e-5)
    for field in ("translation", "states", "keypoints", "log_sigma", "part_logits"):
        torch.testing.assert_close(getattr(found, field), getattr(truth, field), atol=1e-5, rtol=1e-5)


def test_only_what_is_asked_for_is_seen_in_the_mirror() -> None:
    mirror = Mirror.of(CATEGORIES["laptop"], tells_outside=False)
    assert mirror is not None
    prior, generator = prior_of(CATEGORIES["laptop"]), torch.Generator().manual_seed(2)
    points, rows = torch.randn(3, 5, 3, generator=generator), torch.tensor([False, True, False])
    assert torch.equal(mirror.images(points, rows), torch.stack([points[0], points[1] * FLIP, points[2]]))
    beta = torch.randn(3, prior.basis_size, generator=generator)
    aside = make_transform(torch.eye(3).expand(3, 3, 3), torch.tensor([0.5, 0.0, 0.0]).expand(3, 3))
    said = said_of(prior, beta, torch.zeros(3, 1), aside)
    said = replace(said, part_logits=said.part_logits[..., :2])
    found = mirror.back(said, rows)
    assert torch.equal(found.keypoints[[0, 2]], said.keypoints[[0, 2]])
    torch.testing.assert_close(found.keypoints[1], said.keypoints[1] - torch.tensor([1.0, 0.0, 0.0]))


def test_other_categories_have_no_images_of_their_own() -> None:
    """Scissors, a jar's thread, doors hinged at one side, and specs whose joints move another way in the mirror."""
    for name in ("scissors", "jar", "microwave", "refrigerator", "cabinet_two_doors"):
        assert Mirror.of(omad.get_category(name), tells_outside=True) is None
    dishwasher = CATEGORIES["dishwasher"]
    [hinge] = dishwasher.joints
    for axis in ((0.0, 1.0, 0.0), (0.7, 0.7, 0.0)):  # a door at the side turns the other way; a slanted one, askew
        assert Mirror.of(replace(dishwasher, joints=(replace(hinge, axis=axis),)), tells_outside=True) is None
    glasses = CATEGORIES["eyeglasses"]
    right, left = glasses.joints
    assert Mirror.of(replace(glasses, joints=(right, replace(left, limits=(-1.0, 0.0)))), tells_outside=True) is None
    assert Mirror.of(replace(glasses, joints=(right, replace(left, axis=(0.0, 2.0, 0.0)))), True) is not None


@pytest.mark.parametrize("name", ["eyeglasses", "drawer"])
def test_networks_say_of_images_what_they_say_of_objects(name: str) -> None:
    """Of a network's last look: as near as its own answers to two choices of points are, not to the last digit."""
    estimator = omad.Estimator.from_pretrained(name, "cpu")
    category, net = estimator.category, estimator.net
    mirror = Mirror.of(category, net.tells_outside)
    assert mirror is not None
    view = standard_view(generate(category, 0, "test"), category, (0, 0))
    points = view.observation().points / category.metres_per_unit
    cloud = torch.as_tensor(points[np.random.default_rng(0).permutation(len(points))[:512]], dtype=torch.float32)
    T = torch.as_tensor(view.T_camera_base, dtype=torch.float32)
    T = torch.cat([torch.cat([T[:3, :3], T[:3, 3:] / category.metres_per_unit], 1), T[3:]])
    inverse = invert_transform(T[None])[0]
    shown = (cloud @ inverse[:3, :3].T + inverse[:3, 3])[None]
    image = torch.ones(1, dtype=torch.bool)
    with torch.no_grad():
        plain, other = net(shown), mirror.back(net(mirror.images(shown, image)), image)
    apart = (plain.keypoints - other.keypoints).norm(dim=-1).mean()
    assert 0 < apart < 0.1  # some percent of the object; left for right would be half of it
    assert (plain.part_logits.argmax(-1) == other.part_logits.argmax(-1)).float().mean() > 0.9
