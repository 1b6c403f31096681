"""Things that are of no category: seeded, closed, at real sizes, and as various as they should be."""

import numpy as np

from omad.data.procedural.strangers import KINDS, UNITS, stranger, strangers
from omad.geometry.mesh import closed


def test_the_same_arguments_give_the_same_things():
    one, other, another = strangers(12, 3), strangers(12, 3), strangers(12, 4)
    for groups in (one, another):
        assert sum(len(group.models) for group in groups) == 12
    vertices = [[model.parts[0].vertices for group in groups for model in group.models] for groups in (one, other)]
    assert all(np.array_equal(a, b) for a, b in zip(*vertices, strict=True))
    assert one[0].models[0].name not in {model.name for group in another for model in group.models}


def test_they_are_closed_and_of_real_sizes():
    for index in range(60):
        thing = stranger(np.random.default_rng(index))
        assert closed(thing)
        assert 0.01 < np.linalg.norm(np.ptp(thing.vertices, axis=0)) < 4
    assert len({len(make(np.random.default_rng(0))) for make in KINDS}) > 2


def test_things_of_about_one_size_are_together():
    for group in strangers(60, 1):
        unit = group.category.metres_per_unit
        for model in group.models:
            nearest = min(UNITS, key=lambda other: abs(np.log(other / (model.diagonal / 2))))
            assert nearest == unit
            assert np.allclose(model.part_boxes().sum(1), 0, atol=1e-9)  # centred
