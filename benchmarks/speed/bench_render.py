"""How many standard views a second one CPU core renders and writes.

    OMP_NUM_THREADS=1 python benchmarks/speed/bench_render.py [--category dishwasher] [--triangles 20000] [--json]

Objects are procedural ones, their triangles split until there are at least as many as asked for. A view is 640x480
depth and part labels and the truth, files included. Median of several runs of one process; two processes beside it,
where there are two cores.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
import tyro

from omad.data.procedural import generate
from omad.data.rendering.view_folder import render_to_folder
from omad.geometry.mesh import Mesh
from omad.objects.category_file import get_category
from omad.objects.model import ObjectModel


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    category: str = "dishwasher"
    triangles: int = 20_000
    objects: int = 4
    views: int = 200
    runs: int = 3
    json: bool = False


def split_triangles(model: ObjectModel, least: int) -> ObjectModel:
    """The same object made of at least ``least`` triangles."""
    while sum(len(part.faces) for part in model.parts) < least:
        parts = [trimesh.remesh.subdivide(part.vertices, part.faces)[:2] for part in model.parts]
        model = replace(model, parts=tuple(Mesh(vertices, faces) for vertices, faces in parts))
    return model


def main(config: Config) -> dict:
    category = get_category(config.category)
    models = [split_triangles(generate(category, i, "test"), config.triangles) for i in range(config.objects)]
    seconds: dict[int, list[float]] = {1: [], 2: []} if (os.cpu_count() or 1) > 1 else {1: []}
    for run in range(config.runs + 1):
        for processes, taken in seconds.items():
            with tempfile.TemporaryDirectory() as folder:
                began = time.perf_counter()
                render_to_folder(models, category, Path(folder) / "views", config.views, run, processes=processes)
                if run:  # the first compiles
                    taken.append(time.perf_counter() - began)
    return {
        "category": category.name,
        "triangles": int(np.median([sum(len(p.faces) for p in m.parts) for m in models])),
        "views_per_second": {processes: config.views / float(np.median(taken)) for processes, taken in seconds.items()},
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
    }


if __name__ == "__main__":
    arguments = tyro.cli(Config, description=__doc__)
    answer = main(arguments)
    print(json.dumps(answer) if arguments.json else "\n".join(f"{key}: {value}" for key, value in answer.items()))
