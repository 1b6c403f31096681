"""How many images a second ``omad serve`` answers to 16 clients, beside the library's own bulk rate of the same images.

python benchmarks/speed/bench_serve.py
"""

import argparse
import io
import os
import statistics
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

import omad
from helpers.service import INTRINSICS, Running, served
from omad.applications.bulk.stream import Frame, estimate_stream
from omad.common.runtime import cores
from omad.data.rendering.standard_views import View, standard_views
from omad.data.source import load_models
from omad.sensing.camera_files import parse_camera
from omad.sensing.depth_files import parse_depth

VIEWS = 32


def image_of(view: View) -> bytes:
    """16-bit PNG, millimetres."""
    stored = io.BytesIO()
    Image.fromarray(np.rint(view.depth * 1000).astype(np.uint16)).save(stored, "PNG")
    return stored.getvalue()


def in_bulk(estimator: omad.Estimator, images: list[bytes], count: int) -> float:
    """Images a second, from PNG to answer."""
    K = parse_camera(INTRINSICS.decode(), "intrinsics").K

    def load(image: bytes) -> omad.Observation:
        return omad.Observation.from_depth(parse_depth(image, "depth"), K)

    frames = (Frame(str(i), lambda i=i: load(images[i % VIEWS])) for i in range(count))
    began = time.perf_counter()
    for outcome in estimate_stream(estimator, frames):
        assert outcome.estimate is not None
    return count / (time.perf_counter() - began)


def by_service(running: Running, images: list[bytes], count: int, clients: int, checks: bytes) -> tuple[float, float]:
    """Images a second, and the median of the seconds that a client waits."""
    waits: list[float] = []
    lock = threading.Lock()

    def ask(i: int) -> None:
        fields = {"depth": images[i % VIEWS], "intrinsics": INTRINSICS, "category": b"laptop", "checks": checks}
        began = time.perf_counter()
        reply = running.post(fields)
        assert reply.status == 200, reply.body
        with lock:
            waits.append(time.perf_counter() - began)

    began = time.perf_counter()
    with ThreadPoolExecutor(clients) as pool:
        list(pool.map(ask, range(count)))
    return count / (time.perf_counter() - began), statistics.median(waits)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=320, help="of each round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--clients", type=int, default=16)
    told = parser.parse_args()
    estimator = omad.Estimator.from_pretrained("laptop", "cpu")
    models = load_models("procedural", estimator.category, 8, "test", 0).models
    images = [image_of(view) for view in islice(standard_views(models, estimator.category, VIEWS), VIEWS)]
    found: dict[str, list[float]] = {"bulk": [], "few checks": [], "all checks": []}
    waits: dict[str, list[float]] = {"few checks": [], "all checks": []}
    with served("--seconds", "600") as running:
        in_bulk(estimator, images, VIEWS)
        for checks in (b"few", b"all"):
            by_service(running, images, VIEWS, told.clients, checks)
        for _ in range(told.rounds):
            found["bulk"].append(in_bulk(estimator, images, told.images))
            for name, checks, share in (("few checks", b"few", 1), ("all checks", b"all", 4)):
                rate, wait = by_service(running, images, told.images // share, told.clients, checks)
                found[name].append(rate)
                waits[name].append(wait)
    best = max(found["bulk"])
    print(f"{cores()} cores, load {os.getloadavg()[0]:.1f}, {told.clients} clients, {told.rounds} rounds")
    print(f"{'images a second, maximum / median':40} of bulk   waits, median")
    for name, rates in found.items():
        wait = f"{1000 * min(waits[name]):.0f} ms" if name in waits else ""
        told_rates = f"{name:12} {max(rates):7.1f} / {statistics.median(rates):7.1f}"
        print(f"{told_rates:40} {max(rates) / best:6.0%}    {wait}")


if __name__ == "__main__":
    main()
