"""Files as people have them, and the one line they get when a file is not what it should be."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from omad.common.errors import InputError
from omad.common.files import write_atomic
from omad.geometry.lens import Distortion
from omad.sensing.camera_files import read_camera, read_intrinsics
from omad.sensing.depth_files import in_metres, is_cloud, parse_depth, read_cloud, read_color, read_depth, read_mask
from omad.sensing.observation import Observation

DEPTH_MM = np.arange(12, dtype=np.uint16).reshape(3, 4) * 100
CLOUD = np.random.default_rng(0).uniform(-1, 1, (60, 3)).astype(np.float32)
K = np.array([[600.0, 0, 319.5], [0, 601, 239.5], [0, 0, 1]])


def assert_one_line(error: pytest.ExceptionInfo, *words: str) -> None:
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message


# depth


def test_depth_png_is_millimetres_unless_a_scale_is_given(tmp_path: Path) -> None:
    path = tmp_path / "depth.png"
    Image.fromarray(DEPTH_MM).save(path)
    metres = read_depth(path)
    assert metres.dtype == np.float32
    assert np.allclose(metres, DEPTH_MM / 1000)
    assert np.allclose(read_depth(path, 1e-4), DEPTH_MM / 10000)


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float32, np.float64])
def test_depth_arrays(tmp_path: Path, dtype: type) -> None:
    expected = DEPTH_MM / 1000 if np.issubdtype(dtype, np.integer) else DEPTH_MM
    np.save(tmp_path / "depth.npy", DEPTH_MM.astype(dtype))
    np.savez(tmp_path / "one.npz", anything=DEPTH_MM.astype(dtype))
    np.savez(tmp_path / "named.npz", depth=DEPTH_MM.astype(dtype), other=np.zeros(3))
    for name in ("depth.npy", "one.npz", "named.npz"):
        assert np.allclose(read_depth(tmp_path / name), expected)


@pytest.mark.parametrize(("dtype", "stored"), [("u2", 65535), ("i4", 65535), ("i4", 2**31 - 1), ("i2", 32767)])
def test_the_largest_integer_is_no_measurement(tmp_path: Path, dtype: str, stored: int) -> None:
    image = DEPTH_MM.astype(dtype)
    image[1, 2] = stored
    np.save(tmp_path / "depth.npy", image)
    expected = DEPTH_MM / 1000
    expected[1, 2] = 0
    assert np.allclose(read_depth(tmp_path / "depth.npy"), expected)
    np.save(tmp_path / "depth.npy", image.astype(np.float32))
    assert read_depth(tmp_path / "depth.npy")[1, 2] == np.float32(stored)


@pytest.mark.parametrize("order", "<>")
def test_portable_maps_of_floats_and_integers(tmp_path: Path, order: str) -> None:
    """Floats stand the lowest row first; integers up to 2047, as a Kinect's, are not stretched to all of 16 bits."""
    head = b"Pf # made by hand\n4 3\n%d\n" % (-1 if order == "<" else 1)
    (tmp_path / "depth.pfm").write_bytes(head + (DEPTH_MM / 1000)[::-1].astype(f"{order}f4").tobytes())
    (tmp_path / "depth.pgm").write_bytes(b"P5\n4 3\n2047\n" + DEPTH_MM.astype(">u2").tobytes())
    for file in (tmp_path / "depth.pfm", tmp_path / "depth.pgm"):
        assert np.allclose(read_depth(file), DEPTH_MM / 1000)
        assert np.allclose(parse_depth(file.read_bytes(), "sent"), DEPTH_MM / 1000)
    for content in (
        b"PF\n4 3\n-1\n",
        head,
        b"P2\n4 3\n255\n",
        b"Pf\n-1 1\n-1\n" + bytes(4),
        b"P5\n4 3\n255\n" + bytes(12),
    ):
        (tmp_path / "broken.pfm").write_bytes(content)
        with pytest.raises(InputError) as error:
            read_depth(tmp_path / "broken.pfm")
        assert_one_line(error, "broken.pfm")


def test_depth_errors_say_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        read_depth(tmp_path / "none.png")
    assert_one_line(error, "none.png", "no such file")
    (tmp_path / "depth.exr").write_bytes(b"x")
    with pytest.raises(InputError) as error:
        read_depth(tmp_path / "depth.exr")
    assert_one_line(error, ".exr", ".png", ".npy")
    for mode in ("L", "RGB"):
        Image.new(mode, (4, 3)).save(tmp_path / "eight.png")
        with pytest.raises(InputError) as error:
            read_depth(tmp_path / "eight.png")
        assert_one_line(error, "eight.png", "16-bit")
    np.savez(tmp_path / "named.npz", rgb=np.zeros((4, 12, 3), np.uint8), depth_image=np.ones((4, 12)))
    np.savez(tmp_path / "cloud.npz", rgb=np.zeros((60, 3), np.uint8), xyz=np.ones((60, 3)))
    assert [is_cloud(tmp_path / name) for name in ("named.npz", "cloud.npz")] == [False, True]
    with pytest.raises(InputError) as error:
        read_depth(tmp_path / "named.npz")
    assert_one_line(error, "rgb, depth_image", "'depth'")
    for name in ("broken.png", "broken.npy", "broken.npz"):
        (tmp_path / name).write_bytes(b"not what it says")
        with pytest.raises(InputError) as error:
            read_depth(tmp_path / name)
        assert_one_line(error, name)
    Image.fromarray(DEPTH_MM.repeat(40, 0).repeat(40, 1)).save(tmp_path / "cut.png")
    whole = (tmp_path / "cut.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError) as error:
        read_depth(tmp_path / "cut.png")
    assert_one_line(error, "cut.png")
    np.save(tmp_path / "flat.npy", np.zeros(7))
    with pytest.raises(InputError) as error:
        read_depth(tmp_path / "flat.npy")
    assert_one_line(error, "flat.npy", "(7,)")
    np.savez(tmp_path / "two.npz", a=DEPTH_MM, b=DEPTH_MM)
    with pytest.raises(InputError) as error:
        read_depth(tmp_path / "two.npz")
    assert_one_line(error, "two.npz", "'depth'")
    np.save(tmp_path / "text.npy", np.array([["a"]]))
    with pytest.raises(InputError):
        read_depth(tmp_path / "text.npy")
    with pytest.raises(InputError) as error:
        read_depth(tmp_path / "one.png", depth_scale=-1)
    assert_one_line(error, "one.png")
    Image.fromarray(DEPTH_MM).save(tmp_path / "good.png")
    with pytest.raises(InputError) as error:
        read_depth(tmp_path / "good.png", depth_scale=0)
    assert_one_line(error, "scale", "0.001")


# clouds


def pcd(encoding: str, extra: bool) -> bytes:
    """A PCD file; with ``extra``, padding, normals of three and colour lie around the coordinates."""
    names = "_ x y z n rgb" if extra else "x y z"
    head = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {names}\nSIZE {'1 4 4 4 8 4' if extra else '4 4 4'}\n"
        f"TYPE {'U F F F F U' if extra else 'F F F'}\nCOUNT {'3 1 1 1 3 1' if extra else '1 1 1'}\n"
        f"WIDTH {len(CLOUD)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(CLOUD)}\nDATA {encoding}\n"
    )
    if encoding == "ascii":
        rows = [
            f"1 2 3 {x:.9f} {y:.9f} {z:.9f} 0 0 1 255" if extra else f"{x:.9f} {y:.9f} {z:.9f}" for x, y, z in CLOUD
        ]
        return (head + "\n".join(rows) + "\n").encode()
    if encoding == "binary_compressed":
        columns = CLOUD.T.tobytes()
        return head.encode() + by_lzf(bytes(3 * len(CLOUD)) + columns + bytes(28 * len(CLOUD)) if extra else columns)
    if not extra:
        return head.encode() + CLOUD.tobytes()
    table = np.zeros(len(CLOUD), [("_", "u1", 3), ("xyz", "<f4", 3), ("n", "<f8", 3), ("rgb", "<u4")])
    table["xyz"] = CLOUD
    return head.encode() + table.tobytes()


def by_lzf(data: bytes) -> bytes:
    """Compressed, as simply as may be, after both lengths: 32 bytes that are one are that one and a copy of it."""
    some = [data[at : at + 32] for at in range(0, len(data), 32)]
    made = b"".join(
        bytes([0, each[0], 7 << 5, 22, 0]) if each == each[:1] * 32 else bytes([len(each) - 1]) + each for each in some
    )
    return len(made).to_bytes(4, "little") + len(data).to_bytes(4, "little") + made


@pytest.mark.parametrize("extra", [False, True])
@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path: Path, encoding: str, extra: bool) -> None:
    (tmp_path / "cloud.pcd").write_bytes(pcd(encoding, extra))
    assert np.allclose(read_cloud(tmp_path / "cloud.pcd"), CLOUD, atol=1e-6)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_of_points_and_of_a_mesh(tmp_path: Path, encoding: str) -> None:
    trimesh.PointCloud(CLOUD, colors=np.full((60, 4), 200, np.uint8)).export(tmp_path / "cloud.ply", encoding=encoding)
    assert np.allclose(read_cloud(tmp_path / "cloud.ply"), CLOUD, atol=1e-6)
    trimesh.creation.box().export(tmp_path / "mesh.ply", encoding=encoding)
    assert read_cloud(tmp_path / "mesh.ply").shape == (8, 3)


def test_textures_that_a_ply_names_are_not_looked_for(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    lines = trimesh.creation.box().export(file_type="ply", encoding="ascii")
    named = lines.replace(b"format ascii 1.0\n", b"format ascii 1.0\ncomment TextureFile wood.png\n")
    (tmp_path / "mesh.ply").write_bytes(named)
    assert read_cloud(tmp_path / "mesh.ply").shape == (8, 3)
    assert not caplog.records


@pytest.mark.parametrize("delimiter", [" ", ",", "\t", ", "])
@pytest.mark.parametrize("name", ["cloud.xyz", "cloud.txt"])
def test_text_clouds_with_comments_and_colours(tmp_path: Path, name: str, delimiter: str) -> None:
    np.savetxt(tmp_path / name, np.hstack([CLOUD, CLOUD]), delimiter=delimiter, header="x y z r g b")
    assert np.allclose(read_cloud(tmp_path / name), CLOUD)
    (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + (tmp_path / name).read_bytes())  # as Windows writes it
    assert np.allclose(read_cloud(tmp_path / name), CLOUD)


def test_array_clouds(tmp_path: Path) -> None:
    np.save(tmp_path / "cloud.npy", CLOUD)
    np.savez(tmp_path / "cloud.npz", points=CLOUD, labels=np.zeros(60))
    np.save(tmp_path / "organised.npy", CLOUD.reshape(6, 10, 3))
    for name in ("cloud.npy", "cloud.npz", "organised.npy"):
        assert np.array_equal(read_cloud(tmp_path / name), CLOUD)


def test_cloud_errors_say_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        read_cloud(tmp_path / "none.ply")
    assert_one_line(error, "none.ply", "no such file")
    (tmp_path / "cloud.las").write_bytes(b"x")
    with pytest.raises(InputError) as error:
        read_cloud(tmp_path / "cloud.las")
    assert_one_line(error, ".las", ".ply", ".pcd", ".xyz")
    for name in ("a.ply", "a.pcd", "a.xyz", "a.npz"):
        (tmp_path / name).write_bytes(b"something\nelse\n")
        with pytest.raises(InputError) as error:
            read_cloud(tmp_path / name)
        assert_one_line(error, name)
    for encoding in ("binary", "binary_compressed"):
        (tmp_path / "cut.pcd").write_bytes(pcd(encoding, False)[:-100])
        with pytest.raises(InputError) as error:
            read_cloud(tmp_path / "cut.pcd")
        assert_one_line(error, "cut.pcd")
    (tmp_path / "packed.pcd").write_bytes(pcd("zipped", False))
    with pytest.raises(InputError) as error:
        read_cloud(tmp_path / "packed.pcd")
    assert_one_line(error, "zipped", "ascii or binary")
    np.save(tmp_path / "two.npy", CLOUD[:, :2])
    with pytest.raises(InputError) as error:
        read_cloud(tmp_path / "two.npy")
    assert_one_line(error, "(N, 3)", "(60, 2)")
    np.savetxt(tmp_path / "image.txt", np.ones((60, 200)))
    with pytest.raises(InputError) as error:
        read_cloud(tmp_path / "image.txt")
    assert_one_line(error, "image.txt", "depth image")


# intrinsics and masks


def test_intrinsics_in_every_form(tmp_path: Path) -> None:
    flat = K.ravel().tolist()
    forms = {
        "open3d.json": json.dumps({"width": 640, "height": 480, "intrinsic_matrix": K.T.ravel().tolist()}),
        "realsense.json": json.dumps(
            {"fx": 600.0, "fy": 601, "ppx": 319.5, "ppy": 239.5, "model": "none"}, indent="\t"
        ),
        "rows.json": json.dumps({"intrinsic_matrix": K.tolist()}),
        "scene_camera.json": json.dumps({number: {"cam_K": flat, "depth_scale": 0.1} for number in "01"}),
        "projection.txt": "\n".join(" ".join(map(str, row)) for row in np.c_[K, np.zeros(3)]),
        "homogeneous.txt": " ".join(map(str, np.block([[K, np.zeros((3, 1))], [np.eye(4)[3:]]]).ravel())),
        "plain.json": json.dumps({"fx": 600.0, "fy": 601, "cx": 319.5, "cy": 239.5}),
        "nested.json": json.dumps({"K": K.tolist()}),
        "ros1.yaml": f"height: 480\nwidth: 640\nD: [0, 0, 0, 0, 0]\nK: {flat}\nR: [1, 0, 0]\n",
        "ros2.yaml": "header:\n  frame_id: camera\nk:\n" + "".join(f"- {x}\n" for x in flat),
        "calibration.yaml": f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {flat}\n",
        "matrix.txt": "\n".join(" ".join(map(str, row)) for row in K),
        "four.txt": "# fx fy cx cy\n600 601 319.5 239.5\n",
        "rows.yaml": "".join(f"- [{', '.join(map(str, row))}]\n" for row in K),
        "named.json": json.dumps({"intrinsics": K.tolist()}),
        "two.json": json.dumps({"color": {"fx": 1, "fy": 1, "cx": 0, "cy": 0}, "depth": {"K": flat}}),
    }
    for name, content in forms.items():
        (tmp_path / name).write_text(content)
        assert np.allclose(read_intrinsics(tmp_path / name), K), name
        assert np.allclose(read_intrinsics(str(tmp_path / name)), K), name
    np.save(tmp_path / "K.npy", K)
    assert np.allclose(read_intrinsics(tmp_path / "K.npy"), K)
    assert np.allclose(read_intrinsics("600,601,319.5,239.5"), K)
    assert np.allclose(read_intrinsics("600, 601, 319.5, 239.5"), K)


def test_a_calibration_of_opencv(tmp_path: Path) -> None:
    """As ``cv::FileStorage`` writes it: a first line that is no YAML, and matrices with a tag of its own."""
    matrix = "{}: !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: {}\n"
    lens = [0.1, -0.2, 0.001, 0.002]
    written = f"%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n{matrix}{matrix}fisheye_model: {{}}\n"
    for fisheye, model in enumerate(("plumb_bob", "equidistant")):
        told = ("camera_matrix", 3, 3, K.ravel().tolist(), "distortion_coefficients", 4, 1, lens, fisheye)
        (tmp_path / "calibration.yml").write_text(written.format(*told))
        camera = read_camera(tmp_path / "calibration.yml")
        assert np.allclose(camera.K, K)
        assert camera.size == (640, 480)
        assert camera.distortion == Distortion(model, tuple(lens))


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("a.json", "{", "JSON"),
        ("b.json", '{"width": 640}', "ppx"),
        ("c.yaml", "K: [1, 2, 3]", "3x3"),
        ("d.yaml", "K: hello", "ppx"),
        ("e.txt", "hello", "ppx"),
        ("f.txt", "0 600 320 240", "pinhole"),
        ("g.txt", " ".join(map(str, K.T.ravel())), "row by row"),
        ("moved.txt", "600 0 320 30 0 600 240 0 0 0 1 0", "12 numbers"),
        ("skew.txt", "600 12 320 0 600 240 0 0 1", "skewed by 12 pixels"),
        ("turned.txt", "600 0 320 -9 600 240 0 0 1", "rectify"),
        ("h.yaml", "", "ppx"),
        ("rig.yaml", "cam0: {intrinsics: [600, 600, 320, 240]}\ncam1: {}", "several cameras"),
        ("i.yaml", "a: [", "YAML"),
    ],
)
def test_intrinsics_errors(tmp_path: Path, name: str, content: str, word: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as error:
        read_intrinsics(tmp_path / name)
    assert_one_line(error, name, word)


@pytest.mark.parametrize("text", ["600,600,320", "camera.json", "nan,600,320,240"])
def test_intrinsics_text_errors(text: str) -> None:
    with pytest.raises(InputError) as error:
        read_intrinsics(text)
    assert_one_line(error, text)


def test_masks(tmp_path: Path) -> None:
    mask = np.eye(4, dtype=bool)
    Image.fromarray(mask).save(tmp_path / "bits.png")
    Image.fromarray(mask.astype(np.uint8) * 255).save(tmp_path / "grey.png")
    colour = np.zeros((4, 4, 4), np.uint8)
    colour[..., 3] = 255  # opaque black is outside
    colour[mask, 1] = 200
    Image.fromarray(colour).save(tmp_path / "rgba.png")
    np.save(tmp_path / "mask.npy", mask)
    for name in ("bits.png", "grey.png", "rgba.png", "mask.npy"):
        assert np.array_equal(read_mask(tmp_path / name), mask), name
    with pytest.raises(InputError):
        read_mask(tmp_path / "none.png")


def test_colours_for_printers_are_those_that_are_printed(tmp_path: Path) -> None:
    image = Image.new("RGB", (8, 6), (200, 30, 60))
    image.save(tmp_path / "rgb.jpg", quality=95)
    image.convert("CMYK").save(tmp_path / "cmyk.jpg", quality=95)
    assert Image.open(tmp_path / "cmyk.jpg").mode == "CMYK"
    colours = [read_color(tmp_path / name).astype(int) for name in ("rgb.jpg", "cmyk.jpg")]
    assert colours[1].shape == (6, 8, 3)
    assert np.abs(colours[0] - colours[1]).max() < 10


# writing


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "out.json"
    write_atomic(path, lambda p: p.write_text("first"))
    assert path.read_text() == "first"

    def fail(temporary: Path) -> None:
        temporary.write_text("half")
        assert temporary.parent == path.parent
        assert temporary.suffix == ".json"
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_atomic(path, fail)
    assert path.read_text() == "first"
    assert [p.name for p in path.parent.iterdir()] == ["out.json"]
    (tmp_path / "plain").write_text("")
    assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_writing_below_a_file_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError) as error:
        write_atomic(tmp_path / "file" / "out.json", lambda p: p.write_text(""))
    assert_one_line(error, "out.json")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [1e-30, 1e300, 0.0, -0.001, float("nan")])
def test_a_depth_scale_that_none_can_be_is_refused(scale: float) -> None:
    with pytest.raises(InputError, match=r"^depth scale .*: give metres per stored integer, 0\.001 for millimetres"):
        in_metres(np.full((60, 80), 900, np.uint16), scale)
    with pytest.raises(InputError, match=r"^depth scale 5000: .* where 5000 integers are a metre, it is 0\.0002$"):
        in_metres(np.full((60, 80), 900, np.uint16), 5000)


@pytest.mark.filterwarnings("error")
def test_distances_of_nothing_are_refused() -> None:
    depth, points = np.full((60, 80), 1e-27, np.float32), np.random.default_rng(0).normal(size=(500, 3)) * 1e-27
    with pytest.raises(InputError, match=r"depth: median distance 1e-27 m is nothing .* check the depth scale"):
        Observation.from_depth(depth, (60, 60, 39.5, 29.5), segment="plane")
    with pytest.raises(InputError, match=r"points: median distance \S+ m is nothing"):
        Observation.from_points(points, segment="plane")
