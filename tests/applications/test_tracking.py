"""Following an object through frames: the filter, what is believed of its shape, and the command."""

import base64
import csv
import io
import json
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from sequences import SequenceConfig, SequenceFrame, render_sequence

import omad
from helpers.headless_browser import HeadlessBrowser
from omad.applications.tracking import page, pictures
from omad.applications.tracking.motion import MotionConfig, MotionFilter, Placement
from omad.applications.tracking.sequence import TrackedSequence
from omad.applications.tracking.tracker import TrackedEstimate, TrackedStates, TrackerConfig
from omad.cli.main import run
from omad.cli.track import track_text
from omad.common.errors import InputError, WorkError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.objects.category_file import get_category

finish = TrackedSequence.finish
GIVEN = ["--category", "laptop", "--intrinsics", "600,600,319.5,239.5", "--json"]
NO_SHARES = [("gate", 0.0), ("gate", 1.0), ("jitter", -0.1), ("jitter", 1.1)]


@pytest.fixture(scope="module")
def sequence() -> list[SequenceFrame]:
    """A laptop, gone in frames 4 to 6."""
    category = get_category("laptop")
    config = SequenceConfig(frames=10, fps=5.0, swing=0.2, gap=(4, 7))
    return list(render_sequence(generate(category, 0, "test"), category, config))


@pytest.fixture
def folder(sequence, tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "frames").mkdir()
    for index, frame in enumerate(sequence):
        image = Image.fromarray(np.rint(frame.depth * 1000).astype(np.uint16))
        image.save(tmp_path / "frames" / f"{index:04d}.png")
    return Path("frames")


@pytest.mark.slow
def test_lost_and_found(folder, capsys):
    code = run(["track", str(folder), "--fps", "5", *GIVEN])
    summary = json.loads(capsys.readouterr().out)
    lines = [json.loads(line) for line in Path("omad-track/frames.jsonl").read_text().splitlines()]
    assert code == 0
    assert summary["frames"] == 10
    assert [lines[i]["status"] for i in (3, 4)] == ["tracking", "coasting"]
    assert lines[9]["status"] == "tracking"
    rows = [*csv.DictReader(Path("omad-track/states.csv").read_text().splitlines())]
    told = [line["probability"] for line in lines]
    assert [float(row["probability"] or "nan") for row in rows] == pytest.approx(
        [np.nan if one is None else one for one in told], abs=1e-3, nan_ok=True
    )
    assert summary["doubtful"] == sum(bool(line["doubtful"]) for line in lines) == sum((one or 1) < 0.5 for one in told)
    assert {"states.csv", "states.png", "summary.json"} <= {path.name for path in Path("omad-track").iterdir()}


@pytest.mark.slow
def test_of_a_long_track_some_frames_are_shown_and_states_are_kept(folder, capsys, monkeypatch):
    monkeypatch.setattr(page, "MOST_SHOWN", 3)
    kept: list[TrackedStates] = []
    monkeypatch.setattr(TrackedSequence, "finish", lambda self, truth: kept.extend(self.tracked) or finish(self, truth))
    assert run(["track", str(folder), "--fps", "5", *GIVEN]) == 0
    text = Path("omad-track/track.html").read_text()
    assert 1 <= text.count('"picture":') <= 3
    assert 1 <= text.count('"cloud":') <= 3
    assert len(kept) == 10
    assert max(len(pickle.dumps(one)) for one in kept) < 1000  # an hour has a hundred thousand


def test_a_track_that_is_cut_short_leaves_an_earlier_one_whole(folder, capsys, monkeypatch):
    def kept() -> int:
        return len(Path("omad-track/frames.jsonl").read_text().splitlines())

    def cut_short(self, frames):
        follow(self, list(frames)[:3])
        raise WorkError("the disk is full")

    follow = TrackedSequence.follow
    for earlier in (False, True):
        with monkeypatch.context() as disk:
            disk.setattr(TrackedSequence, "follow", cut_short)
            assert run(["track", str(folder), "--fps", "5", *GIVEN]) == 1
        assert kept() == (4 if earlier else 3)
        assert not list(Path("omad-track").glob(".omad-*"))
        assert run(["track", str(folder), "--fps", "5", "--most", "4", *GIVEN]) == 0
        assert kept() == 4


def test_stream_with_bad_frames_and_times(folder, capsys, monkeypatch):
    (folder / "0001.png").write_bytes(b"broken")
    Image.new("I;16", (20, 10), 900).save(folder / "0002.png")
    names = "".join(f"{folder}/000{i}.png\t{i / 5}\n" for i in range(4))
    monkeypatch.setattr("sys.stdin", io.StringIO(names))
    assert run(["track", "-", "--static-base", *GIVEN[:-1]]) == 2
    out = capsys.readouterr().out
    lines = [json.loads(line) for line in out.splitlines()[:4]]
    assert [line["status"] == "refused" for line in lines] == [False, True, True, False]
    assert lines[3]["time"] == pytest.approx(0.6)
    assert "20x10" in lines[2]["reason"]


@pytest.mark.parametrize(("second", "time"), [("0001.png\tsoon", None), ("0001.png\tnan", None), ("0001.png\t0", 0.0),
                                            (f"{10 * '1234567'}.png", None)])  # fmt: skip
def test_a_line_with_a_wrong_time_is_refused_and_the_stream_goes_on(second, time, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("0000.png", second.partition("\t")[0], "0002.png"):
        Image.new("I;16", (64, 48), 900).save(name)
    monkeypatch.setattr("sys.stdin", io.StringIO(f"0000.png\t0\n{second}\n0002.png\t0.5\n"))
    assert run(["track", "-", *GIVEN[:-1]]) == 2
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["status"] for line in lines[:3]] == ["lost", "refused", "lost"]
    assert lines[1]["time"] == time
    assert "time" in lines[1]["reason"]
    assert [one["reason"] for one in lines[3]["refused"]] == [lines[1]["reason"]]


@pytest.fixture(scope="module")
def stapler() -> tuple[omad.Observation, omad.Estimate]:
    """One of its joints has a long name."""
    category = get_category("stapler")
    observation = standard_view(generate(category, 3, "test"), category, (1, 3)).observation()
    return observation, omad.Estimator.from_pretrained("stapler", "cpu")(observation)


def test_a_frame_that_a_cold_start_explains_surprises_as_its_answer_does(stapler):
    observation, found = stapler
    seen = replace(found, probability=1.0)
    aside = np.eye(4)
    aside[0, 3] = 1.0
    placed = replace(seen.placed, T_camera_part=aside @ seen.placed.T_camera_part)
    wrong = replace(seen, placed=placed, keypoints=seen.keypoints + aside[:3, 3])

    class Misled(omad.Estimator):
        def __call__(self, *_):
            return seen

        def near(self, *_):
            return wrong

    tracker = omad.Tracker(Misled(omad.Estimator.from_pretrained("stapler", "cpu").net))
    first, second = tracker(observation, 0.0), tracker(observation, 0.1)
    assert (first.status, second.status, second.single) == ("tracking", "tracking", seen)
    assert second.surprise == pytest.approx(0, abs=1e-6)
    assert tracker(observation, 60.0).single is seen  # after a pause nothing surprises


def test_a_shape_that_is_known_stays(stapler):
    observation, found = stapler
    tracker = omad.Tracker(omad.Estimator.from_pretrained("stapler", "cpu"))
    known = omad.Known(beta=found.beta)
    tracked = [tracker(observation, time, known).estimate for time in (0.0, 0.1, 0.2)]
    for estimate in filter(None, tracked):
        np.testing.assert_allclose(estimate.beta, found.beta, atol=1e-5)
    assert tracked[-1] is not None


def test_a_frame_that_is_refused_for_what_is_known_leaves_the_track_as_it_was(stapler):
    observation, _ = stapler
    tracker, other = (omad.Tracker(omad.Estimator.from_pretrained("stapler", "cpu")) for _ in range(2))
    tracker(observation, 0.0), other(observation, 0.0)
    with pytest.raises(omad.InputError, match="known gravity"):
        tracker(observation, 0.1, omad.Known(gravity=[0, 0, 0]))
    found, wanted = (each(observation, 0.1).estimate for each in (tracker, other))
    assert np.array_equal(found.keypoints, wanted.keypoints)


def test_joints_stop_at_their_limits():
    start = Placement(np.eye(4), np.array([0.2, 1.7, 0.5]))
    filter = MotionFilter(MotionConfig(), (True,) * 3, start, 1e-3 * np.eye(9), [(0, 1.5)] * 3)
    filter.velocity[6:] = (-2, 2, 0.1)
    filter.predict(0.5)
    np.testing.assert_allclose(filter.placement.joint_states, (0, 1.7, 0.5 + 0.1 * (1 - np.exp(-0.5))))
    assert filter.velocity[6:].tolist() == [0, 0, pytest.approx(0.1 * np.exp(-0.5))]


def test_what_may_be_another_object_is_no_surer_than_that(stapler):
    observation, _ = stapler
    tracker = omad.Tracker(omad.Estimator.from_pretrained("stapler", "cpu"))
    first, second = (tracker(replace(observation, likelihood=0.3), time) for time in (0.0, 0.1))
    assert (first.status, second.status) == ("lost", "tracking")
    assert second.estimate.probability <= 0.3


def test_an_unseen_object_is_less_and_less_surely_where_it_was(stapler):
    tracker = omad.Tracker(omad.Estimator.from_pretrained("stapler", "cpu"), TrackerConfig(sure=0.0))
    told = [tracker(seen, time).estimate.probability for seen, time in ((stapler[0], 0), (None, 0.03), (None, 0.5))]
    assert told[0] >= told[1] > 0.8 * told[0]
    assert told[2] < 0.5 * told[0]


def test_a_tracked_joint_is_as_sure_as_each_frame_says(stapler):
    tracker = omad.Tracker(omad.Estimator.from_pretrained("stapler", "cpu"), TrackerConfig(sure=0.0))
    first = tracker(stapler[0], 0.0)
    for tracked, single in zip(first.estimate.joints, first.single.joints, strict=True):
        assert tracked.interval(0.9) == pytest.approx(single.interval(0.9), abs=1e-3)
    unseen = tracker(None, 0.3).estimate
    assert all(b.state_std > a.state_std for a, b in zip(first.estimate.joints, unseen.joints, strict=True))


@pytest.mark.parametrize(("probability", "status"), [(0.95, "tracking"), (0.6, "lost"), (None, "lost")])
def test_probable_answers_start_tracks_even_where_keypoints_are_hard_to_tell(stapler, probability, status):
    """As on shut chests."""
    observation, found = stapler
    unit = found.category.metres_per_unit
    unsure = replace(found, probability=probability, keypoint_std=np.full_like(found.keypoint_std, 0.2 * unit))
    assert unsure.expected_error > TrackerConfig().worst_std * unit

    class Unsure(omad.Estimator):
        def __call__(self, *_):
            return unsure

    tracker = omad.Tracker(Unsure(omad.Estimator.from_pretrained("stapler", "cpu").net))
    assert tracker(observation, 0.0).status == status


def test_a_line_says_of_which_hand_the_shape_is(stapler):
    estimate = replace(stapler[1], hand_probability=0.75)
    for one in (estimate, estimate.in_mirror()):
        said = TrackedEstimate(0.0, "tracking", one).to_dict()
        assert said["mirrored"] == one.of_other_hand
        assert said["hand_probability"] == 0.75
    lost = TrackedEstimate(0.0, "lost", None).to_dict()
    assert (lost["mirrored"], lost["hand_probability"]) == (None, None)


def test_the_first_frame_tells_the_shape_and_a_door_that_shuts_keeps_its_hinges():
    category = get_category("refrigerator")
    model, tracker = generate(category, 13, "test"), omad.Tracker(omad.Estimator.from_pretrained("refrigerator", "cpu"))
    views = [standard_view(model, category, (2, 5), states=np.array([s])).observation() for s in (0.9, 0.9, 0.45, 0.0)]
    first, *_, shut = (tracker(view, time / 2) for time, view in enumerate(views))
    np.testing.assert_allclose(first.estimate.keypoints, first.single.keypoints, atol=1e-3)
    assert shut.status == "tracking"
    assert tracker.estimator(views[-1]).hand_probability < 0.8
    assert (shut.estimate.of_other_hand, shut.single.of_other_hand) == (False, False)
    assert min(shut.estimate.hand_probability, shut.single.hand_probability) > 0.95


def test_the_page_has_a_grid_a_scale_and_axes_and_names_in_full(stapler, tmp_path):
    shown = page.TrackPage()
    for time in (0.0, 0.5, 1.0):
        shown.add(f"{time}.png", stapler[0], TrackedEstimate(time, "tracking", stapler[1]))
    shown.save(tmp_path / "track.html", "a stapler")
    assert "__" not in re.sub(r"<script id=.data.*?</script>", "", (tmp_path / "track.html").read_text(), flags=re.S)
    browser = HeadlessBrowser(tmp_path / "profile", 1000, 900)
    browser.command("Page.navigate", url=(tmp_path / "track.html").as_uri())
    browser.wait("document.readyState === 'complete' && document.title.startsWith('a stapler')")

    def pixels(name: str) -> np.ndarray:
        """(H, W, 3) of a canvas."""
        picture = browser.run(f"document.getElementById('{name}').toDataURL()")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.partition(",")[2]))).convert("RGB"))

    space, plot = pixels("space"), pixels("plot")
    browser.close()
    assert browser.errors == []
    bar, axes = space[-19:-10, 12:24], space[-90:, -90:].reshape(-1, 3)
    assert (bar == 0x33).all(2).any()
    assert (np.abs(axes - np.array([220, 20, 60])).max(1) < 20).any()  # crimson: x
    assert ((space > 210) & (space < 235)).all(2).sum() > 200  # the grid
    assert (plot[:, :4] == 255).all()  # names end before the edge
    assert (plot[:, 4:60] < 100).any()


def test_names_that_end_in_half_a_time_are_refused(folder, capsys):
    for index, name in enumerate(("1403636579_763555584.png", "20231305123045.png")):
        (folder / f"{index:04d}.png").rename(folder / name)
        assert run(["track", str(folder), *GIVEN]) == 2
        assert f"{name}: its number is no time; give the times with --times" in capsys.readouterr().err
        (folder / name).unlink()


@pytest.mark.parametrize("content", ["", "name,seconds\n0000.png,0\n0001.png,soon\n", "0000.png,0\n"])
def test_times_that_do_not_fit_are_refused(folder, content, capsys):
    Path("times.csv").write_text(content)
    assert run(["track", str(folder), "--times", "times.csv", *GIVEN]) == 2
    assert "times" in capsys.readouterr().err


def test_an_empty_folder_is_refused(tmp_path):
    assert run(["track", str(tmp_path), *GIVEN]) == 2


def test_tracker_wants_rising_times():
    tracker = omad.Tracker(omad.Estimator.from_pretrained("laptop"))
    assert tracker(None, 0.0).status == "lost"
    with pytest.raises(InputError, match="frame"):
        tracker(None, 0.0)
    assert type(tracker(None, np.float32(0.5)).time) is float
    for wrong in ("1", None, np.nan):
        with pytest.raises(InputError, match="must be seconds"):
            tracker(None, wrong)


def test_a_person_reads_degrees_and_centimetres():
    states = {"last_state": 0.5, "lowest_state": 0.0, "highest_state": None}
    joints = [{"name": "hinge", "type": "revolute", **states}, {"name": "slide", "type": "prismatic", **states}]
    answer = {"joint_states": joints, "status": {"tracking": 7, "coasting": 0, "lost": 1}, "frames": 8}
    answer |= {"output": "out", "seconds_per_frame": 0.012, "refused": [], "doubtful": 3}
    told = [line.split() for line in track_text(answer).splitlines()]
    assert ["hinge", "28.6°", "0.0°", "-"] in told
    assert ["slide", "50.0", "cm", "0.0", "cm", "-"] in told
    assert ["frames:", "8", "(7", "tracking,", "1", "lost,", "12", "ms", "each)"] in told
    assert "doubtful: 3 frames" in track_text(answer)
    assert "doubtful" not in track_text(answer | {"doubtful": 0})
    error = {"mean": 0.1, "p95": 0.2, "jitter": 0.1}
    longer = track_text(answer | {"errors": 2 * [{"tracked": error, "single": error | {"mean": 0.2}}]})
    assert ["hinge", "28.6°", "0.0°", "-", "5.7°", "11.5°"] in [line.split() for line in longer.splitlines()]


def test_a_track_leaves_no_files_of_an_earlier_one(folder, capsys):
    output = Path("omad-track")
    assert run(["track", str(folder), "--most", "2", "--gif", "--formats", "ply", *GIVEN]) == 0
    more = [output / name for name in ("track.gif", "last/object.ply", "last/part-screen.ply")]
    mine = output / "last" / "notes.txt"
    mine.touch()
    assert all(file.is_file() for file in more)
    assert run(["track", str(folder), "--most", "1", *GIVEN]) == 0
    assert mine.is_file()
    assert not [file for file in more if file.exists()]
    assert (output / "track.html").is_file()


def test_a_first_frame_may_be_broken_and_options_that_are_wrong_for_all_leave_an_earlier_track(folder, capsys):
    (folder / "0000.png").write_bytes(b"broken")
    assert run(["track", str(folder), "--most", "3", *GIVEN]) == 2
    out, err = capsys.readouterr()
    assert json.loads(out)["status"]["tracking"] == 2
    assert err.count("0000.png: ") == 1
    for index in range(1, 3):
        (folder / f"{index:04d}.png").write_bytes(b"broken")
    assert run(["track", str(folder), "--most", "4", *GIVEN]) == 2  # three that are broken, and one
    assert json.loads(capsys.readouterr().out)["status"]["tracking"] == 1
    before = {path: path.read_bytes() for path in Path("omad-track").iterdir()}
    for wrong, said in (("--gravity=0,0,0", "has no direction"), ("--box=900,900,950,950", "box: 900")):
        assert run(["track", str(folder), *GIVEN, wrong]) == 2
        err = capsys.readouterr().err
        assert said in err
        assert len(err.splitlines()) == 1
    assert {path: path.read_bytes() for path in Path("omad-track").iterdir()} == before


def test_a_page_is_named_where_there_is_one(folder, capsys):
    assert run(["track", str(folder), "--most", "1", *GIVEN[:-1]]) == 0
    assert "page: omad-track/track.html" in capsys.readouterr().out
    for path in folder.iterdir():
        Image.new("I;16", (640, 480)).save(path)
    assert run(["track", str(folder), "--most", "1", *GIVEN[:-1]]) == 1
    said = capsys.readouterr().out
    assert "page:" not in said
    assert "followed in no frame" in said


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("truth", "frame,hinge\n0000.png,nan\n", "a line is short or holds no number"),
        ("times", "0000.png,0\n0001.png,1\n0000.png,2\n", "line 3 names 0000.png again"),
        ("times", "".join(f"000{i}.png,1\n" for i in range(10)), "the same time as 0000.png; correct the table"),
    ],
)
def test_tables_that_say_nothing_are_refused(folder, name, content, said, capsys):
    Path("table.csv").write_text(content)
    assert run(["track", str(folder), f"--{name}", "table.csv", *GIVEN]) == 2
    assert said in capsys.readouterr().err


def test_a_film_of_a_long_track_has_some_of_its_frames(stapler, monkeypatch):
    monkeypatch.setattr(pictures, "MOST", 4)
    observation, film = stapler[0], pictures.Film()
    for number in range(21):
        film.add(observation if number % 8 == 0 else None, TrackedEstimate(number / 30, "lost", None))
    assert len(film.pictures) == 3  # of frames 0, 8 and 16
    assert all(np.asarray(picture).mean() > 60 for picture in film.pictures)


def test_an_image_of_one_row_has_its_pictures():
    row, lost = omad.Observation.from_depth(np.ones((1, 2000)), (600, 600, 999, 0)), TrackedEstimate(0.0, "lost", None)
    pictures.Film().add(row, lost)
    page.TrackPage().add("row.png", row, lost)


@pytest.mark.parametrize(("field", "value"), [*NO_SHARES, ("motion", MotionConfig(decay=0.0))])
def test_settings_that_no_tracker_can_have_are_refused(field, value):
    with pytest.raises(InputError, match=f"TrackerConfig: {field}"):
        TrackerConfig(**{field: value})
