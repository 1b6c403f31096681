"""Masks as other programs store them: grey ones as colours, with transparency, compressed; and what is none."""

import numpy as np
import pytest
from PIL import Image

from omad.common.errors import InputError
from omad.sensing.depth_files import parse_mask, read_mask
from omad.sensing.masks import as_mask

MASK = np.zeros((120, 160), dtype=bool)
MASK[20:90, 30:100] = True
LIKELY = np.where(MASK, 0.9, 0.1).astype(np.float32)


@pytest.mark.parametrize("channels", [[LIKELY] * 3, [*[LIKELY] * 3, np.ones_like(LIKELY)]])
def test_probabilities_stored_as_colours_are_probabilities(channels):
    np.testing.assert_array_equal(as_mask(np.stack(channels, -1)), MASK)


@pytest.mark.parametrize("alpha", [254, 200, 128])
def test_where_hardly_anything_is_transparent_the_colours_are_the_mask(alpha):
    stored = np.dstack([np.repeat(MASK[..., None] * 255, 3, 2), np.full(MASK.shape, 255)]).astype(np.uint8)
    stored[0, 0, 3] = alpha
    np.testing.assert_array_equal(as_mask(stored), MASK)
    stored[..., 3] = np.where(MASK, 255, alpha - 128)
    np.testing.assert_array_equal(as_mask(stored), MASK)


@pytest.mark.parametrize("colour", [(255, 255, 255), (255, 0, 0)])
def test_what_webp_blurs_is_no_part_of_the_mask(tmp_path, colour):
    Image.fromarray(np.uint8(MASK[..., None] * [colour])).save(tmp_path / "lossy.webp", quality=80)
    Image.fromarray(np.uint8(MASK[..., None] * [colour])).save(tmp_path / "lossless.webp", lossless=True)
    for name in ("lossy.webp", "lossless.webp"):
        for found in (read_mask(tmp_path / name), parse_mask((tmp_path / name).read_bytes(), name)):
            assert np.count_nonzero(found != MASK) <= (140 if name == "lossy.webp" else 0)  # half of the outline


def test_ids_in_a_lossy_image_are_refused_and_in_a_lossless_one_read(tmp_path):
    labels = Image.fromarray(np.where(MASK, 40, 90).astype(np.uint8))
    labels.save(tmp_path / "lossy.webp")
    with pytest.raises(InputError, match=r"lossy\.webp: compression has blurred its ids"):
        read_mask(tmp_path / "lossy.webp", 40)
    grey = Image.merge("LA", [labels, Image.new("L", labels.size, 255)])
    grey.save(tmp_path / "grey.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "grey.png", 40), MASK)


def test_what_is_no_probability_is_told_from_logits():
    with pytest.raises(InputError, match=r"from 0 to 230 are no probabilities; divide them"):
        as_mask(np.linspace(0, 230, MASK.size).reshape(MASK.shape))
    with pytest.raises(InputError, match="look like logits; pass mask > 0"):
        as_mask(np.linspace(-3, 4, MASK.size).reshape(MASK.shape))


def test_an_id_that_several_annotations_have_is_named():
    one = {"id": 5, "size": [120, 160], "counts": [120 * 160]}
    with pytest.raises(InputError, match=r"with the ids 5, 5; several of them are 5; give one"):
        as_mask({"annotations": [one, one]}, 5)
