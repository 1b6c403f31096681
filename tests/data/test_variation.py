"""Variants of a few models are objects of their category: joints fit their parts, mirrored ones move as mirrored."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.categories import CATEGORIES, DRAWER, EYEGLASSES, LAPTOP
from helpers.own_models import JAR, jar, microwave
from omad import get_category
from omad.data.procedural import generate
from omad.data.urdf_import.alignment import check_like
from omad.data.variation import AT_REST, Variation, mirrored, nearly_at_rest, with_variants
from omad.geometry.mesh import triangle_normals
from omad.geometry.transforms import MIRROR_X
from omad.objects.model import PointObject


@pytest.fixture(scope="module")
def microwaves():
    category = get_category("docs/categories/microwave.toml")
    models = [microwave("a"), microwave("b", 0.45, 0.3, 0.4), microwave("c", 0.55, 0.25, 0.3)]
    return category, models, with_variants(models, category, 40)


def test_the_models_come_first_and_the_seed_tells_the_rest(microwaves):
    category, models, made = microwaves
    assert made[:3] == models
    assert len({model.name for model in made}) == len(made) == 40
    again, other = with_variants(models, category, 40), with_variants(models, category, 40, seed=1)
    assert all(np.array_equal(a.parts[1].vertices, b.parts[1].vertices) for a, b in zip(made, again, strict=True))
    assert not np.array_equal(made[5].parts[1].vertices, other[5].parts[1].vertices)
    assert with_variants(models, category, 2) == models


def test_doors_stay_doors(microwaves):
    """Boxes stay boxes, the hinge stays at the door's corner, the door before the body; shares of the whole differ."""
    _, _, made = microwaves
    for model in made:
        body, door = model.part_boxes()
        for part in model.parts:
            normals = triangle_normals(part.triangles)
            assert np.sort(np.abs(normals), axis=1)[:, :2].max() < 1e-12
        np.testing.assert_allclose(model.pivots[0, [0, 2]], door[0, [0, 2]], atol=1e-9)
        np.testing.assert_allclose(model.axes, [[0, -1, 0]], atol=1e-12)
        assert door[0, 2] == pytest.approx(body[1, 2])
        assert model.closed
        np.testing.assert_allclose(model.part_boxes().reshape(-1, 3).min(0), -model.part_boxes().max((0, 1)))
    widths = np.array([np.ptp(model.part_boxes(), axis=1)[:, 0] for model in made])
    assert np.ptp(widths[:, 1] / widths[:, 0]) > 0.2
    assert np.ptp(widths[:, 0]) > 0.15


@pytest.mark.parametrize("name", ["laptop", "eyeglasses", "dishwasher", "drawer"])
def test_a_mirrored_object_moves_as_the_mirror_shows_it(name):
    category = CATEGORIES[name]
    model = generate(category, 3)
    image = mirrored(model, category)
    states = model.limits @ [0.3, 0.7]
    order = [part.mirror for part in category.parts]
    signs = np.sign((image.axes * [joint.axis for joint in category.joints]).sum(1))
    assert (signs > 0).all()
    found = np.array(states)[np.array(order[1:]) - 1]
    inside = (image.limits[:, 0] <= found) & (found <= image.limits[:, 1])
    found = np.where(inside, found, -found)  # a temple folds the other way round
    assert ((image.limits[:, 0] <= found) & (found <= image.limits[:, 1])).all()
    for part, moved in enumerate(image.posed_vertices(found)):
        np.testing.assert_allclose(moved, model.posed_vertices(states)[order[part]] * MIRROR_X, atol=1e-9)
    again = mirrored(image, category)
    np.testing.assert_allclose(again.axes, model.axes, atol=1e-12)
    np.testing.assert_allclose(again.limits, model.limits, atol=1e-12)


def test_symmetric_objects_stay_symmetric():
    models = [generate(EYEGLASSES, index) for index in range(2)]
    for model in with_variants(models, EYEGLASSES, 8)[2:]:
        assert model.pivots[0, 0] > 0 > model.pivots[1, 0]
        assert np.sign(model.limits.sum(1)).tolist() == [1, -1]
    one = with_variants([generate(LAPTOP, 0)], LAPTOP, 6, how=Variation(exchanged=0))
    for model in one:
        boxes = model.part_boxes()
        np.testing.assert_allclose(boxes[0].sum(0)[0], boxes[1].sum(0)[0], atol=1e-3)
        np.testing.assert_allclose(model.axes, [[1, 0, 0]], atol=1e-9)


def test_a_door_that_is_called_its_own_image_is_none():
    """Its hinge would be on the other side, which the spec does not know."""
    microwave = get_category("microwave")
    symmetric = tuple(replace(part, mirror=index) for index, part in enumerate(microwave.parts))
    category = replace(microwave, parts=symmetric, either_hand=False)
    assert category.part_images is None
    for made in with_variants([generate(microwave, 0)], category, 12):
        check_like(made, category)
        assert made.limits.min() >= 0
    other = tuple(replace(joint, limits=(0.0, 1.0 + index)) for index, joint in enumerate(EYEGLASSES.joints))
    assert replace(EYEGLASSES, joints=other).part_images is None
    assert EYEGLASSES.part_images == (0, 2, 1)


def test_screws_keep_their_sense(tmp_path):
    spec = tmp_path / "jar.toml"
    spec.write_text(JAR)
    model = jar()
    for made in with_variants([model], get_category(spec), 12):
        assert made.tree == model.tree
        np.testing.assert_allclose(made.axes, model.axes, atol=1e-12)


def test_clouds_without_meshes_stay_as_they_are():
    cloud = np.random.default_rng(0).random((20, 3))
    known = PointObject.from_clouds(
        "cloud", [cloud, cloud + 1], np.eye(3)[:1], np.zeros((1, 3)), np.array([[0.0, 1.0]])
    )
    assert with_variants([known], LAPTOP, 10) == [known]


def test_what_is_nearly_at_rest_moves_a_little():
    model = generate(LAPTOP, 0)
    shut = nearly_at_rest(model, np.random.default_rng(0))
    assert 0 < np.abs(shut.limits).max() <= AT_REST * np.abs(model.limits).max()
    assert shut.parts == model.parts


def test_what_is_flat_stays_flat():
    model = generate(LAPTOP, 0)
    sheet = replace(model, parts=tuple(part.warped(lambda v: v * [1, 1, 0]) for part in model.parts))
    for made in with_variants([sheet], LAPTOP, 3):
        assert np.isfinite(made.part_boxes()).all()
        assert np.ptp(made.part_boxes()[..., 2]) < 1e-9


def test_drawers_slide_as_far_as_they_are_deep():
    model = generate(DRAWER, 0)
    deep = np.ptp(model.part_boxes(), axis=1)[1:, 2]
    for made in with_variants([model], DRAWER, 6, how=Variation(shares=0, bends=0, exchanged=0))[1:]:
        factor = np.ptp(made.part_boxes(), axis=1)[1:, 2] / deep
        assert np.abs(factor - 1).max() > 1e-3
        np.testing.assert_allclose(made.limits[:, 1] / model.limits[:, 1], factor, rtol=1e-6)
