"""Tracking of recordings and of a camera, with the options that one image has, and the page of a track."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from sequences import SequenceConfig, SequenceFrame, render_sequence

from helpers.headless_browser import HeadlessBrowser
from helpers.recordings import DEPTH_INFO, PINHOLE, START, write_bag
from omad.applications.tracking.frames import Clock, frames_from, frames_of, read_times
from omad.applications.tracking.streams import recorded, taken
from omad.cli.main import run
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.objects.category_file import get_category
from omad.sensing.foreign import bags
from omad.sensing.foreign.bags import RecordedFrame, Topics, read_bag
from omad.sensing.foreign.images import depth_from, image_from

K = ["--intrinsics", "600,600,319.5,239.5"]
GIVEN = ["--category", "laptop", "--json"]


@pytest.fixture(scope="module")
def sequence() -> list[SequenceFrame]:
    category = get_category("laptop")
    return list(render_sequence(generate(category, 0, "test"), category, SequenceConfig(frames=4, fps=10.0, swing=0.2)))


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def folder(sequence) -> Path:
    Path("frames").mkdir()
    for index, frame in enumerate(sequence):
        Image.fromarray(np.rint(frame.depth * 1000).astype(np.uint16)).save(f"frames/{index:04d}.png")
    return Path("frames")


def tracked(capsys, *arguments: str, code: int = 0) -> tuple[dict, list[dict]]:
    capsys.readouterr()
    assert run(["track", *arguments, *GIVEN]) == code
    lines = Path("omad-track/frames.jsonl").read_text().splitlines()
    return json.loads(capsys.readouterr().out), [json.loads(line) for line in lines]


def test_a_sure_first_frame_is_tracked(folder, capsys):
    _, lines = tracked(capsys, str(folder), *K, "--fps", "10")
    assert [line["status"] for line in lines] == ["tracking"] * 4


def test_where_nothing_is_followed_a_wrong_gravity_may_be_why(folder, sequence, capsys):
    x, y, z = -sequence[0].T_camera_base[:3, 1]
    for gravity, told in ((f"{x},{y},{z}", False), ("1,0,0", True)):
        run(["track", str(folder), *K, *GIVEN, f"--gravity={gravity}"])
        assert ("with a wrong one nothing is followed" in capsys.readouterr().err) == told


def test_options_of_one_image_hold_for_tracks(folder, sequence, capsys):
    Path("world").mkdir()
    up = sequence[0].T_camera_base[:3, 1]
    for index in range(4):
        T = np.eye(4)
        T[:3, :3] = np.stack([np.cross(up, [0, 0, 1.0]), np.cross(up, np.cross(up, [0, 0, 1.0])), up])
        T[:3, :3] /= np.linalg.norm(T[:3, :3], axis=1, keepdims=True)
        T[:3, 3] = [0, 0, index]
        np.savetxt(f"world/{index:04d}.txt", T)
    Path("colours").mkdir()
    for index in range(4):
        Image.new("RGB", (640, 480), (200, 0, 100)).save(f"colours/{index:04d}.jpg")
    options = ["--world", "world", "--color", "colours", "--distortion", "none", "--formats", "urdf", "ros", "--gif"]
    _, lines = tracked(capsys, str(folder), *K, "--fps", "10", *options)
    heights = [line["world"]["T_world_base"][2][3] for line in lines]
    assert np.diff(heights) == pytest.approx(1, abs=0.1)
    assert Path("omad-track/last/robot.urdf").is_file()
    base = json.loads(Path("omad-track/last/ros.json").read_text())["tf"]["transforms"][0]
    assert base["header"]["frame_id"] == "world"
    assert base["transform"]["translation"]["z"] == pytest.approx(heights[-1])
    assert Image.open("omad-track/track.gif").convert("RGB").resize((1, 1)).getpixel((0, 0))[0] > 150  # in colour
    assert run(["track", str(folder), *K, *GIVEN, "--gravity=0,1,0", "--fps", "10"]) in (0, 1)
    assert run(["track", str(folder), *K, *GIVEN, "--gravity", "world"]) == 2
    assert run(["track", str(folder), *K, *GIVEN, "--formats", "doc"]) == 2
    assert run(["track", str(folder), *K, *GIVEN, "--world", "world", "--static-base"]) == 2
    Path("world/0002.txt").unlink()
    summary, lines = tracked(capsys, str(folder), *K, "--world", "world", "--fps", "10", code=2)
    assert "T_world_camera" in summary["refused"][0]["reason"]


@pytest.mark.slow
def test_the_page_has_a_slider_for_time(folder, capsys, tmp_path):
    tracked(capsys, str(folder), *K, "--fps", "10")
    page = Path("omad-track/track.html")
    assert page.stat().st_size < 1_000_000
    browser = HeadlessBrowser(tmp_path / "profile", 1000, 800)
    try:
        browser.command("Page.navigate", url=page.absolute().as_uri())
        browser.wait("document.getElementById('now')?.textContent.includes('0000.png')")
        browser.run("time = document.getElementById('time'); time.value = 3; time.dispatchEvent(new Event('input'))")
        assert "0003.png" in browser.run("document.getElementById('now').textContent")
        assert "hinge" in browser.run("document.getElementById('joints').textContent")
        assert browser.run("frames.every(frame => frame.picture && frame.dots.length === data.part_of.length)")
        assert browser.errors == []
    finally:
        browser.close()


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "bag"])
def test_recordings_are_tracked(kind, sequence, folder, capsys):
    bag = write_bag(Path("recording.bag" if kind == "bag" else "recording"), sequence, kind)
    Path("masks").mkdir()
    for index, frame in enumerate(sequence):
        Image.fromarray(np.uint8(frame.depth > 0) * 255).save(f"masks/{index:04d}.png")
    _, expected = tracked(capsys, str(folder), *K, "--fps", "10", "--mask", "masks")
    bag = next(bag.glob("*.mcap"), bag) if kind == "mcap" else bag  # a file alone, or a bag's folder
    _, lines = tracked(capsys, str(bag), "--mask-topic", "/mask")
    for option in ("mask_topic", "color_topic", "depth_topic"):
        with pytest.raises(InputError, match=f"{DEPTH_INFO} holds sensor_msgs/msg/CameraInfo; name one of"):
            next(read_bag(bag, Topics(**{option: DEPTH_INFO})))
    assert [line["time"] for line in lines] == pytest.approx([0, 0.1, 0.2, 0.3])
    for line, other in zip(lines, expected, strict=True):
        assert line["joints"][0]["state"] == pytest.approx(other["joints"][0]["state"], abs=1e-3)


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_masks_are_those_of_their_images_however_late_they_were_worked_out(kind, sequence):
    bag = write_bag(Path("recording.bag" if kind == "bag" else "recording"), sequence, kind, late=240_000_000)
    frames = list(read_bag(bag, Topics(mask_topic="/mask")))
    assert [frame.name for frame in frames] == [str(START + index * 100_000_000) for index in range(4)]
    for frame, own in zip(frames, sequence, strict=True):
        assert frame.mask is not None
        assert np.array_equal(frame.mask > 0, own.depth > 0)
        np.testing.assert_allclose(frame.depth, own.depth, rtol=0, atol=1e-3)
        assert frame.camera is not None


def test_a_recording_without_images_of_depth_is_refused(sequence, capsys):
    write_bag(Path("recording"), sequence[:0], "mcap")
    assert run(["track", "recording", *GIVEN]) == 2
    assert "topic /camera/depth/image_rect_raw has no images" in capsys.readouterr().err


def test_an_image_without_its_mask_is_named_and_not_searched(sequence, capsys):
    bag = write_bag(Path("recording"), sequence, "mcap", masks=(0, 1, 3))
    faults = [str(frame.fault or "") for frame in read_bag(bag, Topics(mask_topic="/mask"))]
    assert faults == ["", "", "no mask of /mask was taken within 0.05 s of it", ""]
    assert not any(frame.fault for frame in read_bag(bag, Topics()))
    assert run(["track", str(bag), *GIVEN, "--mask-topic", "/mask"]) == 2
    assert "no mask of /mask" in capsys.readouterr().err


def test_an_image_of_a_recording_that_cannot_be_read_leaves_the_others(sequence, monkeypatch):
    def cut_short(message):
        seen.append(message)
        return depth_from(message) if len(seen) != 2 else image_from(SimpleNamespace(**vars(message) | {"step": 0}))

    seen = []
    bag = write_bag(Path("recording"), sequence, "mcap")
    monkeypatch.setattr(bags, "depth_from", cut_short)
    frames = list(taken(read_bag(bag, Topics())))
    assert [frame.time for frame in frames] == pytest.approx([0, 0.1, 0.2, 0.3])
    assert [frame.fault is None for frame in frames] == [True, False, True, True]
    assert "are no 640x480 image" in str(frames[1].fault)


def test_frames_that_a_recorder_wrote_at_once_have_the_times_of_their_headers(sequence):
    bag = write_bag(Path("recording"), sequence, "mcap", together=2)
    found = list(recorded(bag, Topics()))
    assert [frame.time for frame in found] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert [int(frame.path.name) - START for frame in found] == [index * 100_000_000 for index in range(4)]
    assert not any(frame.fault for frame in found)


def test_a_frame_that_is_no_later_than_another_is_named():
    frames = [RecordedFrame(str(time), time, np.ones((2, 2)), None) for time in (5.0, 6.0, 6.0, 5.5, 7.0)]
    found = list(taken(frames))
    assert [frame.time for frame in found] == [0.0, 1.0, 1.0, 0.5, 2.0]
    assert ["no later" in str(frame.fault) for frame in found] == [False, False, True, True, False]


def test_one_wrong_stamp_costs_one_frame_and_a_pause_none():
    """A frame an hour ahead of those around it, a pause of an hour, and one that is ahead at the end."""
    times = (0.0, 0.1, 3600.0, 0.2, 0.3, 3600.3, 3600.4, 9000.0)
    found = list(taken([RecordedFrame(str(time), time, np.ones((2, 2)), None) for time in times]))
    assert [frame.time for frame in found] == list(times)
    assert [str(frame.fault) for frame in found if frame.fault] == [
        "3600.0: was taken 3600 s later than the frame after it; correct its stamp"
    ]


def test_a_camera_of_another_namespace_is_not_the_images(sequence, capsys):
    bag = write_bag(Path("recording"), sequence[:1], "mcap", info="/camera/color/camera_info")
    assert next(read_bag(str(bag))).camera is None
    assert next(read_bag(bag, Topics(info_topic="/camera/color/camera_info"))).camera is not None
    assert run(["track", str(bag), *GIVEN]) == 2
    assert "--info-topic" in capsys.readouterr().err


def test_rectified_images_have_the_camera_of_P_and_no_lens(sequence):
    P = [600, 0, 319.5, 0, 0, 600, 239.5, 0, 0, 0, 1, 0]
    raw = [640, 0, 300, 0, 640, 200, 0, 0, 1], [-0.28, 0.09, 0, 0, 0], P
    told = next(read_bag(write_bag(Path("rectified"), sequence[:1], "mcap", camera=raw), Topics())).camera
    assert told is not None
    assert (told.K.ravel().tolist(), told.distortion) == (PINHOLE[0], None)


def test_intrinsics_take_the_place_of_a_camera_that_nobody_calibrated(sequence, capsys):
    bag = str(write_bag(Path("recording"), sequence[:1], "mcap", camera=([0] * 9, [], [0] * 12)))
    assert run(["track", bag, *GIVEN]) == 2
    assert "camera_info: " in (told := capsys.readouterr().err)
    assert "--intrinsics" in told
    assert tracked(capsys, bag, *K)[1][0]["status"] == "tracking"


@pytest.mark.parametrize("option", [("--mask", "."), ("--mask-id", "3"), ("--times", "times.csv"), ("--fps", "10")])
def test_what_holds_for_no_frame_of_a_recording_is_refused(option, sequence, capsys):
    bag = str(write_bag(Path("recording"), sequence[:1], "mcap"))
    assert run(["track", bag, *GIVEN, *option]) == 2
    assert option[0] in capsys.readouterr().err


def test_topics_of_frames_that_are_files_are_refused(folder, capsys):
    assert run(["track", str(folder), *GIVEN, *K, "--mask-topic", "/mask"]) == 2
    assert "--mask-topic: goes with a recording" in capsys.readouterr().err


def test_a_recording_in_another_unit_is_read_with_its_scale_and_ones_own_colours(sequence, capsys):
    tenths = [replace(frame, depth=10 * frame.depth) for frame in sequence]  # as a driver that stores 0.1 mm
    bag = str(write_bag(Path("recording"), tenths, "mcap"))
    Image.new("RGB", (640, 480), (200, 0, 100)).save("colour.png")
    options = ["--depth-scale", "0.0001", "--color", "colour.png", "--gif", "--mask-topic", "/mask"]
    _, lines = tracked(capsys, bag, *options)
    assert [line["status"] for line in lines] == ["tracking"] * 4
    assert Image.open("omad-track/track.gif").convert("RGB").resize((1, 1)).getpixel((0, 0))[0] > 150
    Path("camera.json").write_text(json.dumps({"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5, "depth_scale": 1e-4}))
    _, lines = tracked(capsys, bag, "--intrinsics", "camera.json", "--mask-topic", "/mask")
    assert [line["status"] for line in lines] == ["tracking"] * 4


def test_recordings_that_do_not_fit_are_refused(sequence, capsys):
    bag = str(write_bag(Path("recording"), sequence[:1], "mcap"))
    assert run(["track", bag, *GIVEN, "--depth-topic", "/depth"]) == 2
    assert "/camera/depth/camera_info" in capsys.readouterr().err  # what there is
    Path("broken.mcap").write_bytes(b"\x89MCAP0\r\nno")
    assert run(["track", "broken.mcap", *GIVEN]) == 2
    assert "broken.mcap" in capsys.readouterr().err
    assert run(["track", *GIVEN]) == 2
    assert "--camera" in capsys.readouterr().err


@pytest.fixture
def camera(sequence, monkeypatch) -> list[str]:
    """A pyrealsense2 whose camera shows the sequence and then has no more; the list says what became of it."""
    said: list[str] = []

    def intrinsics():
        told = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "ppx": 319.5, "ppy": 239.5}
        return SimpleNamespace(**told, model="distortion.brown_conrady", coeffs=[0.0] * 5)

    def frame_set(number: int):
        depth = np.rint(sequence[number].depth * 1000).astype(np.uint16)
        profile = SimpleNamespace(as_video_stream_profile=lambda: SimpleNamespace(get_intrinsics=intrinsics))
        seen = SimpleNamespace(get_data=lambda: depth, get_units=lambda: 0.001, get_profile=lambda: profile,
                               get_frame_number=lambda: number)  # fmt: skip
        return SimpleNamespace(get_depth_frame=lambda: seen, get_color_frame=lambda: None)

    class Pipeline:
        def __init__(self) -> None:
            self.number = 0

        def start(self) -> None:
            said.append("start")

        def wait_for_frames(self):
            if self.number == len(sequence):
                raise RuntimeError("End of file reached")
            self.number += 1
            return frame_set(self.number - 1)

        def stop(self) -> None:
            said.append("stop")

    module = SimpleNamespace(pipeline=Pipeline, align=lambda stream: None, stream=SimpleNamespace(depth=1))
    monkeypatch.setitem(sys.modules, "pyrealsense2", module)
    return said


def test_a_camera_is_followed(camera, capsys):
    summary, lines = tracked(capsys, "--camera", "realsense")
    assert summary["status"]["tracking"] == len(lines) == 4
    assert camera == ["start", "stop"]
    assert run(["track", "--camera", "realsense", "--depth-scale", "0.001", *GIVEN]) == 2
    assert "--depth-scale" in capsys.readouterr().err


def test_a_camera_without_its_package_names_the_cure(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    assert run(["track", "--camera", "realsense", *GIVEN]) == 2
    assert "omad[realsense]" in capsys.readouterr().err


def test_a_track_is_recorded_or_shown_live(folder, capsys):
    Path("omad-track").mkdir()
    Path("omad-track/track.rrd").write_text("earlier")
    assert run(["track", str(folder), *K, *GIVEN, "--formats", "rrd", "--live"]) == 2
    assert "--live" in capsys.readouterr().err
    assert Path("omad-track/track.rrd").read_text() == "earlier"


def test_a_track_is_recorded_for_rerun_and_shown_live(folder, capsys, monkeypatch):
    rr = pytest.importorskip("rerun", reason="the recording is an extra: pip install 'omad[rerun]'")
    tracked(capsys, str(folder), *K, "--fps", "10", "--formats", "rrd")
    assert Path("omad-track/track.rrd").stat().st_size > 10_000
    assert not list(Path("omad-track").glob(".omad-*"))
    spawned = []
    monkeypatch.setattr(rr.RecordingStream, "spawn", lambda stream: spawned.append(stream))
    tracked(capsys, str(folder), *K, "--fps", "10", "--live")
    assert len(spawned) == 1


@pytest.mark.parametrize(
    ("one", "other", "seconds"),
    [
        ("2024-05-01_12-30-59.png", "2024-05-01_12-31-01.png", 2.0),
        ("frame-20240501T123059.png", "frame-20240501T123101.depth.png", 2.0),
        ("20240501_123059.750.png", "20240501_123100.250.png", 0.5),
        ("2024-02-29 23:59:59,5Z.npy", "2024-03-01 00:00:00,0Z.npy", 0.5),
        ("20240501123059750.png", "20240501123100250.png", 0.5),
        ("2024-05-01_12-30-05_0007.png", "2024-05-01_12-30-05_0010.png", 0.3),  # frames of that recording
        ("1999123123595901.png", "1999123123595903.png", 2e-6),  # microseconds since 1970
        ("00002.depth.png", "00004.depth.png", 0.2),
        ("00002_depth.png", "00010_depth.png", 0.8),
        ("3-aligned_Depth.png", "12-aligned_Depth.png", 0.9),
        ("1700000000.25_depth.png", "1700000001.50_depth.png", 1.25),
        ("d_1620000000123.4567.png", "d_1620000000156.4567.png", 0.033),
        ("d_1620000000.25.png", "d_1620000001.50.png", 1.25),
        ("t_12.25.png", "t_13.50.png", 1.25),
    ],
)
def test_names_tell_dates_stamps_and_frames(one, other, seconds):
    clock = Clock(10.0)
    assert [clock(Path(one)), clock(Path(other))] == pytest.approx([0.0, seconds], abs=1e-6)


def test_a_line_without_a_time_after_lines_with_one_is_told_of_alone():
    frames = list(frames_from(["a_1.png\t1700000000.0", "a_2.png", "a_3.png\t1700000000.5"], Clock(30.0)))
    assert [frame.time for frame in frames if frame.fault is None] == [1700000000.0, 1700000000.5]
    assert "a_2.png: has no time, lines before it have one" in str(frames[1].fault)
    frames = list(frames_from(["a_1.png", "a_2.png\t100", "a_3.png"], Clock(30.0)))
    assert [frame.fault is None for frame in frames] == [True, False, True]
    assert "a_2.png: has a time, lines before it have none" in str(frames[1].fault)


def test_times_count_from_the_earliest_frame(folder):
    clock = Clock(30.0, {f"{index:04d}.png": 5.0 - index for index in range(20)})
    frames = frames_of(folder, clock)
    assert [frame.time for frame in frames] == list(range(len(frames)))
    assert [frame.path.name for frame in frames] == sorted((frame.path.name for frame in frames), reverse=True)


def test_a_table_of_times_may_hold_empty_lines(tmp_path):
    (tmp_path / "times.csv").write_text("name,seconds\n\na,1\nb,2.5\n\n")
    assert read_times(tmp_path / "times.csv") == {"a": 1.0, "b": 2.5}
