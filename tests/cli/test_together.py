"""``omad estimate --together``: several images of one object at one moment."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.command_line import LAPTOP, K, answer, laptop_view, refused, save_png
from omad.cli.main import run
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import standard_view
from omad.data.rendering.tabletop import draw_tabletop
from omad.objects.category_file import get_category


@pytest.fixture
def images(tmp_path, monkeypatch) -> list[str]:
    """Two images of the laptop, and where their cameras are in files beside them."""
    monkeypatch.chdir(tmp_path)
    category, first = get_category("laptop"), laptop_view()
    second = standard_view(generate(category, 0, "test"), category, (0, 1001), states=first.states)
    for name, view in (("a", first), ("b", second)):
        save_png(f"{name}.png", view.depth)
        np.savetxt(f"{name}.txt", np.linalg.inv(view.T_camera_base))
    return ["a.png", "b.png", *LAPTOP, *K]


@pytest.mark.slow
def test_images_of_one_object_get_one_answer(images, capsys):
    found = answer(capsys, "estimate", *images, "--together", "a.txt", "b.txt")["results"]
    a, b = found
    assert a["joints"][0]["state"] == pytest.approx(b["joints"][0]["state"])
    assert np.allclose(a["world"]["T_world_base"], b["world"]["T_world_base"], atol=1e-5)
    turned = np.array(a["world"]["T_world_base"])[:3, :3]  # the files' world is the true base
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 5
    for result in found:
        assert json.loads((Path(result["output"]) / "estimate.json").read_text())["world"] == result["world"]
        assert (Path(result["output"]) / "estimate.html").is_file()


@pytest.mark.slow
def test_a_wrong_pose_is_doubtful(images, capsys):
    T = np.loadtxt("b.txt")
    np.savetxt("inverted.txt", np.linalg.inv(T))
    assert run(["estimate", *images, "--together", "a.txt", "inverted.txt", "--json"]) == 0
    told = capsys.readouterr()
    found = json.loads(told.out)["results"]
    assert "views" in {check["name"] for result in found for check in result["checks"]}
    assert all(result["doubtful"] for result in found)  # of two views, either may be the wrong one
    for name in ("a", "b"):  # whose answer is doubtful for what the other view says
        assert "its T_world_camera may be wrong" in Path(f"omad-estimate/{name}/estimate.html").read_text()
    assert told.err.count("its T_world_camera may be wrong") == 2
    assert "warning: view 1: " in told.err or "warning: view 2: " in told.err


@pytest.mark.slow
def test_a_wrong_gravity_is_doubtful_and_a_right_one_is_not(images, capsys):
    down = -np.linalg.inv(np.loadtxt("a.txt"))[:3, 1]
    turned = Rotation.from_rotvec([0, 0, np.radians(30)]).apply(down)
    for gravity, wrong in ((down, False), (turned, True)):
        told = "--gravity=" + ",".join(map(str, gravity))
        found = answer(capsys, "estimate", *images, "--together", "a.txt", "b.txt", told)["results"]
        assert [result["doubtful"] for result in found] == [wrong, wrong]
        assert ["gravity" in {check["name"] for check in result["checks"]} for result in found] == [wrong, wrong]


def test_what_does_not_go_together_is_refused(images, capsys):
    compared = refused(capsys, "estimate", *images, "--together", "a.txt", "b.txt", "--compare")
    assert "--compare: is for single views" in compared
    assert "1 poses for 2 different inputs" in refused(capsys, "estimate", *images, "--together", "a.txt")
    both = refused(capsys, "estimate", *images, "--together", "a.txt", "b.txt", "--world", "a.txt")
    assert "leave out --world" in both
    auto = ["--category", "auto", *K, "--together", "a.txt", "b.txt"]
    assert "name a category" in refused(capsys, "estimate", "a.png", "b.png", *auto)


def test_detect_takes_gravity_for_a_camera_on_its_head(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    drawn = draw_tabletop(("laptop",), (3, 5), "test", ON)
    camera = drawn.camera
    np.save("level.npy", drawn.depth)
    np.save("turned.npy", drawn.depth[::-1, ::-1])
    command = ["--categories", "laptop", "--intrinsics"]
    level_k = f"{camera.fx},{camera.fy},{camera.cx},{camera.cy}"
    turned_k = f"{camera.fx},{camera.fy},{camera.width - 1 - camera.cx},{camera.height - 1 - camera.cy}"
    level = np.array(answer(capsys, "detect", "level.npy", *command, level_k)["support_plane"])
    down = level[:3] * (1, 1, -1)  # minus its normal, turned by half a turn about z
    found = answer(capsys, "detect", "turned.npy", *command, turned_k, "--gravity=" + ",".join(map(str, down)))
    assert not any("turned" in warning for warning in found["warnings"])
    assert np.allclose(found["support_plane"], level * (-1, -1, 1, 1), atol=0.01)
