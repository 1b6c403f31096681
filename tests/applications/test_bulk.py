"""Many images: the answers of single calls, in order, in bounded memory, from every source, in spite of bad ones."""

import io
import json
import os
import shutil
import sys
from dataclasses import replace
from functools import cache
from itertools import count, islice
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import omad
from helpers.command_line import laptop_view
from helpers.pages import blocks
from omad import Estimator, Frame, InputError, Observation, estimate_stream
from omad.applications.bulk import stream
from omad.applications.bulk.results import Results
from omad.applications.bulk.sources import open_sources
from omad.sensing.input_options import InputOptions

K = "600,600,319.5,239.5"
NUMBERS = tuple(map(float, K.split(",")))
READING = InputOptions(intrinsics=K)


@cache
def estimator() -> Estimator:
    return Estimator.from_pretrained("laptop", "cpu")


@cache
def depths() -> np.ndarray:
    """(6, 480, 640) uint16 millimetres: one view moved about, so that answers differ."""
    depth = np.rint(laptop_view().depth * 1000).astype(np.uint16)
    return np.stack([np.roll(depth, (3 * i, -5 * i), (0, 1)) for i in range(6)])


def masks() -> np.ndarray:
    """(6, 480, 640) bool: without some columns of the object."""
    return (depths() > 0) & (np.arange(640) % 7 > 0)


def observation(i: int, masked: bool = False) -> Observation:
    depth = (depths()[i] * 0.001).astype(np.float32)
    return Observation.from_depth(depth, NUMBERS, masks()[i] if masked else None)


@cache
def alone(i: int, masked: bool = False) -> omad.Estimate:
    return estimator()(observation(i, masked))


def assert_same(outcomes: list[stream.Outcome], masked: bool = False) -> None:
    """As single calls answer."""
    assert [outcome.refused for outcome in outcomes] == [None] * len(outcomes)
    for i, outcome in enumerate(outcomes):
        found, expected = outcome.estimate, alone(i, masked)
        assert found is not None
        assert found.joint_states == pytest.approx(expected.joint_states, abs=1e-6)
        assert found.T_camera_base == pytest.approx(expected.T_camera_base, abs=1e-6)
        assert found.beta == pytest.approx(expected.beta, abs=1e-5)


def test_answers_are_those_of_single_calls_in_order():
    outcomes = list(estimate_stream(estimator(), map(observation, range(6)), workers=3, batch=1))
    assert [outcome.name for outcome in outcomes] == list("012345")
    assert_same(outcomes)
    assert_same(list(estimate_stream(estimator(), map(observation, range(6)), workers=np.int64(2), batch=4)))


def test_a_bad_frame_is_told_of_in_its_place():
    def fails() -> Observation:
        raise RuntimeError("the cable\nis loose")

    depth = (depths()[0] * 0.001).astype(np.float32)
    frames = [
        Frame.of_depth("good", depth, NUMBERS),
        Frame.of_depth("empty", np.zeros((480, 640), np.float32), NUMBERS),
        Frame("loose", fails),
        Frame.of_depth("last", depth, NUMBERS, depth > 0),
    ]
    outcomes = list(estimate_stream(estimator(), frames, batch=4))
    assert [outcome.name for outcome in outcomes] == ["good", "empty", "loose", "last"]
    assert "no pixel holds a measurement" in (outcomes[1].refused or "")
    assert outcomes[2].refused == "RuntimeError: the cable is loose"
    assert_same([outcomes[0]])
    assert_same([outcomes[3]])


def test_a_frame_that_spoils_its_batch_is_told_of_alone(monkeypatch):
    def answered(self, view, *others):
        views = [view] if isinstance(view, Observation) else view
        if any("poison" in each.warnings for each in views):
            raise ValueError("singular")
        return usual(self, view, *others)

    usual = Estimator.__call__
    monkeypatch.setattr(Estimator, "__call__", answered)
    views = [observation(0), replace(observation(1), warnings=("poison",)), observation(2)]
    outcomes = list(estimate_stream(estimator(), views, batch=3))
    assert [outcome.refused for outcome in outcomes] == [None, "ValueError: singular", None]


def test_a_camera_may_write_each_image_over_the_last_one():
    depth = np.empty((480, 640))

    def camera():
        for image in depths():
            depth[:] = 0.001 * image
            yield Frame.of_depth("", depth, NUMBERS)

    assert_same(list(estimate_stream(estimator(), camera(), workers=2, batch=2)))


def test_frames_are_taken_only_shortly_before_they_are_needed():
    """So that an endless stream, as of a camera, takes no more memory than a short one."""
    taken = count()

    def endless():
        while True:
            next(taken)
            yield observation(0)

    outcomes = estimate_stream(estimator(), endless(), workers=2, batch=2)
    assert len(list(islice(outcomes, 5))) == 5
    outcomes.close()
    assert next(taken) <= 5 + (stream.IN_FLIGHT * 2 + 1) * 2


@pytest.fixture
def stored(tmp_path) -> Path:
    for folder, images in (("depth", depths()), ("mask", masks().astype(np.uint8) * 255)):
        (tmp_path / folder).mkdir()
        for i, image in enumerate(images):
            Image.fromarray(image).save(tmp_path / folder / f"{i}.png")
    np.save(tmp_path / "stack.npy", depths())
    np.save(tmp_path / "masks.npy", masks())
    np.savez(tmp_path / "both.npz", depth=(depths() * 0.001).astype(np.float32), mask=masks())
    return tmp_path


def outcomes_of(source) -> list[stream.Outcome]:
    return list(estimate_stream(estimator(), source.after(0), batch=6))


def test_folders_and_stacks_give_what_single_images_give(stored):
    folder, stack, both = stored / "depth", stored / "stack.npy", stored / "both.npz"
    assert_same(outcomes_of(open_sources([folder], READING)))
    assert_same(outcomes_of(open_sources([folder], replace(READING, mask=stored / "mask"))), masked=True)
    found = outcomes_of(open_sources([stack], replace(READING, mask=stored / "masks.npy")))
    assert [outcome.name for outcome in found] == [f"{stack}[{i}]" for i in range(6)]
    assert_same(found, masked=True)
    assert_same(outcomes_of(open_sources([both], READING)), masked=True)
    several = open_sources([folder, stack, folder / "3.png"], READING)
    assert several.total == 13
    names = [frame.name for frame in several.after(0)]
    assert [frame.name for frame in several.after(7)] == names[7:]


def test_nothing_in_a_folder_is_passed_over(stored, monkeypatch):
    """Neither a link whose file is missing, nor one that is called by no text, nor a folder that is not to be read."""
    (stored / "depth" / "gone.png").symlink_to(stored / "none.png")
    os.rename(stored / "depth" / "5.png", os.fsencode(stored / "depth") + b"/z\xff.png")
    *_, gone, odd = outcomes_of(open_sources([stored / "depth"], READING))
    assert "gone.png: no such file" in (gone.refused or "")
    assert (Path(odd.name).name, odd.refused) == (r"z\xff.png", None)
    json.dumps(odd.name).encode()
    np.savez(stored / "sole.npz", depths())
    assert open_sources([stored / "sole.npz"], READING).total == 6

    def closed(folder):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "scandir", closed)
    with pytest.raises(InputError, match=r"depth: cannot be listed \(Permission denied\)"):
        open_sources([stored / "depth"], READING)


def test_images_of_one_name_in_several_folders_have_each_their_mask(stored):
    for name in ("x", "y"):
        for kind in ("depth", "mask"):
            (stored / kind / name).mkdir()
            os.rename(stored / kind / f"{'xy'.index(name)}.png", stored / kind / name / "a.png")
    inputs, reading = [stored / "depth" / "x", stored / "depth" / "y"], replace(READING, mask=stored / "mask")
    assert_same(outcomes_of(open_sources(inputs, reading)), masked=True)
    os.rename(stored / "mask" / "x" / "a.png", stored / "mask" / "a.png")
    for name in ("x", "y"):
        shutil.rmtree(stored / "mask" / name)
    with pytest.raises(InputError, match=r"has one mask for .*x/a.png and .*y/a.png; lay those of .*y into .*mask/y"):
        open_sources(inputs, reading)


def test_an_image_without_intrinsics_is_refused_alone(stored):
    """Be it the first one."""
    (stored / "depth" / "1.json").write_text('{"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5}')
    first, second, *_ = outcomes_of(open_sources([stored / "depth"]))
    assert "0.png: a depth image needs --intrinsics" in (first.refused or "")
    assert second.refused is None


def test_stacks_of_label_images_are_read_by_their_number(stored):
    np.save(stored / "labels.npy", np.where(masks(), 3, 7).astype(np.uint8))
    reading = replace(READING, mask=stored / "labels.npy", mask_id=3)
    assert_same(outcomes_of(open_sources([stored / "stack.npy"], reading)), masked=True)


def test_the_number_of_an_object_needs_a_mask(stored):
    """Of stacks and Parquet files, too."""
    reading = replace(READING, mask_id=3)
    with pytest.raises(InputError, match="--mask-id 3: tells one of a mask's objects"):
        open_sources([stored / "stack.npy"], reading)
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pyarrow.table({"depth": [b""]}), stored / "bare.parquet")
    with pytest.raises(InputError, match="--mask-id 3: tells one of a mask's objects"):
        open_sources([stored / "bare.parquet"], reading)


def columns(form: str) -> dict[str, list]:
    """Of a Parquet file, with the views in one of its forms."""
    size = {"height": [480] * 6, "width": [640] * 6}
    if form == "raw":
        return {"depth": [d.tobytes() for d in depths()], "mask": [m.tobytes() for m in masks()], **size}
    if form == "numbers":
        return {"depth": [d.ravel() * 0.001 for d in depths()], "mask": [m.ravel() for m in masks()], **size}
    return {"depth": [list(d) for d in depths()], "mask": [list(m) for m in masks()], "intrinsics": [NUMBERS] * 6}


def test_parquet_gives_what_single_images_give(stored):
    parquet, table = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow").table
    file = stored / "views.parquet"
    for form in ("raw", "numbers", "rows"):
        parquet.write_table(table(columns(form)), file, row_group_size=4)
        source = open_sources([file], InputOptions() if form == "rows" else READING)
        assert_same(outcomes_of(source), masked=True)
    images = {kind: [(stored / kind / f"{i}.png").read_bytes() for i in range(6)] for kind in ("depth", "mask")}
    images |= {"intrinsics": [K] * 6, "id": list("abcdef")}
    parquet.write_table(table(images), file, row_group_size=4)
    source = open_sources([file])
    assert source.total == 6
    assert [frame.name for frame in source.after(0)] == list("abcdef")
    assert [frame.name for frame in source.after(5)] == ["f"]
    assert_same(outcomes_of(source), masked=True)
    labels = [Image.fromarray(np.where(mask, 3, 7).astype(np.uint8)) for mask in masks()]
    for i, image in enumerate(labels):
        image.save(stored / "mask" / f"{i}.png")
    numbered = images | {"mask": [(stored / "mask" / f"{i}.png").read_bytes() for i in range(6)]}
    parquet.write_table(table(numbered), file)
    assert_same(outcomes_of(open_sources([file], InputOptions(mask_id=3))), masked=True)
    np.savetxt(stored / "K.txt", np.eye(3))
    parquet.write_table(table(images | {"intrinsics": [str(stored / "K.txt")] * 6}), file)
    assert all("intrinsics" in (outcome.refused or "") for outcome in outcomes_of(open_sources([file])))
    images["depth"][2] = b"no image"
    parquet.write_table(table(images), file)
    refused = [outcome.refused for outcome in outcomes_of(open_sources([file]))]
    assert "depth: not readable as an image" in (refused.pop(2) or "")
    assert refused == [None] * 5


def test_a_file_at_an_address_that_was_written_anew_is_another(stored):
    parquet, table = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow").table
    file = stored / "views.parquet"
    parquet.write_table(table(columns("raw")), file)
    address = Path(file.as_uri())  # as a command line has it
    first, again = (open_sources([address], READING).fingerprint() for _ in range(2))
    os.utime(file, (1e9, 1e9))
    assert first == again != open_sources([address], READING).fingerprint()


def test_images_of_a_parquet_file_may_stand_beside_their_size(stored):
    """Which pixels without a shape of their own need, in the column beside."""
    parquet, table = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow").table
    png = [(stored / "mask" / "0.png").read_bytes()]
    views = {"depth": [depths()[0].tobytes()], "mask": png, "height": [480], "width": [640]}
    parquet.write_table(table(views), stored / "views.parquet")
    [frame] = open_sources([stored / "views.parquet"], READING).after(0)
    assert np.array_equal(frame.load().points, observation(0, masked=True).points)


def test_a_rows_own_scale_counts_more_than_the_one_for_all(stored):
    parquet, table = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow").table
    png = (stored / "depth" / "0.png").read_bytes()
    parquet.write_table(table({"depth": [png] * 2, "depth_scale": [2e-3, None]}), stored / "scales.parquet")
    own, usual = open_sources([stored / "scales.parquet"], replace(READING, depth_scale=1e-3)).after(0)
    np.testing.assert_allclose(own.load().points, 2 * usual.load().points, rtol=1e-6)


def test_a_rows_image_and_camera_may_tell_its_scale(stored):
    """As those of single images do."""
    parquet, table = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow").table
    told, plain, noted = PngInfo(), io.BytesIO(), io.BytesIO()
    told.add_text("depth_scale", "0.002")
    Image.fromarray(depths()[0]).save(plain, "PNG")
    Image.fromarray(depths()[0]).save(noted, "PNG", pnginfo=told)
    camera = json.dumps({**dict(zip(("fx", "fy", "cx", "cy"), NUMBERS, strict=True)), "depth_scale": 0.003})
    images = [plain.getvalue(), noted.getvalue(), noted.getvalue(), noted.getvalue()]
    columns = {"depth": images, "intrinsics": [None, None, camera, camera], "depth_scale": [None, None, None, 0.004]}
    parquet.write_table(table(columns), stored / "scales.parquet")
    usual, *others = (frame.load().points for frame in open_sources([stored / "scales.parquet"], READING).after(0))
    for times, points in zip((2, 3, 4), others, strict=True):
        np.testing.assert_allclose(points, times * usual, rtol=1e-6)


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"depth_scale": ["0.001"]}, r"depth_scale: is '0.001'; give numbers above 0"),
        ({"depth": [{"path": "x"}]}, "depth: its struct has no field bytes"),
        ({"height": ["a"], "width": [640]}, "height: is 'a'; give whole numbers from 1"),
        ({"height": [0], "width": [640]}, "height: is 0; give whole"),
        ({"height": [480], "width": [640.5]}, r"width: is 640\.5; give whole"),
    ],
)
def test_values_of_a_parquet_file_that_are_none_are_named(stored, columns, reason):
    parquet, table = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow").table
    png = (stored / "depth" / "0.png").read_bytes()
    parquet.write_table(table({"depth": [png]} | columns), stored / "odd.parquet")
    [frame] = open_sources([stored / "odd.parquet"], READING).after(0)
    with pytest.raises(InputError, match=reason):
        frame.load()
    parquet.write_table(table({"depth": [png], "height": [float("nan")], "width": [640.0]}), stored / "odd.parquet")
    [frame] = open_sources([stored / "odd.parquet"], READING).after(0)
    assert len(frame.load().points) > 50


def test_the_number_of_an_object_needs_a_mask_in_every_row(stored):
    """Or one for rows without."""
    parquet, table = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow").table
    labels = [np.where(mask, 3, 7).astype(np.uint8).tobytes() for mask in masks()[:1]]
    size = {"height": [480] * 2, "width": [640] * 2}
    views = {"depth": [depths()[i].tobytes() for i in range(2)], "mask": [*labels, None], **size}
    parquet.write_table(table(views), stored / "views.parquet")
    reading = replace(READING, mask_id=3)
    good, bad = outcomes_of(open_sources([stored / "views.parquet"], reading))
    assert_same([good], masked=True)
    assert bad.refused is not None
    assert bad.refused.startswith("mask: is null, and --mask-id 3 tells one of its objects; give the row a mask")
    np.save(stored / "labels.npy", np.where(masks()[1], 3, 7).astype(np.uint8))
    found = outcomes_of(open_sources([stored / "views.parquet"], replace(reading, mask=stored / "labels.npy")))
    assert_same(found, masked=True)


@pytest.mark.parametrize(
    ("inputs", "mask", "reason"),
    [
        ([], None, "no input"),
        (["."], None, "no depth image, cloud or Parquet file"),
        (["missing.png"], None, "no such file"),
        (["stack.npy"], "mask", "give a stack of masks"),
        (["stack.npy"], "few.npy", "that of its masks"),
        (["depth"], "masks.npy", "is a stack, but"),
        (["one_mask.npz"], None, "that of its masks"),
        (["broken.parquet"], None, "not readable as Parquet"),
        (["other.parquet"], None, "no column depth"),
        (["empty.parquet"], None, "holds no image"),
        (["unnamed.npz"], None, "holds a, b; name the array 'depth'"),
    ],
)
def test_what_cannot_be_read_at_all_is_said_at_once(stored, inputs, mask, reason):
    np.save(stored / "few.npy", masks()[:2])
    np.savez(stored / "one_mask.npz", depth=depths(), mask=masks()[0])
    np.savez(stored / "unnamed.npz", a=depths(), b=depths())
    (stored / "empty").mkdir()
    if any(name.endswith(".parquet") for name in inputs):
        parquet, table = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow").table
        (stored / "broken.parquet").write_bytes(b"PAR1")
        parquet.write_table(table({"image": [b""]}), stored / "other.parquet")
        parquet.write_table(table({"depth": [b""]}).slice(1), stored / "empty.parquet")
    paths = [stored / "empty" if name == "." else stored / name for name in inputs]
    with pytest.raises(InputError, match=reason):
        open_sources(paths, replace(READING, mask=None if mask is None else stored / mask))


def test_parquet_without_its_package_names_the_extra(stored, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    (stored / "views.parquet").touch()
    with pytest.raises(InputError, match=r"pip install 'omad\[parquet\]'"):
        open_sources([stored / "views.parquet"], READING)
    with pytest.raises(InputError, match=r"pip install 'omad\[parquet\]'"):
        Results.open(stored / "results.parquet", {})


def test_the_page_does_what_it_says(capsys):
    [code] = blocks(Path(__file__).parents[2] / "docs" / "bulk.md", "python")
    exec(code, {"depths": [(depth * 0.001).astype(np.float32) for depth in depths()[:2]], "K": NUMBERS})
    rows = [line.strip("]").split(" [") for line in capsys.readouterr().out.splitlines()]
    assert [name for name, _ in rows] == ["0", "1"]
    assert [float(state) for _, state in rows] == pytest.approx([alone(i).joint_states[0] for i in range(2)], abs=1e-6)
