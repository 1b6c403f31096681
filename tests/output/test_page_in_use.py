"""Pages on small screens, by keyboard, with fingers and for a screen reader."""

from pathlib import Path

import pytest

from helpers.command_line import laptop_view
from helpers.headless_browser import HeadlessBrowser
from omad.applications.tracking.page import TrackPage
from omad.applications.tracking.tracker import TrackedEstimate
from omad.estimation.estimator import Estimator
from omad.output.page import save_html
from omad.sensing.observation import Observation

NAME = "a_name_that_goes_on_and_on_without_any_place_to_break_it_at_all_0123456789_0123456789.png"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """With a page of an estimate and one of a track."""
    made = tmp_path_factory.mktemp("pages")
    observation = Observation.from_depth(laptop_view().depth, laptop_view().camera)
    estimate = Estimator.from_pretrained("laptop", "cpu")(observation)
    save_html(observation, estimate, made / "estimate.html", title=NAME)
    track = TrackPage()
    for time in (0.0, 0.5):
        track.add(NAME, observation, TrackedEstimate(time, "tracking", estimate))
    track.save(made / "track.html", NAME)
    return made


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = HeadlessBrowser(tmp_path_factory.mktemp("profile"), 360, 900)
    yield browser
    browser.close()


@pytest.fixture(params=["estimate", "track"])
def opened(request, folder, browser) -> HeadlessBrowser:
    browser.command("Emulation.setDeviceMetricsOverride", width=360, height=900, deviceScaleFactor=1, mobile=True)
    browser.command("Page.navigate", url=(folder / f"{request.param}.html").as_uri())
    browser.wait(f"document.title.startsWith('a_name') && location.pathname.endsWith('{request.param}.html')")
    browser.wait("document.getElementById('space').height > 150")
    return browser


def test_a_small_screen_shows_the_whole_width(opened):
    assert opened.run("document.documentElement.scrollWidth") == 360


def test_the_view_is_turned_shifted_and_zoomed_by_keys(opened):
    eye = "JSON.stringify(eye)"
    first = before = opened.run(eye)
    opened.run("document.getElementById('space').focus()")
    for key, shift in (("ArrowLeft", 0), ("ArrowUp", 0), ("ArrowRight", 8), ("+", 0), ("-", 0)):
        press(opened, key, shift)
        assert opened.run(eye) != before
        before = opened.run(eye)
    press(opened, "Home")
    assert opened.run(eye) == first
    assert opened.errors == []


def press(browser: HeadlessBrowser, key: str, modifiers: int = 0) -> None:
    for kind in ("keyDown", "keyUp"):
        browser.command("Input.dispatchKeyEvent", type=kind, key=key, modifiers=modifiers)


def test_two_fingers_zoom(opened):
    opened.run("document.getElementById('space').scrollIntoView()")
    top, before = opened.run("document.getElementById('space').getBoundingClientRect().top"), opened.run("eye.zoom")
    for kind, apart in (("touchStart", 20), ("touchMove", 30), ("touchMove", 60)):
        points = [{"x": 160 + side * apart, "y": top + 100, "id": number} for number, side in enumerate((-1, 1))]
        opened.command("Input.dispatchTouchEvent", type=kind, touchPoints=points)
    opened.command("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    assert opened.run("eye.zoom") == pytest.approx(3 * before, rel=0.1)


def test_what_is_read_aloud(opened):
    """Pictures have a name, and sliders say what stands beside them rather than radians or a number."""
    named = "c.role && (c.ariaLabel || c.getAttribute('aria-labelledby'))"
    assert opened.run(f"[...document.querySelectorAll('canvas')].every(c => {named})")
    told = opened.run("[...document.querySelectorAll('input[type=range]')].map(s => s.getAttribute('aria-valuetext'))")
    text = opened.run("document.body.innerText")
    assert told
    assert all(each and each in text for each in told)
