"""The HTML page: its numbers are the estimate's, it needs nothing but itself, and its sliders move the object."""

import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
import torch

import omad
from helpers.categories import CATEGORIES
from helpers.command_line import LAPTOP, K, answer, save_png
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view, true_pose
from omad.estimation.checks import doubts
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.estimation.part_labels import LabelledPoints
from omad.geometry.joint_kinds import Motion
from omad.geometry.kinematics import KinematicTree, deform, part_transforms
from omad.objects.category_file import get_category
from omad.objects.pose import ObjectPose
from omad.output.formats import save_formats
from omad.output.page import MAX_POINTS, page_text, save_html
from omad.output.picture import PART_COLOURS, part_colours
from omad.sensing.observation import Observation

OPENED = ("laptop", "drawer", "eyeglasses")
"""Categories whose pages are opened: one joint that turns, three that slide, two that turn."""
BROWSER = next(filter(None, map(shutil.which, ["chromium", "chromium-browser", "google-chrome", "chrome"])), None)
HOSTILE = "</script><b id=bad>&amp; __DATA__ Müller"


@cache
def seen(name: str) -> tuple[Observation, Estimate, ObjectPose]:
    """One standard view of an unseen object, what is made of it, and the truth."""
    category = get_category(name)
    view = standard_view(generate(category, 0, "test"), category, (0, 1000))
    observation = Observation.from_depth(view.depth, view.camera)
    return observation, Estimator.from_pretrained(name, "cpu")(observation), true_pose(view, category)


@cache
def page(name: str) -> str:
    return page_text(*seen(name), title=HOSTILE)


def data_of(text: str) -> dict:
    found = re.findall(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)
    assert len(found) == 1
    return json.loads(found[0], parse_constant=lambda constant: pytest.fail(f"{constant} is not JSON"))


def moved(data: dict, states: list[float]) -> np.ndarray:
    """(M, 3) keypoints of the page's object at ``states``, by the package's own kinematics."""
    joints = data["joints"]
    tree = KinematicTree(tuple(j["parent"] for j in joints), tuple(Motion(j["turn"], j["slide"]) for j in joints))
    keypoints, axes, pivots, at, base = (
        torch.tensor(values, dtype=torch.float64)[None]
        for values in (
            data["canonical_keypoints"],
            [j["canonical_axis"] for j in joints],
            [j["canonical_pivot"] for j in joints],
            states,
            data["T_camera_base"],
        )
    )
    return deform(tree, torch.tensor(data["part_of_keypoint"]), keypoints, axes, pivots, at, base)[0].numpy()


@pytest.mark.parametrize("name", CATEGORIES)
def test_numbers_are_those_of_the_estimate(name):
    observation, estimate, truth = seen(name)
    data = data_of(page(name))
    assert moved(data, [j["state"] for j in data["joints"]]) == pytest.approx(estimate.keypoints, abs=1e-6)
    assert [j["state"] for j in data["joints"]] == pytest.approx(estimate.joint_states)
    assert [j["state_std"] for j in data["joints"]] == pytest.approx([j.state_std for j in estimate.joints], abs=1e-6)
    assert [j["true_state"] for j in data["joints"]] == pytest.approx(truth.states, abs=1e-6)
    assert [j["fraction"] for j in data["joints"]] == pytest.approx([j.fraction for j in estimate.joints], abs=1e-4)
    assert np.array(data["initial_keypoints"]) == pytest.approx(estimate.initial.keypoints, abs=1e-5)
    assert len(data["cloud"]) == len(data["labels"]) <= min(MAX_POINTS, data["points"])
    assert data["points"] == len(observation.points)
    assert set(data["labels"]) <= set(range(-1, len(data["parts"])))  # -1: not on the object
    assert data["title"] == HOSTILE


@pytest.mark.parametrize("name", CATEGORIES)
def test_keypoints_lie_on_the_picture(name):
    data, (_, estimate, _) = data_of(page(name)), seen(name)
    c, p = data["picture"], estimate.keypoints
    u, v = c["fx"] * p[:, 0] / p[:, 2] + c["cx"], c["fy"] * p[:, 1] / p[:, 2] + c["cy"]
    assert max(c["width"], c["height"]) == 480
    assert np.mean((u > 0) & (u < c["width"]) & (v > 0) & (v < c["height"])) > 0.9
    assert c["source"].startswith("data:image/png;base64,")


@pytest.mark.parametrize("name", CATEGORIES)
def test_page_is_small_and_needs_nothing_else(name):
    text = page(name)
    assert len(text.encode()) < 250_000
    assert not re.findall(
        r"""(?:src|href)\s*=\s*["'](?!data:)|https?://|@import|url\(|\bfetch\(|<link[^>]*stylesheet""", text
    )
    assert "default-src 'none'" in text  # the browser itself refuses every request
    assert "<b id=bad" not in text


def test_a_bare_cloud_has_a_page_without_an_image():
    observation, estimate, _ = seen("laptop")
    data = data_of(page_text(Observation.from_points(observation.points), estimate))
    assert data["picture"]["source"] is None
    assert data["title"] == "laptop"
    assert [j["true_state"] for j in data["joints"]] == [None]


@pytest.mark.parametrize("of", ["without labels", "of other points"])
def test_points_that_nobody_labelled_are_grey(of, tmp_path):
    observation, estimate, _ = seen("laptop")
    if of == "without labels":
        estimate = estimate.without_labels()
    else:
        observation = observation.part(np.arange(len(observation.points)) % 2 == 0)
    save_html(observation, estimate, tmp_path / "page.html")
    data = data_of((tmp_path / "page.html").read_text())
    assert len(data["labels"]) == len(data["cloud"])
    assert set(data["labels"]) == {-1}
    assert len(omad.show(observation, estimate).axes) >= 4


def test_arguments_in_the_wrong_order_are_named(tmp_path):
    observation, estimate, _ = seen("laptop")
    for ask in (
        lambda: save_html(estimate, observation, tmp_path / "page.html"),
        lambda: save_formats(observation, estimate, tmp_path, "ply"),
        lambda: doubts(estimate, observation),
    ):
        with pytest.raises(InputError, match="was given the"):
            ask()
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_commands_write_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    answer(capsys, "estimate", save_png("one.png"), *LAPTOP, *K)
    data = data_of(Path("omad-estimate/one/estimate.html").read_text(encoding="utf-8"))
    assert data["title"] == "one.png"
    found = answer(capsys, "demo", *LAPTOP, "--objects", "1")
    (written,) = [name for name in found["files"] if name.endswith(".html")]
    demo = data_of(Path(written).read_text(encoding="utf-8"))
    assert demo["joints"][0]["true_state"] == pytest.approx(found["results"][0]["truth"]["joint_states"][0], abs=1e-6)


# Runs before the page: notes what goes wrong. Under virtual time no frames come, so they are made by a timer.
CATCH = """<script>
window.requestAnimationFrame = draw => setTimeout(draw, 1);
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function(kind) {
  return getContext.call(this, kind, {willReadFrequently: true});
};
window.errors = [];
window.addEventListener("error", event => errors.push(String(event.message)));
window.addEventListener("securitypolicyviolation", event => errors.push("refused " + event.blockedURI));
window.addEventListener("unhandledrejection", event => errors.push(String(event.reason)));
for (const kind of ["error", "warn"]) console[kind] = (...words) => errors.push(words.join(" "));
</script>"""
# Runs after it: moves every slider to both ends, resets, changes every tick box, turns the view.
ACT = """<script>
window.addEventListener("load", async () => {
  const frame = () => new Promise(done => setTimeout(done, 10));
  const drawn = () => ["picture", "space"].map(id => {
    const canvas = document.getElementById(id);
    const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    return new Uint32Array(pixels.buffer).reduce((hash, value) => (31 * hash + value) | 0, 0);
  });
  const said = {steps: []};
  const note = async () => {
    await frame();
    const now = {keypoints: keypoints(states), axes: axisLines(states), drawn: drawn()};
    said.steps.push({states: [...states], ...now});
  };
  await note();
  const inputs = [...document.querySelectorAll("input[type=range]")];
  for (const slider of inputs) for (const end of ["min", "max"]) {
    slider.value = slider[end];
    slider.dispatchEvent(new Event("input"));
    await note();
  }
  document.getElementById("reset").click();
  await note();
  for (const box of document.querySelectorAll("input[type=checkbox]")) { box.click(); await note(); }
  const space = document.getElementById("space");
  space.hasPointerCapture = () => true;  // only a real mouse can be captured
  space.dispatchEvent(new PointerEvent("pointermove", {pointerId: 1, movementX: 60, movementY: 20}));
  await note();
  said.text = document.body.innerText;
  said.title = document.title;
  said.errors = errors;
  parent.postMessage(said, "*");
});
</script>"""
# Shows all pages in frames, so that one start of the browser does for all.
GATHER = """<!doctype html><meta charset="utf-8"><script>
const said = {};
window.addEventListener("message", event => {
  said[[...document.querySelectorAll("iframe")].find(frame => frame.contentWindow === event.source).name] = event.data;
  document.body.dataset.said = encodeURIComponent(JSON.stringify(said));
});
</script><body>"""


@pytest.fixture(scope="session")
def said_in_browser(tmp_path_factory) -> dict:
    """By category, what its page showed in a headless browser, step by step."""
    if BROWSER is None:
        pytest.skip("no Chromium or Chrome on the path: the page was not opened")
    folder, frames = tmp_path_factory.mktemp("browser"), GATHER
    for name in (*OPENED, "stapler"):
        text = page(name).replace("<title>", CATCH + "<title>", 1).replace("</body>", ACT + "</body>")
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
        frames += f'<iframe name="{name}" src="{name}.html" width="420" height="900"></iframe>'
    (folder / "all.html").write_text(frames, encoding="utf-8")
    done = subprocess.run(
        [
            BROWSER, "--headless", "--disable-gpu", "--enable-logging=stderr", "--virtual-time-budget=20000",
            f"--user-data-dir={folder / 'profile'}", *(["--no-sandbox"] if os.geteuid() == 0 else []),
            "--dump-dom", (folder / "all.html").as_uri(),
        ],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert not [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    found = re.findall(r'data-said="(.*?)"', done.stdout)
    assert found, done.stderr[-2000:]
    return json.loads(unquote(found[0]))


@pytest.mark.parametrize("name", OPENED)
def test_in_a_browser(name, said_in_browser):
    said, data = said_in_browser[name], data_of(page(name))
    assert said["errors"] == []
    assert said["title"] == f"{HOSTILE} · OMAD"
    joints = data["joints"]
    for step in said["steps"]:
        assert np.array(step["keypoints"]) == pytest.approx(moved(data, step["states"]), abs=1e-6)
        for joint, ends in zip(joints, np.array(step["axes"]), strict=True):
            along = ends[1] - ends[0]
            expected = expected_axis(data, step["states"], joint)
            assert along / np.linalg.norm(along) == pytest.approx(expected, abs=1e-6)
    first, *moves = said["steps"]
    slid, (again, *rest) = moves[: 2 * len(joints)], moves[2 * len(joints) :]
    for number, step in enumerate(slid):
        joint = joints[number // 2]
        end = (min, max)[number % 2](joint["state"], joint["limits"][number % 2])
        assert step["states"][number // 2] == pytest.approx(end)
        assert all(old != new for old, new in zip(([first] + slid)[number]["drawn"], step["drawn"], strict=True))
    assert again["drawn"] == first["drawn"]
    for before, after in zip([again, *rest], rest, strict=False):
        assert before["drawn"][1] != after["drawn"][1]  # each tick, and the turn, change the view in space
    for joint in joints:
        degrees = f"{np.degrees(joint['state']):.1f}°"
        shown = degrees if joint["type"] == "revolute" else f"{100 * joint['state']:.1f} cm"
        assert joint["name"] in said["text"]
        assert shown in said["text"]
        said_of_it = next(line for line in said["text"].splitlines() if line.startswith(f"{joint['name']} ("))
        travel = f"{round(100 * joint['fraction']) + 0} %"
        assert travel in said_of_it.split("\t")  # as JSON and the command have it
        assert f"{shown}, {travel}" in said_of_it  # and the slider, which stands there


def test_a_slider_takes_along_what_goes_no_further_than_it(said_in_browser):
    joints, steps = data_of(page("stapler"))["joints"], said_in_browser["stapler"]["steps"]
    assert [joint["at_most"] for joint in joints] == [None, 0]
    lid, magazine = np.array([step["states"] for step in steps]).T
    moved = slice(1, 5)  # the lid to both ends, then the magazine
    assert np.ptp(lid[moved]) > 1
    assert (magazine[moved] <= np.maximum(lid[moved], joints[1]["limits"][0]) + 1e-9).all()


def expected_axis(data: dict, states: list[float], joint: dict) -> np.ndarray:
    """A joint's axis in the camera frame at ``states``: its parent's rotation of the canonical one."""
    joints = data["joints"]
    tree = KinematicTree(tuple(j["parent"] for j in joints), tuple(Motion(j["turn"], j["slide"]) for j in joints))
    axes, pivots, at, base = (
        torch.tensor(values, dtype=torch.float64)[None]
        for values in (
            [j["canonical_axis"] for j in joints],
            [j["canonical_pivot"] for j in joints],
            states,
            data["T_camera_base"],
        )
    )
    parent = part_transforms(tree, axes, pivots, at, base)[0, joint["parent"], :3, :3].numpy()
    return parent @ np.array(joint["canonical_axis"])


def test_points_outside_the_object_are_told_and_grey():
    observation, estimate, truth = seen("laptop")
    labels = np.where(np.arange(len(observation.points)) % 3, estimate.part_labels, -1)
    logits = np.eye(3)[labels]  # the last of three is that of no part
    told = replace(estimate, labelled=LabelledPoints(observation.points, np.arange(len(labels)), logits, 2))
    assert np.array_equal(told.part_labels, labels)
    assert -1 in data_of(page_text(observation, told, truth))["labels"]
    assert np.array_equal(part_colours(labels)[labels < 0][0], PART_COLOURS[-1])
