"""What is shipped can tell that it is whole."""

import json
import shutil

import numpy as np
import pytest
from safetensors import safe_open

from omad import Estimator
from omad.common.errors import InputError
from omad.model.checkpoint import CHECKSUM, WEIGHTS, shipped_categories
from omad.model.surfaces.bank import FILE, ShapeBank


@pytest.mark.parametrize("path", sorted(WEIGHTS.rglob("model.safetensors")), ids=lambda p: str(p.relative_to(WEIGHTS)))
def test_weights_carry_a_checksum(path):
    with safe_open(path, "np") as file:
        assert len(file.metadata()[CHECKSUM]) == 64


@pytest.mark.parametrize("name", shipped_categories())
def test_what_lies_beside_carries_one_too(name):
    assert len(json.loads((WEIGHTS / name / "confidence.json").read_text())["sha256"]) == 64
    with np.load(WEIGHTS / name / FILE) as bank:
        assert len(str(bank["sha256"])) == 64


def same_bank(one: ShapeBank, other: ShapeBank) -> bool:
    same = (one.meshes, one.follows) == (other.meshes, other.follows)
    for key in ("basis", "keypoints"):
        same &= np.array_equal(getattr(one, key), getattr(other, key))
    return same and all(map(np.array_equal, one.shares.arrays().values(), other.shares.arrays().values()))


@pytest.mark.parametrize("name", ["model.safetensors", "surfaces.npz", "confidence.json"])
def test_a_turned_bit_is_noticed(name, tmp_path):
    """Anywhere: in a head, a number, or a checksum."""
    good = {path.name: path for path in (WEIGHTS / "laptop").iterdir() if path.is_file()}
    for each, path in good.items():
        shutil.copy(path, tmp_path / each)
    whole = Estimator.from_pretrained(tmp_path, "cpu").surfaces.bank
    content, rng = good[name].read_bytes(), np.random.default_rng(0)
    for place in rng.integers(0, len(content), 12):
        spoilt = bytearray(content)
        spoilt[place] ^= 1 << int(rng.integers(8))
        (tmp_path / name).write_bytes(spoilt)
        try:
            bank = Estimator.from_pretrained(tmp_path, "cpu").surfaces.bank  # which is read when it is needed
        except InputError as error:
            said = str(error)
        else:  # of an archive, a bit that tells no number may turn: when it was made, say
            said = FILE if same_bank(bank, whole) else ""
        assert name in said
