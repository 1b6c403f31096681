"""Views to learn confidence from: spoilt in few ways or in many, of usual and unusual objects, and of other things."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from omad.common.errors import InputError
from omad.data.procedural import GENERATORS, generate
from omad.data.rendering.spoils.scenes import draw_scene
from omad.data.rendering.spoils.spoiling import spoilt, within_range
from omad.data.rendering.spoils.things import simple_thing
from omad.data.rendering.spoils.thinned import FEWEST, STREAM, some_points, thinned_spoil
from omad.data.rendering.standard_views import View
from omad.geometry.mesh import Mesh
from omad.geometry.rigid import box
from omad.objects.category import Category
from omad.objects.category_file import get_category
from omad.objects.model import ObjectModel
from omad.sensing.observation import Observation

OTHERS, HEAPS = 0.14, 0.06
"""Shares of the views that show objects of other categories, and heaps of boxes and cans."""
STRETCHED = 0.5
"""Share of the category's objects whose proportions are changed ..."""
STRETCHES = (0.1, 0.25)
"""... by one of these, the standard deviation of each side's logarithm: real objects are unlike those trained on."""
PART_MISSED = 0.1
"""Share of the views whose mask leaves a part out, as a click on the object may make one."""
SPARSE = 0.25
"""Share of the views of which some points alone are shown."""
SEEDS = 2**31
APART = 2**31
"""Third number of the seeds of views to learn from. Those to measure on (``view_seed``) have small ones; a seed of two
numbers is one whose third is 0, that of the first view of an object."""


@dataclass(frozen=True)
class Example:
    """One view."""

    view: View
    of_category: bool
    """False: there is no right answer to it."""
    part_missed: bool = False
    """Whether the mask leaves out a part, whose state it then hardly tells."""
    kept: np.ndarray | None = None
    """Which of its points are shown; None: all."""

    def observation(self) -> Observation:
        """What an estimator is shown."""
        seen = self.view.observation()
        return seen if self.kept is None else Observation.from_points(seen.points[self.kept])


def examples(models: Sequence[ObjectModel], category: Category, indices: Iterable[int], seed: int) -> Iterator[Example]:
    """Views of the ``models`` and of what is none of them, one of each index, but where it would show too little; the
    same for the same arguments."""
    found = (_example(models, category, (seed, index, APART)) for index in indices)
    return (example for example in found if example is not None)


def _example(models: Sequence[ObjectModel], category: Category, seed: tuple[int, int, int]) -> Example | None:
    """None where such a view shows too little."""
    rng = np.random.default_rng((*seed, STREAM))
    kind, model, own = rng.random(), models[int(rng.integers(len(models)))], category
    if kind < OTHERS:
        own = get_category(str(rng.choice([name for name in GENERATORS if name != category.name])))
        model = _at_some_size(generate(own, int(rng.integers(SEEDS)), "train"), own, category, rng)
    elif kind < OTHERS + HEAPS:
        model = _heap(model, rng)
    elif rng.random() < STRETCHED:
        model = model.stretched(np.exp(rng.normal(0, rng.choice(STRETCHES), 3)))
    spoil = replace(thinned_spoil(rng), part_missed=bool(rng.random() < PART_MISSED))
    try:
        scene = draw_scene(model, own, seed, spoil.staging)
        if not within_range(scene, spoil):
            return None
        view = spoilt(scene, spoil).view
        seen = len(view.observation().points)
    except InputError:
        return None
    return Example(view, kind >= OTHERS + HEAPS, spoil.part_missed, _some(seen, rng))


def _some(points: int, rng: np.random.Generator) -> np.ndarray | None:
    """Which of so many points are shown: mostly all."""
    return None if rng.random() >= SPARSE or points <= FEWEST else some_points(points, rng)


def _at_some_size(model: ObjectModel, own: Category, category: Category, rng: np.random.Generator) -> ObjectModel:
    """From its own size to that of objects of the category."""
    return model.stretched(np.full(3, (category.metres_per_unit / own.metres_per_unit) ** rng.random()))


def _heap(model: ObjectModel, rng: np.random.Generator) -> ObjectModel:
    """Boxes and cans where the parts of an object are."""
    meshes = []
    for part in model.parts:
        thing, place = simple_thing(rng), box(part.vertices).mean(0)
        size = rng.uniform(0.3, 1.0) * model.diagonal
        meshes.append(_placed(thing, place, size))
    return replace(model, parts=tuple(meshes))


def _placed(thing: Mesh, place: np.ndarray, size: float) -> Mesh:
    low, high = box(thing.vertices)
    factor = size / float(np.linalg.norm(high - low))
    return thing.warped(lambda vertices: (vertices - (low + high) / 2) * factor + place)
