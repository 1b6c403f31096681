"""Make the small benchmark that the tests hold the shipped weights to: clouds of unseen objects, and the truth.

    python benchmarks/tables/make_golden.py [--categories microwave oven] [--views 24]

Writes ``tests/golden/golden_<category>.npz``: standard views of half as many objects, noise off and on in turn, 1200
points stored in steps of 0.2 mm from their middle. Default: of categories with weights that have none yet.
Cabinets with one door have 150 views, staplers, desk lamps and refrigerators with two doors 48, suitcases 40, chests of
three drawers 60.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from zipfile import ZIP_LZMA, ZipFile

import numpy as np
import tyro

from omad.common.files import write_atomic
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view, true_pose
from omad.model.checkpoint import shipped_categories
from omad.objects.category_file import get_category
from omad.sensing.observation import Observation

POINTS, SEED, STEP = 1200, 11, 2e-4
FOLDER = Path(__file__).parents[2] / "tests" / "golden"


def main(categories: tuple[str, ...] = (), views: int = 24) -> None:
    missing = (name for name in shipped_categories() if not (FOLDER / f"golden_{name}.npz").exists())
    for name in categories or missing:
        category, rng = get_category(name), np.random.default_rng(SEED)
        columns: dict[str, list[np.ndarray]] = {}
        for index in range(views):
            model = generate(category, index // 2, "test", SEED)
            view = standard_view(model, category, (SEED, index), LEVELS["on" if index % 2 else "off"])
            points = Observation.from_depth(view.depth, view.camera).points
            chosen = rng.choice(len(points), POINTS, replace=len(points) < POINTS)
            pose = true_pose(view, category)
            steps = np.rint(points[chosen] / STEP).astype(np.int32)
            middle = np.rint(steps.mean(0)).astype(np.int32)
            row = {
                "points": (steps - middle).T.astype(np.int16),  # so LZMA does best
                "middle": middle,
                "states": pose.states,
                "axes": pose.axes,
                "pivots": pose.pivots,
                "T_camera_part": pose.T_camera_part,
                "part_boxes": view.truth.part_boxes,
            }
            for key, value in row.items():
                columns.setdefault(key, []).append(value)
        arrays = {key: np.stack(values) for key, values in columns.items()}
        write_atomic(FOLDER / f"golden_{name}.npz", lambda path, a=arrays: keep(path, a))


def keep(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """A ``.npz`` a fifth smaller than NumPy's own, which NumPy reads as well."""
    with ZipFile(path, "w", ZIP_LZMA) as file:
        for key, values in arrays.items():
            with file.open(f"{key}.npy", "w") as member:
                np.lib.format.write_array(member, values, allow_pickle=False)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
