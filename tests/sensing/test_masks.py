"""Masks in every form that people have them in, and the cure where it is none. COCO's strings are pycocotools' own."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.path import Path as Outline
from PIL import Image

from omad.common.errors import InputError
from omad.geometry.camera import Camera
from omad.sensing.depth_files import parse_mask, read_mask
from omad.sensing.masks import as_mask, check_size
from omad.sensing.observation import Observation

MASK = np.zeros((6, 9), dtype=bool)
MASK[2:5, 3:7] = True
PROBABILITY = np.where(MASK, 0.7, 0.2)
ROWS, COLUMNS = np.mgrid[:40, :60]
RING = ((COLUMNS - 30) ** 2 / 400 + (ROWS - 18) ** 2 / 120 < 1) & ~((COLUMNS - 25) ** 2 + (ROWS - 18) ** 2 < 20)
RING_COUNTS = "W>7P12N2N2N2O0O2O0O2O00E^O0a0OC0<0D0<OF0:0F0:0F0:1D0<0D0<2@0`0<00000000000000001N10001N101N101N2N2N2NR<"
"""What pycocotools.mask.encode says of the ring."""


def coloured(alpha: np.ndarray, colours: np.ndarray) -> np.ndarray:
    return np.dstack([np.repeat(colours[..., None], 3, 2), alpha]).astype(np.uint8)


@pytest.mark.parametrize(
    "form",
    [
        MASK,
        MASK[None],
        MASK[..., None],
        torch.tensor(MASK)[None],
        0.9 * torch.tensor(MASK).bfloat16(),
        MASK.astype(np.uint8) * 255,
        MASK * 255.0,
        PROBABILITY,
        PROBABILITY[None].astype(np.float16),
        coloured(np.full(MASK.shape, 255), MASK * 200),
        coloured(MASK * 255, np.full(MASK.shape, 90)),
        np.repeat(MASK[..., None], 3, 2),
    ],
)
def test_every_form_is_the_same_mask(form: object) -> None:
    found = as_mask(form)
    assert found.dtype == bool
    assert np.array_equal(found, MASK)


def test_which_of_a_label_image_is_asked_for(tmp_path: Path) -> None:
    labels = np.where(MASK, 3, 1).astype(np.uint8)
    labels[0] = 0
    Image.fromarray(labels).save(tmp_path / "labels.png")
    for refused in (lambda: as_mask(labels), lambda: as_mask(labels[None]), lambda: read_mask(tmp_path / "labels.png")):
        with pytest.raises(InputError, match=r"label image of 1, 3; give mask_id \(--mask-id\)"):
            refused()
    assert np.array_equal(as_mask(labels != 0), labels != 0)


def test_grey_edges_and_pictures_are_no_labels() -> None:
    smooth = np.where(MASK, 255, 0).astype(np.uint8)
    smooth[2, 3:6] = 60, 128, 200
    assert np.array_equal(as_mask(smooth), MASK)
    parts = np.where(MASK, np.uint8(255), np.uint8(0))  # as omad render labels what is no part, and VOC what is unclear
    parts[2, 3:6] = 1
    with pytest.raises(InputError, match=r"label image of 1, 255; .* mask != 0 for all"):
        as_mask(parts)
    labels = np.where(MASK, np.uint8(1), np.uint8(255))  # where the first part is 0
    labels[2, 3:5] = 0
    with pytest.raises(InputError, match=r"label image of 1, 255; .* mask != 255 for all"):
        as_mask(labels)
    picture = np.arange(1, 201).reshape(10, 20)
    assert as_mask(picture).all()


def several() -> np.ndarray:
    """Labels of two objects and a small third."""
    labels = np.where(MASK, 2, 0).astype(np.uint8)
    labels[0, :5], labels[5, 8] = 1, 3
    return labels


PALETTE = np.array([[0, 0, 0], [128, 0, 0], [0, 128, 0], [128, 128, 0]], np.uint8)
"""The first colours of PASCAL VOC."""


def test_a_palette_holds_labels(tmp_path: Path) -> None:
    image = Image.fromarray(several())
    image.putpalette(PALETTE.ravel().tolist())
    image.save(tmp_path / "palette.png")
    for read in (read_mask, lambda path, *given: parse_mask(path.read_bytes(), "mask", *given)):
        with pytest.raises(InputError, match=r"label image of 1, 2, 3; give mask_id \(--mask-id\)"):
            read(tmp_path / "palette.png")
        assert np.array_equal(read(tmp_path / "palette.png", 2), MASK)


def test_of_two_colours_or_greys_a_palette_is_a_picture(tmp_path: Path) -> None:
    red = [[0, 0, 0], [200, 30, 30]]
    smooth = np.where(MASK, 2, 0).astype(np.uint8)
    smooth[2, 3:7] = 1
    forms = {
        "red": (MASK, red, None),
        "inverted": (~MASK, red[::-1], None),
        "grey": (smooth, [[0, 0, 0], [128] * 3, [255] * 3], None),
        "transparent": (MASK, red[:1] * 2, 0),
        "empty": (MASK, red[:1] * 2, None),
    }
    for name, (numbers, colours, transparent) in forms.items():
        image = Image.fromarray(numbers.astype(np.uint8))
        image.putpalette(np.ravel(colours).tolist())
        image.save(tmp_path / f"{name}.png", transparency=transparent)
        assert np.array_equal(read_mask(tmp_path / f"{name}.png"), MASK), name


@pytest.mark.parametrize("alpha", [None, 255, "varies"])
def test_several_colours_are_several_objects(alpha: object) -> None:
    image = PALETTE[several()]
    if alpha is not None:
        opaque = several() > 0 if alpha == "varies" else np.ones(MASK.shape, bool)
        image = np.dstack([image, np.where(opaque, 255, 0).astype(np.uint8)])
    with pytest.raises(InputError, match=r"several objects, in 3 colours; give a label image .* \(--mask-id\)"):
        as_mask(image)
    image[several() != 2] = 0
    assert np.array_equal(as_mask(image), MASK)


def test_shades_of_one_colour_and_pictures_are_one_object() -> None:
    overlay = np.where(MASK[..., None], [220, 40, 35], 0).astype(np.uint8)
    overlay[2, 3:7] = [[120, 21, 19], [60, 12, 10], [7, 1, 2], [201, 36, 30]]
    overlay[4, 3:7] = 230, 230, 200  # a line around it
    assert np.array_equal(as_mask(overlay), MASK)
    picture = np.random.default_rng(0).integers(1, 255, (40, 60, 3)) * RING[..., None]
    assert np.array_equal(as_mask(picture.astype(np.uint8)), RING)


def test_a_grey_image_stored_as_colours_is_a_label_image(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="label image of 1, 2, 3"):
        as_mask(np.repeat(several()[..., None], 3, 2))


def test_an_id_picks_one_of_a_label_image(tmp_path: Path) -> None:
    labels = np.where(MASK, 3, 1).astype(np.uint8)
    labels[0] = 0
    assert np.array_equal(as_mask(labels, 3), MASK)
    image = Image.fromarray(labels)
    image.save(tmp_path / "grey.png")
    image.putpalette([0, 0, 0, 90, 10, 10, 10, 90, 10, 0, 0, 0])  # id 3 is as black as the background
    image.save(tmp_path / "palette.png")
    image = Image.fromarray(np.repeat(labels[..., None], 3, 2))
    image.save(tmp_path / "colours.png")
    for name in ("grey.png", "palette.png", "colours.png"):
        assert np.array_equal(read_mask(tmp_path / name, 3), MASK), name
    with pytest.raises(InputError, match=r"id 7; there are 0, 1, 3$"):
        as_mask(labels, 7)


def test_coco_run_lengths(tmp_path: Path) -> None:
    compressed = {"size": [40, 60], "counts": RING_COUNTS}
    ends = np.flatnonzero(np.diff(RING.T.ravel(), prepend=False))
    runs = np.diff([0, *ends, RING.size]).tolist()
    for counts in (RING_COUNTS, RING_COUNTS.encode(), runs, np.uint64(runs)):
        assert np.array_equal(as_mask({"size": [40, 60], "counts": counts}), RING)
    assert np.array_equal(as_mask({"size": list(np.int32([40, 60])), "counts": runs}), RING)
    (tmp_path / "annotation.json").write_text(json.dumps({"id": 5, "segmentation": compressed}), "utf-8-sig")
    assert np.array_equal(read_mask(tmp_path / "annotation.json"), RING)
    assert np.array_equal(parse_mask((tmp_path / "annotation.json").read_bytes(), "mask"), RING)


def test_masks_of_segmenters_are_taken_as_they_come() -> None:
    assert np.array_equal(as_mask(MASK[None, None]), MASK)
    assert np.array_equal(as_mask(np.where(MASK, 0.9, np.nan)), MASK)


@pytest.mark.parametrize("form", [MASK, torch.tensor(MASK)[None], MASK.astype(np.uint8)])
def test_an_annotation_may_hold_an_array(form: object) -> None:
    for size in ({}, {"size": None}, {"size": [6, 9]}, {"size": np.array([6, 9])}):
        assert np.array_equal(as_mask({"segmentation": form, "area": 12, "bbox": [3, 2, 4, 3]} | size), MASK)


def test_an_id_picks_one_of_the_labels_that_an_annotation_holds() -> None:
    labels = np.where(MASK, 7, 3)
    assert np.array_equal(as_mask({"segmentation": labels}, 7), MASK)
    file = {"annotations": [{"id": 2, "segmentation": MASK}, {"id": 4, "segmentation": ~MASK}]}
    assert np.array_equal(as_mask(file, 2), MASK)  # there it is an annotation's


def test_an_annotation_of_another_id_is_refused() -> None:
    one = {"id": 2, "segmentation": MASK}
    assert np.array_equal(as_mask(one, 2), MASK)
    with pytest.raises(InputError, match="the annotation has the id 2, not 4"):
        as_mask(one, 4)


@pytest.mark.parametrize("form", [int, float, np.uint8, np.int64, np.array, torch.tensor])
def test_ids_are_whole_numbers_of_any_kind(form: Callable) -> None:
    assert np.array_equal(as_mask(several(), form(2)), MASK)
    file = {"annotations": [{"id": 2, "segmentation": MASK}, {"id": 4, "segmentation": ~MASK}]}
    assert np.array_equal(as_mask(file, form(2)), MASK)
    if form in (int, np.int64):  # beyond what a float tells apart
        assert np.array_equal(as_mask(np.where(MASK, 2**53 + 1, 2**53), form(2**53 + 1)), MASK)


@pytest.mark.parametrize("wrong", ["1", 1.5, np.nan, pytest.param(10**400, id="long"), [1, 2], None.__class__])
def test_ids_that_are_none_are_refused(wrong: object) -> None:
    with pytest.raises(InputError, match=r"mask_id: is .*; give a whole number"):
        as_mask(several(), wrong)  # type: ignore[arg-type]


def test_an_annotation_of_a_whole_file(tmp_path: Path) -> None:
    ring = {"id": 5, "image_id": 1, "segmentation": {"size": [40, 60], "counts": RING_COUNTS}}
    triangle = {"id": 8, "image_id": 2, "segmentation": [[1, 1, 9, 1, 1, 9]]}
    images = [{"id": 1, "height": 40, "width": 60}, {"id": 2, "height": 20, "width": 30}]
    for number, file in enumerate([{"images": images, "annotations": [ring]}, {"image": {}, "annotations": [ring]}]):
        (tmp_path / f"{number}.json").write_text(json.dumps(file))
        assert np.array_equal(read_mask(tmp_path / f"{number}.json"), RING)
    both = {"images": images, "annotations": [ring, triangle]}
    assert np.array_equal(as_mask(both, 5), RING)
    assert as_mask(both, 8).shape == (20, 30)
    with pytest.raises(InputError, match="ids 5, 8"):
        as_mask(both, 6)


def test_a_list_of_annotations_is_as_a_file_of_them(tmp_path: Path) -> None:
    runs = {"size": [40, 60], "counts": RING_COUNTS}
    ring, other = {"id": 5, "segmentation": runs}, {"id": 8, "segmentation": {"size": [40, 60], "counts": [2400]}}
    for number, listed in enumerate(([ring], [{"category_id": 1, "segmentation": runs, "score": 0.9}], [runs])):
        (tmp_path / f"{number}.json").write_text(json.dumps(listed))
        assert np.array_equal(read_mask(tmp_path / f"{number}.json"), RING)
    assert np.array_equal(parse_mask(json.dumps([ring, other]).encode(), "mask", 5), RING)
    assert np.array_equal(as_mask([{"segmentation": MASK, "area": 12}]), MASK)
    with pytest.raises(InputError, match=r"2 annotations with the ids 5, 8; give mask_id \(--mask-id\)"):
        as_mask([ring, other])
    with pytest.raises(InputError, match=r"ids 5, 8; none of them is 7"):
        as_mask([ring, other], 7)
    for wrong in ([], [5], [ring, 5], [{"size": [40, 60]}]):
        with pytest.raises(InputError, match="holds no mask; give one COCO segmentation"):
            parse_mask(json.dumps(wrong).encode(), "mask")


def test_annotations_without_ids_are_told_by_their_place() -> None:
    runs = {"size": [40, 60], "counts": RING_COUNTS}
    listed = [{"segmentation": {"size": [40, 60], "counts": [2400]}, "area": 0}, {"segmentation": runs, "area": 9}]
    assert np.array_equal(as_mask(listed, 1), RING)
    with pytest.raises(InputError, match=r"2 annotations with the ids 0, 1; give mask_id \(--mask-id\)"):
        as_mask(listed)


def test_outlines_of_labelme(tmp_path: Path) -> None:
    def outlined(*shapes: dict) -> Path:
        table = {"version": "5.4.1", "shapes": shapes, "imageData": None, "imageHeight": 40, "imageWidth": 60}
        (tmp_path / "outlined.json").write_text(json.dumps(table))
        return tmp_path / "outlined.json"

    def square(left: int, **more: object) -> dict:
        corners = [[left, 10], [left + 8, 10], [left + 8, 20], [left, 20]]
        return {"label": "laptop", "points": corners, "group_id": None, "shape_type": "polygon", **more}

    expected = np.zeros((2, 40, 60), dtype=bool)
    expected[0, 10:20, 5:13] = expected[1, 10:20, 30:38] = True
    assert np.array_equal(read_mask(outlined(square(5))), expected[0])
    assert np.array_equal(read_mask(outlined(square(5), square(30)), 1), expected[1])
    assert np.array_equal(read_mask(outlined(square(5, group_id=1), square(30, group_id=1))), expected.any(0))
    with pytest.raises(InputError, match=r"2 annotations with the ids 0, 1; give mask_id"):
        read_mask(outlined(square(5), square(30)))
    with pytest.raises(InputError, match="kind 'circle'; draw polygons"):
        read_mask(outlined(square(5, shape_type="circle")))
    for wrong in (5, [5], None):
        with pytest.raises(InputError, match="as LabelMe writes them"):
            as_mask({"shapes": wrong})


@pytest.mark.parametrize(
    ("shape", "cure"),
    [((240, 320), "resize it"), ((640, 480), "turn it by 90 degrees"), ((720, 1280), "--color-intrinsics")],
)
def test_a_mask_of_another_size_is_told_what_it_may_be(shape: tuple[int, int], cure: str) -> None:
    with pytest.raises(InputError, match=cure):
        check_size(np.ones(shape, bool), (480, 640))


@pytest.mark.parametrize("quality", [30, 75, 95])
def test_several_colours_of_a_jpeg_are_refused_with_the_cure(tmp_path: Path, quality: int) -> None:
    rows, columns = np.mgrid[:120, :160]
    left, right = (columns < 70) & (rows > 20), (columns > 95) & (rows > 60)
    colours = PALETTE[np.where(left, 1, np.where(right, 2, 0))]
    Image.fromarray(colours).save(tmp_path / "two.jpg", quality=quality)
    for read in (read_mask, lambda path: parse_mask(path.read_bytes(), str(path))):
        with pytest.raises(InputError, match=r"two\.jpg: mask: shows several objects.*JPEG.*store it as PNG"):
            read(tmp_path / "two.jpg")
    slanted = abs(rows - columns) < 4  # all of it is edge
    for name, inside, colour in (("one", left, PALETTE[1]), ("thin", slanted, [200, 30, 160]), ("white", left, 255)):
        Image.fromarray(np.uint8(inside[..., None] * [colour] * np.ones(3))).save(tmp_path / "a.jpg", quality=quality)
        assert np.mean(read_mask(tmp_path / "a.jpg") != inside) < 0.02, name
    shaded = np.random.default_rng(0).integers(60, 255, (120, 160, 3)) * left[..., None]
    Image.fromarray(shaded.astype(np.uint8)).save(tmp_path / "picture.jpg", quality=quality)
    assert read_mask(tmp_path / "picture.jpg").any()


def test_floats_that_are_whole_numbers_are_as_integers() -> None:
    labels = np.where(MASK, 3.0, 7.0)
    assert np.array_equal(as_mask(labels, 3), MASK)
    smooth = np.where(MASK, 255.0, 0.0)
    smooth[2, 3:6] = 60, 128, 200
    assert np.array_equal(as_mask(smooth), MASK)


def test_a_string_that_goes_on_for_ever_is_refused_at_once() -> None:
    with pytest.raises(InputError, match="no string of COCO run lengths"):
        as_mask({"size": [40, 60], "counts": "o" * 10_000_000})


def test_polygons_of_any_kind_are_filled_as_another_program_fills_them() -> None:
    """Matplotlib, say: triangles partly or wholly outside of the image."""
    rng = np.random.default_rng(0)
    centres = np.stack(np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5), -1)
    for corners in rng.uniform(-10, 45, (20, 3, 2)):
        inside = Outline(corners).contains_points(centres.reshape(-1, 2)).reshape(30, 40)
        found = as_mask({"size": [30, 40], "segmentation": [corners.ravel().tolist()]})
        assert np.array_equal(found, inside)


def test_polygons_that_take_hours_are_refused() -> None:
    zigzag = [value for i in range(100_000) for value in (i % 7, 5000 * (i % 2))]
    with pytest.raises(InputError, match="too many corners"):
        as_mask({"size": [5000, 9000], "segmentation": [zigzag]})


def test_polygons() -> None:
    triangle, square = [1, 1, 9, 1, 1, 9], [20, 20, 24, 20, 24, 24, 20, 24]
    found = as_mask({"size": [40, 60], "segmentation": [triangle, square]})
    x, y = COLUMNS + 0.5, ROWS + 0.5
    expected = (x > 1) & (y > 1) & (x + y < 10) | (x > 20) & (x < 24) & (y > 20) & (y < 24)
    assert np.array_equal(found, expected)


@pytest.mark.parametrize(
    ("wrong", "cure"),
    [
        (np.where(MASK, 4.2, -3.1), "logits; pass mask > 0"),
        (np.stack([MASK] * 2), "holds 2 masks; pass one of them"),
        (MASK[0], r"shape \(H, W\)"),
        (np.full(MASK.shape, "a"), "booleans or numbers"),
        ([[0, 1], [1]], "booleans or numbers"),
        ({"counts": [1, 2]}, "size"),
        ({"size": [6, 9]}, "one annotation of a file"),
        ({"size": [6, 9], "counts": [50, 3]}, "run lengths"),
        ({"size": [6, 9], "counts": "W>7P12N"}, "run lengths"),
        ({"size": [6, 9], "counts": [50, [4]]}, "run lengths"),
        ({"size": [6, 9], "counts": [2**62, 2**62, 2**62, 2**62 + 54]}, "run lengths"),  # whose sum is 54 in 64 bits
        ({"size": [6, 9], "segmentation": [[1, 2, 3, 4]]}, "three corners"),
        ({"annotations": [], "images": []}, "size"),
        ({"annotations": [], "images": []}, '"annotations" holds none'),
        ({"annotations": [{"id": 4}, {"id": 7}]}, r"with the ids 4, 7; give mask_id \(--mask-id\)"),
        ({"annotations": [{"id": 4, "segmentation": [[1, 1, 9, 1, 1, 9]]}]}, "size"),
        ({"annotations": 3}, "annotations"),
        ({"size": [6, 9], "polygons": 5}, "three corners"),
        ({"size": [6, 9], "polygons": None}, "three corners|no list of numbers|NaN"),
        ({"size": [6, 9], "polygons": ["abc"]}, "no list of numbers"),
        ({"size": [6, 9], "polygons": [[1, 1, 5, 1, 1, float("nan")]]}, "NaN"),
        (np.where(MASK, 3.0, 7.0), r"label image of 3, 7; give mask_id \(--mask-id\)"),
    ],
)
def test_what_is_no_mask_is_refused_with_the_cure(wrong: object, cure: str) -> None:
    with pytest.raises(InputError, match=cure) as error:
        as_mask(wrong)
    assert "\n" not in str(error.value)


def test_a_coloured_image_has_no_ids() -> None:
    with pytest.raises(InputError, match="one channel"):
        as_mask(np.dstack([MASK, MASK, ~MASK]).astype(np.uint8), 1)


def test_masks_of_all_or_hardly_anything_are_named() -> None:
    depth, camera = np.full((400, 500), 1.5, np.float32), Camera(500, 400, 500.0, 500.0, 249.5, 199.5)
    speck = np.zeros(depth.shape, dtype=bool)
    speck[100:108, 100:108] = True
    assert "100%" in " ".join(Observation.from_depth(depth, camera, np.ones(depth.shape)).warnings)
    assert "hardly anything" in " ".join(Observation.from_depth(depth, camera, speck[None]).warnings)
    speck[100:200, 100:200] = True
    assert Observation.from_depth(depth, camera, speck).warnings == ()
    labels = np.where(speck, 2, 1)
    assert np.array_equal(Observation.from_depth(depth, camera, labels, mask_id=2).mask, speck)


def test_colours_that_are_no_numbers_are_nothing() -> None:
    image = np.zeros((4, 5, 3))
    image[1:3, 2, 0], image[0] = 0.8, np.nan
    assert np.array_equal(as_mask(image), image[..., 0] == 0.8)
