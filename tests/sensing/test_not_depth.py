"""Images that hold something else than depth along z: what tells it, and who says so."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.command_line import LAPTOP, answer, save_png
from helpers.command_line import K as K_OPTION
from helpers.lenses import K
from helpers.tabletop import cloud_of, on_a_table
from omad import Estimator, Observation, Tracker, estimate_stream
from omad.data.rendering.depth_noise import LEVELS, add_noise
from omad.estimation.checks import depth_doubts, doubts
from omad.geometry.camera import STANDARD_CAMERA
from omad.sensing.cutting.not_depth import DISTANCES, INVERSE, Z_BUFFER, NotDepth, what_else


def as_distances(depth: np.ndarray) -> np.ndarray:
    """Of depth (480, 640), from the camera's centre."""
    rows, columns = np.indices(depth.shape)
    return depth * np.sqrt(1 + ((columns - 319.5) / 600) ** 2 + ((rows - 239.5) / 600) ** 2)


def inverted(depth: np.ndarray) -> np.ndarray:
    """Of depth (480, 640), one over it, as disparities are."""
    return np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize(("wrong", "held"), [(as_distances, DISTANCES), (inverted, INVERSE)])
def test_what_images_hold_in_place_of_depth_is_told(noisy: bool, wrong: Callable, held: NotDepth):
    depth, mask = on_a_table()
    depth = add_noise(depth, LEVELS["on"], STANDARD_CAMERA, np.random.default_rng(0)) if noisy else depth
    assert what_else(cloud_of(depth)) is None
    assert what_else(cloud_of(wrong(depth))) is held
    assert what_else(cloud_of(np.where(mask, wrong(depth), 0))) is None  # without a plane nothing tells it
    for seen, told in ((depth, []), (wrong(depth), [held.told])):
        view = Observation.from_depth(seen, K, mask)
        assert [check.what for check in depth_doubts(view)] == told
        assert list(depth_doubts(Observation.from_depth(seen, K))) == []  # all of it is the object


def test_a_z_buffer_is_told_by_what_it_was_cleared_with():
    depth, mask = on_a_table()
    depth = np.where(np.arange(480)[:, None] < 40, 0, depth)
    z = np.where(depth > 0, (10 - 1 / np.maximum(depth, 0.1)) / (10 - 0.1), 1.0)  # near 0.1 m, far 10 m
    for seen, told in ((z, [Z_BUFFER.told]), (np.where(depth > 0, z, 0), []), (np.where(depth > 0, depth, 4.0), [])):
        assert [check.what for check in depth_doubts(Observation.from_depth(seen, K, mask))] == told


def test_every_way_to_an_answer_asks_whether_images_hold_depth():
    depth, mask = on_a_table()
    view, estimator = Observation.from_depth(as_distances(depth), K, mask), Estimator.from_pretrained("laptop")
    assert "depth" in [check.name for check in doubts(view, estimator(view))]
    tracker = Tracker(estimator)
    followed = [tracker(view, number / 30).estimate for number in range(3)]
    streamed = [outcome.estimate for outcome in estimate_stream(estimator, [view] * 3, workers=1)]
    for estimate in (*followed[1:], *streamed):
        assert estimate is not None
        assert estimate.doubtful
        assert any(DISTANCES.told in warning for warning in estimate.warnings)


def test_an_answer_from_distances_is_doubtful(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    depth, mask = on_a_table()
    save_png("depth.png", as_distances(depth))
    Image.fromarray(mask).save("mask.png")
    found = answer(capsys, "estimate", "depth.png", *LAPTOP, *K_OPTION, "--mask", "mask.png")
    assert found["doubtful"]
    assert "distance from the camera's centre" in next(c for c in found["checks"] if c["name"] == "depth")["what"]
    for name in ("a", "b"):
        Path(f"{name}.png").write_bytes(Path("depth.png").read_bytes())
        Image.fromarray(mask).save(f"{name}.mask.png")
        np.savetxt(f"{name}.txt", np.eye(4))
    both = answer(capsys, "estimate", "a.png", "b.png", *LAPTOP, *K_OPTION, "--together", "a.txt", "b.txt")["results"]
    assert all("depth" in [check["name"] for check in each["checks"]] for each in both)
    found = answer(capsys, "detect", "depth.png", *K_OPTION, "--categories", "laptop")
    assert any("distance from the camera's centre" in warning for warning in found["warnings"])
