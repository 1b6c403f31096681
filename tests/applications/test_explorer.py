"""The explorer: what it draws is the model's, what it finds is the estimator's, and its page works in a browser."""

import importlib.util
import io
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.categories import CATEGORIES
from helpers.command_line import K, laptop_view, refused, save_png
from helpers.headless_browser import PROGRAM, HeadlessBrowser
from omad.applications.explorer import fitting
from omad.applications.explorer.drawing import ObjectSpace
from omad.applications.explorer.fitting import FitRequest, describe_fit, fit_demo, fit_file
from omad.applications.explorer.places import Places
from omad.cli.explore import Explore, free_port
from omad.common.errors import InputError
from omad.estimation.estimator import Estimator
from omad.geometry.transforms import MIRROR_X

NO_VIEWER = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="needs viser: pip install 'omad[explore]'"
)
SHIPPED = list(CATEGORIES)


@cache
def estimator(name: str) -> Estimator:
    return Estimator.from_pretrained(name, "cpu")


def space(name: str) -> ObjectSpace:
    return ObjectSpace(estimator(name).net.prior, estimator(name).category)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_sliders_at_the_estimate_draw_the_estimate(name):
    fit = fit_demo(estimator(name), 0)
    estimate, drawn = fit.estimate, space(name).draw(space(name).estimated(fit.estimate))
    T = estimate.T_camera_base
    assert drawn.keypoints @ T[:3, :3].T + T[:3, 3] == pytest.approx(estimate.keypoints, abs=1e-5)
    assert T @ drawn.T_base_part == pytest.approx(estimate.T_camera_part, abs=1e-5)
    for joint, (tail, head) in zip(estimate.joints, drawn.arrows, strict=True):
        along = T[:3, :3] @ (head - tail) / np.linalg.norm(head - tail)
        assert along == pytest.approx(joint.axis, abs=1e-5)
        if joint.pivot is not None:
            arm = T[:3, :3] @ tail + T[:3, 3] - joint.pivot
            assert np.linalg.norm(np.cross(arm, joint.axis)) < 1e-5
    assert len(fit.cloud) == len(fit.labels)


def test_an_object_of_the_other_hand_is_drawn_as_it_is():
    """A laptop's mirror image is found where that of the laptop is."""
    seen = estimator("laptop")(laptop_view().observation())
    plain, image = (space("laptop").estimated(estimate) for estimate in (seen, seen.in_mirror()))
    assert (plain.of_other_hand, image.of_other_hand) == (False, True)
    drawn, estimate = space("laptop").draw(image), seen.in_mirror()
    T = estimate.T_camera_base
    assert drawn.keypoints @ T[:3, :3].T + T[:3, 3] == pytest.approx(estimate.keypoints, abs=1e-5)
    assert T @ drawn.T_base_part == pytest.approx(estimate.T_camera_part, abs=1e-5)
    for mesh, other in zip(drawn.parts, space("laptop").draw(plain).parts, strict=True):
        assert mesh.vertices == pytest.approx(other.vertices * MIRROR_X)
        assert np.linalg.det(mesh.triangles).sum() == pytest.approx(np.linalg.det(other.triangles).sum(), abs=1e-9)
    along = T[:3, :3] @ np.subtract(*drawn.arrows[0][::-1])
    assert along / np.linalg.norm(along) == pytest.approx(estimate.joints[0].axis, abs=1e-5)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_joint_moves_what_hangs_on_it(name):
    objects, category = space(name), estimator(name).category
    state, part_of = objects.mean(), np.array(category.part_of_keypoint)
    before = objects.draw(state)
    for joint, reach in enumerate(objects.limits):
        far = reach[np.abs(reach - state.joint_states[joint]).argmax()]
        after = objects.draw(objects.with_joint(state, joint, far))
        moved = np.linalg.norm(after.keypoints - before.keypoints, axis=1) > 1e-6
        carried = [joint in category.tree.path(part) for part in range(len(category.parts))]
        assert {k: bool(moved[part_of == k].any()) for k in range(len(carried))} == dict(enumerate(carried))


def test_a_joint_is_held_by_the_one_that_it_must_not_exceed():
    objects = space("stapler")  # its magazine would go through the base
    open_, both = objects.with_joint(objects.mean(), 0, 1.0), objects.with_joint(objects.mean(), 1, 0.5)
    assert open_.joint_states == pytest.approx([1.0, 0.0])
    assert both.joint_states == pytest.approx([0.0, 0.0])
    within = objects.with_joint(open_, 1, 0.7)
    assert within.joint_states == pytest.approx([1.0, 0.7])
    assert objects.with_joint(within, 1, 1.4).joint_states == pytest.approx([1.0, 1.0])
    assert objects.with_joint(within, 0, 0.4).joint_states == pytest.approx([0.4, 0.4])


@pytest.mark.parametrize("name", SHIPPED)
def test_shape_sliders_count_standard_deviations(name):
    objects = space(name)
    state = objects.with_sigma(objects.mean(), 1, 2.0)
    assert objects.sigmas(state) == pytest.approx([0, 2] + [0] * (objects.components - 2))
    assert np.abs(objects.draw(state).keypoints - objects.draw(objects.mean()).keypoints).max() > 1e-4


@pytest.mark.parametrize("name", SHIPPED)
def test_random_objects_are_drawn_from_the_prior(name):
    objects, rng = space(name), np.random.default_rng(0)
    states = [objects.random(rng) for _ in range(300)]
    sigmas = np.array([objects.sigmas(state) for state in states])
    assert sigmas.mean(0) == pytest.approx(0, abs=0.25)
    assert sigmas.std(0) == pytest.approx(1, abs=0.2)
    joints = np.array([state.joint_states for state in states])
    assert ((joints >= objects.limits[:, 0]) & (joints <= objects.limits[:, 1])).all()
    assert np.ptp(joints, axis=0) == pytest.approx(np.diff(objects.limits)[:, 0], rel=0.1)


def test_a_file_is_fitted_as_the_estimate_command_does(tmp_path):
    path = save_png(str(tmp_path / "one.png"))
    fit = fit_file(estimator("laptop"), FitRequest.of_texts(path, K[1], "", "", False, "", Places((tmp_path,))))
    assert np.degrees(fit.estimate.joint_states - laptop_view().states) == pytest.approx(0, abs=5)
    text = describe_fit(fit)
    assert "`one.png`" in text
    assert f"{np.degrees(fit.estimate.joints[0].state):.1f}°" in text


def test_what_strangers_files_are_called_is_shown_and_not_run(tmp_path):
    path = save_png(str(tmp_path / "one.png"))
    fit = fit_file(estimator("laptop"), FitRequest.of_texts(path, K[1], "", "", False, "", Places((tmp_path,))))
    told = replace(fit.estimate, warnings=("<iframe src=x>.color.png [a](b) does not lie on it",))
    text = describe_fit(replace(fit, estimate=told))
    assert "iframe" in text
    assert not {*"<["} & {*text}


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (("", "", "", "", False, ""), "file"),
        (("none.png", K[1], "", "", False, ""), "none.png: "),
        (("depth.png", "", "", "", False, ""), "intrinsics"),
        (("depth.png", "1,2", "", "", False, ""), "1,2"),
        (("depth.png", K[1], "", "1,2", False, ""), "--box"),
        (("depth.png", K[1], "", "", False, "minus"), "depth scale minus"),
        (("broken.png", K[1], "", "", True, "0.001"), "broken.png"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(texts, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_png("depth.png")
    Path("broken.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=said):
        fit_file(estimator("laptop"), FitRequest.of_texts(*texts, Places((tmp_path,))))


def test_bad_options_are_refused(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert "--demo" in refused(capsys, "explore", "laptop", "--demo", "--depth", "a.png")
    assert "--components" in refused(capsys, "explore", "laptop", "--components", "0")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "omad[explore]" in refused(capsys, "explore", "laptop")


def test_of_a_category_without_a_generator_a_file_is_asked_for(monkeypatch):
    monkeypatch.setattr(fitting, "GENERATORS", ())
    with pytest.raises(InputError, match="makes none of laptop; give a file to fit"):
        fit_demo(estimator("laptop"), 0)


def test_a_port_in_use_is_refused():
    assert Explore(category="laptop").host == "127.0.0.1"
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(InputError, match=f"{other.getsockname()[1]}.*--port 0"):
            free_port("127.0.0.1", other.getsockname()[1])
    with pytest.raises(InputError, match="65535"):
        free_port("127.0.0.1", 70000)
    with pytest.raises(InputError, match=r"192\.0\.2\.1: is not this machine's"):
        free_port("192.0.2.1", 0)


@pytest.mark.slow
@NO_VIEWER
def test_command_serves_until_interrupted():
    command = [sys.executable, "-m", "omad", "explore", "laptop", "--port", "0", "--json"]
    served = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert served.stderr is not None
    url = next(line.split()[1] for line in served.stderr if line.startswith("omad: http"))
    served.send_signal(signal.SIGINT)
    out, err = served.communicate(timeout=30)
    assert served.returncode == 0, err
    assert out.startswith("{"), out
    assert len(out.splitlines()) == 1
    assert url in out
    assert "Traceback" not in err


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """A page of the explorer, and the browser that shows it."""
    pytest.importorskip("viser", reason="needs viser: pip install 'omad[explore]'")
    if PROGRAM is None:
        pytest.skip("no Chromium or Chrome on the path: the page was not opened")
    from omad.applications.explorer.gate import start_server
    from omad.applications.explorer.page import ExplorerPage

    port = free_port("127.0.0.1", 0)
    server = start_server("127.0.0.1", port, "OMAD")
    places = Places((tmp_path_factory.getbasetemp(),))
    page = ExplorerPage(server, estimator("laptop"), components=3, seed=0, places=places)
    browser = HeadlessBrowser(tmp_path_factory.mktemp("profile"), 800, 500)
    browser.command("Page.navigate", url=f"http://127.0.0.1:{port}")
    browser.wait("document.body && document.body.innerText.includes('Random object')")
    yield page, browser
    browser.close()
    server.stop()
    page.close()


def until(true) -> None:
    end = time.monotonic() + 120
    while not true():
        assert time.monotonic() < end
        time.sleep(0.3)


def colours(browser: HeadlessBrowser) -> np.ndarray:
    """(H, W, 3) of the tab left of the panel, where the view in space is."""
    image = np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB")).astype(int)
    return image[image.shape[0] // 4 :, :450]


def test_page_in_a_browser(opened, tmp_path):
    page, browser = opened
    saturated = lambda: int((np.ptp(colours(browser), axis=2) > 60).sum())  # noqa: E731
    until(lambda: saturated() > 100)  # the object is there, and in colour
    rest = colours(browser)

    browser.run("document.querySelector('[role=slider]').focus()")
    for kind in ("keyDown", "keyUp"):
        browser.command("Input.dispatchKeyEvent", type=kind, key="Home", code="Home", windowsVirtualKeyCode=36)
    until(lambda: page.state.joint_states[0] == pytest.approx(page.space.limits[0, 0], abs=0.01))
    until(lambda: (np.abs(colours(browser) - rest).max(2) > 12).mean() > 0.005)  # a translucent part is pale

    shown = "[...document.querySelectorAll('[role=slider]')].map(e => e.getAttribute('aria-valuenow')).join()"
    before, state = browser.run(shown), page.state
    browser.click("button", "Random object")
    until(lambda: page.state is not state)
    browser.wait(f"({shown}) !== {before!r}")
    assert np.degrees(page.state.joint_states[0]) == pytest.approx(page.joints[0].value)

    page.path.value, page.intrinsics.value = str(tmp_path / "none.png"), K[1]
    browser.run(
        "[...document.querySelectorAll('*')].find(e => !e.children.length"
        " && e.textContent.startsWith('Fit a depth')).click()"
    )
    browser.click("button", "Fit this file")
    browser.wait("document.body.innerText.includes('no such file')")
    assert page.fit is None

    page.path.value = save_png(str(tmp_path / "one.png"))
    browser.click("button", "Fit this file")
    browser.wait("document.body.innerText.includes('Found in')")
    assert page.fit is not None
    assert page.state.joint_states == pytest.approx(page.fit.estimate.joint_states)
    assert browser.errors == []
