"""A chair of boxes: of no category, and of no generator."""

import numpy as np

from omad.data.procedural.shapes import box
from omad.data.procedural.strangers import strangers
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import View, standard_view
from omad.geometry.mesh import merge_meshes
from omad.objects.model import ObjectModel


def chair_view(seed: int = 0) -> View:
    """With camera noise."""
    legs = [box((x - 0.02, 0, z - 0.02), (x + 0.02, 0.45, z + 0.02)) for x in (-0.18, 0.18) for z in (-0.18, 0.18)]
    seat, back = box((-0.21, 0.45, -0.21), (0.21, 0.49, 0.21)), box((-0.21, 0.49, -0.21), (0.21, 0.95, -0.18))
    chair = merge_meshes([*legs, seat, back])
    category = max((group.category for group in strangers(20)), key=lambda category: category.metres_per_unit)
    model = ObjectModel.of(category, "chair", (chair, chair), np.eye(3)[1:2], np.zeros((1, 3)))
    return standard_view(model.centred(), category, (seed, 5), ON)
