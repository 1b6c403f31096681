"""``omad render --cluster``: views with their truth as rows (``data/shards/views.py`` says which)."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.spoils.spoiling import cluttered
from omad.data.rendering.standard_views import standard_view, view_seed
from omad.data.rendering.stored_images import where_stored
from omad.data.rendering.view_folder import depth_scale_of
from omad.data.shards.views import as_png, row_of, view_schema
from omad.data.source import Split, load_models
from omad.objects.category import Category
from omad.objects.category_file import get_category
from omad.objects.model import ObjectModel


@dataclass(frozen=True)
class RenderWork:
    """Standard views, dealt out to the objects in turn, or with ``clutter`` scenes spoilt at random."""

    category: str
    source: str
    objects: int
    split: Split
    seed: int
    noise: str
    """One of ``depth_noise.LEVELS``."""
    clutter: bool

    def __call__(self, start: int, stop: int) -> list[dict[str, Any]]:
        """Rows of the views from ``start`` to before ``stop``."""
        category, models = _loaded(self)
        scale = depth_scale_of(category)
        rows = []
        for index in range(start, stop):
            seed = view_seed(index, len(models), self.seed)
            model, more = models[seed[1]], {}
            if self.clutter:
                spoil, made = cluttered(model, category, seed)
                view, instances = made.view, where_stored(made.instances, made.view.depth, scale)
                more = {"instances": as_png(instances), "spoil": json.dumps(asdict(spoil))}
            else:
                view = standard_view(model, category, seed, LEVELS[self.noise])
            rows.append(row_of(view, scale) | more)
        return rows

    def schema(self) -> Any:
        """pyarrow.Schema of the rows."""
        return view_schema(self.clutter)

    def refused(self, row: dict[str, Any]) -> bool:
        """No view is: an object that cannot be seen ends the run."""
        return False


@cache
def _loaded(work: RenderWork) -> tuple[Category, Sequence[ObjectModel]]:
    """Once a process."""
    category = get_category(work.category)
    return category, load_models(work.source, category, work.objects, work.split, work.seed).models
