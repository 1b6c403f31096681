"""What a million images cost in shards: core seconds and bytes of rendering, bulk estimation and evaluation, as slopes
between runs of two lengths, so that what is paid once (imports, weights, objects) does not count.

OMP_NUM_THREADS=1 python benchmarks/speed/bench_shards.py
"""

import argparse
import os
import resource
import statistics
import tempfile
import time
from pathlib import Path

from omad.applications.cluster.bulk import BulkWork
from omad.applications.cluster.render import RenderWork
from omad.applications.cluster.shards import Plan, Work
from omad.data.shards.store import Store
from omad.evaluation.evaluate_shards import PoseWork
from omad.sensing.input_options import FrameOptions, InputOptions

OBJECTS = 8


def cost(work: Work, folder: Path, images: int, shard: int) -> tuple[float, float, int]:
    """Core seconds, seconds, and bytes of the shards of so many images, all made in this process."""
    plan = Plan(Store.of(folder), work, images, shard)
    began, used = time.perf_counter(), time.process_time()
    for number in range(plan.shards):
        done = plan(number)
        assert done.error is None, done.error
    spent = time.process_time() - used, time.perf_counter() - began
    return *spent, sum(file.stat().st_size for file in folder.iterdir())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=128, help="of the longer runs; of the shorter ones half")
    parser.add_argument("--shard", type=int, default=32)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--category", default="laptop")
    parser.add_argument("--works", nargs="+", default=["render", "clutter", "bulk", "eval"])
    told = parser.parse_args()
    long, short = told.images, told.images // 2
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        view = (told.category, "procedural", OBJECTS, "test", 0, "on")
        render, clutter = RenderWork(*view, clutter=False), RenderWork(*view[:-1], "off", clutter=True)
        cost(render, root / "views", long, told.shard)
        bulk = BulkWork((root / "views",), InputOptions(), FrameOptions(), told.category, "cpu", False, 16)
        pose = PoseWork(told.category, "cpu", False, False, "procedural", OBJECTS, long, 0, "on", "refuse")
        works = {"render": render, "clutter": clutter, "bulk": bulk, "eval": pose}
        print(f"{told.category}, load {os.getloadavg()[0]:.1f}; an image, minimum / median of {told.rounds} rounds")
        print(f"{'':18} {'core ms':>17} {'ms':>17} {'bytes':>8}   a million: core hours, GB")
        for name, work in ((name, works[name]) for name in told.works):
            work(0, 1)
            slopes = []
            for turn in range(told.rounds):
                at = [root / f"{name}-{turn}-{size}" for size in ("short", "long")]
                less, more = (cost(work, *row, told.shard) for row in zip(at, (short, long), strict=True))
                slopes.append([(b - a) / (long - short) for a, b in zip(less, more, strict=True)])
            cores, walls = ([1000 * row[i] for row in slopes] for i in (0, 1))
            size = slopes[0][2]
            hours = statistics.median(cores) * 1e6 / 1000 / 3600
            spread = [f"{min(each):6.1f} / {statistics.median(each):6.1f}" for each in (cores, walls)]
            print(f"{name:18} {spread[0]:>17} {spread[1]:>17} {size:8.0f}   {hours:.1f} h, {size / 1000:.2f} GB")
    print(f"memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
