"""What comes in from strangers: refused in one line, before it is unpacked."""

import json
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from PIL import Image

from omad.common import incoming, limits
from omad.common.decode import Shape, Within, decode
from omad.common.errors import InputError
from omad.common.incoming import read_arrays, read_image, read_json, read_text
from omad.common.limits import Limits
from omad.sensing.camera_files import read_camera
from omad.sensing.depth_files import parse_depth, read_cloud, read_depth, read_mask


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def small(monkeypatch):
    """Limits that small files go beyond."""
    few = Limits(image_pixels=1000, data_bytes=100_000, sent_bytes=50_000, text_bytes=2000, cloud_points=100)
    for module in (limits, incoming):
        monkeypatch.setattr(module, "limits", lambda: few)


def png_header(width: int, height: int) -> bytes:
    """A PNG that says to be so large, and holds next to nothing."""
    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(b"\0" * 100)), (b"IEND", b"")]
    made = b"\x89PNG\r\n\x1a\n"
    for kind, data in chunks:
        made += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return made


POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 100 100\n%%EndComments\nshowpage\n"


def test_a_depth_image_with_postscript_inside_starts_no_other_program(monkeypatch):
    monkeypatch.setattr("subprocess.Popen", lambda *a, **k: pytest.fail("another program was started"))
    monkeypatch.setattr("subprocess.check_call", lambda *a, **k: pytest.fail("another program was started"))
    for name in ("depth.png", "depth.tif"):
        Path(name).write_bytes(POSTSCRIPT)
        for read in (read_depth, read_mask):
            with pytest.raises(InputError, match=rf"{name}: not readable as an image"):
                read(name)


@pytest.mark.parametrize("size", [(2**31 - 1, 1), (20_000, 20_000), (9000, 9000)])
def test_an_image_that_says_to_be_huge_is_refused(size):
    Path("depth.png").write_bytes(png_header(*size))
    with pytest.raises(InputError, match=r"depth\.png: .*OMAD_LIMITS=image_(pixels|side)"):
        read_depth("depth.png")


def test_a_larger_image_may_be_allowed(small, monkeypatch):
    Image.fromarray(np.ones((49, 51), np.uint16)).save("depth.png")
    with pytest.raises(InputError, match="image_pixels") as refused:
        read_depth("depth.png")
    more = Limits.of_text(str(refused.value).rpartition("OMAD_LIMITS=")[2])
    for module in (limits, incoming):
        monkeypatch.setattr(module, "limits", lambda: more)
    assert read_depth("depth.png").shape == (49, 51)


def test_archives_that_unpack_to_too_much_are_refused(small):
    np.savez_compressed("cloud.npz", points=np.zeros((20_000, 3)))
    assert Path("cloud.npz").stat().st_size < 10_000
    with pytest.raises(InputError, match=r"cloud\.npz: .*OMAD_LIMITS=data_bytes"):
        read_cloud("cloud.npz")
    np.savez_compressed("sent.npz", depth=np.zeros((30, 300)))
    assert read_arrays(Path("sent.npz"), "NPZ")  # who has the file may unpack as much
    with pytest.raises(InputError, match=r"depth: .*OMAD_LIMITS=sent_bytes"):
        parse_depth(Path("sent.npz").read_bytes(), "depth")


def npy_claiming(shape: str) -> bytes:
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode()


@pytest.mark.parametrize("shape", ["(1000000000000, 3)", "(-1, 3)", "(10, 3)", "(99999999999999999999,)"])
def test_arrays_that_claim_more_than_there_is_are_refused(shape):
    Path("a.npy").write_bytes(npy_claiming(shape))
    with pytest.raises(InputError, match=r"a\.npy: not readable as NPY"):
        read_arrays(Path("a.npy"), "NPY")
    with zipfile.ZipFile("a.npz", "w") as archive:
        archive.writestr("points.npy", npy_claiming(shape))
    with pytest.raises(InputError, match=r"a\.npz: "):
        read_arrays(Path("a.npz"), "NPZ")


def test_arrays_of_objects_and_records_are_refused():
    np.save("objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    np.save("records.npy", np.zeros(3, dtype=[("a", "f4"), ("b", "f4")]))
    for name in ("objects.npy", "records.npy"):
        with pytest.raises(InputError, match=name):
            read_arrays(Path(name), "NPY")
    with zipfile.ZipFile("text.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(InputError, match=r"text\.npz"):
        read_cloud("text.npz")


def test_arrays_come_as_numpy_writes_them():
    rng = np.random.default_rng(0)
    for array in (rng.normal(size=(4, 3)), np.asfortranarray(rng.normal(size=(4, 3))), np.array("text"), np.zeros(0)):
        np.save("a.npy", array)
        np.savez_compressed("a.npz", one=array, two=array)
        again = read_arrays(Path("a.npz"), "NPZ")
        assert isinstance(again, dict)
        np.testing.assert_array_equal(read_arrays(Path("a.npy"), "NPY"), array)
        np.testing.assert_array_equal(again["two"], array)


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9)
)


@pytest.mark.parametrize(
    "text",
    [BOMB, "!!python/object/apply:os.system ['true']", "!!bool foo", "!!int ''", "!!timestamp x", "{a: [", "\0",
     "a: " + "[" * 5000, "[" * 100_000, '{"K": ' + "[" * 100_000, '{"fx": 1' + "0" * 400 + "}",
     '{"fx": 1, "fy": 1, "cx": 1, "cy": 1, "width": 1e400, "height": 3}',
     '{"fx": 1, "fy": 1, "cx": 1, "cy": 1, "coeffs": [1' + "0" * 400 + "]}",
     "fx: 1\nfy: 1\ncx: 1\ncy: 1\nwidth: .inf\nheight: 2", '{"fx": NaN, "fy": 1, "cx": 1, "cy": 1}'],
)  # fmt: skip
def test_camera_files_of_any_text(text):
    for name in ("camera.yaml", "camera.json", "camera.txt"):
        Path(name).write_text(text)
        with pytest.raises(InputError, match="camera"):
            read_camera(name)


@pytest.mark.parametrize("name", [None, 3, "a\0b", "x" * 5000, "x" * 300 + ".png", "no such.png", {}])
def test_paths_of_any_kind(name):
    for read in (read_depth, read_mask, read_cloud, read_camera):
        with pytest.raises(InputError):
            read(name)


@pytest.mark.parametrize("text", ["[" * 100_000, "{", "[NaN]", "", '{"a": ' + "9" * 5000 + "}"])
def test_broken_json_is_named(text):
    Path("a.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.json: not readable as JSON.*; mend it"):
        read_json(Path("a.json"), "mend it")


def test_json_may_begin_with_a_byte_order_mark():
    Path("a.json").write_text('\ufeff{"a": 1}', encoding="utf-8")
    assert read_json(Path("a.json"), "mend it") == {"a": 1}


def test_text_beyond_its_limit_is_not_read(small):
    Path("a.json").write_text(json.dumps([1] * 2000))
    with pytest.raises(InputError, match="OMAD_LIMITS=text_bytes"):
        read_text(Path("a.json"))


@pytest.mark.parametrize(
    "text", ["image_pixels", "pixels=3", "image_pixels=x", "image_pixels=nan", "links=0", "links=-1"]
)
def test_a_wrong_limit_is_named(text):
    with pytest.raises(InputError, match=r"OMAD_LIMITS: .*no limit"):
        Limits.of_text(text)


def test_limits_are_set_by_name():
    found = Limits.of_text(" image_pixels=2e8, links=7 ,")
    assert (found.image_pixels, found.links, found.parts) == (200_000_000, 7, Limits().parts)


@dataclass(frozen=True)
class Typed:
    count: Annotated[int, Within(1, 10)]
    places: Annotated[np.ndarray, Shape(None, 3)]
    names: dict[str, float]


def test_values_are_decoded_by_type():
    found = decode(Typed, {"count": 3, "places": [[1, 2, 3]], "names": {"a": 1}})
    assert found.places.shape == (1, 3)
    assert found.names == {"a": 1.0}


@pytest.mark.parametrize(
    ("field", "value"),
    [("count", 0), ("count", 11), ("count", True), ("count", 10**400), ("count", None), ("places", [[1, 2], [3]]),
     ("places", [["x"] * 3]), ("places", [[1, 2, 1e300]]), ("places", [[1, 2, float("nan")]]), ("places", None),
     ("places", [[1, 2, 10**400]]), ("names", []), ("names", {"a": 10**400}), ("names", {"a": "x"}), ("names", {1: 2})],
)  # fmt: skip
def test_values_of_another_kind_are_named(field, value):
    with pytest.raises(ValueError, match=f"^{field}"):
        decode(Typed, {"count": 3, "places": [[1, 2, 3]], "names": {}, field: value})


def test_thumbnails_keep_their_colours():
    image = Image.fromarray(np.full((4, 4, 3), (250, 10, 10), np.uint8)).quantize(4)
    image.save("a.png")
    np.testing.assert_allclose(read_image(Path("a.png"), "a.png", "RGB")[0, 0], [250, 10, 10], atol=3)
